"""The quadratic around a frequency and the bound of its rest, against the sensitivity itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mfc_analysis.analysis.frequency import taylor
from mfc_analysis.analysis.frequency.sensitivity import opened, sensitivity, sensitivity_at_infinity
from mfc_analysis.analysis.frequency.taylor import beyond, pieces
from mfc_analysis.analysis.spectrum import spectrum
from mfc_analysis.analysis.system import OpenSystem
from tests.analysis.test_disk import SATELLITE, coupled


def arm(delay: float = 0.0, lag: float = 0.01) -> OpenSystem:
    """Two coupled joints with a torque lag and PD feedback of the encoder, which is cut together with its rate."""
    M, K, D = np.linalg.inv([[2.0, 0.5], [0.5, 1.0]]), np.diag([90.0, 60.0]), np.diag([20.0, 9.0])
    eye, zero = np.eye(2), np.zeros((2, 2))
    return OpenSystem(
        times=np.zeros(1),
        A=np.block([[zero, eye, zero], [zero, zero, M], [zero, zero, -eye / lag]])[None],
        B=np.block([[zero, zero, zero], [zero, zero, zero], [eye / lag, zero, zero]])[None],
        C=np.block([[zero, zero, zero], [eye, zero, zero], [zero, eye, zero]])[None],
        D=np.block([[zero, -K, -D], [zero, zero, zero], [zero, zero, zero]])[None],
        state_names=tuple("abcdef"),
        input_names=(),
        output_names=(),
        wires={"torque": slice(0, 2), "position": slice(2, 4), "rate": slice(4, 6)},
        wire_names=("a", "b") * 3,
        wire_delay=np.r_[np.full(2, delay), np.zeros(4)],
        points=("torque", "position"),
    )


LOOPS = {
    "coupled": (coupled(2, 3), "torque"),
    "both ends": (SATELLITE, ("torque", "force")),
    "encoder": (arm(), "position"),
    "torque and encoder": (arm(), ("torque", "position")),
    "dead time": (arm(0.02), "torque"),
    "dead time, encoder": (arm(0.02), "position"),
    "dead time, torque and encoder": (arm(0.02), ("torque", "position")),
    "sampled": (replace(coupled(1, 2), A=np.eye(6) + 0.05 * coupled(1, 2).A, B=0.05 * coupled(1, 2).B, dt=0.05), "torque"),
}


@pytest.mark.parametrize("modal", [True, False])
@pytest.mark.parametrize("name", LOOPS)
def test_the_rest_is_below_its_bound_and_of_third_order(monkeypatch, name: str, modal: bool) -> None:
    system, at = LOOPS[name]
    if not modal:
        monkeypatch.setattr(taylor, "CONDITION", 0.0)
    channels = opened(system, at)
    moving = channels.rates >= 0
    found = pieces(channels, 0, system.radius, spectrum(system).rates[0])
    assert len(found) == (1 if system.dt or system.delayed else 2)
    for piece in found:
        c, r = (piece.edges[1:] + piece.edges[:-1]) / 2, np.diff(piece.edges) / 4
        around = piece.around(c, r)
        for part in (-1.0, 0.3, 1.0):
            x = c + part * r
            S = sensitivity(channels, 0, np.array([piece.frequency(one) for one in x]))
            if not system.dt and piece.frequency(2.0) == 0.5:  # beyond the poles the channels with a rate are scaled
                S = S * x[:, None, None] ** (moving[None, :].astype(float) - moving[:, None])
            left = S - around.value - (x - c)[:, None, None] * around.slope - ((x - c) ** 2 / 2)[:, None, None] * around.bend
            size = np.abs(S).max(axis=(1, 2), keepdims=True)
            assert (np.abs(left) <= around.rest * abs(part) ** 3 + 1e-9 * size).all()
        tight = piece.around(c, r / 10)
        assert (tight.rest <= around.rest / 900 + 1e-300).all()
        assert np.median(tight.rest.max(axis=(1, 2)) / np.abs(tight.value).max(axis=(1, 2))) < 1e-3


def test_beside_a_resonance_nothing_is_promised_that_does_not_hold() -> None:
    # the interval holds a pole 1e-6 from the axis, far from its center: no bound, or a large one
    A = np.array([[0.0, 1.0], [-1.0, -2e-6]])
    system = replace(SATELLITE, A=A[None], B=SATELLITE.B * 1e-9)
    for condition in (1e5, 0.0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(taylor, "CONDITION", condition)
            piece = pieces(opened(system, "torque"), 0, 0.01, np.linalg.eigvals(A).astype(complex))[0]
            rest = piece.around(np.array([0.8]), np.array([0.5])).rest
            truth = sensitivity(opened(system, "torque"), 0, np.array([1.0]))[0] - np.eye(2)
            assert (rest[0].max() >= 0.9 * np.abs(truth).max()) or np.isinf(rest).all()


@pytest.mark.parametrize("name", ["dead time", "dead time, encoder", "dead time, torque and encoder"])
def test_beyond_the_last_frequency_the_loops_are_smaller_than_the_bound(name: str) -> None:
    system, at = LOOPS[name]
    channels = opened(system, at)
    moving = channels.rates >= 0
    sizes = []
    for w in (1e3, 1e4):
        bound = beyond(channels, 0, w)
        for x in w * np.array([1.0, 1.003, 1.7, 30.0]):
            S = sensitivity(channels, 0, np.array([x]))[0] * x ** (moving[:, None].astype(float) - moving[None, :])
            far = sensitivity_at_infinity(channels, 0)
            if moving.any() and not moving.all():
                far = np.eye(len(S))
            assert (np.abs(S - far) <= bound * (1 + 1e-9) + 1e-13).all()
        cross = np.outer(~moving, moving)
        sizes.append(np.where(cross | cross.T, 0, bound).max())
    assert sizes[1] < sizes[0] / 5
