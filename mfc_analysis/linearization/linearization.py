"""The loop linearised at all times at once. Its methods call the functions of ``analysis``."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter, methodcaller
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.spectrum import PoleTable, pole_table, poles, root_rows
from mfc_analysis.analysis.stability import Stability, stability
from mfc_analysis.analysis.system import HORIZON, OpenSystem, checked_horizon, close_wires
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import Coordinates, External, closed_matrix, closed_system, external, open_system, without_wires
from mfc_analysis.dynamics.operating_point import CHUNK, OperatingPoint, chunks, nominal, residual
from mfc_analysis.errors import BadArgument, MfcWarning, UnknownPoint, Unsupported
from mfc_analysis.linearization.chunks import each, joined
from mfc_analysis.linearization.decentralised import Decentralised, decentralised
from mfc_analysis.linearization.start import chosen_coordinates, operating_points, start_at
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints
from mfc_analysis.simulation.simulation import Simulation

if TYPE_CHECKING:
    from control import FrequencyResponseData, StateSpace

    from mfc_analysis.analysis.comparison import Comparison
    from mfc_analysis.analysis.disk import DiskMargin
    from mfc_analysis.analysis.floquet import TransientGrowth
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.analysis.passivity import Passivity
    from mfc_analysis.analysis.port import Port, PortSystem
    from mfc_analysis.analysis.steps import Step, Steps
    from mfc_analysis.linearization.second_opinion import SecondOpinion
    from mfc_analysis.plots.figure import Axes

MANY_SAMPLES = 60  #: samples in transit above which the verdict counts roots instead of computing all of them


@dataclass(frozen=True, eq=False)
class Linearization:
    """A closed loop linearised exactly at m operating points; nx states, in deviations from them.

    A, B, C, D, ``poles``, ``system`` and ``loop`` leave out the dead time (``delay``, ``force_delay`` [s]); ``stable``, margins,
    frequency responses and ``delay_roots`` include it exactly. With a sample time all models are discrete (``dt`` > 0, poles in z)
    and include the dead time.

    Made by ``ClosedLoop.linearize`` from the ``equations`` of the loop at an operating ``point``, in ``coordinates`` "state" or "error".
    In its methods ``index`` is one of the m times (0: the first) and ``at`` an analysis point (None: the plant input). ``channel`` is one of its
    channels, by number or name; ``frequencies`` are w (k,) [rad/s]. ``ax``: to draw in; None: a new figure of pyplot.
    """

    equations: Equations
    point: OperatingPoint
    coordinates: Coordinates
    about: str | Array  #: "reference", "equilibrium", "simulation", or states of one's own (m, nx) at these times
    run: Simulation | None = None  #: the run that ``about="simulation"`` follows
    horizon: float = HORIZON  #: [s] of the verdict: roots with |s| < 1/horizon are slow

    def again(self, times: Array) -> Linearization:
        """The same loop, operating points and coordinates at other times (m,) [s]. Raises Unsupported where no state of one's own is known."""
        return linearize(self.equations, times, start_at(self.about, self.times, times), self.coordinates, self.run, self.horizon)

    # --- matrices ------------------------------------------------------------------------------------------------

    @property
    def times(self) -> Array:
        """(m,) [s] of the operating points."""
        return self.point.times

    @cached_property
    def residual(self) -> Array:
        """(m, n) residual acceleration [rad/s^2] (velocity plants: velocity [rad/s]) at the operating points; 0 at an equilibrium."""
        known = self.point.residual
        return residual(self.equations, self.times, self.point.x, nominal(self.equations, self.times)) if known is None else known

    @property
    def dt(self) -> float:
        """Sample time [s]; 0 for a continuous loop."""
        return self.equations.sample_time

    @property
    def delay(self) -> float:
        """Dead time [s] of the actuators that A, poles, system and loop leave out (0 in a sampled loop, which includes it)."""
        return 0.0 if self.dt else self.equations.actuators.delay

    @property
    def force_delay(self) -> float:
        """Dead time [s] of the force sensor that A, poles, system and loop leave out."""
        return 0.0 if self.dt else float(self.equations.hardware.force_delay or 0.0)

    @property
    def A(self) -> Array:
        """(m, nx, nx) state matrix of the closed loop."""
        return self._closed[0]

    @property
    def B(self) -> Array:
        """(m, nx, nu) input matrix: reference, disturbance at the joints, F_d."""
        return self._closed[1]

    @property
    def C(self) -> Array:
        """(m, ny, nx) output matrix: q, error, commanded torque, F_tip."""
        return self._closed[2]

    @property
    def D(self) -> Array:
        """(m, ny, nu) feedthrough matrix."""
        return self._closed[3]

    @cached_property
    def _closed(self) -> tuple[Array, Array, Array, Array]:
        if self.dt or "opened" in self.__dict__:
            return close_wires(self.opened)
        return closed_system(self.equations, self.times, self.point.x, self.coordinates)

    @cached_property
    def opened(self) -> OpenSystem:
        """The loop with every wire cut: the model that ``analysis`` works on."""
        return self._sampled() if self.dt else self._continuous

    @property
    def _continuous(self) -> OpenSystem:
        return replace(open_system(self.equations, self.times, self.point.x, self.coordinates), horizon=self.horizon)

    def _sampled(self, on_wires: bool = False) -> OpenSystem:
        from mfc_analysis.analysis.sampled import sampled

        return sampled(self._continuous, self.dt, on_wires=on_wires)

    @property
    def _samples_in_transit(self) -> float:
        """States that the dead times of a sampled loop take."""
        hardware = self.equations.hardware
        late = self.equations.n * hardware.command_delay + 6 * (hardware.force_delay or 0.0)
        return late / self.dt if self.dt else 0.0

    def opened_for(self, *at: str | None) -> OpenSystem:
        """``opened``; for the encoder, in state coordinates, in which the rate wire is the derivative of the position wire."""
        return self._opened_in_state if "position" in at and self.coordinates == "error" and not self.dt else self.opened

    @cached_property
    def _opened_in_state(self) -> OpenSystem:
        return replace(open_system(self.equations, self.times, self.point.x, "state"), horizon=self.horizon)

    @property
    def _external(self) -> External:
        if self.dt:
            return External(self.opened.state_names, self.opened.input_names, self.opened.output_names)
        return external(self.equations, self.coordinates)

    @property
    def state_names(self) -> tuple[str, ...]:
        """nx names; with a sample time they include the samples in transit."""
        return self._external.states

    @property
    def input_names(self) -> tuple[str, ...]:
        """nu names of the external inputs."""
        return self._external.inputs

    @property
    def output_names(self) -> tuple[str, ...]:
        """ny names of the external outputs."""
        return self._external.outputs

    # --- poles ---------------------------------------------------------------------------------------------------

    def poles(self, n_jobs: int | None = None) -> Complex:
        """(m, nx) closed-loop poles [1/s] (z-plane with a sample time), slowest first; without dead time. ``n_jobs`` as ``margins``."""
        if self._many:
            return np.concatenate(each(methodcaller("poles"), self._parts(), checks.jobs(n_jobs)))
        return poles(self.reduced)

    @cached_property
    def reduced(self) -> OpenSystem:
        """The loop without inputs, outputs and wires where those do not matter for its poles."""
        if self.dt:
            return self.opened
        unknown = {"opened", "_closed"}.isdisjoint(self.__dict__)
        A = closed_matrix(self.equations, self.times, self.point.x, self.coordinates) if unknown else self.A
        return replace(without_wires(self.equations, self.times, A), horizon=self.horizon)

    @cached_property
    def stability(self) -> Stability:
        """The verdict at each time over the horizon, dead time included."""
        if self._many:
            verdicts: list[Stability] = each(attrgetter("stability"), self._parts(), None)
            return joined(verdicts)
        return stability(self.judged if self._late or self._samples_in_transit > MANY_SAMPLES else self.reduced)

    @cached_property
    def judged(self) -> OpenSystem:
        """``opened``; where many samples are in transit, with z^-d on the wires in place of a state for each."""
        return self._sampled(on_wires=True) if self._samples_in_transit > MANY_SAMPLES else self.opened

    @property
    def stable(self) -> Bools:
        """(m,) True where the roots that are not slow decay, there are such roots, and nothing drifts; exact with dead time."""
        return self.stability.stable

    @property
    def slow(self) -> Ints:
        """(m,) roots with |s| < 1/horizon: free positions, ramps, creep."""
        return self.stability.slow

    @property
    def neutral(self) -> Ints:
        """(m,) slow roots where nothing drifts."""
        return self.stability.neutral

    @property
    def drifts(self) -> Bools:
        """(m,) True where the slow part keeps moving within the horizon: a position slides, a velocity ramps."""
        return self.stability.drifts

    def pole_table(self, index: int = 0) -> PoleTable:
        """Poles at one time with natural frequency, damping ratio and time constant, slowest first; dead time left out: see ``root_table``."""
        return pole_table(self.reduced, self._index(index))

    def root_table(self, index: int = 0, count: int = 6) -> PoleTable:
        """The ``count`` rightmost characteristic roots at one time, exact with dead time, as ``pole_table``; rightmost first. See ``delay_roots``."""
        i = self._index(index)
        return root_rows(self.again(self.times[i : i + 1]).delay_roots(count)[0], self.horizon)

    def delay_roots(self, count: int = 6) -> Complex:
        """(m, count) rightmost characteristic roots [1/s] with dead time, exact, rightmost first."""
        from mfc_analysis.analysis.delay.roots import delay_roots

        return delay_roots(self.opened, count)

    # --- python-control ------------------------------------------------------------------------------------------

    def system(self, index: int = 0, pade: int | None = None) -> StateSpace:
        """The closed loop at one time as a ``control.StateSpace`` with named signals.

        ``pade``: order (1 to 15) of the Pade approximation of its dead time; None: dead time is left out, with a warning and in its ``name``.
        """
        from mfc_analysis.linearization.exported import closed_model

        one = self._alone(self.opened, index)
        return closed_model(self._without_wire_delay(one, pade))

    def systems(self, pade: int | None = None) -> Iterator[StateSpace]:
        """``system`` at each of the m times, one after the other; ``pade`` likewise."""
        from mfc_analysis.linearization.exported import closed_model

        every = self._without_wire_delay(self.opened, pade)
        return (closed_model(every.at(slice(i, i + 1))) for i in range(len(self)))

    def loop(self, index: int = 0, at: str | None = None, channel: int | str | None = None, pade: int | None = None) -> StateSpace:
        """L(s) at one time, opened at ``at`` in one channel (default: the first), the others closed; negative feedback. ``pade`` as ``system``.

        Returns a ``control.StateSpace`` with one input and output. Raises UnknownPoint, and UnknownName for an unknown channel.
        """
        from mfc_analysis.linearization.exported import loop_model

        at = self._at(at)
        return loop_model(self._without_wire_delay(self._alone(self.opened_for(at), index), pade, at), at, channel)

    def second_opinion(self, index: int = 0, at: str | None = None, channel: int | str | None = None) -> SecondOpinion:
        """The metrics of python-control beside ours, of the same StateSpace at one time. Each difference is explained by a rule, or WATCH.

        ``channel`` None: the one with the smallest phase margin. Raises the errors of ``loop``.
        """
        from mfc_analysis.linearization.second_opinion import second_opinion

        at = self._at(at)
        return second_opinion(self._alone(self.opened_for(at), index), at, channel)

    def _alone(self, system: OpenSystem, index: int) -> OpenSystem:
        i = self._index(index)
        return system.at(slice(i, i + 1))

    def _without_wire_delay(self, system: OpenSystem, pade: int | None, at: str | None = None) -> OpenSystem:
        from mfc_analysis.analysis.pade import with_pade

        if pade is not None:
            return with_pade(system, pade, at)
        if self._late:
            late = f"the dead time, {self.equations.hardware.dead_time}, is left out"
            warnings.warn(f"{late}: pade=5 approximates it; lin.frd and lin.margins include it exactly", MfcWarning, stacklevel=3)
        return system

    @property
    def _late(self) -> bool:
        """Whether the matrices leave out dead time."""
        return bool(self.delay or self.force_delay)

    # --- margins and responses -----------------------------------------------------------------------------------

    def margins(self, at: str | None = None, n_jobs: int | None = None) -> Margins:
        """One-loop-at-a-time margins at ``at``, the others closed: (m, n) metrics. Raises UnknownPoint.

        ``n_jobs``: processes for the chunks of 500 times; None: set by ``joblib.parallel_config``, else one. The numbers are the same.
        """
        from mfc_analysis.analysis.margins import margins

        at = self._at(at)
        if self._many:
            parts: list[Margins] = each(methodcaller("margins", at), self._parts(), checks.jobs(n_jobs))
            return joined(parts)
        return margins(self.opened_for(at), at, self.stability if self.opened.delayed else None)

    def disk_margin(self, at: str | Sequence[str] | None = None, frequencies: ArrayLike | None = None, n_jobs: int | None = None) -> DiskMargin:
        """Disk margin of all loops at once (m,), at one analysis point or several together; ``n_jobs`` as ``margins``.

        ``frequencies`` (nf,) [rad/s]: only at these; None: at all, exact. Raises UnknownPoint, and BadArgument for other frequencies.
        """
        from mfc_analysis.analysis.disk import disk_margin

        points = tuple(self._at(one) for one in at) if isinstance(at, (list, tuple)) and at else (self._at(at),)
        if self._many:
            parts: list[DiskMargin] = each(methodcaller("disk_margin", points, frequencies), self._parts(), checks.jobs(n_jobs))
            return joined(parts, bound=min(parts, key=lambda part: np.nan_to_num(part.worst()[0], nan=np.inf)).bound)
        grid = None if frequencies is None else checks.array("frequencies", frequencies, (None,))
        return disk_margin(self.opened_for(*points), points[0] if len(points) == 1 else points, grid)

    def frequency_response(self, frequencies: ArrayLike, at: str | None = None) -> Complex:
        """(m, n, nf) loop transfer functions L_i(j w) at w [rad/s], each opened alone; dead time included. Raises UnknownPoint."""
        from mfc_analysis.analysis.frequency.response import frequency_response

        w = checks.frequencies(frequencies)
        at = self._at(at)
        return frequency_response(self.opened_for(at), w, at)

    def port(self, frequencies: ArrayLike, at: str = "tool") -> Port:
        """(m, k, 6, 6) driving-point admittance Y(jw) of the loop as given, in contact or not, at w (k,) [rad/s] > 0, dead time exact.

        ``at`` "tool": from the wrench F [N, Nm] on the robot at the tool origin to its body twist [m/s, rad/s], tool frame; a force sensor sees -F.
        "joints": from torques to joint velocities, (m, k, n, n). With a sample time: the part of the velocity at the frequency of the force, see
        ``analysis.port``. Raises BadArgument (frequencies, ``at``).
        """
        from mfc_analysis.analysis.port import Port, admittance

        w = checks.frequencies(frequencies)
        if np.any(w <= 0):
            raise BadArgument("frequencies", frequencies, "finite frequencies > 0 [rad/s]")
        port = self._port(at)
        return Port(self.times, at, port.names, w, admittance(port, w), self.dt)

    def passivity(self, at: str = "tool") -> Passivity:
        """Whether the port is passive at each of the m times: no passive environment then makes the loop unstable. ``at`` as ``port``.

        Where it is not: over which frequencies, in which direction, and how much damping at the port makes it so. One-sided surfaces of the loop
        count as touched. Where the tool may leave them the arm must be passive without them too, which is asked of the loop without surfaces.
        Raises BadArgument.
        """
        from mfc_analysis.analysis.passivity import passivity

        return passivity(self._port(at), at, self.stability)

    def _port(self, at: str) -> PortSystem:
        from mfc_analysis.linearization.port import port_system

        own = self if self.coordinates == "state" else replace(self, coordinates="state")
        return port_system(self.equations, own.opened, self.point.x, at)

    def frd(self, frequencies: ArrayLike, at: str | None = None, channel: int | str | None = None, index: int = 0) -> FrequencyResponseData:
        """L(jw) at w [rad/s] of one channel at one time as ``control.FrequencyResponseData``, dead time included. Raises the errors of ``loop``.

        The other channels are closed with their dead time too, so it is not ``loop`` times exp(-jwT).
        """
        from mfc_analysis.linearization.exported import measured_model

        at = self._at(at)
        return measured_model(self._alone(self.opened_for(at), index), checks.frequencies(frequencies), at, channel)

    def compare(self, frd: Any, at: str | None = None, channel: int | str | None = None, index: int = 0) -> Comparison:
        """A measured L(jw) of one channel (default: the first) over the model's at one time: misfit, margins of both, and a verdict in words.

        ``frd``: of ``mfc.frf.estimate``, or a ``control.FrequencyResponseData``, of L in negative feedback. Raises BadArgument and those of ``loop``.
        """
        from mfc_analysis.analysis.comparison import Comparison, measured_loop

        w, L, deviation = measured_loop(frd, self.dt)
        at, i = self._at(at), self._index(index)
        model = self.frd(w, at, channel, i)
        found = self.again(self.times[i : i + 1]).margins(at)
        j = 0 if channel is None else found.channels.index(channel) if isinstance(channel, str) else channel
        return Comparison(at, found.channels[j], float(self.times[i]), w, L, model.frdata[0, 0], deviation, found.channel(j))

    def step(
        self, index: int = 0, input: int | str = 0, output: int | str = 0, duration: float | None = None, *, times: ArrayLike | None = None
    ) -> Step:
        """Unit step response of the closed loop at one time, with its metrics.

        ``input``, ``output``: one of ``input_names`` and ``output_names``, or its number. ``duration`` [s] of its samples, or their ``times``
        (k,) [s]; omitted: about twice the settling time. Raises UnknownName, BadArgument.
        """
        from mfc_analysis.analysis.steps import step

        return step(self.opened, self._index(index), input, output, duration, times)

    def steps(self, times: ArrayLike, inputs: Sequence[int | str] | None = None, outputs: Sequence[int | str] | None = None) -> Steps:
        """All unit step responses at all m times of the path, as one batch, sampled at ``times`` (k,) [s] after the step, with their metrics.

        ``inputs``, ``outputs``: names or numbers; omitted: all. Raises UnknownName, and BadArgument for times that do not increase from 0 on.
        """
        from mfc_analysis.analysis.steps import steps

        return steps(self.opened, times, inputs, outputs)

    def decentralised(self) -> Decentralised:
        """The same gains on diag(M) and diag(dg/dq): n separate loops. Raises Unsupported for laws that are not decentralised."""
        return decentralised(self.equations, self.point)

    def transient_growth(self) -> TransientGrowth:
        """Largest singular value of the transition matrix Phi(t, 0) along the path (linear time-varying)."""
        from mfc_analysis.linearization.growth import transient_growth

        if self._late:
            raise Unsupported("hardware.delay", self.delay or self.force_delay, "a sample_time with it: without one Phi has infinite dimension")
        return transient_growth(self.times, self.dt, lambda times: self.again(times).A)

    # --- pictures: dead time included; drawn with pyplot unless ``ax`` is given ------------------------------------

    def plot_bode(
        self, index: int = 0, at: str | None = None, channel: int | str | None = None, *, ax: Axes | tuple[Axes, Axes] | None = None
    ) -> Axes:
        """Bode plot of L(jw) at one time with its margins, opened at ``at``; ``channel`` None: the one with the smallest phase margin.

        ``ax``: two Axes for magnitude and phase, or one that is divided. Returns that of the magnitude. Raises the errors of ``loop``.
        """
        from mfc_analysis.linearization.pictures import bode

        at = self._at(at)
        return bode(self._alone(self.opened_for(at), index), at, channel, ax)

    def plot_nyquist(self, index: int = 0, at: str | None = None, channel: int | str | None = None, *, ax: Axes | None = None) -> Axes:
        """Nyquist plot of L(jw) with its margins and the disk of radius 1/Ms about -1. Arguments as ``plot_bode``."""
        from mfc_analysis.linearization.pictures import nyquist

        at = self._at(at)
        return nyquist(self._alone(self.opened_for(at), index), at, channel, ax)

    def plot_poles(self, index: int = 0, *, damping: float | None = None, ax: Axes | None = None) -> Axes:
        """Closed-loop poles at one time; with dead time its rightmost roots, exact. ``damping``: a damping ratio to be drawn as a ray."""
        from mfc_analysis.linearization.pictures import poles

        return poles(self._alone(self.opened, index), damping, ax)

    # --- many points ---------------------------------------------------------------------------------------------

    @property
    def _many(self) -> bool:
        return len(self.times) > CHUNK

    def _parts(self) -> Iterator[Linearization]:
        """This linearisation, ``CHUNK`` times at a time."""
        for some in chunks(self.point):
            yield replace(self, point=some, run=None)

    # --- arguments and text --------------------------------------------------------------------------------------

    def _at(self, at: object) -> str:
        if at is not None and not isinstance(at, str):
            raise UnknownPoint(at, type(self.equations.law).__name__, self.equations.law.opens_at)
        return self.equations.actuator if at is None else at

    def _index(self, index: int) -> int:
        m = len(self.times)
        return checks.whole("index", index, -m, m - 1, f"an integer from 0 to {m - 1}: which of the {m} times") % m

    def __len__(self) -> int:
        return len(self.times)

    def __str__(self) -> str:
        stable = self.stable
        t = self.times
        when = f"t = {t[0]:g} s" if len(t) == 1 else f"{len(t)} times from {t[0]:g} to {t[-1]:g} s"
        kind = f"discrete, dt = {self.dt:g} s" if self.dt else "continuous"
        late, residual = self.equations.hardware.dead_time, float(np.abs(self.residual).max(initial=0.0))
        return (
            f"{self.equations.law} on {self.equations.robot.name}, linearised at {when} "
            f"({kind}; coordinates {self.coordinates!r})\n"
            f"stable at {int(stable.sum())} of {len(stable)} times; slow roots {int(self.slow.max(initial=0))}; "
            f"drifts {'yes' if self.drifts.any() else 'no'}; largest residual {round(residual, 9):.3g}"
            + (f"\ndead time {late}: A, poles, system and loop are without dead time; verdict, margins and delay_roots include it" if late else "")
        )

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        title, *notes = str(self).splitlines()
        worst = int(np.argmin(self.stable))
        found = self.root_table(worst) if self._late else self.pole_table(worst)
        rows = [(f"{p.value:.5g}", f"{p.frequency:.4g}", f"{p.damping:.3g}", f"{p.time_constant:.4g}") for p in found]
        what = "rightmost roots, dead time included," if self._late else "poles"
        name = "root [1/s]" if self._late else "pole [z]" if self.dt else "pole [1/s]"
        return table(f"{title}; {what} at t = {self.times[worst]:g} s", (name, "wn [rad/s]", "damping", "time constant [s]"), rows, notes)


def linearize(
    equations: Equations,
    times: Array,
    about: str | ArrayLike = "reference",
    coordinates: Coordinates | None = None,
    run: Simulation | None = None,
    horizon: float = HORIZON,
) -> Linearization:
    """Implements ``ClosedLoop.linearize``: times (m,) [s], strictly increasing; ``horizon`` [s].

    Raises BadArgument, NearSingular (names time, frame, smallest singular value), NotConverged.
    """
    horizon = checked_horizon(horizon, equations.sample_time)
    point = operating_points(equations, times, about, run)
    asked = about if isinstance(about, str) else point.x
    return Linearization(equations, point, chosen_coordinates(equations, coordinates, point), asked, run, horizon)
