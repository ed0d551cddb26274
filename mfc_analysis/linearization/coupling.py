r"""Interaction of the motion and force parts of a hybrid loop (equation 9.24): leak of the projection, coupling of the closed loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.laws import constraints
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.linearization.linearization import Linearization
    from mfc_analysis.plots.figure import Axes


def leak(rows: ArrayLike | constraints.ConstraintSet, Lambda: ArrayLike, projection: Literal["dynamic", "selection"] = "dynamic") -> Array:
    r"""Acceleration along the free directions that results from an acceleration command along the constraint rows, (..., 6, k).

    9.24 projects the wrench, not X_e: a command c along the rows gives the projected wrench P Lambda c, and the tool accelerates by
    Lambda^{-1} P Lambda c. Column i is this acceleration for c = A_i, row i of A, minus its part along the rows. 0: no leak.

    Args:
        rows: (k, 6) orthonormal rows A with A V_b = 0, or a ``ConstraintSet``. Lambda: (..., 6, 6) task inertia. projection: as in 9.24.

    At rest under the dynamic projection, with a scalar Kp, X_e along the free directions is minus the leak times X_e along the rows.
    Raises BadArgument.
    """
    checks.choice("projection", projection, ("dynamic", "selection"))
    A = constraints.checked_rows(rows, "rows")
    if np.abs(A @ A.T - np.eye(len(A))).max(initial=0.0) > 1e-9:
        raise BadArgument("rows", rows, "orthonormal rows")
    inertia = checks.array("Lambda", Lambda)
    P = constraints.projection(A, inertia) if projection == "dynamic" else constraints.selection(A)
    out = np.linalg.solve(inertia, P @ inertia @ A.T)
    return np.asarray(out - A.T @ (A @ out))


@dataclass(frozen=True, eq=False)
class Coupling(Shown):
    """Transfer gain between two groups of signals of a closed loop over frequency, dead time left out."""

    frequencies: Array  #: (nf,) [rad/s]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    gain: Array  #: (m, nf) largest singular value, in units of outputs per input

    def __str__(self) -> str:
        gain, w = self.peak()
        between = f"{', '.join(self.inputs)} -> {', '.join(self.outputs)}"
        return f"coupling {between}: largest gain {gain:.4g} at {w:.4g} rad/s, of {len(self.gain)} times and {self.frequencies.size} frequencies"

    __repr__ = __str__

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """The gain over frequency, a line for each of the m times. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        lines = [("", row) for row in self.gain]
        return plots.curves(self.frequencies, lines, xlabel="ω [rad/s]", ylabel="coupling gain", log="xy", ax=plots.shown("map", ax)[0])

    def peak(self) -> tuple[float, float]:
        """Largest gain over all times and frequencies, and its frequency [rad/s]."""
        _, j = np.unravel_index(int(np.argmax(self.gain)), self.gain.shape)
        return float(self.gain.max()), float(self.frequencies[j])


def coupling(lin: Linearization, inputs: tuple[str, ...], outputs: tuple[str, ...], frequencies: ArrayLike) -> Coupling:
    """Largest singular value of the closed loop from some inputs to some outputs, at each time and frequency.

    Args:
        inputs, outputs: names of ``lin.input_names`` and ``lin.output_names``, e.g. ("F_d_fz",) and ("X_e_vx", "X_e_vy").
        frequencies: (nf,) [rad/s], nonzero where a slow root is exactly zero.

    Raises UnknownName, and BadArgument for frequencies that are not a list of numbers or a sampled loop.
    """
    w = checks.vector("frequencies", frequencies)
    if w.size == 0:
        raise BadArgument("frequencies", frequencies, "at least one frequency [rad/s]")
    if lin.dt:
        raise BadArgument("lin", f"a sampled loop, dt = {lin.dt:g} s", "a continuous one")
    columns, lines = _places("inputs", inputs, lin.input_names), _places("outputs", outputs, lin.output_names)
    A, B, C, D = lin.A, lin.B[:, :, columns], lin.C[:, lines], lin.D[:, lines][:, :, columns]
    eye = np.eye(A.shape[-1])
    gain = np.stack([_gain(A, B, C, D, float(x), eye) for x in w], axis=1)
    return Coupling(w, tuple(inputs), tuple(outputs), gain)


def _gain(A: Array, B: Array, C: Array, D: Array, w: float, eye: Array) -> Array:
    return np.asarray(np.linalg.norm(C @ np.linalg.solve(1j * w * eye - A, B.astype(complex)) + D, 2, axis=(1, 2)))


def _places(argument: str, names: Any, known: tuple[str, ...]) -> list[int]:
    return [known.index(name) for name in checks.names(argument, names, known)]
