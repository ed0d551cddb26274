"""Step responses of the closed loop, with their metrics.

All responses of a point are computed together, and one is a batch of one. For the samples see ``step_samples``. The metrics are those of the sum
of the modes, to where the last has died away: they depend on no grid and no duration. For dead time see ``delay.steps``.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.delay.steps import delayed_runner, longest_run, longest_step, never_settled
from mfc_analysis.analysis.modal_response import ModalPieces, terms
from mfc_analysis.analysis.modes import Mode, modes
from mfc_analysis.analysis.slow import MOVES
from mfc_analysis.analysis.spectrum import spectrum
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.step_run import BAND, METRICS, metrics, metrics_of
from mfc_analysis.analysis.step_samples import FEWEST, between, input_groups, step_samples
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.maths.checks import number, times as checked_times
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from control import TimeResponseData

    from mfc_analysis.plots.figure import Axes

MOST_SAMPLES = 60_000_000  #: of a sampled loop
DIED = 14.0  #: time constants of the slowest characteristic root in a run with dead time,
ROOTS = 8  #: of those that are looked at
AFFORDED = 50_000  #: steps of such a run, unless it takes more to settle


class Outcome(enum.Enum):
    """Long-term behaviour of the response."""

    SETTLES = "the response settles"
    RAMPS = "the response does not settle within the horizon: a slow root integrates the input"
    GROWS = "the response grows: the closed loop is unstable"


@dataclass(frozen=True, eq=False)
class Step(Shown):
    """Response of one output to a unit step of one input. NaN: not defined (it does not settle, or it settles at zero)."""

    t: Array  #: (k,) [s]
    y: Array  #: (k,) output per unit of the input
    input: str
    output: str
    time: float  #: [s] of the operating point
    outcome: Outcome  #: does it settle?
    steady_state: float  #: final value; inf with its sign where it ramps, NaN where it grows
    rise: float  #: [s] from the first 10 % to the first 90 % of the final value; NaN if that is zero
    settling: float  #: [s] last time outside ``settling_band``; inf where it ramps, NaN where it grows
    settling_band: float  #: 0.02: of the final value, or of the peak where that is zero
    overshoot: float  #: fraction of the final value by which the peak exceeds it; NaN if that is zero
    undershoot: float  #: fraction of the final value by which the response first moves in the wrong direction
    peak: float  #: largest |y|, the final value where that is never exceeded; NaN where it does not settle
    peak_time: float  #: [s]; inf where the response comes nearest to its peak at the end

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """The response with its final value and settling band. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        settles = self.outcome is Outcome.SETTLES
        target = self.steady_state if settles else None
        band = self.settling_band * (abs(self.steady_state) or self.peak) if settles else None
        title = f"Unit step of {self.input}, t = {self.time:g} s"
        return plots.step(self.t, self.y, target=target, band=band, quantity=self.output, title=title, axes=plots.shown("response", ax))[0]

    @property
    def response(self) -> TimeResponseData:
        """The samples as a ``control.TimeResponseData`` of one input, a unit step, and one output."""
        return _response(self.t, self.y[None, None], (self.input,), (self.output,))

    def __str__(self) -> str:
        if self.outcome is not Outcome.SETTLES:
            return f"step {self.input} -> {self.output} at t = {self.time:.4g} s: {self.outcome.value}"
        return (
            f"step {self.input} -> {self.output} at t = {self.time:.4g} s: final value {self.steady_state:.4g}, rise {self.rise:.4g} s (10-90 %), "
            f"settling {self.settling:.4g} s ({100 * self.settling_band:g} %), overshoot {100 * self.overshoot:.3g} %"
        )

    __repr__ = __str__


@dataclass(frozen=True, eq=False)
class Steps:
    """Unit step responses of m points, ny outputs and nu inputs, computed when they are asked for; ``steps[i, output, input]`` is one of them.

    The metrics are (m, ny, nu), as in ``Step``, which defines them. They do not depend on ``t``.
    """

    t: Array  #: (k,) [s]
    system: OpenSystem  #: with the inputs and outputs asked for
    settling_band: float = BAND  #: of the final value, or of the peak where that is zero

    @property
    def inputs(self) -> tuple[str, ...]:
        """(nu,) names."""
        return self.system.input_names

    @property
    def outputs(self) -> tuple[str, ...]:
        """(ny,) names."""
        return self.system.output_names

    @property
    def times(self) -> Array:
        """(m,) [s] of the operating points."""
        return self.system.times

    @cached_property
    def y(self) -> Array:
        """(m, ny, nu, k) outputs per unit of the inputs. Raises ``BadArgument`` for more steps than a loop with dead time affords."""
        return step_samples(self.system, self.t)

    @cached_property
    def _metrics(self) -> dict[str, Array]:
        ny, nu = len(self.outputs), len(self.inputs)
        found = pair_metrics(self.system, np.tile(np.arange(nu), ny), np.repeat(np.arange(ny), nu))
        return {name: values.reshape(len(self), ny, nu) for name, values in found.items()}

    @property
    def outcome(self) -> Array:
        """(m, ny, nu) of ``Outcome``."""
        return self._metrics["outcome"]

    @property
    def steady_state(self) -> Array:
        """Final values; inf with its sign where a response ramps, NaN where it grows."""
        return self._metrics["steady_state"]

    @property
    def rise(self) -> Array:
        """[s] from the first 10 % to the first 90 % of the final value."""
        return self._metrics["rise"]

    @property
    def settling(self) -> Array:
        """[s] last time outside ``settling_band``; inf where a response ramps, NaN where it grows."""
        return self._metrics["settling"]

    @property
    def overshoot(self) -> Array:
        """Fraction of the final value by which the peak exceeds it."""
        return self._metrics["overshoot"]

    @property
    def undershoot(self) -> Array:
        """Fraction of the final value by which a response first moves in the wrong direction."""
        return self._metrics["undershoot"]

    @property
    def peak(self) -> Array:
        """Largest abs(y), the final value where that is never exceeded."""
        return self._metrics["peak"]

    @property
    def peak_time(self) -> Array:
        """[s]; inf where a response comes nearest to its peak at the end."""
        return self._metrics["peak_time"]

    def __getitem__(self, where: tuple[int, int | str, int | str]) -> Step:
        """One response, by its point, output and input (numbers or names). Raises ``BadArgument`` and ``UnknownName``."""
        i = _index(self.system, where[0])
        o, j = _number("output", where[1], self.outputs), _number("input", where[2], self.inputs)
        y = self.y[i, o, j] if "y" in self.__dict__ else step_samples(between(self.system.at(np.array([i])), [j], [o]), self.t)[0, 0, 0]
        metrics = {name: values[i, o, j] for name, values in self._metrics.items()}
        return Step(self.t, y, self.inputs[j], self.outputs[o], float(self.times[i]), settling_band=self.settling_band, **metrics)

    def plot(self, output: int | str = 0, input: int | str = 0, *, ax: Axes | None = None) -> Axes:
        """The responses of one output to one input at all m points, that with the longest settling time in colour.

        ``ax``: to draw in; None: a new figure of pyplot. Raises ``BadArgument`` and ``UnknownName`` as an index does.
        """
        from mfc_analysis import plots

        o, j = _number("output", output, self.outputs), _number("input", input, self.inputs)
        worst = int(np.argmax(np.nan_to_num(self.settling[:, o, j], nan=np.inf)))
        title, axes = f"Unit step of {self.inputs[j]}", plots.shown("response", ax)[0]
        when = float(self.times[worst])
        return plots.responses(self.t, self.y[:, o, j], worst=worst, worst_time=when, quantity=self.outputs[o], title=title, ax=axes)

    @property
    def responses(self) -> tuple[TimeResponseData, ...]:
        """The samples (ny, nu, k) at each of the m points as a ``control.TimeResponseData``, as ``control.step_response`` gives them."""
        return tuple(_response(self.t, y, self.inputs, self.outputs) for y in self.y)

    def __len__(self) -> int:
        return len(self.times)

    def _rows(self) -> list[tuple[str, str, str, str]]:
        """Of every output: its name, the longest settling and the largest overshoot with where they are, and how many settle."""
        return [
            (
                name,
                self._largest(self.settling[:, o], " s"),
                self._largest(100 * self.overshoot[:, o], " %"),
                f"{np.count_nonzero(self.outcome[:, o] == Outcome.SETTLES)} of {self.outcome[:, o].size}",
            )
            for o, name in enumerate(self.outputs)
        ]

    def _largest(self, values: Array, unit: str) -> str:
        known = np.where(np.isfinite(values), values, -np.inf)
        if not np.isfinite(known).any():
            return "-"
        i, j = np.unravel_index(int(known.argmax()), known.shape)
        return f"{values[i, j]:.4g}{unit} ({self.inputs[j]}, t = {self.times[i]:.4g} s)"

    def __str__(self) -> str:
        rows = [
            f"  {name}: longest settling {settling}, largest overshoot {over}; {settled} settle" for name, settling, over, settled in self._rows()
        ]
        return "\n".join([self._title, *rows])

    __repr__ = __str__

    @property
    def _title(self) -> str:
        points = f"{len(self)} point{'s' * (len(self) != 1)}"
        return f"step responses of {len(self.outputs)} outputs to {len(self.inputs)} inputs at {points}, {self.t.size} samples each"

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        heads = ("output", f"longest settling ({100 * self.settling_band:g} %)", "largest overshoot", "settle")
        return table(self._title, heads, self._rows())


def _response(t: Array, y: Array, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> TimeResponseData:
    """Responses y (ny, nu, k) to unit steps."""
    from control import TimeResponseData

    u = np.broadcast_to(np.eye(len(inputs))[..., None], (len(inputs), len(inputs), t.size))
    return TimeResponseData(
        t, y, inputs=u, issiso=y.shape[:2] == (1, 1), output_labels=list(outputs), input_labels=list(inputs), title="Step response",
        plot_inputs=False, trace_labels=[f"From {name}" for name in inputs], trace_types=["step"] * len(inputs),
    )  # fmt: skip


def step(system: OpenSystem, index: int, input: str | int, output: str | int, duration: float | None = None, times: ArrayLike | None = None) -> Step:
    """Unit step response from ``input`` to ``output`` of the closed loop at point ``index``, dead time included.

    ``input``, ``output``: names or numbers. ``times`` (k,) [s] of the samples returned, or their ``duration`` [s]; omitted: about twice the
    settling time. The metrics do not depend on it: they are those of the sum of all modes, or, with dead time, of a run to where the slowest
    root has died away. Raises ``UnknownName``, ``BadArgument``, and ``NotConverged`` where that takes too many steps.
    """
    i = _index(system, index)
    into, out = _number("input", input, system.input_names), _number("output", output, system.output_names)
    one = between(system.at(np.array([i])), [into], [out])
    if duration is not None:
        duration = number("duration", duration, low=0.0, strict=True)
    t = None if times is None else _sample_times(times)
    if t is not None and duration is not None:
        raise BadArgument("duration", duration, "either times or a duration")
    first = np.zeros(1, int)
    point = _points(one)[0]
    found = {name: values[0] for name, values in point.metrics(first, first).items()}
    if t is None:
        t, y = point.samples(duration, **found)
    else:
        y = step_samples(one, t)[0, 0, 0]
    found.pop("longest")
    return Step(t, y, one.input_names[0], one.output_names[0], float(one.times[0]), settling_band=BAND, **found)


def steps(system: OpenSystem, times: ArrayLike, inputs: Sequence[str | int] | None = None, outputs: Sequence[str | int] | None = None) -> Steps:
    """Unit step responses of all outputs to all inputs at all points, dead time included, sampled at ``times`` (k,) [s] after the step.

    ``inputs``, ``outputs``: names or numbers; None: all. Raises ``UnknownName`` and ``BadArgument``.
    """
    into, out = (
        range(len(known)) if asked is None else [_number(which, name, known) for name in asked]
        for which, asked, known in (("inputs", inputs, system.input_names), ("outputs", outputs, system.output_names))
    )
    for which, asked in (("inputs", into), ("outputs", out)):
        if not asked:
            raise BadArgument(which, [], "at least one of them")
    return Steps(_sample_times(times), between(system, into, out))


def _sample_times(times: ArrayLike) -> Array:
    t = checked_times(times)
    if t[0] < 0:
        raise BadArgument("times", times, "increasing times >= 0 [s] after the step")
    return t


def _index(system: OpenSystem, index: int) -> int:
    m = len(system.A)
    if not -m <= index < m:
        raise BadArgument("index", index, f"a point from 0 to {m - 1}")
    return int(index) % m


def _number(argument: str, name: str | int, known: tuple[str, ...]) -> int:
    if isinstance(name, (int, np.integer)) and not isinstance(name, (bool, np.timedelta64)):
        if not 0 <= name < len(known):
            raise UnknownName(argument, name, [*known, *map(str, range(len(known)))])
        return int(name)
    if not isinstance(name, str) or name not in known:
        raise UnknownName(argument, name, known)
    return known.index(name)


def _points(system: OpenSystem) -> list[Point]:
    verdict = stability(system)
    decay = verdict.nonzero_stable | ~verdict.held
    return [Point(system.at(np.array([i])), closed, bool(decay[i])) for i, closed in enumerate(zip(*close_wires(system), strict=True))]


def pair_metrics(system: OpenSystem, into: Ints, out: Ints) -> dict[str, Array]:
    """(m, P) outcome, final value and metrics, by their names in ``Step``, of the steps from inputs ``into`` (P,) to outputs ``out`` (P,)."""
    found = [point.metrics(into, out) for point in _points(system)]
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
        steady = d - starts.sum(axis=0)
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
        """The same with dead time, from a run to where the slowest characteristic root has died away, or as far as ``AFFORDED`` steps go."""
        system = self.system
        roots = delay_roots(system, ROOTS)[0]
        decay = -roots.real[np.isfinite(roots.real) & (np.abs(roots) >= system.radius)]
        longest = min(max([DIED / x for x in decay if x > 0], default=0.0), AFFORDED * longest_step(system))
        most = longest_run(system)
        longest = min(max(longest, 10 * float(system.wire_delay.max())), most)
        found = {name: np.zeros(steady.size) for name in (*METRICS, "longest")}
        rows = np.unique(out)
        for group in input_groups(between(system, range(system.nu), rows)):
            group = np.intersect1d(group, into)
            run = delayed_runner(between(system, group, rows))
            left, duration = np.flatnonzero(np.isin(into, group)), longest
            while left.size:
                piece = run(duration, FEWEST).of(np.searchsorted(rows, out[left]) * group.size + np.searchsorted(group, into[left]))
                new = metrics_of(piece, steady[left])
                settled = new["settling"] < 0.9 * duration
                for name, values in new.items():
                    found[name][left[settled]] = values[settled]
                found["longest"][left] = duration
                left = left[~settled]
                if left.size and duration >= most:
                    raise never_settled(system, int(into[left[0]]), int(out[left[0]]), float(min(decay, default=0.0)))
                duration = min(2 * duration, most)
        return found

    def samples(
        self, duration: float | None, outcome: Outcome, settling: float, overshoot: float, peak_time: float, longest: float, **_: float
    ) -> tuple[Array, Array]:
        """Times [s] and values of the only response of the system; ``duration`` None: chosen by its metrics."""
        system, dt = self.system, self.system.dt
        if duration is None:
            turned = peak_time if overshoot > 0 else 0.0
            duration = float(max(2 * settling, 1.2 * turned) or longest) if outcome is Outcome.SETTLES else self._unsettled()
            duration = min(duration, longest_run(system)) if system.delayed else duration
        if system.delayed:
            t, values = delayed_runner(system)(duration, self._count(duration)).samples
            return t, values[0]
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
