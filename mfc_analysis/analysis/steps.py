"""Step responses of the closed loop, with their metrics.

All responses of a point are computed together, and one is a batch of one. For the samples see ``step_samples``. The metrics are those of the sum
of the modes, to where the last has died away: they depend on no grid and no duration. For dead time see ``delay.steps``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.step_metrics import Outcome, pair_metrics, points
from mfc_analysis.analysis.step_run import BAND
from mfc_analysis.analysis.step_samples import between, step_samples
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.checks import number, times as checked_times
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from control import TimeResponseData

    from mfc_analysis.plots.figure import Axes


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
        what, band = f"step {self.input} -> {self.output} at t = {self.time:.4g} s", f"{100 * self.settling_band:g} %"
        if self.outcome is not Outcome.SETTLES:
            return f"{what}: {self.outcome.value}"
        if np.isnan(self.rise):  # there is nothing to rise to
            peak = f"peak {self.peak:.4g} at {self.peak_time:.4g} s, " if self.peak else ""
            return f"{what}: returns to zero, {peak}settling {self.settling:.4g} s ({band} of the peak)"
        return (
            f"{what}: final value {self.steady_state:.4g}, rise {self.rise:.4g} s (10-90 %), settling {self.settling:.4g} s ({band}), "
            f"overshoot {100 * self.overshoot:.3g} %"
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
        if not isinstance(where, tuple) or len(where) != 3:
            raise BadArgument("index", where, "a point, an output and an input")
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
    point = points(one)[0]
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
