"""Frequency responses from measured signals, with their coherence: Welch's averaged spectra, direct or by way of an excitation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Complex

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

JITTER = 0.04  #: of a sample time: how far the steps of the time may differ; 2 % of a sample at each end are 0.4 deg at a tenth of the sample rate
FEWEST = 2  #: averages, without which a coherence says nothing
CYCLES = 50  #: of the lowest frequency of an octave in a segment, where the record is long enough
LOWEST_LINE = 3  #: of a window, the first that neither the mean nor its window's main lobe reaches
COHERENT = 0.8  #: coherence from which on a response is called measured, where a text must draw a line


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """A measured frequency response y = G u at k frequencies.

    The coherence is the part of the power at a frequency that is explained, 0 to 1; the rest is noise (or nonlinearity). Without an excitation r
    it is the ordinary coherence of u and y; with one the smaller of the coherence of r and u, and of |G U_r|^2 / (|G U_r|^2 + |y - G u|^2), U_r
    the part of u that r causes.
    """

    frequencies: Array  #: (k,) [rad/s], increasing
    response: Complex  #: (k,) G(jw)
    coherence: Array  #: (k,) 0 to 1
    averages: Array  #: (k,) independent segments in the average
    method: str  #: how it was estimated

    @property
    def frd(self) -> Any:
        """The response as ``control.FrequencyResponseData``."""
        import control

        return control.frd(self.response, self.frequencies, inputs=["u"], outputs=["y"], name="measured", smooth=False)

    @property
    def gain_db(self) -> Array:
        """(k,) [dB] of the response."""
        return np.asarray(20 * np.log10(np.maximum(np.abs(self.response), 1e-300)))

    @property
    def phase_deg(self) -> Array:
        """(k,) [deg] of the response, unwrapped."""
        return np.asarray(np.degrees(np.unwrap(np.angle(self.response))))

    @property
    def deviation(self) -> Array:
        """(k,) standard deviation of the response over its size: sqrt((1 - c) / (2 c K)), c the coherence, K the averages, times K / (K - 1).

        0.01 is 0.09 dB and 0.57 deg. Source: Bendat & Piersol, Random Data, ch. 9; the last factor for few averages, which look too coherent.
        """
        c, K = self.coherence, self.averages
        with np.errstate(divide="ignore"):
            return np.asarray(np.sqrt((1 - c) * K / (2 * c)) / (K - 1))

    def where(self, some: Bools) -> FrequencyResponse:
        """The response at some of its frequencies, (k,) booleans."""
        return FrequencyResponse(self.frequencies[some], self.response[some], self.coherence[some], self.averages[some], self.method)

    def plot(self, *, ax: tuple[Axes, Axes, Axes] | None = None) -> Axes:
        """Gain [dB], phase [deg] and coherence over the frequency [rad/s]. Returns the uppermost axes.

        ``ax``: three to draw in; None: a new figure of pyplot.
        """
        from mfc_analysis import plots

        return plots.response(self, axes=plots.shown("three histories", ax))[0]

    def _bands(self) -> str:
        """The bands in which the response is coherent."""
        good = self.coherence >= COHERENT
        edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
        bands = [(a, b - 1) for a, b in edges.reshape(-1, 2) if b - a >= 3]
        if not bands:
            return f"nowhere above {COHERENT:g}: nothing was measured"
        said = ", ".join(f"{self.frequencies[a]:.3g} to {self.frequencies[b]:.3g} rad/s" for a, b in bands[:4])
        return f"above {COHERENT:g} from {said}" + (" and in narrower bands" if len(bands) > 4 else "")

    def __str__(self) -> str:
        w = self.frequencies
        return (
            f"measured response, {w.size} frequencies from {w[0]:.4g} to {w[-1]:.4g} rad/s ({w[0] / 2 / np.pi:.3g} to {w[-1] / 2 / np.pi:.3g} Hz)\n"
            f"  {self.method}; {self.averages.min():.3g} to {self.averages.max():.3g} averages\n"
            f"  coherence {self._bands()}"
        )

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        title, *notes = str(self).splitlines()
        return table(title, COLUMNS, self.rows(), notes)

    def rows(self, count: int = 16) -> list[tuple[str, ...]]:
        """At most ``count`` frequencies, evenly spaced on a logarithmic axis, as cells in the order of ``COLUMNS``."""
        w = np.log(self.frequencies)
        some = np.unique([int(np.abs(w - at).argmin()) for at in np.linspace(w[0], w[-1], count)])
        gain, phase, off = self.gain_db, self.phase_deg, self.deviation
        return [
            (
                f"{self.frequencies[i]:.4g}", f"{self.frequencies[i] / 2 / np.pi:.3g}", f"{gain[i]:.2f}", f"{phase[i]:.1f}",
                f"{self.coherence[i]:.3f}", f"{8.686 * off[i]:.2g} dB, {np.degrees(off[i]):.2g} deg",
            )
            for i in some
        ]  # fmt: skip


COLUMNS = ("w [rad/s]", "[Hz]", "gain [dB]", "phase [deg]", "coherence", "standard deviation")


def estimate(
    t: ArrayLike,
    u: ArrayLike,
    y: ArrayLike,
    r: ArrayLike | None = None,
    *,
    period: float | None = None,
    averages: int = 8,
    cycles: float = CYCLES,
    window: str = "hann",
) -> FrequencyResponse:
    """The frequency response G of y = G u from a record of N samples, by averaged spectra (Welch), with its coherence.

    Args:
        t: (N,) [s], uniform.
        u: (N,) input of what is measured, any unit; for L of a loop that is excited between controller and arm: the signal after the excitation.
        y: (N,) its output, any unit; for L: minus the signal before the excitation, as L is in negative feedback.
        r: (N,) [unit of u] the excitation, where the record is of a closed loop. There the noise comes back through the feedback into u: u and y
            alone give a biased G, often with a coherence near 1. With r the estimate G = S_ry / S_ru has no such bias (joint input-output).
        period: [s] of a periodic excitation (a multisine), a whole number of samples. Each segment is then one period without a window, so nothing
            leaks, and only the lines of the excitation are kept. Leave out the first period, in which the arm has not settled.
        averages: smallest number of segments, that of the lowest frequencies; higher ones have more. Segments overlap by half.
        cycles: periods of the lowest frequency of each octave in a segment, as far as ``averages`` allows: the frequencies are 1/``cycles`` of
            it apart. More for a lightly damped resonance.
        window: of ``scipy.signal.get_window``.

    Returns:
        ``FrequencyResponse``; ``.frd`` is a ``control.FrequencyResponseData``.

    Raises BadArgument: steps of t that differ (with the index), signals of another length, a record too short. Source: Ljung, System
    Identification, ch. 6 and 13; Pintelon & Schoukens, System Identification, ch. 2.
    """
    dt = sample_time(t)
    N = np.size(t)
    given = [("u", u), ("y", y), *([] if r is None else [("r", r)])]
    signals = np.stack([checks.array(name, x, (N,)) for name, x in given])
    for (name, _), x in zip(given, signals, strict=True):
        if np.ptp(x) == 0:
            raise BadArgument(name, f"{x[0]:g} at all times", "a signal that changes")
    fewest = checks.whole("averages", averages, FEWEST, 10**6)
    if period is not None:
        return _periodic(signals, dt, _samples_of(period, dt, N))
    cycles = checks.number("cycles", cycles, low=2.0)
    longest = 2 * N // (fewest + 1)
    if longest < 4 * LOWEST_LINE:
        raise BadArgument("t", f"{N} samples", f"at least {2 * LOWEST_LINE * (fewest + 1)} samples for {fewest} averages")
    parts, high = [], 0.5 / dt
    while True:
        size = int(np.ceil(2 * cycles / (high * dt)))
        last = size >= longest
        size = min(size, longest)
        f, spectra = _spectra(signals, dt, size, window)
        low = LOWEST_LINE / (size * dt) if last else high / 2
        some = (f >= low * (1 - 1e-9)) & (f < high * (1 - 1e-9))
        parts.append((f[some], spectra[:, :, some], np.full(int(some.sum()), _independent(N, size, window))))
        if last:
            break
        high = low
    f, spectra, K = (np.concatenate([part[i] for part in reversed(parts)], axis=-1) for i in range(3))
    return _response(f, spectra, K, _said(r, f"Welch, {window} window, half overlap"))


def sample_time(t: ArrayLike) -> float:
    """The sample time [s] of times ``t`` (N,) [s]. Raises BadArgument, which names the first step that is not as long as the others."""
    takes = "times [s] with steps of one length: interpolate the record, or cut it at the gap"
    times = checks.array("t", t, (None,))
    if times.size < 2 * LOWEST_LINE:
        raise BadArgument("t", f"{times.size} times", f"at least {2 * LOWEST_LINE} times [s]")
    steps = np.diff(times)
    usual = float(np.median(steps))
    if usual <= 0:
        raise BadArgument("t", f"steps of {usual:g} s", takes)
    bad = np.flatnonzero(np.abs(steps - usual) > JITTER * usual)
    if bad.size:
        k = int(bad[0]) + 1
        raise BadArgument(f"t[{k}]", f"{times[k]:.9g}, {steps[k - 1]:.6g} s after the time before, and not {usual:.6g} s", takes)
    return float((times[-1] - times[0]) / (times.size - 1))


def _samples_of(period: object, dt: float, N: int) -> int:
    whole = checks.number("period", period, low=0.0, strict=True) / dt
    size = round(whole)
    if abs(whole - size) > 1e-3 or size < 2 * LOWEST_LINE or size * FEWEST > N:
        raise BadArgument("period", f"{whole:.6g} samples", f"a whole number of samples [s], of which t, with {N}, has at least {FEWEST} periods")
    return size


def _spectra(signals: Array, dt: float, size: int, window: str, overlap: bool = True) -> tuple[Array, Complex]:
    """Frequencies [Hz] and averaged cross spectra (s, s, k) conj(X_i) X_j of the signals (s, N), in segments of ``size`` samples."""
    from scipy import signal

    try:
        f, P = signal.csd(
            signals[:, None], signals[None], 1 / dt, window=window, nperseg=size, noverlap=size // 2 if overlap else 0, detrend="constant"
        )
    except ValueError as why:
        raise BadArgument("window", window, "the name of a window of scipy.signal.get_window") from why
    return np.asarray(f, float), np.asarray(P, np.complex128)


def _independent(N: int, size: int, window: str) -> float:
    """Segments of ``size`` samples that overlap by half, counted as independent ones of equal variance."""
    from scipy import signal

    count = max(1, (N - size // 2) // (size - size // 2))
    w = np.asarray(signal.get_window(window, size), float)
    c = float(w[: size - size // 2] @ w[size // 2 :]) / float(w @ w)
    return count / (1 + 2 * c**2 * (1 - 1 / count))


def _response(f: Array, P: Complex, K: Array, method: str) -> FrequencyResponse:
    """G and its coherence from the spectra of (u, y) or (u, y, r), where there is power."""
    k = P.shape[0] - 1  # of the excitation: r, or u itself
    k = k if k == 2 else 0
    some = (np.abs(P[k, 0]) > 0) & (P[k, k].real > 0)
    if not some.any():
        raise BadArgument("u", "a signal without power at these frequencies", "a signal with an excitation")
    f, P, K = f[some], P[:, :, some], K[some]
    G = P[k, 1] / P[k, 0]
    explained = np.abs(P[k, 1]) ** 2 / P[k, k].real
    noise = np.maximum(P[1, 1].real - 2 * (G * P[0, 1].conj()).real + np.abs(G) ** 2 * P[0, 0].real, 0.0)
    total = explained + noise
    coherence = np.divide(explained, total, out=np.zeros_like(total), where=total > 0)
    if k:  # where r causes nothing, G is that of the noise, which may explain y well
        coherence = np.minimum(coherence, np.abs(P[k, 0]) ** 2 / (P[k, k] * P[0, 0]).real)
    return FrequencyResponse(2 * np.pi * f, np.asarray(G), np.clip(coherence, 0.0, 1.0), np.asarray(K, float), method)


def _periodic(signals: Array, dt: float, size: int) -> FrequencyResponse:
    """Averaged over whole periods of ``size`` samples, at the lines that the excitation repeats in every period."""
    periods = signals.shape[1] // size
    f, P = _spectra(signals[:, : periods * size], dt, size, "boxcar", overlap=False)
    k = 2 if len(signals) == 3 else 0
    lines = np.fft.rfft(signals[k, : periods * size].reshape(periods, size), axis=1)
    power = (np.abs(lines) ** 2).mean(axis=0)
    repeats = np.abs(lines.mean(axis=0)) ** 2 > 0.5 * power
    inner = np.arange(f.size)
    some = repeats & (power > 1e-8 * power[1:].max()) & (inner > 0) & (inner < size / 2)
    if not some.any():
        raise BadArgument("period", f"{size * dt:g} s", "the period [s] of the excitation: no line of this one repeats")
    method = _said(signals if k else None, f"{periods} periods of {size * dt:.6g} s, no window")
    return _response(f[some], P[:, :, some], np.full(int(some.sum()), float(periods)), method)


def _said(r: object, how: str) -> str:
    return f"{how}; from the excitation r (no bias by feedback)" if r is not None else f"{how}; from u and y alone"
