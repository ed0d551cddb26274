"""Disk margins against closed forms, python-control and perturbations that really destabilise."""

from __future__ import annotations

from importlib.util import find_spec

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.disk import Bound, disk_margin, singular_values
from mfc_analysis.analysis.frequency.sensitivity import opened, sensitivity, sensitivity_at_infinity
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument, UnknownPoint
from tests.soak.disk import KINDS, run

needs_slycot = pytest.mark.skipif(find_spec("slycot") is None, reason="slycot is not installed")


def feedback(A, B, C, K, delay: float = 0.0) -> OpenSystem:
    """x' = A x + B u, y = C x, u = -K y, opened at its inputs ("torque") and outputs ("force")."""
    A, B, C, K = (np.atleast_2d(np.asarray(x, float)) for x in (A, B, C, K))
    n, k, p = len(A), B.shape[1], len(C)
    D = np.zeros((k + p, k + p))
    D[:k, k:] = -K
    return OpenSystem(
        times=np.zeros(1),
        A=A[None],
        B=np.hstack([B, np.zeros((n, p))])[None],
        C=np.vstack([np.zeros((k, n)), C])[None],
        D=D[None],
        state_names=tuple(f"x{i}" for i in range(n)),
        input_names=(),
        output_names=(),
        wires={"torque": slice(0, k), "force": slice(k, k + p)},
        wire_names=(*(f"u{i}" for i in range(k)), *(f"y{i}" for i in range(p))),
        wire_delay=np.r_[np.full(k, delay), np.zeros(p)],
        points=("torque", "force"),
    )


SATELLITE = feedback([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.eye(2))
THIRD_ORDER = feedback([[-10, -10, -10], [1, 0, 0], [0, 1, 0]], [[1], [0], [0]], [[0, 0, 25]], 1.0)


def coupled(seed: int = 0, n: int = 3, gain: float = 0.8) -> OpenSystem:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3 * n, 3 * n)) - (0.2 + 1.25 * np.sqrt(3 * n)) * np.eye(3 * n)
    return feedback(A, rng.normal(size=(3 * n, n)), rng.normal(size=(n, 3 * n)), gain * np.eye(n))


def test_the_satellite_is_perfect_one_loop_at_a_time_and_fragile_all_at_once() -> None:
    # one loop at a time, the other closed, is 1/s: S - T = (s - 1)/(s + 1), of modulus 1 everywhere
    one = feedback([[0.0]], [[1.0]], [[1.0]], 1.0)
    alone = disk_margin(one, "torque")
    assert alone.alpha[0] == pytest.approx(2.0, abs=1e-12)
    assert alone.gain_increase[0] > 1e9
    assert alone.gain_reduction[0] < 1e-9
    assert alone.phase_deg[0] == pytest.approx(90.0)
    together = disk_margin(SATELLITE, "torque")
    assert together.alpha[0] == pytest.approx(0.0998, abs=5e-5)
    both_ends = disk_margin(SATELLITE, ("torque", "force"))
    assert both_ends.alpha[0] == pytest.approx(0.0498, abs=5e-5)
    assert both_ends.channels == ("torque u0", "torque u1", "force y0", "force y1")
    assert together.bound is both_ends.bound is Bound.EXACT


def test_a_third_order_loop_has_its_published_disk() -> None:
    found = disk_margin(THIRD_ORDER, "torque")
    assert found.alpha[0] == pytest.approx(0.458, abs=5e-4)
    assert found.phase_deg[0] == pytest.approx(25.8, abs=0.05)
    assert found.frequency[0] == pytest.approx(1.95, abs=0.01)
    assert found.gain_db[0] == pytest.approx(20 * np.log10(found.gain_increase[0]))
    assert found.gain_reduction[0] * found.gain_increase[0] == pytest.approx(1.0)
    # the whole grid, fine, gives no more
    fine = disk_margin(THIRD_ORDER, "torque", np.linspace(1.9, 2.0, 2001))
    assert found.alpha[0] == pytest.approx(fine.alpha[0], rel=1e-8)


@needs_slycot
@pytest.mark.parametrize(("seed", "n"), [(0, 2), (1, 3), (2, 4)])
def test_on_the_same_grid_it_is_the_number_of_python_control(seed: int, n: int) -> None:
    w = np.logspace(-1.5, 1.5, 60)
    system = coupled(seed, n)
    L = control.ss(system.A[0], system.B[0][:, :n], 0.8 * system.C[0][n:], np.zeros((n, n)))
    theirs = control.disk_margins(L, w)
    ours = disk_margin(system, "torque", w)
    assert ours.stable[0]
    assert ours.alpha[0] == pytest.approx(min(theirs[0], 2.0), rel=1e-6)


def test_the_known_worst_perturbation_of_the_satellite_puts_a_root_on_the_axis() -> None:
    found = disk_margin(SATELLITE, "torque")
    w, alpha = found.frequency[0], found.alpha[0]
    M = sensitivity(opened(SATELLITE, "torque"), 0, np.array([w]))[0] - np.eye(2) / 2
    # search the phases of both perturbations of size alpha for one that makes I - M Delta singular
    phase = np.exp(1j * np.linspace(-np.pi, np.pi, 721))
    d1, d2 = np.meshgrid(alpha * phase, alpha * phase)
    det = (1 - M[0, 0] * d1) * (1 - M[1, 1] * d2) - M[0, 1] * M[1, 0] * d1 * d2
    assert np.abs(det).min() < 2e-2
    for grown, reached in ((0.9, False), (1.1, True)):  # below the disk no determinant is near zero, beyond it they surround zero
        sizes = np.linspace(0, grown, 40)[:, None, None]
        a, b = d1[::8, ::8] * sizes, d2[::8, ::8] * sizes
        dets = (1 - M[0, 0] * a) * (1 - M[1, 1] * b) - M[0, 1] * M[1, 0] * a * b
        assert bool(np.abs(dets).min() < 0.05) is reached


def test_all_gains_inside_the_guarantee_are_harmless_together() -> None:
    system = coupled(1)
    found = disk_margin(system, "torque")
    rng = np.random.default_rng(5)
    A, B, C = system.A[0], system.B[0][:, :3], system.C[0][3:]
    for _ in range(200):
        f = np.exp(rng.uniform(-1, 1, 3) * np.log(found.gain_increase[0]) * 0.999)
        assert np.linalg.eigvals(A - B @ np.diag(f) @ (0.8 * C)).real.max() < 0


def test_an_unstable_loop_has_no_disk() -> None:
    found = disk_margin(feedback([[1.0]], [[1.0]], [[1.0]], 0.5), "torque")
    assert not found.stable[0]
    assert np.isnan(found.alpha[0])
    assert found.bound is Bound.NONE
    assert np.isnan(found.worst()[0])
    assert "stable at 0 of 1" in str(found)


def test_dead_time_is_exact_in_the_sensitivity() -> None:
    T, w = 0.13, np.array([0.1, 1.0, 4.0, 50.0])
    system = feedback([[0, 1], [0, 0]], [[0], [1]], [[4.0, 2.0]], 1.0, delay=T)
    s = 1j * w
    L = (2 * s + 4) / s**2 * np.exp(-s * T)
    assert_allclose(sensitivity(opened(system, "torque"), 0, w)[:, 0, 0], 1 / (1 + L), rtol=1e-12)
    assert_allclose(sensitivity(opened(system, "force"), 0, w)[:, 0, 0], 1 / (1 + L), rtol=1e-12)
    found = disk_margin(system, "torque")
    fine = np.linspace(0.05, 60, 60001)
    Lf = (2j * fine + 4) / (1j * fine) ** 2 * np.exp(-1j * fine * T)
    assert found.alpha[0] == pytest.approx(1 / np.abs(1 / (1 + Lf) - 0.5).max(), rel=1e-6)
    assert disk_margin(feedback([[0, 1], [0, 0]], [[0], [1]], [[4.0, 2.0]], 1.0, delay=0.8), "torque").stable[0] == np.False_


def test_the_encoder_is_position_and_rate_together() -> None:
    kp, kd = 9.0, 4.0
    system = OpenSystem(
        times=np.zeros(1),
        A=np.array([[[0.0, 1.0], [0.0, 0.0]]]),
        B=np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]]),
        C=np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]]),
        D=np.array([[[0.0, -kp, -kd], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]]),
        state_names=("q", "v"),
        input_names=(),
        output_names=(),
        wires={"torque": slice(0, 1), "position": slice(1, 2), "rate": slice(2, 3)},
        wire_names=("j", "j", "j"),
        wire_delay=np.zeros(3),
        points=("torque", "position"),
    )
    w = np.logspace(-1, 2, 9)
    L = (kd * 1j * w + kp) / (1j * w) ** 2
    assert_allclose(sensitivity(opened(system, "position"), 0, w)[:, 0, 0], 1 / (1 + L), rtol=1e-12)
    assert_allclose(sensitivity_at_infinity(opened(system, "position"), 0), [[1.0]])
    assert disk_margin(system, "position").alpha[0] == pytest.approx(disk_margin(system, "torque").alpha[0], rel=1e-9)
    with pytest.raises(UnknownPoint, match="'torque', 'position'"):
        disk_margin(system, "rate")
    with pytest.raises(BadArgument, match="at"):
        disk_margin(system, ())


def test_sampled_loops_end_at_their_nyquist_frequency() -> None:
    A, dt = np.array([[1.0]]), 0.1
    system = feedback(A, [[dt]], [[1.0]], 2.0)
    sampled = OpenSystem(**{**system.__dict__, "dt": dt})
    w = np.array([0.5, 10.0, np.pi / dt])
    L = 2 * dt / (np.exp(1j * w * dt) - 1)
    assert_allclose(sensitivity(opened(sampled, "torque"), 0, w)[:, 0, 0], 1 / (1 + L), rtol=1e-12)
    # |S - 1/2| = |z - 1 - 0.2| / |z - 1 + 0.2| / 2 is largest at z = -1
    assert disk_margin(sampled, "torque").alpha[0] == pytest.approx(2 * 1.8 / 2.2)
    with pytest.raises(BadArgument, match="half the sample rate"):
        disk_margin(sampled, "torque", [40.0])


@pytest.mark.parametrize("bad", [[0.0, 1.0], [2.0, 1.0], [], [np.inf]])
def test_bad_frequencies_are_refused(bad) -> None:
    with pytest.raises(BadArgument, match="frequencies"):
        disk_margin(SATELLITE, "torque", bad)


def test_singular_values_of_s_and_t_are_those_of_the_matrices() -> None:
    w = np.array([0.3, 3.0])
    found = singular_values(SATELLITE, "torque", w)
    P = control.ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))
    for k, x in enumerate(w):
        S = np.linalg.inv(np.eye(2) + P(1j * x))
        assert_allclose(found.S[0, k], np.linalg.svd(S)[1], rtol=1e-10)
        assert_allclose(found.T[0, k], np.linalg.svd(np.eye(2) - S)[1], rtol=1e-10)


def test_dead_time_that_makes_an_elastic_mode_narrow_is_not_missed() -> None:
    # elastic joint, PD, 7.23 ms; the peak at 245 rad/s is no pole of the loop without dead time. alpha was 0.272, "exact"
    J, motor, k, d, kp, kd, T = 0.5, 0.0955, 4550.0, 0.358, 39.19, 1.63, 7.23e-3
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-k / motor, k / motor, -d / motor, d / motor], [k / J, -k / J, d / J, -d / J]]
    B, C = [[0], [0], [1 / motor], [0]], [[kp, 0, kd, 0]]
    found = disk_margin(feedback(A, B, C, 1.0, delay=T), "torque")
    w = np.concatenate([np.linspace(0.01, 2000, 200_001), np.linspace(244, 247, 200_001)])
    s = 1j * w
    spring = d * s + k
    L = np.exp(-s * T) * (kp + kd * s) * (J * s**2 + spring) / ((motor * s**2 + spring) * (J * s**2 + spring) - spring**2)
    truth = 1 / np.abs((1 - L) / (1 + L) / 2).max()
    assert truth < 0.05
    assert found.alpha[0] == pytest.approx(truth, rel=1e-6)
    assert found.bound is Bound.EXACT
    assert found.alpha[0] <= 1 / (np.abs(1 / (1 + L)).max() - 0.5)


def test_frequencies_of_ones_own_are_a_grid_and_nothing_is_promised_between_them() -> None:
    found = disk_margin(SATELLITE, "torque", np.geomspace(0.01, 100, 7))
    assert found.bound is Bound.GRID
    assert "between them" in str(found)
    many = np.geomspace(0.01, 100, 30_001)
    assert disk_margin(SATELLITE, "torque", many).alpha[0] == pytest.approx(disk_margin(SATELLITE, "torque").alpha[0], rel=1e-5)


def test_what_is_not_certain_is_not_called_exact(monkeypatch) -> None:
    monkeypatch.setattr("mfc_analysis.analysis.mu_peak.MOST", 20)
    assert disk_margin(coupled(2, 4), "torque").bound is Bound.GRID


@pytest.mark.parametrize("kind", KINDS)
def test_random_loops_have_the_disk_of_a_dense_grid_and_keep_below_their_sensitivity_peaks(kind: str) -> None:
    found = run(10, 3, (kind,), frequencies=400)
    assert len(found) == 10 and any(one.bound is Bound.EXACT for one in found)
    assert all(one.good for one in found), [one for one in found if not one.good]
