"""Metrics of step responses, of all pairs of one point at once: what settles, when, and how far it overshoots."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mfc_analysis.analysis.delay.roots import delay_roots, slow_rates
from mfc_analysis.analysis.delay.steps import delayed_runner, grid, longest_shown, longest_step, never_settled
from mfc_analysis.analysis.modal_response import ModalPieces, terms
from mfc_analysis.analysis.modes import Mode, modes
from mfc_analysis.analysis.slow import MOVES
from mfc_analysis.analysis.spectrum import spectrum
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.step_run import METRICS, Piece, metrics, metrics_of
from mfc_analysis.analysis.step_samples import FEWEST, between, input_groups, step_samples
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array, Ints

MOST_SAMPLES = 60_000_000  #: of a sampled loop
DIED = 14.0  #: time constants of the slowest characteristic root in a run with dead time
NOISE = 1e-8  #: of the largest response of an output: one within that of its end counts as settled there
ROUNDING = 1e-13  #: of the largest of all outputs, likewise
STILL = 0.5  #: of its distance from the final value: a response that moves less in the second half of its run stands still
AFFORDED = 50_000  #: steps of such a run, unless it takes more to settle


class Outcome(enum.Enum):
    """Long-term behaviour of the response."""

    SETTLES = "the response settles"
    RAMPS = "the response does not settle within the horizon: a slow root integrates the input"
    GROWS = "the response grows: the closed loop is unstable"


def points(system: OpenSystem) -> list[Point]:
    """The loop at each of its points."""
    verdict = stability(system)
    decay = verdict.nonzero_stable | ~verdict.held
    return [Point(system.at(np.array([i])), closed, bool(decay[i])) for i, closed in enumerate(zip(*close_wires(system), strict=True))]


def pair_metrics(system: OpenSystem, into: Ints, out: Ints) -> dict[str, Array]:
    """(m, P) outcome, final value and metrics, by their names in ``Step``, of the steps from inputs ``into`` (P,) to outputs ``out`` (P,)."""
    found = [point.metrics(into, out) for point in points(system)]
    return {name: np.array([one[name] for one in found]).reshape(len(found), into.size) for name in ("outcome", "steady_state", *METRICS)}


@dataclass(frozen=True, eq=False)
class Point:
    """A loop at one point, and what all its responses share."""

    system: OpenSystem
    closed: tuple[Array, Array, Array, Array]  #: A, B, C, D of the closed loop, without dead time
    others_decay: bool  #: no root grows that is not slow: also where every root is slow

    @cached_property
    def modes(self) -> list[Mode]:
        """Of the rates: of A, or (A - I) / dt."""
        A, dt = self.closed[0], self.system.dt
        return modes((A - np.eye(len(A))) / dt if dt else A, self.system.radius)

    @cached_property
    def _still(self) -> Array:
        """(nx, nu) M^-1 B, M and B those of the rates: minus the final state under a unit step of each input, where every mode decays."""
        A, B, dt = *self.closed[:2], self.system.dt
        M, B = ((A - np.eye(len(A))) / dt, B / dt) if dt else (A, B)
        X = np.linalg.solve(M, B)
        return np.asarray(X + np.linalg.solve(M, B - M @ X))

    def metrics(self, into: Ints, out: Ints) -> dict[str, Array]:
        """(P,) of each response: the outcome, the final value, the metrics, and "longest": a time [s] at which everything has died away.

        Dead time has no effect on final values. A slow mode that is not sure to decay leaves no trace, or ramps.
        """
        system, dt, P = self.system, self.system.dt, into.size
        found = {name: np.full(P, np.nan) for name in ("steady_state", *METRICS)}
        found |= {"outcome": np.full(P, Outcome.GROWS), "longest": np.zeros(P)}
        if not self.others_decay:
            return found
        _, B, C, D = self.closed
        b, c, d = B[:, into] / (dt or 1.0), C[out], D[out, into]
        slow = [mode for mode in self.modes if (np.abs(mode.rates) < system.radius).all()]
        loose = [mode for mode in slow if not mode.decays(dt)]
        found_terms = terms([mode for mode in self.modes if mode not in loose], b, c, dt)
        starts = found_terms.a[found_terms.starts].real
        # the sum over the modes has their rounding: it hides a final value that an integral makes 0
        steady = d - (starts.sum(axis=0) if loose else (c * self._still[:, into].T).sum(axis=1))
        steady[np.abs(steady) < 1e-13 * (np.abs(starts).sum(axis=0) + np.abs(d))] = 0.0
        horizon = system.horizon if np.isfinite(system.horizon) else 1.0
        moved = np.zeros((2, P))
        for mode in loose:
            moved += [((c @ mode.right @ mode.integral(time, dt)).T * (mode.left @ b)).sum(axis=0).real for time in (horizon, horizon / 2)]
        ramps = np.abs(moved).max(axis=0) > MOVES * (found_terms.size.sum(axis=0) + np.abs(d)) + 1e-300
        found["steady_state"] = np.where(ramps, np.copysign(np.inf, moved[0]), steady)
        at = np.flatnonzero(~ramps)
        if at.size:
            if system.delayed:
                new = self._delayed_metrics(into[at], out[at], steady[at])
            else:
                pieces = ModalPieces(found_terms.of(at), steady[at])
                new = metrics(pieces.piece, steady[at], pieces.reach) | {"longest": np.full(at.size, pieces.end)}
            late = (new["settling"] > system.horizon) & (len(slow) > len(loose))
            for name, values in new.items():
                found[name][at] = np.where(late & (name != "longest"), np.nan, values)
            ramps[at[late]] = True
            found["steady_state"][at[late]] = np.copysign(np.inf, steady[at[late]])
        found["settling"][ramps] = np.inf
        found["outcome"] = np.array([Outcome.SETTLES, Outcome.RAMPS])[ramps.astype(int)]
        return found

    def _delayed_metrics(self, into: Ints, out: Ints, steady: Array) -> dict[str, Array]:
        """The same with dead time, from a run to where the slowest characteristic root has died away, or as far as ``AFFORDED`` steps go.

        It is repeated, twice as long, until all have settled: a root that decays slowly and turns fast shows in the run itself.
        """
        system = self.system
        decay = slow_rates(system)
        died = max([DIED / x for x in decay if x > 0], default=0.0)
        longest = max(min(died, AFFORDED * longest_step(system)), 10 * float(system.wire_delay.max()))
        found = {name: np.zeros(steady.size) for name in (*METRICS, "longest")}
        rows = np.unique(out)
        for group in input_groups(between(system, range(system.nu), rows)):
            group = np.intersect1d(group, into)
            run = delayed_runner(between(system, group, rows))
            left, duration = np.flatnonzero(np.isin(into, group)), longest
            while left.size:
                whole, row = run(duration, FEWEST), np.searchsorted(rows, out[left])
                piece, reached = whole.of(row * group.size + np.searchsorted(group, into[left])), float(whole.t[-1])
                largest = np.abs(whole.ends[0]).max(axis=1).reshape(rows.size, -1).max(axis=1)
                error = np.maximum(NOISE * largest[row], ROUNDING * largest.max())
                if reached >= died:
                    error = np.maximum(error, _beside(piece, steady[left]))
                new = metrics_of(piece, steady[left], error)
                settled = new["settling"] < 0.9 * reached
                for name, values in new.items():
                    found[name][left[settled]] = values[settled]
                found["longest"][left] = reached
                left = left[~settled]
                if left.size and reached < duration * (1 - 1e-9):
                    raise never_settled(system, int(into[left[0]]), int(out[left[0]]), float(min(decay, default=0.0)), reached)
                duration *= 2
        return found

    def samples(
        self, duration: float | None, outcome: Outcome, settling: float, overshoot: float, peak_time: float, longest: float, **_: float
    ) -> tuple[Array, Array]:
        """Times [s] and values of the only response of the system; ``duration`` None: chosen by its metrics."""
        system, dt = self.system, self.system.dt
        if duration is None:
            turned = peak_time if overshoot > 0 else 0.0
            duration = float(max(2 * settling, 1.2 * turned) or longest) if outcome is Outcome.SETTLES else self._unsettled()
            duration = min(duration, longest_shown(system)) if system.delayed else duration
        if system.delayed:
            h, steps = grid(system, duration, self._count(duration))
            run = delayed_runner(system)(h * steps, steps)
            t = np.asarray(h * np.arange(min(steps, int(run.t[-1] / h * (1 + 1e-9))) + 1), float)
            return t, run.values(t)[0]
        if dt:
            count = max(2, int(np.ceil(duration / dt * (1 - 1e-12))))
            if count > MOST_SAMPLES:
                raise BadArgument("duration", duration, f"at most {MOST_SAMPLES * dt:.4g} s, {MOST_SAMPLES} samples of {dt:.3g} s")
            t = np.linspace(0.0, dt * count, count + 1)
        else:
            count = self._count(duration)
            t = np.asarray(duration / count * np.arange(count + 1), float)
        return t, step_samples(system, t)[0, 0, 0]

    def _unsettled(self) -> float:
        """[s] duration that shows how a response grows, or moves on."""
        system = self.system
        known = spectrum(system)
        s = known.rates[~known.slow]
        rate = s.real[np.isfinite(s.real) & (np.abs(s.real) > 1e-12 * np.abs(s))]
        slowest = rate.max() if (rate > 0).any() else np.abs(rate).min() if rate.size else 1.0
        enough = 8 / float(slowest)
        if not system.delayed:
            return enough
        enough = max(enough, 10 * float(system.wire_delay.max()))
        growth = float(delay_roots(system, 1)[0, 0].real) if not self.others_decay else 0.0
        return min(max(enough, min(3 / growth, 20 * enough)) if growth > 0 else enough, AFFORDED * longest_step(system))

    def _count(self, duration: float) -> int:
        if self.system.dt:
            return max(1, round(duration / self.system.dt))
        turns = duration * max((np.abs(mode.rates.imag).max() for mode in self.modes), default=0.0) / (2 * np.pi)
        return int(np.clip(16 * turns, FEWEST, 20 * FEWEST))


def _beside(run: Piece, steady: Array) -> Array:
    """(P,) how far beside ``steady`` each response stands still, for which it is not moving: the error of a final value; 0 where it moves."""
    second = run.samples[1][:, run.t.size // 2 :]
    off = np.abs(second[:, -1] - steady)
    return np.where(np.ptp(second, axis=1) < STILL * off, (1 + STILL) * off, 0.0)
