"""Roots of a sampled loop that reach the contour as the dead time of one channel grows: Newton in (contour, dead time), and special exits.

The contour is the unit circle from the angle of 1/horizon to z = -1, and the arc of the slow roots before it. A loop whose channel acts on
itself within the sample is also lost by a jump, at a whole number of samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mfc_analysis.analysis.frequency.arc import angles
from mfc_analysis.analysis.shifted import Shifted
from mfc_analysis.analysis.spectrum import rates
from mfc_analysis.maths.arrays import Array, Complex, Ints, on_axis

LONGEST = 2000  #: [samples] longest additional dead time at which a crossing is sought of a curve that does not reach all fractions
NEWTON = 12  #: steps
SAME = 1e-9  #: [samples] a crossing this close to the present dead time is the loop itself
NONE = np.log(1e-3)  #: log of the loop gain at all closed poles, below which a channel is never lost
DIRECT = 1e-6  #: relative change of Y at a whole number of samples that is a jump,
FINE, ARC, HALVINGS = 12, 60, 40  #: frequencies a sample of dead time, angles on the arc, along which such a loop is judged, and their halvings

Cases = tuple[Ints, Ints, Array, Array]  # point, channel, parameter of the contour or angle [rad], dead time [samples]; each (k,)
Contour = Callable[[Array], tuple[Complex, Complex, Complex]]  # parameter -> z, ln z and its slope


def circle(theta: Array) -> tuple[Complex, Complex, Complex]:
    """The unit circle at angles theta (k,) [rad]: z, ln z and its slope."""
    return np.asarray(np.exp(1j * theta), np.complex128), on_axis(theta), np.full(theta.size, 1j, np.complex128)


def polished(loop: Shifted, point: Ints, channel: Ints, u: Array, T: Array, contour: Contour, lowest: float) -> Cases:
    """Newton in the parameter of the contour and the dead time; those that converge to a later dead time than the present one."""
    u, T, first = u.copy(), T.copy(), T.copy()
    miss = np.full(u.size, np.inf)
    for _ in range(NEWTON):
        d = np.maximum(np.ceil(T) - 1, 0)
        z, log_z, slope = contour(u)
        value, by_z, by_f = loop.at(point, channel, z, T - d)
        error = value - (d + 1) * log_z
        error = error.real + 1j * (np.remainder(error.imag + np.pi, 2 * np.pi) - np.pi)
        miss = np.abs(error)
        by_u = (by_z * z - (d + 1)) * slope
        with np.errstate(divide="ignore", invalid="ignore"):
            across = by_u.real * by_f.imag - by_u.imag * by_f.real
            du = (error.real * by_f.imag - error.imag * by_f.real) / across
            dT = (by_u.real * error.imag - by_u.imag * error.real) / across
        size = np.maximum(np.maximum(np.abs(du) / (0.2 * np.abs(u) + 1e-3), np.abs(dT) / 0.3), 1)
        go = np.isfinite(du) & np.isfinite(dT)
        if not go.any() or (np.abs(dT[go]) <= 1e-13 * T[go]).all():
            break
        u, T = np.where(go, u - du / size, u), np.where(go, T - dT / size, T)
    good = (miss < 1e-7) & (loop.present[channel] + SAME < T) & (np.abs(T - first) < 1 + 0.1 * first) & (u >= lowest * (1 - 1e-9)) & (u <= np.pi)
    return point[good], channel[good], u[good], T[good]


def at_nyquist(loop: Shifted) -> Cases:
    """Roots that leave through z = -1, where Y/U is real: 1 for odd d, -1 for even d."""
    m, _n = loop.at_infinity.shape
    f = np.unique(np.concatenate([np.linspace(a, b, 5) for a, b in zip(loop.edges[:-1], loop.edges[1:], strict=True)]))
    ratio = loop.over(np.full((m, 1), -1.0 + 0j), *loop.nodes(f))[..., 0].real
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(ratio))
    point, channel, k = np.nonzero(((size[..., 1:] > 0) != (size[..., :-1] > 0)) & (ratio[..., 1:] * ratio[..., :-1] > 0))
    a, b, high = f[k], f[k + 1], size[point, channel, k + 1] > 0
    x = (a + b) / 2
    z = np.full(k.size, -1.0 + 0j)
    for _ in range(60):
        value, _, slope = loop.at(point, channel, z, x)
        right = (value.real > 0) == high
        a, b = np.where(right, a, x), np.where(right, x, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = x - value.real / slope.real
        inside = (step > a) & (step < b)
        if not k.size or (np.abs(np.where(inside, step, (a + b) / 2) - x) < 1e-15).all():
            break
        x = np.where(inside, step, (a + b) / 2)
    odd = ratio[point, channel, k] > 0
    d = np.maximum(np.ceil(loop.present[channel] + SAME - x), 0)
    d += (np.remainder(d, 2) == 1) != odd
    return point, channel, np.full(k.size, np.pi), d + x


def on_the_arc(loop: Shifted, poles: Complex, radius: float) -> Cases:
    """Roots that leave through the arc s = radius e^(j phi) of the slow roots; the parameter is phi, the angle returned that of z."""
    _m, _n = loop.at_infinity.shape

    def along(x: Array) -> tuple[Complex, Complex, Complex]:
        s = radius * np.exp(1j * x)
        return np.asarray(np.exp(s), np.complex128), np.asarray(s, np.complex128), np.asarray(1j * s, np.complex128)

    phi = angles(rates(poles, 1.0), radius)
    s = radius * np.exp(1j * phi)
    half = np.array([0.5])
    ratio = loop.over(np.exp(s), *loop.nodes(half))[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.unwrap(np.angle(ratio), axis=2)
        a -= np.where(np.abs(a[..., :1]) < 1, a[..., :1], a[..., :1] - np.pi)
        log = np.log(np.abs(ratio)) + 1j * a
    log = np.where(np.isfinite(log), log, -99.0)  # a channel without a loop
    found = []
    for k in (0, 1):
        T = (log + 2j * np.pi * k) / s[:, None] - 0.5
        point, channel, i = np.nonzero((T.imag[..., 1:] > 0) != (T.imag[..., :-1] > 0))
        share = T.imag[point, channel, i] / (T.imag[point, channel, i] - T.imag[point, channel, i + 1])
        at = T.real[point, channel, i] + share * (T.real[point, channel, i + 1] - T.real[point, channel, i])
        found.append((point, channel, phi[point, i] + share * (phi[point, i + 1] - phi[point, i]), at))
        if k == 0:
            point, channel = np.nonzero(ratio[..., 0].real > 0)
            found.append((point, channel, np.zeros(point.size), T.real[point, channel, 0]))
    point, channel, u, T = (np.concatenate(one) for one in zip(*found, strict=True))
    ahead = loop.present[channel] + SAME < T
    point, channel, u, T = point[ahead], channel[ahead], u[ahead], T[ahead]
    point, channel, u, T = polished(
        loop, point, channel, u, T,
        along, -np.inf,
    )  # fmt: skip
    inside = (u > -1e-9) & (u < np.pi / 2)
    return point[inside], channel[inside], radius * np.sin(u[inside]), T[inside]


def jumped(loop: Shifted, theta: Array, radius: float, best: tuple[Array, Array]) -> None:
    """Where a channel acts on itself within the sample, a dead time just above a whole number costs one sample more and may be a loss.

    No root is on the contour there (its angle: inf). The loop is lost where U - z^-(d + 1) Y(z; 0+) turns around zero on the contour.
    """
    m, n = loop.at_infinity.shape
    (points, channels), place = np.indices((m, n)).reshape(2, -1), np.full(m * n, np.exp(1j))
    before, after = (np.exp(loop.at(points, channels, place, np.full(m * n, f))[0]) for f in (1.0, 0.0))
    direct = (np.abs(before * place - after) > DIRECT * np.abs(after)).reshape(m, n)
    for point, channel in zip(*np.nonzero(direct), strict=True):
        now = float(loop.present[channel])
        last = float(min(best[0][point, channel], now + LONGEST))

        def log_ratio(p: Array, point: int = point, channel: int = channel) -> tuple[Complex, Complex, Complex]:
            """ln z at p along the contour, -1 to 0 on the arc and then the angle beyond it, log Y/U and U there."""
            log_z = np.where(p < 0, radius * np.exp(1j * np.pi / 2 * np.minimum(p + 1, 1)), 1j * (radius + np.maximum(p, 0)))
            with np.errstate(divide="ignore", invalid="ignore"):
                cases = np.full(p.size, point), np.full(p.size, channel), np.exp(log_z)
                return log_z, loop.at(*cases, np.zeros(p.size))[0], loop.sensitivity(*cases)

        if log_ratio(np.maximum(theta[point] - radius, 0))[1].real.max() < NONE:  # rounding of a channel without a loop
            continue
        along = np.union1d(np.linspace(0, np.pi - radius, int(FINE * (last + 1))), np.maximum(theta[point] - radius, 0))
        p = np.concatenate([np.linspace(-1, 0, ARC)[:-1] if radius > 0 else np.zeros(0), along])
        log_z, log, U = log_ratio(p)
        if not (log.real > 0).any():  # smaller than one all along: never lost
            continue
        for d in np.arange(np.ceil(now - SAME), last):
            x, F = p, U * (1 - np.exp(log - (d + 1) * log_z))
            for _ in range(HALVINGS):
                wide = np.flatnonzero(np.abs(np.angle(F[1:] / F[:-1])) > 1)
                if not wide.size:
                    break
                middle = (x[wide] + x[wide + 1]) / 2
                where, more, S = log_ratio(middle)
                x, F = np.insert(x, wide + 1, middle), np.insert(F, wide + 1, S * (1 - np.exp(more - (d + 1) * where)))
            if abs(np.angle(F[1:] / F[:-1]).sum()) > np.pi / 2:
                best[0][point, channel], best[1][point, channel] = max(d, now), np.inf
                break


def least(best: tuple[Array, Array], point: Ints, channel: Ints, angle: Array, T: Array) -> None:
    """Puts dead times T (k,) [samples] and their angles into ``best`` (m, n) where they are smaller than what is there."""
    order = np.argsort(-T, kind="stable")  # of several for one entry the smallest is written last
    point, channel, angle, T = point[order], channel[order], angle[order], T[order]
    better = best[0][point, channel] > T
    best[0][point[better], channel[better]], best[1][point[better], channel[better]] = T[better], angle[better]
