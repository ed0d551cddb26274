"""A measured loop over the model's: the misfit at each frequency, the margins of both, and a verdict in words."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis.analysis.frf import FrequencyResponse
from mfc_analysis.analysis.margins import Margins
from mfc_analysis.analysis.measured import sampled_margins, samples
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array, Bools, Complex

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

UNSURE = 0.12  #: standard deviation of a measured response over its size (1 dB, 7 deg) above which it takes no part in a verdict
NEAR_DB = 20.0  #: the margins are decided where the gain of the loop is within this of 1
WIDTH = 1 / 6  #: [octave] half the width of the widest average over neighbouring frequencies
SURE = 0.01  #: standard deviation over its size (0.09 dB, 0.6 deg) from which on a response is not averaged over its neighbours
GAIN_DB, PHASE_DEG = 0.5, 3.0  #: a misfit below these, and below two standard deviations, is none
FEWEST = 3  #: frequencies of a comparison


@dataclass(frozen=True, eq=False)
class Comparison:
    """A measured loop L and the model's at the same k frequencies, and the margins of both; L is in negative feedback."""

    at: str  #: analysis point
    channel: str  #: of it
    time: float  #: [s] of the linearisation
    frequencies: Array  #: (k,) [rad/s], increasing
    measured: Complex  #: (k,) L(jw)
    model: Complex  #: (k,) L(jw), dead time included
    deviation: Array  #: (k,) standard deviation of the measured response over its size; 0 where it is not known
    model_margins: Margins  #: of the model, one time and channel, exact

    @cached_property
    def trusted(self) -> Bools:
        """(k,) where the measured response is known well enough, to 12 % (1 dB, 7 deg), and so are most of its neighbours.

        Of a thousand frequencies without any signal, a few have a high coherence by chance.
        """
        return np.asarray((self.deviation <= UNSURE) & (_median(self.frequencies, self.deviation) <= UNSURE))

    @property
    def gain_db(self) -> Array:
        """(k,) [dB] the measured gain less the model's."""
        return np.asarray(20 * np.log10(np.abs(self.measured / self.model)))

    @cached_property
    def phase_deg(self) -> Array:
        """(k,) [deg] the measured phase less the model's, continuous over the trusted frequencies; negative where the measured loop lags more."""
        turn = np.degrees(np.angle(self.measured / self.model))
        some = np.flatnonzero(self.trusted)
        if some.size:
            first = some[np.abs(np.log(np.abs(self.model[some]))).argmin()]  # beside the crossover a misfit is less than half a turn
            out = np.degrees(np.unwrap(np.radians(turn[some])))
            turn[some] = out + turn[first] - out[np.searchsorted(some, first)]
        return np.asarray(turn)

    @cached_property
    def averaged(self) -> Complex:
        """(k,) the measured loop with less noise: its misfit averaged over as many neighbours as bring its standard deviation to 1 %.

        These lie within a sixth of an octave; where the response is known to 1 % it stays as measured, resonances included.
        """
        misfit = self.gain_db * np.log(10) / 20 + 1j * np.radians(self.phase_deg)
        out, w, some = np.array(self.measured, np.complex128), np.log2(self.frequencies), np.flatnonzero(self.trusted)
        for i in some:
            away = np.abs(w[some] - w[i])
            nearest = np.argsort(away, kind="stable")[: max(1, int(np.ceil((self.deviation[i] / SURE) ** 2)))]
            out[i] = self.model[i] * np.exp(misfit[some[nearest[away[nearest] <= WIDTH]]].mean())
        return out

    @cached_property
    def margins(self) -> Margins:
        """Margins of the measured loop, from the trusted data (``averaged``) and nothing beyond them; NaN where it, or the model, is unstable.

        The measured loop is stable if the model is and (1 + L) of the data over that of the model does not encircle 0. Outside the data the loop is
        taken to be the model. Raises BadArgument where the data are too coarse, or end where 1 + L is far from the model's.
        """
        some = self.trusted
        w, L, M = self.frequencies[some], self.averaged[some], self.model[some]
        stable = bool(self.model_margins.stable[0])
        if stable:
            ratio = (1 + L) / (1 + M)
            steps = np.angle(ratio[1:] / ratio[:-1])
            turned = float(steps.sum())
            ends = abs(float(np.angle(ratio[0]))) + abs(float(np.angle(ratio[-1])))
            if np.abs(steps).max() > 0.9 * np.pi or ends > 0.9 * np.pi:
                takes = "trusted samples closer together, up to frequencies at which the measured loop is near the model or small"
                raise BadArgument("frd", f"{w.size} trusted samples from {w[0]:.4g} to {w[-1]:.4g} rad/s", takes)
            stable = abs(turned - float(np.angle(ratio[-1]) - np.angle(ratio[0]))) < 0.1
        return sampled_margins(w, L, stable, self.at, self.channel)

    # --- the verdict ---------------------------------------------------------------------------------------------------

    @cached_property
    def near(self) -> Bools:
        """(k,) the trusted frequencies that decide the margins: there the gain of the model or of the data is within 20 dB of 1."""
        size = 20 * np.abs(np.log10(np.abs(np.stack([self.measured, self.model]))))
        return np.asarray(self.trusted & (size <= NEAR_DB).any(axis=0))

    @cached_property
    def missing_delay(self) -> float:
        """[s] the dead time that would explain the misfit of the phase near the crossover; NaN where it explains less than 80 % of it.

        Negative where the model has too much.
        """
        w, phase = self.frequencies[self.near], np.radians(self.phase_deg[self.near])
        if w.size < FEWEST or not phase.any():
            return float("nan")
        late = -float(w @ phase) / float(w @ w)
        left = phase + w * late
        return late if left @ left < 0.2 * (phase @ phase) else float("nan")

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Where the model is off, in words: the bands in which the misfit is more than noise and more than 0.5 dB or 3 deg, the largest first."""
        w = self.frequencies[self.near]
        if w.size < FEWEST:
            return ()
        L, M = self.measured[self.near], self.model[self.near]
        noise = self._averaged_deviation()
        found: list[tuple[float, str]] = []
        for misfit, least, unit, per_unit in ((self.phase_deg[self.near], PHASE_DEG, "deg", 57.3), (self.gain_db[self.near], GAIN_DB, "dB", 8.686)):
            middle = _median(w, misfit)
            sign = np.sign(middle) * (np.abs(middle) > np.maximum(least, 2 * per_unit * noise))
            for a, b in _runs(sign):
                worse = np.median(np.abs(1 + L[a:b]) / np.abs(1 + M[a:b])) < 1
                low, high = np.percentile(np.abs(middle[a:b]), [10, 90])
                size = f"{_short((low + high) / 2)} {unit}" if high < 1.5 * low else f"{_short(low)} to {_short(high)} {unit}"
                where = _band(w[a], w[b - 1], a == 0, b == w.size)
                what = f"its {'phase' if unit == 'deg' else 'gain'} is too {'low' if sign[a] > 0 else 'high'}"
                found.append((float(high / least), f"the model is {'optimistic' if worse else 'pessimistic'} by {size} {where} ({what})"))
        return tuple(said for _, said in sorted(found, reverse=True))

    @property
    def verdict(self) -> str:
        """The answer in a sentence: where the model is optimistic or pessimistic, and by how much; or how well it agrees."""
        w = self.frequencies[self.near]
        if w.size < FEWEST:
            return "no verdict: near the crossover there are too few frequencies at which the measured loop is known to 1 dB"
        if not self.findings:
            gain, phase = (np.abs(_median(w, x[self.near])).max() for x in (self.gain_db, self.phase_deg))
            band = _band(w[0], w[-1], False, False)
            return f"the model agrees with the data, within {_short(max(gain, 0.05))} dB and {_short(max(phase, 0.5))} deg {band}"
        said = "; ".join(self.findings[:3])
        late = self.missing_delay
        if "deg" in said and np.isfinite(late):
            said += f"; {_short(abs(1e3 * late))} ms of dead time {'missing' if late > 0 else 'too much'} in the model would explain the phase"
        return said

    def _averaged_deviation(self) -> Array:
        """(j,) of the median over neighbours, at the near frequencies."""
        w, off = self.frequencies[self.near], self.deviation[self.near]
        count = np.array([(np.abs(np.log2(w / at)) <= WIDTH).sum() for at in w])
        return np.asarray(1.25 * off / np.sqrt(count))

    # --- shown ---------------------------------------------------------------------------------------------------------

    def numbers(self) -> dict[str, dict[str, float]]:
        """Each margin, by its name in ``Margins``: measured and of the model; NaN where it is not known."""
        try:
            found = self.margins
        except BadArgument:
            found = None
        nan = float("nan")
        return {
            key: {"measured": nan if found is None else float(getattr(found, key)[0, 0]), "model": float(getattr(self.model_margins, key)[0, 0])}
            for _, _, _, key in MARGINS
        }

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Each margin: its name, measured, of the model, and the measured one less the model's."""
        try:
            found = self.margins
        except BadArgument as why:
            return [("margins", f"not found: {why}", "", "")]
        if np.isnan(found.phase_deg).any():
            whose = "measured loop" if self.model_margins.stable[0] else "model"
            return [("margins", f"not defined: the {whose} is unstable", "", "")]
        out = []
        for name, unit, scale, key in MARGINS:
            a, b = (scale * float(getattr(m, key)[0, 0]) for m in (found, self.model_margins))
            off = f"{a - b:+.3g} {unit}" if np.isfinite(a) and np.isfinite(b) else ""
            out.append((name, f"{a:.4g} {unit}" if np.isfinite(a) else "not in the data", f"{b:.4g} {unit}" if np.isfinite(b) else "unlimited", off))
        return [(a, *(x.rstrip() for x in cells)) for a, *cells in out]  # type: ignore[misc]  # four of them

    def __str__(self) -> str:
        w = self.frequencies[self.trusted]
        span = f" from {w[0]:.4g} to {w[-1]:.4g} rad/s" if w.size else ""
        lines = [
            f"measured loop over the model at {self.at!r}, {self.channel}, t = {self.time:g} s: {w.size} of {self.frequencies.size} "
            f"frequencies trusted{span}",
            f"  {self.verdict}",
        ]
        rows = [("", "measured", "model", "difference"), *self.rows()]
        wide = [max(len(row[k]) for row in rows) for k in range(4)]
        return "\n".join(lines + ["  " + "  ".join(cell.ljust(wide[k]) for k, cell in enumerate(row)).rstrip() for row in rows])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        title, verdict, *_ = str(self).splitlines()
        return table(title, ("margin", "measured", "model", "difference"), self.rows(), [verdict.strip()])

    def plot(self, *, ax: tuple[Axes, Axes, Axes] | None = None) -> Axes:
        """Gain and phase of both loops over the frequency [rad/s], and the misfit of the phase. Returns the uppermost axes.

        ``ax``: three to draw in; None: a new figure of pyplot.
        """
        from mfc_analysis import plots

        return plots.comparison(self, axes=plots.shown("three histories", ax))[0]


MARGINS = (
    ("phase margin", "deg", 1.0, "phase_deg"),
    ("crossover", "rad/s", 1.0, "crossover"),
    ("gain margin, up", "dB", 1.0, "gain_increase_db"),
    ("gain margin, down", "dB", 1.0, "gain_reduction_db"),
    ("delay margin", "ms", 1e3, "delay"),
    ("sensitivity peak", "", 1.0, "sensitivity_peak"),
)  #: name, unit, factor to it, and field of ``Margins``


def _median(w: Array, values: Array) -> Array:
    """The median of the values (k,) over the neighbours within ``WIDTH`` of each frequency."""
    return np.array([np.median(values[np.abs(np.log2(w / at)) <= WIDTH]) for at in w])


def _runs(sign: Array) -> list[tuple[int, int]]:
    """Start and end of each run of one sign that is not zero and at least ``FEWEST`` long."""
    edges = [0, *(np.flatnonzero(np.diff(sign)) + 1).tolist(), sign.size]
    return [(a, b) for a, b in pairwise(edges) if sign[a] and b - a >= FEWEST]


def _short(value: float) -> str:
    """A positive number with two digits, whole from 100 on."""
    return f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"


def _band(low: float, high: float, from_first: bool, to_last: bool) -> str:
    a, b = (_short(w / 2 / np.pi) for w in (low, high))
    if from_first and to_last:
        return f"from {a} to {b} Hz"
    return f"below {b} Hz" if from_first else f"above {a} Hz" if to_last else f"between {a} and {b} Hz"


def measured_loop(frd: object, dt: float) -> tuple[Array, Complex, Array]:
    """Frequencies (k,) [rad/s], L (k,) and its standard deviation over its size (k,), below the Nyquist frequency of a model with ``dt`` [s] > 0.

    Raises BadArgument.
    """
    import control

    if isinstance(frd, FrequencyResponse):
        w, L, deviation = frd.frequencies, frd.response, frd.deviation
    elif isinstance(frd, control.FrequencyResponseData):
        w, L = samples(frd, "frd")
        deviation = np.zeros(w.size)
    else:
        raise BadArgument("frd", frd, "a result of mfc.frf.estimate, or control.FrequencyResponseData of one channel")
    some = (w < np.pi / dt) & (L != 0) if dt else L != 0
    if some.sum() < FEWEST:
        raise BadArgument("frd", f"{some.sum()} frequencies", f"at least {FEWEST} frequencies, below the Nyquist frequency of a sampled loop")
    return w[some], L[some], deviation[some]
