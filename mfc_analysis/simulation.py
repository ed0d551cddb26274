"""Nonlinear simulation: the equations of the loop in scipy's ``solve_ivp``. The only one who integrates.

Without dead time and sampling: one run, LSODA with the exact Jacobian. With dead time: method of steps, segments no longer than
the shortest dead time. With a sample time: sample by sample, the torque held, the law's own states advanced as the discrete
model advances them. One-sided surfaces push and never pull; touch and lift are events.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from mfc_analysis.equations import Equations, Flow, Inputs
from mfc_analysis.errors import BadArgument, MfcError, one_warning
from mfc_analysis.jacobians import closed_matrix
from mfc_analysis.maths import checks
from mfc_analysis.maths.dual import value
from mfc_analysis.operating_point import OperatingPoint

if TYPE_CHECKING:
    from mfc_analysis.loop import ClosedLoop

Array = NDArray[np.float64]
Disturbance = Callable[[float], Array]

METHODS = ("LSODA", "Radau", "BDF", "RK45", "RK23", "DOP853")
FAR = 1e4  #: [rad, m, rad/s, m/s] beyond this position or velocity a run has diverged
SHORTEST = 1e-9  #: [s] a run below this is taken for a slip
FASTEST = 1e15  #: [1/s of any state] beyond this rate a run is refused
NO_FORCE = 1e-9  #: [N, Nm] a surface that presses less is not touched
CONTACT_STEP = 2e-3  #: [s] longest step where contact can be lost: a grazing touch is not stepped over


class Outcome(Enum):
    """How a run ended."""

    FINISHED = "the run reached its end"
    DIVERGED = "the motion diverged"
    REFUSED = "the law could not be evaluated any further"
    SOLVER = "the solver could not go on"


@dataclass(frozen=True, eq=False)
class Event:
    """A surface touched or left."""

    time: float  #: [s]
    kind: str  #: "touch" or "lift"
    surface: int  #: index in the list of environments
    axis: str  #: direction of its compliance frame


@dataclass(frozen=True, eq=False)
class Simulation:
    """A nonlinear run: k times."""

    t: Array  #: (k,) [s]
    x: Array  #: (k, nx) states in the order of ``state_names``
    q: Array  #: (k, n) [rad, m]
    v: Array  #: (k, n)
    tau: Array  #: (k, n) what drives the joints, after dead time, limit and lag [Nm] (velocity laws: the velocity [rad/s])
    command: Array  #: (k, n) what the law commands
    error: Array  #: (k, n) e = q_d - q, or (k, 6) X_e for tool laws
    twist: Array  #: (k, 6) body twist of the tool [m/s, rad/s]
    force: Array  #: (k, 6) F_tip, tool frame [N, Nm]
    events: tuple[Event, ...]
    outcome: Outcome
    message: str  #: what happened and when, a sentence
    state_names: tuple[str, ...]
    path: _Path = field(repr=False)
    arrived: Callable[[float], Array] | None = field(default=None, repr=False)  #: with dead time or sampling: t -> (n,) command at the joints

    @property
    def diverged(self) -> bool:
        """True where the run stopped before its end; ``message`` says why and when, the arrays keep what there is."""
        return self.outcome is not Outcome.FINISHED

    @property
    def end(self) -> float:
        """Last time reached [s]."""
        return float(self.t[-1])

    def state(self, t: ArrayLike) -> Array:
        """(m, nx) the state at times within the run, from the solver's dense output. Raises BadArgument outside."""
        times = np.atleast_1d(np.asarray(t, float))
        if np.any(times < self.t[0] - 1e-12) or np.any(times > self.t[-1] + 1e-12):
            raise BadArgument("times", t, f"times within the run, {self.t[0]:g} to {self.t[-1]:g} s")
        return np.stack([self.path.at(float(ti)) for ti in times])

    def operating_point(self, times: Array) -> OperatingPoint:
        """The run as operating points at times (m,) [s], to linearise along. Raises BadArgument outside the run."""
        return OperatingPoint(times, self.state(times), np.zeros((len(times), self.q.shape[1])))

    def __str__(self) -> str:
        return f"simulation from {self.t[0]:g} to {self.t[-1]:g} s, {len(self.t)} points, {len(self.events)} contact events: {self.message}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        rows = []
        for name, values in (("error", self.error), ("velocity", self.v), ("torque", self.tau), ("force", self.force)):
            size = np.abs(values).max(axis=1)
            rows.append((name, f"{size.max():.4g}", f"{self.t[int(np.argmax(size))]:.4g}", f"{size[-1]:.4g}"))
        return table(str(self), ("signal", "largest", "at [s]", "at the end"), rows)


class _Path:
    """Dense output put together from segments."""

    def __init__(self, t0: float, x0: Array) -> None:
        self.starts: list[float] = [t0]
        self.pieces: list[Callable[[float], Array]] = []
        self.first = x0

    def add(self, end: float, piece: Callable[[float], Array]) -> None:
        self.pieces.append(piece)
        self.starts.append(end)

    def at(self, t: float) -> Array:
        if t <= self.starts[0] or not self.pieces:
            return self.first
        late = t + 1e-12 * max(1.0, abs(t))  # at a sampling instant: what the law holds after it
        i = min(max(int(np.searchsorted(self.starts, late, side="right")) - 1, 0), len(self.pieces) - 1)
        return np.asarray(self.pieces[i](min(t, self.starts[i + 1])))


@dataclass(eq=False)
class _Run:
    """One run under way: what the three ways of integrating share."""

    equations: Equations
    disturbance: Disturbance | None
    options: dict[str, Any]
    path: _Path
    events: list[Event]
    outcome: Outcome = Outcome.FINISHED
    message: str = Outcome.FINISHED.value
    refused: MfcError | None = None
    arrived: Callable[[float], Array] | None = None  #: with dead time or sampling: the command that has reached the joints

    def inputs(self, t: float) -> Inputs:
        return Inputs() if self.disturbance is None else Inputs(disturbance=self.disturbance(t))

    @property
    def one_sided(self) -> bool:
        return any(s.one_sided for s in self.equations.surfaces)

    def integrate(
        self, rates: Callable[[float, Array], Array], start: float, end: float, x: Array, jac: Any = None, short: bool = False
    ) -> Array | None:
        """From start to end; adds to the path. None where the run has stopped.

        ``short``: one of many short segments, where a multistep method would only ever be starting: explicit Runge-Kutta then.
        """
        options = dict(self.options)
        if short and options["method"] == "LSODA":
            options.update(method="DOP853" if options["rtol"] < 1e-8 else "RK45", first_step=end - start)
        if jac is not None and options["method"] in ("LSODA", "Radau", "BDF"):
            options["jac"] = jac
        if self.one_sided:
            options["max_step"] = CONTACT_STEP

        def solve(f: Callable[[float, Array], Array], options: dict[str, Any]) -> Any:
            with np.errstate(all="ignore"):
                return solve_ivp(f, (start, end), x, dense_output=True, events=[self._far()], **options)

        try:
            found = solve(self._stopping(rates), options)
        except _Stop:  # maybe only a step too far: again, by a method that shortens a step it cannot evaluate
            found = solve(self._or_nan(rates), {**options, "method": "Radau" if jac is not None else "RK45", "first_step": None})
        self.events += self._contacts(found)
        self.path.add(float(found.t[-1]), found.sol)
        if found.status == 1 or not np.isfinite(found.y).all():
            self.stop(Outcome.DIVERGED, float(found.t[-1]), f"position or velocity beyond {FAR:g}")
            return None
        if found.status < 0:
            outcome = Outcome.SOLVER if self.refused is None else Outcome.REFUSED
            self.stop(outcome, float(found.t[-1]), str(self.refused or found.message))
            return None
        self.refused = None
        return np.asarray(found.y[:, -1])

    def _stopping(self, rates: Callable[[float, Array], Array]) -> Callable[[float, Array], Array]:
        def guarded(t: float, x: Array) -> Array:
            try:
                return _of_this_world(rates(t, x))
            except MfcError as why:
                self.refused = why
                raise _Stop from why

        return guarded

    def _or_nan(self, rates: Callable[[float, Array], Array]) -> Callable[[float, Array], Array]:
        def guarded(t: float, x: Array) -> Array:
            try:
                return _of_this_world(rates(t, x))
            except MfcError as why:
                self.refused = why
                return np.full(x.shape, np.nan)

        return guarded

    def refuse(self, t: float, why: MfcError) -> None:
        """End the run where the law itself, between two segments, cannot be evaluated."""
        self.stop(Outcome.REFUSED, t, str(why))

    def stop(self, outcome: Outcome, t: float, why: str) -> None:
        self.outcome, self.message = outcome, f"{outcome.value} at t = {t:.4g} s: {why}"

    def _far(self) -> Any:
        watch = np.concatenate(
            [np.arange(where.start, where.stop) for name, (where, _) in self.equations.parts.items() if name in ("q", "v", "theta", "omega")]
        )

        def far(t: float, x: Array) -> float:
            return FAR - float(np.abs(x[watch]).max())

        far.terminal = True  # type: ignore[attr-defined]
        return far

    def _contacts(self, found: Any) -> list[Event]:
        """Touch and lift between the solver's steps, located on its dense output.

        Not by solve_ivp's own events: those take the signs from the steps and search on the dense output, which differs by rounding.
        """
        e = self.equations
        if not self.one_sided or found.t.size < 2:
            return []

        def forces(t: Array) -> list[Array]:
            return [value(f) for f in e.touch(e.split(np.ascontiguousarray(np.atleast_2d(found.sol(t).T)))).forces]

        at_steps = forces(found.t)
        out = []
        for i, surface in enumerate(e.surfaces):
            for axis, index in zip(surface.axis_names, surface.index, strict=True) if surface.one_sided else ():
                presses = at_steps[i][:, index] > NO_FORCE
                for k in np.flatnonzero(presses[:-1] != presses[1:]):
                    low, high = float(found.t[k]), float(found.t[k + 1])
                    while high - low > 1e-12 * max(1.0, high):
                        middle = 0.5 * (low + high)
                        if (forces(np.array([middle]))[i][0, index] > NO_FORCE) == presses[k]:
                            low = middle
                        else:
                            high = middle
                    out.append(Event(high, "touch" if presses[k + 1] else "lift", i, axis))
        return out


def _of_this_world(rates: Array) -> Array:
    """Rates as they are; of larger ones a solver would never make an end. Raises BadArgument."""
    if not np.abs(rates).max() < FASTEST:
        raise BadArgument("the motion", f"rates of {np.abs(rates).max():.3g}", f"rates of the states below {FASTEST:g}")
    return rates


class _Stop(Exception):
    """The law refused; unwinds the solver."""


def simulate(
    loop: ClosedLoop,
    times: float | ArrayLike,
    x0: Array,
    disturbance: ArrayLike | Callable[[float], ArrayLike] | None,
    *,
    rtol: float,
    atol: float,
    method: str,
) -> Simulation:
    """The run behind ``ClosedLoop.simulate``. Raises BadArgument for bad input, and what the law raises at the start."""
    asked = _asked_times(times)
    checks.choice("method", method, METHODS)
    options = {"rtol": checks.number("rtol", rtol, low=1e-14), "atol": checks.number("atol", atol, low=1e-16), "method": method}
    e = loop.equations
    run = _Run(e, _disturbance(disturbance, e.n), options, _Path(float(asked[0]), x0), [])
    moving = np.concatenate([x0[where] for name, (where, _) in e.parts.items() if name in ("q", "v", "theta", "omega")])
    if np.abs(moving).max() > FAR:
        raise BadArgument("the start", float(np.abs(moving).max()), f"positions and velocities up to {FAR:g}")
    start = e.flow(float(asked[0]), x0, None, run.inputs(float(asked[0])))  # an impossible start is an error, not an outcome
    _of_this_world(value(e.join(start.rates)))
    with one_warning():
        if len(asked) > 1:
            _run(run, asked, x0)
        return _gathered(run, asked)


def _run(run: _Run, asked: Array, x0: Array) -> None:
    hardware = run.equations.hardware
    if hardware.sample_time is not None:
        from mfc_analysis.sampled_run import run_sampled

        run_sampled(run, asked, x0)
    elif hardware.delay is not None or hardware.force_delay is not None:
        from mfc_analysis.sampled_run import run_with_dead_time

        run_with_dead_time(run, asked, x0)
    else:
        _run_continuous(run, asked, x0)


def _run_continuous(run: _Run, asked: Array, x0: Array) -> None:
    e, lose = run.equations, run.one_sided

    def rates(t: float, x: Array) -> Array:
        return value(e.join(e.flow(t, x, None, run.inputs(t), lose_contact=lose).rates))

    known = [np.zeros((e.nx, e.nx))]

    def jac(t: float, x: Array) -> Array:
        with suppress(MfcError):  # a trial step too far: the rates will say so; for the solver the last one will do
            known[0] = closed_matrix(e, np.array([t]), x[None], lose_contact=lose)[0]
        return known[0]

    run.integrate(rates, float(asked[0]), float(asked[-1]), x0, jac)


def _gathered(run: _Run, asked: Array) -> Simulation:
    e = run.equations
    end = run.path.starts[-1]
    t = asked[asked <= end + 1e-12]
    if run.outcome is not Outcome.FINISHED and end > t[-1]:
        t = np.append(t, end)
    x = np.stack([run.path.at(float(ti)) for ti in t])
    kept = np.isfinite(x).all(axis=1)
    t, x, flow = _signals(run, t[kept], x[kept])
    s = e.split(x)
    command = np.array(np.broadcast_to(value(flow.command), (len(t), e.n)))
    q = np.array(s["q"])
    v = np.array(s["v"]) if "v" in s else np.array(np.broadcast_to(value(flow.rates["q"]), q.shape))
    arrived = command if run.arrived is None else np.stack([run.arrived(float(ti)) for ti in t])
    tau = np.array(s["lag"]) if "lag" in s else np.array(value(e._limited(arrived)))
    twist = value(e.plant.jacobian(np.ascontiguousarray(q), v))
    events = tuple(sorted(run.events, key=lambda event: event.time))
    return Simulation(
        t, x, q, v, tau, command, np.array(value(flow.error)), twist, np.array(value(flow.F_tip)), events,
        run.outcome, run.message, e.state_names, run.path, run.arrived,
    )  # fmt: skip


def _signals(run: _Run, t: Array, x: Array) -> tuple[Array, Array, Flow]:
    """The signals along the run, without the last points where the law could not be evaluated any more."""
    while True:
        try:
            disturbance = None if run.disturbance is None else np.stack([run.disturbance(float(ti)) for ti in t])
            return t, x, run.equations.flow(t, x, None, Inputs(disturbance=disturbance), lose_contact=run.one_sided)
        except MfcError:
            if run.outcome is not Outcome.REFUSED or len(t) == 1:
                raise
            t, x = t[:-1], x[:-1]


def _asked_times(times: float | ArrayLike) -> Array:
    given = checks.at_least_1d("times", times)
    if np.ndim(times) == 0:
        return np.linspace(0.0, checks.number("times", times, low=SHORTEST), 501)
    asked = checks.times(given)
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
