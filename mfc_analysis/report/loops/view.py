"""A loop with the results that a report shows: verdict, linearisation, margins and the worst case along the path; each computed once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mfc_analysis.analysis.frequency.response import frequency_response
from mfc_analysis.analysis.frequency.window import window
from mfc_analysis.maths.arrays import Array, Bools, Complex
from mfc_analysis.report.document.document import Number, found_of, limit_of, written
from mfc_analysis.report.loops.checks import checks
from mfc_analysis.report.loops.points import Smallest, smallest
from mfc_analysis.requirements.line import Line
from mfc_analysis.requirements.requirements import Requirements, Verdict
from mfc_analysis.requirements.slow import slow_words

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.linearization.linearization import Linearization
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.requirements.evidence import Evidence


FEWEST_ROOTS = 6  #: of a loop with dead time
NO_FEEDBACK = 1e-12  #: |L| below which a channel counts as without feedback
FAR, FAST = 0.5, 10.0  #: [rad, m], [rad/s, m/s] beyond which a diverging simulation is cut off


class Place(NamedTuple):
    """The worst case of a loop along its path."""

    row: int  #: index of the time
    channel: int  #: index of the channel at the analysis point
    time: float  #: [s]
    name: str  #: of the channel


@dataclass(frozen=True, eq=False)
class View:
    """One loop with the results that its pages need.

    Args:
        name: of the loop, as shown to the reader. times: (m,) [s]. at: analysis point; None: the plant input.
    """

    name: str
    loop: ClosedLoop
    times: Array
    requirements: Requirements = field(default_factory=Requirements)
    at: str | None = None

    @cached_property
    def verdict(self) -> Verdict:
        """The requirements and the values found."""
        return self.requirements.check(self.loop, self.times, self.at)

    @property
    def evidence(self) -> Evidence:
        """The metrics behind the verdict."""
        return self.verdict.evidence

    @property
    def point(self) -> str:
        """The analysis point."""
        return self.verdict.at

    @property
    def lin(self) -> Linearization:
        """The loop linearised about its reference at the times."""
        return self.evidence.linearization

    @property
    def margins(self) -> Margins:
        """One-loop margins at the analysis point."""
        return self.evidence.margins

    @cached_property
    def every_margin(self) -> tuple[Margins, ...]:
        """The margins at each analysis point of the loop, those at ``point`` first."""
        return (self.margins, *(self.lin.margins(point) for point in self.lin.opened.points if point != self.point))

    @cached_property
    def smallest(self) -> Mapping[str, Smallest]:
        """The smallest margins over all analysis points."""
        return smallest(self.every_margin)

    def place(self, found: Smallest) -> str:
        """Channel, analysis point if the loop has several, and time on a path, as text."""
        return place_words(found.where if len(self.every_margin) > 1 else found.channel, found.when, len(self.times))

    @property
    def checks(self) -> tuple[Line, ...]:
        """The lines of the verdict, in the units shown to the reader, with their analysis point if the loop has several."""
        many = len(self.every_margin) > 1
        return checks(self.verdict.lines, self.point if many else "", self.smallest)

    @cached_property
    def stable(self) -> bool:
        """Whether the roots that are not slow are stable at all times, so that the margins are defined."""
        return bool(self.evidence.judged.all())

    @cached_property
    def fed_back(self) -> Bools:
        """(n,) whether each channel of the analysis point has feedback at any time, judged by its loop transfer function."""
        grid = np.geomspace(1e-2, 1e3, 12) if not self.lin.dt else np.geomspace(1e-2, 0.9 * np.pi / self.lin.dt, 12)
        few = self.lin.again(self.times[np.unique(np.linspace(0, len(self.times) - 1, 3).astype(int))])
        return np.asarray(np.nanmax(np.abs(few.frequency_response(grid, self.point)), axis=(0, 2), initial=0.0) > NO_FEEDBACK)

    @cached_property
    def worst(self) -> Place:
        """The smallest phase margin; without a crossover, the gain margins, then the peak decide. Unstable loops: the rightmost pole."""
        m, names = self.margins, self.margins.channels
        if not self.stable:
            root = self.evidence.slowest_root()
            i = int(np.argmin(np.abs(self.times - (root.when or 0.0))))
            k = next((j for j, name in enumerate(names) if name == root.where), 0)
            if not self.fed_back[k] and self.fed_back.any():
                k = int(np.argmax(self.fed_back))
            return Place(i, k, float(self.times[i]), names[k])
        for values in (m.phase_deg, m.gain_increase, -m.gain_reduction, -m.sensitivity_peak):
            kept = np.where(np.isnan(values), np.inf, values)
            if np.isfinite(kept.min()) and kept.min() != 0:
                i, k = (int(x) for x in np.unravel_index(int(np.argmin(kept)), kept.shape))
                return Place(i, k, float(self.times[i]), names[k])
        return Place(0, 0, float(self.times[0]), names[0])

    def frequencies(self, count: int = 360) -> Array:
        """(count,) [rad/s] around the poles and crossover frequencies of the worst case."""
        i, k = self.worst.row, self.worst.channel
        m = self.margins
        marks = np.array([f[i, k] for f in (m.crossover, m.reduction_frequency, m.increase_frequency)])
        return window(self.evidence.spectrum.rates[i], marks, float(m.crossover[i, k]), self.lin.dt, count)

    def response(self, frequencies: Array, at: str | None = None, channel: int | None = None) -> Complex:
        """(nf,) L(jw) in the worst case (``channel``: of another channel), dead time included."""
        one = self.lin.again(self.times[self.worst.row : self.worst.row + 1])
        point = at or self.point
        k = self.worst.channel if channel is None else channel
        return np.asarray(frequency_response(one.opened_for(point), frequencies, point, k)[0, 0])

    @property
    def delayed(self) -> bool:
        """Whether the loop has dead time that its poles leave out."""
        return bool(self.lin.delay or self.lin.force_delay)

    @cached_property
    def poles(self) -> Complex:
        """(m, k) closed-loop poles, slowest first (a sampled loop: in z); with dead time its exact rightmost roots [1/s], rightmost first."""
        if not self.delayed:
            return self.evidence.spectrum.poles
        found = self.evidence.roots[0]
        if found.shape[1] < FEWEST_ROOTS:
            found = self.lin.delay_roots(FEWEST_ROOTS)
        return np.asarray(found[:, np.isfinite(found).all(axis=0)])

    @property
    def growth(self) -> float:
        """[1/s] growth rate in the worst case: the largest real part of the roots, dead time included; 0 if none is positive."""
        real = self.evidence.roots[0][self.worst.row].real
        return float(np.max(real[np.isfinite(real)], initial=0.0))

    def calm(self, duration: float) -> float:
        """The part of ``duration`` [s] to simulate from the worst case: until the error exceeds ``FAR`` or the speed exceeds ``FAST``.

        The whole duration if the loop is stable and the residual at the operating point is zero.
        """
        if self.growth == 0 and not any(line.name == "residual" for line in self.verdict.lines):
            return duration
        x, start, span = self.lin.point.x[self.worst.row], self.worst.time, duration / 32
        while True:
            run = self.loop.simulate(start + np.linspace(0.0, span, 9), x=x)
            if run.diverged or np.abs(run.error - run.error[0]).max() > FAR or np.abs(run.v).max() > FAST or span >= duration:
                return span
            span = min(2 * span, duration)

    def summary(self) -> str:
        """The finding, made from the verdict; where something drifts or is free also what, how slowly, and what would hold it."""
        return f"{self._found()} {self.slow()}".rstrip()

    def slow(self) -> str:
        """Sentences on what keeps moving or is free within the horizon; "" where nothing is."""
        words = slow_words(self.evidence)
        return " ".join(f"{text[:1].upper()}{text[1:]}." for text in (words.means, words.fastest) if words.means and text)

    def _found(self) -> str:
        line, checks = self.verdict.worst, self.checks
        if self.verdict.status == "PASS":
            asked = len(checks)
            lead = "Stable along the whole path" if asked == 1 else f"All {asked} requirements are met"
            return f"{lead}; {self.tightest()}."
        said = checks[0]
        place = f" ({said.place})" if said.place else ""
        note = f": {line.note}" if line.note else ""
        name = said.label[:1].upper() + said.label[1:]
        if np.isnan(line.found):
            return f"{name}: {found_of(said)}{place}{note}."
        if line.name == "stable":
            late = " (dead time included)" if self.delayed else ""
            if line.note.startswith("unstable"):
                return f"Not stable{late}{note.removeprefix(': unstable')}."
            word = "Not stable" if line.status == "FAIL" else "Stable, with a warning"
            return f"{word}: the rightmost {'root' if late else 'pole'}{late} is at {found_of(said)}{place}{note if word == 'Not stable' else ''}."
        return f"{name} is {found_of(said)}, required: {limit_of(said)}{place}{note}."

    def tightest(self) -> str:
        """The smallest phase margin over all analysis points as text."""
        if not self.fed_back.any():
            return "there is no feedback, so there are no margins"
        if not self.stable:
            return f"the loop is unstable ({self.evidence.unstable}), so its margins are not defined"
        found = self.smallest["phase_deg"]
        if not np.isfinite(found.value):
            return f"the loop has no crossover ({place_words(self.worst.name, self.worst.time, len(self.times))})"
        return f"the smallest phase margin is {Number(found.value, '°')} at {Number(found.crossover, 'rad/s')} ({self.place(found)})"


def place_words(name: str, time: float, count: int) -> str:
    """Channel and time as text; only the channel if there is a single time."""
    return name if count == 1 else f"{name}, t = {written(round(time, 4), exact=True)} s"
