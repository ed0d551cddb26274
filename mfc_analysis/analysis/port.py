r"""The loop seen from where the environment touches it: the driving-point admittance Y(jw), force in, velocity out, dead time exact.

All wires are cut, and the force f acts on the plant and on the force sensor::

    x' = A x + B_w w + B f        w: after the cut, each delayed: w = e^{-s T} (C_w x + D_w w + D f)
    y  = C x + E w                y: the velocity of the port

A sampled loop is not time-invariant: a force at w also moves the port at w + 2 pi k/h. ``admittance`` is the part of the velocity at the same
frequency, exactly, harmonics folded by the sampler included: with G the plant under its hold, without controller, and S(z) from the measured
signals to the torque, the loop closed,

.. math:: Y(j\omega) = G_{yf} + G_{y\tau}\, \frac{1 - e^{-j\omega h}}{j\omega h} e^{-j\omega T}\, S(e^{j\omega h})\, G_{mf}

Sources: Colgate & Schenkel, "Passivity of a class of sampled-data systems", J. Robotic Systems 14 (1997) 37-47; Fardad & Bamieh, IEEE Trans.
Automatic Control 54 (2009) 611-614.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Complex, Ints, on_axis

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

CHUNK = 2_000_000  #: complex numbers solved for at a time


@dataclass(frozen=True, eq=False)
class PortSystem:
    """A loop with all its wires cut, and a port of p channels. Of a sampled loop B, D, C, E belong to the continuous one, ``opened.held``."""

    opened: OpenSystem
    names: tuple[str, ...]  #: (p,)
    B: Array  #: (m, nx, p) the force on the states
    D: Array  #: (m, nw, p) the force on the signals before the cuts: what the sensor measures of it
    C: Array  #: (m, p, nx) velocity of the port
    E: Array  #: (m, p, nw) and what the wires add to it at once

    @property
    def continuous(self) -> OpenSystem:
        """The loop in continuous time, to which B, D, C, E belong."""
        return self.opened if self.opened.held is None else self.opened.held

    def at(self, index: int) -> PortSystem:
        """The same at one of the m points."""
        i = slice(index, index + 1)
        return PortSystem(self.opened.at(i), self.names, self.B[i], self.D[i], self.C[i], self.E[i])

    def onto(self, basis: Array) -> PortSystem:
        """The port in the directions of orthonormal columns (p, r) only."""
        names = tuple(f"direction {k + 1}" for k in range(basis.shape[1]))
        return replace(self, names=names, B=self.B @ basis, D=self.D @ basis, C=basis.T @ self.C, E=basis.T @ self.E)

    def damped(self, damping: float) -> PortSystem:
        """The same port with a damper [Ns/m, Nm s/rad] between it and the ground: f - ``damping`` y acts in place of f.

        Of a sampled loop in continuous time, before it is sampled again.
        """
        one = self.continuous
        nu, ny, b = one.nu, one.ny, float(damping)
        A, B, C, D = (np.array(x) for x in (one.A, one.B, one.C, one.D))
        A -= b * self.B @ self.C
        B[:, :, nu:] -= b * self.B @ self.E
        C[:, ny:] -= b * self.D @ self.C
        D[:, ny:, nu:] -= b * self.D @ self.E
        return replace(self, opened=replace(one, A=A, B=B, C=C, D=D))

    @cached_property
    def late(self) -> tuple[Array, Array, Array, Array, Array]:
        """A, B, C, D from [f; the k wires with dead time] to [y; those wires], all others closed, and T (k,) [s]. Not of a sampled loop."""
        one = self.opened
        nu, ny, p = one.nu, one.ny, len(self.names)
        B = np.concatenate([self.B, one.B[:, :, nu:]], axis=2)
        C = np.concatenate([self.C, one.C[:, ny:]], axis=1)
        D = np.block([[np.zeros((len(B), p, p)), self.E], [self.D, one.D[:, ny:, nu:]]])
        keep = one.wire_delay > 0
        return *close_wires(replace(one, B=B, C=C, D=D, input_names=self.names, output_names=self.names), keep), one.wire_delay[keep]


def admittance(port: PortSystem, w: Array, phases: Array | None = None) -> Complex:
    """Y(jw) (m, k, p, p) at w (k,) [rad/s] > 0, dead time included.

    ``phases`` (k, nd) [rad]: those of the dead times of ``PortSystem.late``, in place of w T. Raises ``BadArgument`` at a pole of the loop.
    """
    m, p, s = len(port.B), len(port.names), on_axis(w)
    out = np.empty((m, w.size, p, p), np.complex128)
    step = max(1, CHUNK // max(1, m * (port.opened.nx + port.opened.nw) ** 2))
    for k in range(0, w.size, step):
        here = slice(k, k + step)
        try:
            out[:, here] = _sampled(port, s[here]) if port.opened.dt else _continuous(port, s[here], None if phases is None else phases[here])
        except np.linalg.LinAlgError:
            raise BadArgument("frequencies", w, "frequencies that are not poles of the loop") from None
    return out


def _continuous(port: PortSystem, s: Complex, phases: Array | None) -> Complex:
    """[x; w], w the wires with dead time, by one linear solution at each frequency."""
    A, B, C, D, T = port.late
    m, nx, p, k = len(A), A.shape[-1], len(port.names), s.size
    late = (np.exp(-s[:, None] * T) if phases is None else np.exp(-1j * phases))[:, :, None]
    matrix, right = np.zeros((m, k, nx + T.size, nx + T.size), np.complex128), np.zeros((m, k, nx + T.size, p), np.complex128)
    matrix[..., :nx, :nx] = s[:, None, None] * np.eye(nx) - A[:, None]
    matrix[..., :nx, nx:] = -B[:, None, :, p:]
    matrix[..., nx:, :nx] = -late * C[:, None, p:]
    matrix[..., nx:, nx:] = np.eye(T.size) - late * D[:, None, p:, p:]
    right[..., :nx, :], right[..., nx:, :] = B[:, None, :, :p], late * D[:, None, p:, :p]
    out = np.concatenate([C[:, :p], D[:, :p, p:]], axis=2)[:, None] @ np.linalg.solve(matrix, right) + D[:, None, :p, :p]
    return np.asarray(out, np.complex128)


def _sampled(port: PortSystem, s: Complex) -> Complex:
    direct, held, measured = under_hold(port, s)
    return np.asarray(direct + held @ controller(port, np.exp(s * port.opened.dt)) @ measured, np.complex128)


def under_hold(port: PortSystem, s: Complex) -> tuple[Complex, Complex, Complex]:
    """Of the plant of a sampled port, at s (k,): G_yf (m, k, p, p), G_ytau with hold and dead time (m, k, p, nd), G_mf (m, k, nw, p)."""
    one, h = port.continuous, port.opened.dt
    plant, drive = np.array(sorted(one.plant_states), np.int64), _drives(one)
    nu, ny = one.nu, one.ny
    A, B, C = one.A[:, plant[:, None], plant], port.B[:, plant], port.C[:, :, plant]
    right = np.concatenate([B, one.B[:, plant[:, None], nu + drive]], axis=2)[:, None]
    matrix = s[:, None, None] * np.eye(plant.size) - A[:, None]
    x = np.linalg.solve(matrix, np.broadcast_to(right, (*matrix.shape[:-1], right.shape[-1])).astype(complex))
    forced, driven = x[..., : len(port.names)], x[..., len(port.names) :]
    late = np.exp(-s[:, None] * one.wire_delay)
    hold = (-np.expm1(-s * h) / (s * h))[:, None] * late[:, drive]
    held = (C[:, None] @ driven + port.E[:, None, :, drive]) * hold[:, None, :]
    measured = np.asarray(late[:, :, None] * (one.C[:, None, ny:, plant] @ forced + port.D[:, None]), np.complex128)
    return np.asarray(C[:, None] @ forced, np.complex128), np.asarray(held, np.complex128), measured


def controller(port: PortSystem, z: Complex) -> Complex:
    """S(z) (m, k, nd, nw) of a sampled port: from a signal added to each wire after its cut to the driving wires, all wires closed."""
    discrete, drive = port.opened, _drives(port.opened)
    nx, nw, nu, ny = discrete.nx, discrete.nw, discrete.nu, discrete.ny
    m, n = len(discrete.A), nx + nw
    matrix = np.zeros((m, z.size, n, n), np.complex128)
    matrix[..., :nx, :nx] = z[:, None, None] * np.eye(nx) - discrete.A[:, None]
    matrix[..., :nx, nx:] = -discrete.B[:, None, :, nu:]
    matrix[..., nx:, :nx] = -discrete.C[:, None, ny:]
    matrix[..., nx:, nx:] = np.eye(nw) - discrete.D[:, None, ny:, nu:]
    right = np.zeros((m, z.size, n, nw))
    right[..., nx:, :] = np.eye(nw)
    return np.asarray(np.linalg.solve(matrix, right.astype(complex))[..., nx + drive, :], np.complex128)


def _drives(system: OpenSystem) -> Ints:
    """The wires of the plant's input."""
    name = "torque" if "torque" in system.wires else "velocity"
    return np.arange(system.nw)[system.wires[name]]


# --- the result ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Port:
    """Driving-point admittance Y(jw) of the loop as given, at m times and k frequencies: velocity per force, dead time exact.

    "tool": from the wrench (fx, fy, fz, mx, my, mz) [N, Nm] that acts on the robot at the tool origin, to the body twist [m/s, rad/s], tool frame.
    An entry has the unit of its row over that of its column, such as (m/s)/N. "joints": torque [Nm, N] to joint rate [rad/s, m/s].
    """

    times: Array  #: (m,) [s]
    at: str  #: "tool" or "joints"
    channels: tuple[str, ...]  #: (p,) of the force; p = 6 at the tool, n at the joints
    frequencies: Array  #: (k,) [rad/s]
    admittance: Complex  #: (m, k, p, p)
    dt: float = 0.0  #: [s] sample time; then it is the part of the velocity at the frequency of the force

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Complex:
        """``admittance``."""
        return np.array(self.admittance, dtype)

    def _diagonal(self, index: int) -> Array:
        """(p, k) size of the admittance of each channel alone."""
        return np.asarray(np.abs(np.einsum("kii->ik", self.admittance[index])))

    def __str__(self) -> str:
        w, m = self.frequencies, len(self.times)
        held = f", sampled every {self.dt:g} s: the same frequency only" if self.dt else ""
        p, many = len(self.channels), "1 time" if m == 1 else f"{m} times"
        said = f"{w.size} frequencies from {w.min():.4g} to {w.max():.4g} rad/s" if w.size else "no frequency"
        return f"admittance at the {self.at}: {p} x {p}, {said}, {many}{held}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        if not self.frequencies.size:
            return table(str(self), ("channel",), [(name,) for name in self.channels])
        w, rows = self.frequencies, []
        low, high = int(np.argmin(w)), int(np.argmax(w))
        for name, size in zip(self.channels, self._diagonal(0), strict=True):
            top = int(np.argmax(size))
            with np.errstate(divide="ignore"):
                shown = w[low] / size[low], 1 / (w[high] * size[high])
            rows.append((name, f"{size[top]:.4g}", f"{w[top]:.4g}", *(f"{x:.4g}" for x in shown)))
        heads = ("channel", "largest |Y|", "at [rad/s]", f"w/|Y| at {w[low]:.4g} rad/s", f"1/(w |Y|) at {w[high]:.4g} rad/s")
        notes = ("w/|Y| is a stiffness [N/m, Nm/rad] where the port is a spring, 1/(w |Y|) a mass [kg, kg m^2] where it is one",)
        return table(f"{self}; t = {self.times[0]:g} s", heads, rows, notes)

    def plot(self, index: int = 0, channels: Sequence[int | str] | None = None, *, ax: Axes | tuple[Axes, Axes] | None = None) -> Axes:
        """Magnitude and phase of the diagonal of Y at one time; a channel alone is passive where its phase is within +-90 deg.

        Args:
            index: which of the m times. channels: names or numbers; None: all that move. ax: two Axes, or one that is divided; None: a new figure.

        Returns the Axes of the magnitude. Raises BadArgument, UnknownName.
        """
        from mfc_analysis import plots
        from mfc_analysis.analysis.channels import channel_number

        i = checks.whole("index", index, -len(self.times), len(self.times) - 1)
        Y = np.einsum("kii->ik", self.admittance[i])
        which = [channel_number(one, self.channels) for one in channels] if channels is not None else np.flatnonzero(Y.any(axis=1)).tolist()
        series = [(self.channels[j], Y[j]) for j in which]
        return plots.admittance(self.frequencies, series, title=f"Admittance at the {self.at}", axes=plots.two_axes(ax))[0]
