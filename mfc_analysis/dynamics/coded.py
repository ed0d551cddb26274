r"""A sampled controller as it is coded: sums for integrals, differences of the encoder for the velocity. Exact at the samples.

A rule replaces s by (z - 1)/(T (b z + 1 - b)), with b = 0 (forward Euler), 1/2 (Tustin, trapezoidal) or 1 (backward Euler). An integral
of e by a rule is z_k + b T e_k with z_{k+1} = z_k + T e_k; the filtered derivative s q/(T_f s + 1) is

    d_k = ((T_f - (1 - b) T) d_{k-1} + q_k - q_{k-1}) / (T_f + b T).

States of such code are *stepped*: x_{k+1} = x_k + T x', where x' is what the law gives as their rate.

Source: Astrom & Wittenmark, Computer-Controlled Systems, 3rd ed., ch. 8.2 and 8.5.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector

Rule = Literal["forward", "backward", "tustin"]
PRESENT: Mapping[str, float] = {"forward": 0.0, "tustin": 0.5, "backward": 1.0}  #: b of a rule: the share of the present sample


def difference(s: Mapping[str, Vector], q: Vector, T: float, rule: str, filter_: Array | None) -> tuple[Vector, dict[str, Vector]]:
    """The velocity (..., n) from the encoder q and its last sample, through the filter with time constants (n,) [s]; and the stepped rates."""
    moved = q - s["q_before"]
    rates = {"q_before": moved * (1 / T)}
    if filter_ is None:
        return rates["q_before"], rates
    b = PRESENT[rule]
    v = (s["v_filter"] * (filter_ - (1 - b) * T) + moved) * (1 / (filter_ + b * T))
    rates["v_filter"] = (v - s["v_filter"]) * (1 / T)
    return v, rates


def summed(s: Mapping[str, Vector], rates: Mapping[str, Vector], integrals: tuple[str, ...], T: float, rule: str) -> dict[str, Vector]:
    """The states as the output of the law takes them: each integral with the share of the present sample in its sum."""
    return {**s, **{name: s[name] + rates[name] * (PRESENT[rule] * T) for name in integrals if name in rates}}
