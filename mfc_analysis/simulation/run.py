"""One simulation run: segments of the equations in scipy's ``solve_ivp``. No other file integrates."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy import integrate
from scipy.integrate import solve_ivp
from scipy.optimize import root_scalar

from mfc_analysis.dynamics.environment import LoseContact
from mfc_analysis.dynamics.equations import NO_WRENCH, Equations
from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.errors import BadArgument, MfcError
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import value
from mfc_analysis.simulation.touching import Event, Touching

Disturbance = Callable[[float], Array]
Piece = Callable[[Any], Array]  #: t -> (nx,); (m,) times -> (nx, m)


FAR = 1e4  #: [rad, m, rad/s, m/s] above this position or velocity a run has diverged


FASTEST = 1e15  #: [1/s of any state] above this rate the solver would not finish


MOST = 400_000  #: evaluations that a run takes at most for a joint law without surfaces: about 10 s of work


COST = {"joint": 1.0, "tool": 5.0, "tool force": 12.0, "push": 1.5, "turn": 3.5}  #: time of an evaluation by the law, and that of each surface


SOLVER = {"LSODA": 0.0, "RK23": 1.0, "RK45": 1.0, "DOP853": 1.0, "Radau": 5.0, "BDF": 5.0}  #: time of the solver itself for each evaluation, likewise


STEP = 10_000  #: evaluations beyond the limit after which the step under way has no end


JACOBIAN = 4  #: evaluations that take about as long as one of the Jacobian


HELD = 0.25  #: evaluations that take about as long as one of the plant alone, under a held command


CONTACT_STEP = 2e-3  #: [s] longest step where contact can be lost, so that no short contact is missed


TOGETHER, EACH = 2.0, 0.15  #: time of an evaluation of several runs at once, and that of each of them, in evaluations of one run


def cost(e: Equations) -> float:
    """Time of one evaluation, in evaluations of a joint law without surfaces."""
    law = "tool force" if e.law.space == "tool" and e.law.senses_force else e.law.space
    return COST[law] + sum(COST["push" if max(s.index) < 3 else "turn"] for s in e.surfaces)


def most_evaluations(e: Equations) -> int:
    """The limit of a run for which none is given: about 10 s of work, whatever an evaluation of these equations costs."""
    return int(MOST / cost(e))


class Outcome(Enum):
    """How a run ended."""

    FINISHED = "the run reached its end"
    DIVERGED = "the motion diverged"
    REFUSED = "the law could not be evaluated"
    SOLVER = "the solver failed"
    STOPPED = "the run was stopped"


class DenseOutput:
    """Dense output assembled from segments."""

    def __init__(self, t0: float, x0: Array) -> None:
        self.starts: list[float] = [t0]
        self.pieces: list[Piece] = []
        self.first = x0

    def add(self, end: float, piece: Piece) -> None:
        self.pieces.append(piece)
        self.starts.append(end)

    def at(self, t: float) -> Array:
        """The state (nx,) at one time."""
        if t <= self.starts[0] or not self.pieces:
            return self.first
        late = t + 1e-12 * max(1.0, abs(t))  # at a sampling instant: what the law holds after it
        i = min(max(bisect_right(self.starts, late) - 1, 0), len(self.pieces) - 1)
        return np.asarray(self.pieces[i](min(t, self.starts[i + 1])))

    def along(self, times: Array) -> Array:
        """The states (m, nx) at times (m,), in one call for all that lie in the same piece."""
        out = np.empty((len(times), *self.first.shape))
        late = times + 1e-12 * np.maximum(1.0, np.abs(times))
        of = np.clip(np.searchsorted(self.starts, late, side="right") - 1, 0, max(len(self.pieces) - 1, 0))
        of[(times <= self.starts[0]) | (not self.pieces)] = -1
        for i in np.unique(of):
            out[of == i] = self.first if i < 0 else self.pieces[i](np.minimum(times[of == i], self.starts[i + 1])).T
        return out


@dataclass(eq=False)
class Run:
    """One run in progress: the part that the three integration methods share.

    Or ``count`` runs from different starts, integrated together as one state (count nx,). Each keeps to the tolerances by itself: the norm of
    LSODA is the largest error of any state; that of the Runge-Kutta methods is a mean, so their tolerances shrink with sqrt(count).
    Where one of them stops, all do.
    """

    equations: Equations
    disturbance: Disturbance | None
    options: dict[str, Any]
    path: DenseOutput
    events: list[Event]
    end: float = np.inf  #: [s] where the run is to end
    most: int = MOST  #: evaluations allowed
    count: int | None = None  #: of the runs that are integrated together; None: one alone
    spent: float = 0.0  #: evaluations so far
    outcome: Outcome = Outcome.FINISHED
    message: str = Outcome.FINISHED.value
    refused: MfcError | None = None
    arrived: Callable[[float], Array] | None = None  #: with dead time or sampling: the command that has reached the joints
    touching: Touching | None = field(init=False, default=None)  #: None without a one-sided surface
    _changed: bool = False  #: the last piece ended where contact changes

    def __post_init__(self) -> None:
        if any(s.one_sided for s in self.equations.surfaces):
            self.touching = Touching(self.equations, self.path.first)

    @cached_property
    def price(self) -> float:
        return cost(self.equations)

    @cached_property
    def weight(self) -> float:
        """Time of an evaluation, in evaluations of one run."""
        return 1.0 if self.count is None else TOGETHER + EACH * self.count

    @cached_property
    def _watched(self) -> int:
        """Number of positions and velocities, the first states."""
        parts = self.equations.parts
        return max(int(parts[name].where.stop) for name in ("q", "v", "theta", "omega") if name in parts)

    def farthest(self, x: Array) -> float:
        """[rad, m, rad/s, m/s] largest position or velocity in a state of the solver."""
        return float(np.abs(self.states(x)[..., : self._watched]).max())

    def passed(self, x: Array) -> bool:
        """True where a position or velocity in a state of the solver is beyond the limit."""
        return not x.dot(x) < FAR**2 and self.farthest(x) >= FAR  # the first is quick, and stricter

    def states(self, x: Array) -> Array:
        """(nx,) the state, or (count, nx) those of all runs, from a state of the solver."""
        return x if self.count is None else x.reshape(self.count, -1)

    def rates(self, t: float, x: Array, wires: Wires | None = None) -> Array:
        """Rates of the whole loop, for the solver."""
        e, disturbance = self.equations, None if self.disturbance is None else self.disturbance(t)
        if wires is None and self.count is None:
            return e.rates(t, x, disturbance, lose_contact=self.lose_contact)
        if wires is None:
            return np.ravel(e.rates(t, self.states(x), disturbance, lose_contact=self.lose_contact))
        found = e.flow(t, self.states(x), wires, Inputs(disturbance=disturbance), lose_contact=self.lose_contact)
        return np.ravel(value(e.join(found.rates)))

    def plant_rates(self, t: float, x: Array, drive: Array) -> Array:
        """Rates for the solver of the plant alone, under the command that arrives at the joints; those of the controller's states are 0."""
        e = self.equations
        states = self.states(x)
        s = e.split(states)
        F = e.touch(s, lose_contact=self.lose_contact).wrench if e.surfaces else NO_WRENCH
        moved = e.move(s, drive, F, None if self.disturbance is None else self.disturbance(t))
        return np.ravel(e.state_rates(moved, states.shape[:-1]))

    def held(self, drive: Array) -> Callable[[float, Array], Array]:
        """``plant_rates`` under a command that does not change."""
        return lambda t, x: self.plant_rates(t, x, drive)

    def inputs(self, t: float) -> Inputs:
        return Inputs() if self.disturbance is None else Inputs(disturbance=self.disturbance(t))

    @property
    def lose_contact(self) -> LoseContact:
        """For the equations at this time of the run: the axes of one-sided surfaces that are touched."""
        return False if self.touching is None else self.touching.axes

    def integrate(
        self, rates: Callable[[float, Array], Array], start: float, end: float, x: Array, jac: Any = None, short: bool = False, cost: float = 1.0,
        record: Callable[[float, float, Array], Array] | None = None,
    ) -> Array | None:  # fmt: skip
        """Integrates from start to end and adds to the path. Returns the final state, None where the run has stopped.

        Where contact is made or lost a piece ends and the solver starts again, so that no step contains a jump of the force.
        ``short``: one of many short segments. These use explicit Runge-Kutta, since a multistep method would restart on each.
        ``cost``: of the rates, in evaluations of the equations. ``record(begin, stop, x)`` sees each piece before contact changes, and returns its
        last state.
        """
        now: Array | None = x
        while now is not None:
            begin, now = start, self._piece(rates, start, end, now, jac, short, cost)
            start = self.path.starts[-1]
            if now is not None and record is not None:
                now = record(begin, start, now)
                now = now if self.outcome is Outcome.FINISHED else None
            if now is not None and self.touching is not None and self._changed:
                self.events += self.touching.switch(start, now)
            if end - start <= 1e-14 * max(1.0, abs(end)):
                break
        return now

    def _piece(
        self, rates: Callable[[float, Array], Array], start: float, end: float, x: Array, jac: Any, short: bool, cost: float
    ) -> Array | None:  # fmt: skip
        """``integrate`` up to ``end`` or to where contact changes."""
        self.spent += 1
        if self.spent >= self.most:
            self._give_up(start)
            return None
        if not np.isfinite(x).all():
            self.stop(Outcome.DIVERGED, start, "the state is not finite")
            return None
        options = dict(self.options)
        if short and options["method"] == "LSODA":
            options.update(method="DOP853" if options["rtol"] < 1e-8 else "RK45", first_step=end - start)
        if self.touching is not None:
            options["max_step"] = CONTACT_STEP
        if self.count is not None:
            if options["method"] == "LSODA":
                options["lband"] = options["uband"] = self.equations.nx - 1
            else:
                options.update({name: options[name] / np.sqrt(self.count) for name in ("rtol", "atol")})

        def solve(options: dict[str, Any], *, stops: bool) -> Any:
            f = self._guarded(rates, cost + SOLVER[options["method"]] / self.price, stops)
            if jac is not None and options["method"] in ("LSODA", "Radau", "BDF"):
                options["jac"] = self._counted(jac)
            events = None if self.touching is None else [self.touching.change()]
            with np.errstate(all="ignore"):
                return solve_ivp(f, (start, end), x, dense_output=True, events=events, run=self, **{**options, "method": _ending(options["method"])})

        try:
            try:
                found = solve(options, stops=True)
            except _Stop:  # perhaps only the trial step is too long: retry with a method that shortens it
                if self.count is not None:
                    self.stop(Outcome.REFUSED, start, str(self.refused))
                    return None
                found = solve({**options, "method": "Radau" if jac is not None else "RK45", "first_step": None}, stops=False)
        except _Endless:
            self._give_up(start)
            return None
        last, finite = float(found.t[-1]), bool(np.isfinite(found.y).all())
        far = not finite or self.farthest(found.y[:, -1]) >= FAR
        if far and finite and len(found.t) > 1:
            last = self._passes(found.sol, float(found.t[-2]), last)
        self.path.add(last, found.sol)
        self._changed = found.status == 1
        if far:
            self.stop(Outcome.DIVERGED, last, f"position or velocity beyond {FAR:g}")
            return None
        if found.status == 0 and last < end:
            self._give_up(last)
            return None
        if found.status < 0:
            outcome = Outcome.SOLVER if self.refused is None else Outcome.REFUSED
            self.stop(outcome, float(found.t[-1]), str(self.refused or found.message))
            return None
        self.refused = None
        return np.array(found.y[:, -1])

    def _guarded(self, rates: Callable[[float, Array], Array], cost: float, stops: bool) -> Callable[[float, Array], Array]:
        """The rates for the solver, counted. Where they cannot be evaluated the solver is left (``stops``) or given NaN."""
        work, most = cost * self.weight, self.most + STEP

        def guarded(t: float, x: Array) -> Array:
            self.spent += work
            if self.spent > most:
                raise _Endless
            try:
                found = rates(t, x)
                return found if found.dot(found) < FASTEST**2 else bounded(found)  # the first is quick, and stricter
            except MfcError as why:
                self.refused = why
                if stops:
                    raise _Stop from why
                return np.full(x.shape, np.nan)

        return guarded

    def _counted(self, jac: Callable[[float, Array], Array]) -> Callable[[float, Array], Array]:
        work = JACOBIAN * self.weight

        def counted(t: float, x: Array) -> Array:
            self.spent += work
            return jac(t, x)

        return counted

    def refuse(self, t: float, why: MfcError) -> None:
        """Stops the run where the law cannot be evaluated between two segments."""
        self.stop(Outcome.REFUSED, t, str(why))

    def stop(self, outcome: Outcome, t: float, why: str) -> None:
        self.outcome, self.message = outcome, f"{outcome.value} at t = {t:.4g} s: {why}"

    def _give_up(self, t: float) -> None:
        why = f"{self.most} evaluations of the equations are not enough to reach {self.end:g} s; max_evaluations= allows more"
        self.stop(Outcome.STOPPED, t, why)

    def _passes(self, path: Piece, before: float, after: float) -> float:
        """[s] where the path passes the limit in a step."""

        def left(t: float) -> float:
            return FAR - self.farthest(path(t))

        return float(root_scalar(left, bracket=(before, after), xtol=1e-15).root) if left(before) > 0 > left(after) else after


@cache
def _ending(method: str) -> Any:
    """scipy's solver with this name, whose last step is the first in which its ``run`` goes too far, or after which no work is left."""
    solver: Any = getattr(integrate, method)

    class Ending(solver):  # type: ignore[misc]  # scipy has no types
        status: str

        def __init__(self, *given: Any, run: Run, **options: Any) -> None:
            super().__init__(*given, **options)
            self.run = run

        def step(self) -> Any:
            message = solver.step(self)
            run = self.run
            if self.status == "running" and (run.spent >= run.most or run.passed(self.y)):
                self.status = "finished"
            return message

    return Ending


def bounded(rates: Array) -> Array:
    """The rates unchanged. Raises BadArgument above ``FASTEST``, where the solver would not finish."""
    if not np.abs(rates).max() < FASTEST:
        raise BadArgument("the motion", f"rates of {np.abs(rates).max():.3g}", f"state rates below {FASTEST:g}")
    return rates


class _Endless(Exception):
    """The solver repeats one step and never ends it."""


class _Stop(Exception):
    """The law cannot be evaluated; leaves the solver."""
