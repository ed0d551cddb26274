"""Nonlinear simulation: the equations of the loop in scipy's ``solve_ivp``.

Without dead time and sampling: one run, LSODA with the exact Jacobian. With dead time: method of steps, segments no longer than
the shortest dead time. With a sample time: sample by sample, the torque held, the law's own states advanced as the discrete
model advances them. Where a one-sided surface is touched or left a run goes on with a fresh start of the solver, and logs an event.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.equations import Equations, warn_near_singular
from mfc_analysis.dynamics.flow import Flow, Inputs
from mfc_analysis.dynamics.jacobians import closed_matrix, external, matrix_at
from mfc_analysis.dynamics.operating_point import OperatingPoint
from mfc_analysis.errors import BadArgument, MfcError, UnknownName, Unsupported
from mfc_analysis.laws.law import TWIST, WRENCH
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import value
from mfc_analysis.simulation.delayed import run_with_dead_time
from mfc_analysis.simulation.run import FAR, DenseOutput, Disturbance, Outcome, Run, bounded, most_evaluations
from mfc_analysis.simulation.sampled import run_sampled
from mfc_analysis.simulation.touching import Event

if TYPE_CHECKING:
    from control import TimeResponseData

    from mfc_analysis.plots.figure import Axes

SIGNALS = {
    "error": "error [rad, m]", "q": "q [rad, m]", "v": "v [rad/s, m/s]", "tau": "torque at the joints [Nm, N]", "command": "command [Nm, N]",
    "twist": "twist [m/s, rad/s]", "force": "F_tip [N, Nm]",
}  # fmt: skip
METHODS = ("LSODA", "Radau", "BDF", "RK45", "RK23", "DOP853")
SHORTEST = 1e-9  #: [s] shortest run; a shorter one raises BadArgument
GRAIN = 1e-12  #: of a time (of 1 s where it is earlier), below which two times of a run count as one


@dataclass(frozen=True, eq=False)
class Motion:
    """The states of a nonlinear run at k times."""

    t: Array  #: (k,) [s]
    x: Array  #: (k, nx)
    outcome: Outcome  #: how it ended
    message: str  #: what happened and when, a sentence
    path: DenseOutput = field(repr=False)  #: the states between the samples
    evaluations: int  #: of the equations: the work of the run, as ``max_evaluations`` counts it
    arrived: Callable[[float], Array] | None = field(repr=False)  #: with dead time or sampling: t -> (n,) command at the joints

    @property
    def diverged(self) -> bool:
        """True where the run stopped before its end; ``message`` says why and when, the arrays end there."""
        return self.outcome is not Outcome.FINISHED

    @property
    def end(self) -> float:
        """Last time reached [s]."""
        return float(self.t[-1])

    def state(self, t: ArrayLike) -> Array:
        """(m, nx) state at times ``t`` (m,) [s] within the run, from the solver's dense output. Raises BadArgument outside."""
        times = checks.vector("times", t)
        if times.size == 0 or np.any(times < self.t[0] - 1e-12) or np.any(times > self.t[-1] + 1e-12):
            raise BadArgument("times", t, f"times within the run, {self.t[0]:g} to {self.t[-1]:g} s")
        return self.path.along(times)


@dataclass(frozen=True, eq=False)
class Simulation(Motion):
    """A nonlinear run at k times."""

    t: Array  #: (k,) [s]
    x: Array  #: (k, nx) states in the order of ``state_names``
    q: Array  #: (k, n) [rad, m]
    v: Array  #: (k, n) [rad/s, m/s]
    tau: Array  #: (k, n) torque at the joints, after dead time, limit and lag [Nm] (velocity laws: velocity [rad/s])
    command: Array  #: (k, n) command of the law [Nm] (velocity laws: velocity [rad/s])
    error: Array  #: (k, n) e = q_d - q [rad, m], or X_e of tool laws, (k, 6) or its selected directions
    twist: Array  #: (k, 6) body twist of the tool [m/s, rad/s]
    force: Array  #: (k, 6) F_tip, tool frame [N, Nm]
    events: tuple[Event, ...]  #: contact made and lost
    state_names: tuple[str, ...]  #: (nx,) names of the states
    output_names: tuple[str, ...]  #: names of the outputs of ``response``, as those of the linearised loop

    def operating_point(self, times: Array) -> OperatingPoint:
        """The run as operating points at times (m,) [s], to linearise along. Raises BadArgument outside the run."""
        times = checks.times(times)
        return OperatingPoint(times, self.state(times), np.zeros((len(times), self.q.shape[1])))

    def plot(self, signal: str = "error", *, ax: Axes | None = None) -> Axes:
        """One signal of the run against time, with its contact events.

        Args:
            signal: "error", "q", "v", "tau", "command", "twist" or "force". ax: to draw in; None: a new figure of pyplot.

        Raises UnknownName for another signal.
        """
        from mfc_analysis import plots

        if signal not in SIGNALS:
            raise UnknownName("signal", signal, SIGNALS)
        joints = tuple(name.removeprefix("q_") for name in self.output_names[: self.q.shape[1]])
        columns = {
            "error": tuple(x for x in self.output_names if x.startswith(("e_", "X_e_")))[: self.error.shape[1]],
            "twist": TWIST,
            "force": WRENCH,
        }
        names = tuple(x.removeprefix("e_").removeprefix("X_e_") for x in columns.get(signal, joints))
        events, panel = [(event.time, str(event.kind)) for event in self.events], plots.Panel(SIGNALS[signal], getattr(self, signal))
        return plots.traces(self.t, (panel,), names, events=events, title="Simulation", axes=plots.shown("time history", ax))[0]

    @property
    def response(self) -> TimeResponseData:
        """The run for python-control: outputs q, error, command (and F_tip with a surface) (ny, k), states (nx, k), named as in ``lin.system``."""
        from control import TimeResponseData

        force = any(name.startswith("F_tip") for name in self.output_names)
        y = np.concatenate([self.q, self.error, self.command, *([self.force] if force else [])], axis=1)
        return TimeResponseData(
            self.t, y.T, self.x.T, output_labels=list(self.output_names), state_labels=list(self.state_names), title="Simulation", issiso=False
        )

    def __str__(self) -> str:
        return f"simulation from {self.t[0]:g} to {self.t[-1]:g} s, {len(self.t)} samples, {len(self.events)} contact events: {self.message}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        rows = []
        for name, values in (("error", self.error), ("velocity", self.v), ("torque", self.tau), ("force", self.force)):
            size = np.abs(values).max(axis=1)
            rows.append((name, f"{size.max():.4g}", f"{self.t[int(np.argmax(size))]:.4g}", f"{size[-1]:.4g}"))
        return table(str(self), ("signal", "largest", "at [s]", "at the end"), rows)


def simulate(
    equations: Equations,
    times: float | ArrayLike,
    x0: Array,
    disturbance: ArrayLike | Callable[[float], ArrayLike] | None = None,
    *,
    rtol: float = 1e-6,
    atol: float = 1e-9,
    method: str = "LSODA",
    max_evaluations: int | None = None,
) -> Simulation:
    """Implements ``ClosedLoop.simulate`` for the ``equations`` of the loop, from their state ``x0`` (nx,).

    ``times``, ``disturbance``, ``rtol``, ``atol``, ``method`` and ``max_evaluations`` as there. Raises BadArgument for bad input, and any error
    of the law at the start.
    """
    asked = asked_times(times)
    run = _run_to_end(equations, asked, x0, disturbance, rtol=rtol, atol=atol, method=method, max_evaluations=max_evaluations)
    found = _gathered(run, asked)
    warn_near_singular(equations, found.t, found.q)
    return found


def motion(e: Equations, times: ArrayLike, x0: Array, *, rtol: float, atol: float, max_evaluations: int | None = None) -> Motion:
    """``simulate`` by LSODA without its signals."""
    asked = asked_times(times)
    run = _run_to_end(e, asked, x0, None, rtol=rtol, atol=atol, method="LSODA", max_evaluations=max_evaluations)
    t, x = _reached(run, asked)
    return Motion(t, x, run.outcome, run.message, run.path, round(run.spent), run.arrived)


def _run_to_end(
    equations: Equations,
    asked: Array,
    x0: Array,
    disturbance: ArrayLike | Callable[[float], ArrayLike] | None,
    *,
    rtol: float,
    atol: float,
    method: str,
    max_evaluations: int | None,
) -> Run:
    checks.choice("method", method, METHODS)
    options = {"rtol": checks.number("rtol", rtol, low=1e-14), "atol": checks.number("atol", atol, low=1e-16), "method": method}
    e = equations
    _refuse_what_no_time_resolves(e, float(np.abs(asked).max()))
    most = most_evaluations(e) if max_evaluations is None else checks.whole("max_evaluations", max_evaluations, 1, 10**12)
    run = Run(e, _disturbance(disturbance, e.n), options, DenseOutput(float(asked[0]), x0), [], float(asked[-1]), most)
    if run.farthest(x0) > FAR:
        raise BadArgument("the start", run.farthest(x0), f"positions and velocities up to {FAR:g}")
    # a start that cannot be evaluated raises here; it is not an outcome
    start = e.flow(float(asked[0]), x0, None, run.inputs(float(asked[0])), lose_contact=True)
    with np.errstate(over="ignore"):
        bounded(value(e.join(start.rates)))
    if len(asked) > 1:
        _run(run, asked, x0)
    return run


def _refuse_what_no_time_resolves(e: Equations, latest: float) -> None:
    least = GRAIN * max(1.0, latest)
    for name in ("sample_time",) if e.sample_time else ("delay", "force_delay"):
        grain = getattr(e.hardware, name)
        if grain and grain < least:
            raise Unsupported(f"hardware.{name}", grain, f"{least:g} s or more in a simulation up to {latest:g} s")


def _run(run: Run, asked: Array, x0: Array) -> None:
    if run.equations.sample_time:
        run_sampled(run, asked, x0)
    elif run.equations.delayed:
        run_with_dead_time(run, asked, x0)
    else:
        _run_continuous(run, asked, x0)


def _run_continuous(run: Run, asked: Array, x0: Array) -> None:
    rates = run.equations.rates if run.count is None and run.disturbance is None and run.touching is None else run.rates
    jac = _jacobian(run) if run.count is None else _jacobian_of_many(run, run.count)
    run.integrate(rates, float(asked[0]), float(asked[-1]), x0, jac)


def _jacobian(run: Run) -> Callable[[float, Array], Array]:
    e = run.equations
    known = np.zeros((e.nx, e.nx))

    def jac(t: float, x: Array) -> Array:
        nonlocal known
        with suppress(MfcError):  # the trial step is too long: the rates report it, and the solver uses the last Jacobian
            known = matrix_at(e, t, x, lose_contact=run.lose_contact)
        return known

    return jac


def _jacobian_of_many(run: Run, count: int) -> Callable[[float, Array], Array]:
    """As the solver takes the bands of a matrix, a block for each run."""
    e = run.equations
    nx = e.nx
    row, column = np.mgrid[:nx, :nx]
    bands = np.zeros((2 * nx - 1, count, nx))

    def jac(t: float, x: Array) -> Array:
        with suppress(MfcError):
            known = closed_matrix(e, np.full(count, t), x.reshape(count, nx), lose_contact=run.lose_contact)
            bands[nx - 1 + row - column, :, column] = np.moveaxis(known, 0, -1)
        return np.reshape(bands, (2 * nx - 1, count * nx))

    return jac


def simulate_together(
    e: Equations, times: Array, starts: Array, *, rtol: float, atol: float, max_evaluations: float
) -> tuple[Array | None, Outcome, float]:
    """``simulate`` from the starts (k, nx) at once: states (k, m, nx) at ``times`` (m,), how it ended, and its evaluations.

    The states are None where one of the runs did not reach the end, since then all of them stop there. Not for one-sided surfaces: each run has
    its own contact.
    """
    flat = np.ravel(starts)
    options = {"rtol": rtol, "atol": atol, "method": "LSODA"}
    run = Run(e, None, options, DenseOutput(float(times[0]), flat), [], float(times[-1]), int(max_evaluations), count=len(starts))
    try:
        if run.farthest(flat) < FAR:
            _run(run, times, flat)
        else:
            run.outcome = Outcome.DIVERGED
    except MfcError:  # at the start
        run.outcome = Outcome.REFUSED
    if run.outcome is not Outcome.FINISHED:
        return None, run.outcome, run.spent
    return np.moveaxis(run.path.along(times).reshape(len(times), *starts.shape), 0, 1), run.outcome, run.spent


def _reached(run: Run, asked: Array) -> tuple[Array, Array]:
    """The times that the run has reached, and its states there."""
    end = run.path.starts[-1]
    t = asked[asked <= end + 1e-12]
    if run.outcome is not Outcome.FINISHED and end > t[-1]:
        t = np.append(t, end)
    x = run.path.along(t)
    kept = np.isfinite(x).all(axis=1)
    return t[kept], x[kept]


def _gathered(run: Run, asked: Array) -> Simulation:
    e = run.equations
    t, x, flow = _signals(run, *_reached(run, asked))
    s = e.split(x)
    command = np.array(np.broadcast_to(value(flow.command), (len(t), e.n)))
    q = np.array(s["q"])
    v = np.array(s["v"]) if "v" in s else np.array(np.broadcast_to(value(flow.rates["q"]), q.shape))
    arrived = command if run.arrived is None else np.stack([run.arrived(float(ti)) for ti in t])
    held = e.actuators.output(s)
    tau = np.array(value(e.actuators.limited(arrived) if held is None else held))
    twist = value(e.plant.jacobian(np.ascontiguousarray(q), v))
    events = tuple(sorted(run.events, key=lambda event: event.time))
    return Simulation(
        t, x, run.outcome, run.message, run.path, round(run.spent), run.arrived, q, v, tau, command, np.array(value(flow.error)), twist,
        np.array(value(flow.F_tip)), events, e.state_names, external(e).outputs,
    )  # fmt: skip


def _signals(run: Run, t: Array, x: Array) -> tuple[Array, Array, Flow]:
    """The signals along the run, up to the last time at which the law can be evaluated."""
    while True:
        try:
            disturbance = None if run.disturbance is None else np.stack([run.disturbance(float(ti)) for ti in t])
            return t, x, run.equations.signals(t, x, Inputs(disturbance=disturbance), lose_contact=True)
        except MfcError:
            if run.outcome is not Outcome.REFUSED or len(t) == 1:
                raise
            t, x = t[:-1], x[:-1]


def asked_times(times: float | ArrayLike) -> Array:
    """(k,) [s] of a run: those given, or 501 from 0 to a single duration. Raises BadArgument."""
    asked = checks.times(times)
    if np.ndim(times) == 0:
        return np.linspace(0.0, checks.number("times", times, low=SHORTEST), 501)
    if asked.size > 1 and asked[-1] - asked[0] < SHORTEST:
        raise BadArgument("times", times, f"times that span {SHORTEST:g} s or more, or a single one")
    return asked


def _disturbance(given: ArrayLike | Callable[[float], ArrayLike] | None, n: int) -> Disturbance | None:
    if given is None:
        return None
    if callable(given):
        function = given
        checks.per_joint("disturbance", function(0.0), n)
        return lambda t: checks.per_joint("disturbance", function(t), n)
    constant = checks.per_joint("disturbance", given, n)
    return lambda t: constant
