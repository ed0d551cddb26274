"""The matrix sensitivity two ways: from the closed loop, and as the inverse of I + L."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.frequency import sensitivity as module
from mfc_analysis.analysis.frequency.sensitivity import opened, sensitivity, sensitivity_at_infinity
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument, UnknownPoint

W = np.array([0.2, 1.0, 7.0, 40.0])


def loop(seed: int, delay: float = 0.0, defective: bool = False) -> tuple[OpenSystem, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A plant with two inputs and two outputs behind a static gain, all four wires cut."""
    rng = np.random.default_rng(seed)
    A = np.diag(np.ones(3), 1) - 2 * np.eye(4) if defective else rng.normal(size=(4, 4)) - 3 * np.eye(4)
    B, C, K = rng.normal(size=(4, 2)), rng.normal(size=(2, 4)), rng.normal(size=(2, 2)) * (0 if defective else 0.4)
    D = np.zeros((4, 4))
    D[:2, 2:] = -K
    system = OpenSystem(
        times=np.zeros(1),
        A=A[None],
        B=np.hstack([B, np.zeros((4, 2))])[None],
        C=np.vstack([np.zeros((2, 4)), C])[None],
        D=D[None],
        state_names=tuple("abcd"),
        input_names=(),
        output_names=(),
        wires={"torque": slice(0, 2), "force": slice(2, 4)},
        wire_names=("i", "j", "fx", "fz"),
        wire_delay=np.array([delay, 2 * delay, 0.0, delay]),
        points=("torque", "force"),
    )
    return system, A, B, C, K


@pytest.mark.parametrize("delay", [0.0, 0.07])
@pytest.mark.parametrize("defective", [False, True])
def test_it_is_the_inverse_of_one_plus_the_loop(delay: float, defective: bool) -> None:
    system, A, B, C, K = loop(3, delay, defective)
    for k, w in enumerate(W):
        P = C @ np.linalg.solve(1j * w * np.eye(4) - A, B)
        E_in, E_out = np.diag(np.exp(-1j * w * np.array([delay, 2 * delay]))), np.diag(np.exp(-1j * w * np.array([0.0, delay])))
        at_input, at_output = E_in @ K @ E_out @ P, E_out @ P @ E_in @ K
        assert_allclose(sensitivity(opened(system, "torque"), 0, W)[k], np.linalg.inv(np.eye(2) + at_input), rtol=1e-10, atol=1e-12)
        assert_allclose(sensitivity(opened(system, "force"), 0, W)[k], np.linalg.inv(np.eye(2) + at_output), rtol=1e-10, atol=1e-12)
        both = np.block([[np.eye(2), E_in @ K], [-E_out @ P, np.eye(2)]])
        assert_allclose(sensitivity(opened(system, ("torque", "force")), 0, W)[k], np.linalg.inv(both), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.07])
def test_many_frequencies_are_solved_a_chunk_at_a_time(delay: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one solve gives them; the largest stack of matrices has CHUNK numbers."""
    system, *_ = loop(3, delay, True)
    w = np.geomspace(0.1, 100, 50)
    whole = sensitivity(opened(system, "torque"), 0, w)
    solve, sizes = np.linalg.solve, []

    def counted(A: np.ndarray, B: np.ndarray) -> np.ndarray:
        sizes.append(A.size)
        return solve(A, B)

    monkeypatch.setattr(np.linalg, "solve", counted)
    monkeypatch.setattr(module, "CHUNK", 320)
    assert_allclose(sensitivity(opened(system, "torque"), 0, w), whole, rtol=1e-12)
    assert len(sizes) >= 3 and max(sizes) <= 320


def test_at_infinity_only_the_direct_terms_without_dead_time_are_left() -> None:
    system, *_, K = loop(1)
    both = sensitivity_at_infinity(opened(system, ("torque", "force")), 0)
    assert_allclose(both, np.block([[np.eye(2), -K], [np.zeros((2, 2)), np.eye(2)]]))
    late, *_ = loop(1, 0.1)
    assert_allclose(sensitivity_at_infinity(opened(late, ("torque", "force")), 0), np.eye(4))
    assert_allclose(sensitivity_at_infinity(opened(late, "force"), 0), np.eye(2))


def test_channels_of_several_points_carry_the_name_of_theirs() -> None:
    system, *_ = loop(0)
    assert opened(system, "torque").names == ("i", "j")
    assert opened(system, ("force", "torque")).names == ("force fx", "force fz", "torque i", "torque j")
    with pytest.raises(UnknownPoint, match="command"):
        opened(system, ("torque", "command"))
    with pytest.raises(BadArgument, match="different"):
        opened(system, ("torque", "torque"))
