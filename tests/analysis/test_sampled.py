"""The sampled loop against published margins, Jury's conditions, and the same loop stepped in small exact pieces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.signal import cont2discrete

from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument, Unsupported


def loop(Ap, Bp, Cp, K, Ac=None, Bc=None, Cc=None, delays=(0.0, 0.0), E=None) -> OpenSystem:
    """Plant x' = Ap x + Bp (w_torque + d), measured Cp x (wire "force"); controller c' = Ac c + Bc y, torque = -K y - Cc c. One channel each."""
    Ap, Bp, Cp = np.atleast_2d(Ap), np.reshape(Bp, (-1, 1)), np.reshape(Cp, (1, -1))
    n, c = len(Ap), 0 if Ac is None else len(np.atleast_2d(Ac))
    A = np.zeros((n + c, n + c))
    A[:n, :n] = Ap
    B, C, D = np.zeros((n + c, 3)), np.zeros((3, n + c)), np.zeros((3, 3))  # inputs: d, torque, force; outputs: y, torque, force
    B[:n, 0] = B[:n, 1] = Bp[:, 0]
    C[0, :n] = C[2, :n] = Cp
    D[1, 2] = -K
    if c:
        A[n:, n:], B[n:, 2], C[1, n:] = Ac, np.ravel(Bc), -np.ravel(Cc)
    return OpenSystem(
        times=np.zeros(1),
        A=A[None],
        B=B[None],
        C=C[None],
        D=D[None],
        state_names=tuple(f"x{i}" for i in range(n)) + tuple(f"c{i}" for i in range(c)),
        input_names=("d",),
        output_names=("y",),
        wires={"torque": slice(0, 1), "force": slice(1, 2)},
        wire_names=("joint", "fz"),
        wire_delay=np.array(delays),
        points=("torque", "force"),
        plant_states=tuple(range(n)),
    )


def double_integrator(kp: float, kd: float) -> OpenSystem:
    """q'' = torque = -kp q - kd v, position and rate on wires of their own."""
    D = np.zeros((3, 3))
    D[0, 1:] = -kp, -kd
    return OpenSystem(
        times=np.zeros(1),
        A=np.array([[[0.0, 1.0], [0.0, 0.0]]]),
        B=np.array([[[0.0, 0, 0], [1.0, 0, 0]]]),
        C=np.array([[[0.0, 0], [1.0, 0], [0, 1.0]]]),
        D=D[None],
        state_names=("q", "v"),
        input_names=(),
        output_names=(),
        wires={"torque": slice(0, 1), "position": slice(1, 2), "rate": slice(2, 3)},
        wire_names=("j", "j", "j"),
        wire_delay=np.zeros(3),
        points=("torque", "position"),
        plant_states=(0, 1),
    )


THIRD = (np.array([[-3.0, -2.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), [1.0, 0, 0], [0.0, 0, 2.0])


def radius(system: OpenSystem) -> float:
    return float(np.abs(np.linalg.eigvals(close_wires(system)[0][0])).max())


def test_a_published_sampled_loop_has_its_margins() -> None:
    found = margins(sampled(loop(*THIRD, 1.0), 0.05), "torque")
    assert found.stable[0]
    assert found.gain_increase[0, 0] == pytest.approx(2.793, abs=5e-4)
    assert found.phase_deg[0, 0] == pytest.approx(31.54, abs=5e-3)


def test_the_plant_is_the_zero_order_hold_of_scipy() -> None:
    A, B, C = THIRD
    discrete = sampled(loop(A, B, C, 1.0), 0.05)
    Ad, Bd, *_ = cont2discrete((A, np.reshape(B, (-1, 1)), np.reshape(C, (1, -1)), np.zeros((1, 1))), 0.05)
    assert_allclose(discrete.A[0], Ad, atol=1e-15)
    assert_allclose(discrete.B[0][:, 0], Bd[:, 0], atol=1e-15)  # the disturbance is held as well
    assert_allclose(discrete.B[0][:, 1], Bd[:, 0], atol=1e-15)
    assert_allclose(discrete.B[0][:, 2], 0)
    assert discrete.dt == 0.05
    assert not discrete.wire_delay.any()


@pytest.mark.parametrize(("kp", "kd"), [(100.0, 19.9), (300.0, 15.05), (1.0, 1.0)])
def test_a_sampled_double_integrator_obeys_jury(kp: float, kd: float) -> None:
    h = 0.1  # z^2 - (2 - kp h^2/2 - kd h) z + 1 + kp h^2/2 - kd h: stable iff kp h/2 < kd < 2/h
    discrete = sampled(double_integrator(kp, kd), h)
    A = close_wires(discrete)[0][0]
    assert_allclose(np.poly(A), [1, -(2 - kp * h**2 / 2 - kd * h), 1 + kp * h**2 / 2 - kd * h], rtol=1e-12, atol=1e-12)
    assert (radius(discrete) < 1) == (kp * h / 2 < kd < 2 / h)
    assert discrete.points == ("torque",)


def test_both_sides_of_the_jury_boundaries() -> None:
    h = 0.1
    for kp, kd, stable in ((100.0, 20.0 * 0.999, True), (100.0, 20.0 * 1.001, False), (300.0, 15.0 * 1.001, True), (300.0, 15.0 * 0.999, False)):
        assert (radius(sampled(double_integrator(kp, kd), h)) < 1) is stable


def stepped(system: OpenSystem, N: int, delta: float, torque_steps: int, force_steps: int, samples: int) -> np.ndarray:
    """The same loop in pieces of ``delta``, N pieces a sample: exact, with both dead times whole numbers of pieces. Returns states at the samples."""
    n = len(system.plant_states)
    A, B, C = system.A[0][:n, :n], system.B[0][:n, 1], system.C[0][2, :n]
    Ac, Bc, Cc, K = system.A[0][n:, n:], system.B[0][n:, 2], -system.C[0][1, n:], -system.D[0][1, 2]
    big = expm(np.block([[A, B[:, None]], [np.zeros((1, n + 1))]]) * delta)
    Phi, Gamma = big[:n, :n], big[:n, n]
    c = len(Ac)
    bigc = expm(np.block([[Ac, Bc[:, None]], [np.zeros((1, c + 1))]]) * (N * delta))
    x, z = np.arange(1.0, n + 1), np.arange(1.0, c + 1) / 3
    ys: list[float] = []
    torques: list[float] = []
    found = []
    for piece in range(N * samples):
        ys.append(float(C @ x))
        if piece % N == 0:
            found.append(np.r_[x, z])
            y = ys[piece - force_steps] if piece >= force_steps else 0.0
            torque = -K * y - (Cc @ z if c else 0.0)
            if c:
                z = bigc[:c, :c] @ z + bigc[:c, c] * y
        torques.append(float(torque))
        x = Phi @ x + Gamma * (torques[piece - torque_steps] if piece >= torque_steps else 0.0)
    return np.array(found)


DEAD_TIMES = [(0, 0), (10, 0), (3, 0), (13, 0), (0, 10), (0, 4), (0, 24), (7, 4), (3, 7), (13, 24), (20, 30), (5, 5)]


@pytest.mark.parametrize(("torque_steps", "force_steps"), DEAD_TIMES)
def test_dead_times_whole_and_fractional_agree_with_the_loop_in_small_pieces(torque_steps: int, force_steps: int) -> None:
    N, delta = 10, 0.008
    A, B, C = THIRD
    controller = {"Ac": [[0.0, 1.0], [0.0, -4.0]], "Bc": [0.0, 1.0], "Cc": [0.3, 0.2]}
    system = loop(A, B, C, 0.4, **controller, delays=(torque_steps * delta, force_steps * delta))
    discrete = sampled(system, N * delta)
    assert discrete.nx == 5 + -(-torque_steps // N) + -(-force_steps // N)
    Ad = close_wires(discrete)[0][0]
    x = np.zeros(discrete.nx)
    x[:5] = [1, 2, 3, 1 / 3, 2 / 3]
    expected = stepped(system, N, delta, torque_steps, force_steps, 12)
    for k in range(12):
        assert_allclose(x[:5], expected[k], rtol=1e-9, atol=1e-10)
        x = Ad @ x


def test_registers_have_names_and_belong_to_the_plant() -> None:
    discrete = sampled(loop(*THIRD, 1.0, delays=(0.025, 0.02)), 0.02)
    assert discrete.state_names[3:] == ("torque[-1] joint", "torque[-2] joint", "force[-1] fz")
    assert discrete.plant_states == (0, 1, 2, 3, 4, 5)


def test_a_fractional_delay_has_the_known_input_matrices() -> None:
    h, tau = 0.1, 0.03  # Astrom & Wittenmark: double integrator with a delay of less than a sample
    system = loop([[0.0, 1.0], [0.0, 0.0]], [0.0, 1.0], [1.0, 0.0], 1.0, delays=(tau, 0.0))
    discrete = sampled(system, h)
    assert_allclose(discrete.B[0][:2, 1], [(h - tau) ** 2 / 2, h - tau], rtol=1e-12)
    assert_allclose(discrete.A[0][:2, 2], [tau * (h - tau / 2), tau], rtol=1e-12)


def test_an_integral_is_the_forward_sum_and_a_filter_its_hold_equivalent() -> None:
    h, T = 0.05, 0.02
    system = loop([[-1.0]], [1.0], [1.0], 0.0, Ac=[[0.0, 0.0], [0.0, -1 / T]], Bc=[1.0, 1 / T], Cc=[1.0, 1.0])
    discrete = sampled(system, h)
    assert_allclose(discrete.A[0][1:, 1:], np.diag([1.0, np.exp(-h / T)]), atol=1e-15)
    assert_allclose(discrete.B[0][1:, 2], [h, 1 - np.exp(-h / T)])


def test_fast_sampling_returns_the_continuous_poles_to_first_order() -> None:
    system = loop(*THIRD, 0.4, Ac=[[0.0]], Bc=[1.0], Cc=[0.1])
    truth = np.sort_complex(np.linalg.eigvals(close_wires(system)[0][0]))
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        z = np.linalg.eigvals(close_wires(sampled(system, h))[0][0])
        errors.append(np.abs(np.sort_complex(np.log(z.astype(complex)) / h) - truth).max())
    assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 1.0, atol=0.05)


def test_many_points_are_sampled_at_once() -> None:
    one, two = loop(*THIRD, 1.0, delays=(0.03, 0.01)), loop(*THIRD, 2.0, delays=(0.03, 0.01))
    both = replace(one, times=np.arange(2.0), **{k: np.concatenate([getattr(one, k), getattr(two, k)]) for k in "ABCD"})
    found = sampled(both, 0.02)
    for k, single in enumerate((one, two)):
        for name in "ABCD":
            assert_allclose(getattr(found, name)[k], getattr(sampled(single, 0.02), name)[0], atol=1e-15)


def test_controllers_that_differ_from_point_to_point_keep_their_own_states() -> None:
    one, two = (loop(*THIRD, 1.0, Ac=[[rate]], Bc=[1.0], Cc=[0.1]) for rate in (-1.0, -30.0))
    both = replace(one, times=np.arange(2.0), **{k: np.concatenate([getattr(one, k), getattr(two, k)]) for k in "ABCD"})
    assert_allclose(sampled(both, 0.02).A, np.concatenate([sampled(one, 0.02).A, sampled(two, 0.02).A]), atol=1e-15)


def test_two_joints_with_their_own_dead_times_are_as_each_alone() -> None:
    late = (0.013, 0.031)  # of the torque: the held values switch at different places of the sample
    alone = [loop(*THIRD, 1.0, delays=(T, 0.01)) for T in late]
    n = alone[0].nx

    def side_by_side(M):
        out = np.zeros((1, 2 * M.shape[1], 2 * M.shape[2]))
        out[:, ::2, ::2] = out[:, 1::2, 1::2] = M
        return out

    both = replace(
        alone[0],
        **{k: side_by_side(getattr(alone[0], k)) for k in "ABCD"},
        state_names=tuple(f"x{i}" for i in range(2 * n)),
        input_names=("d1", "d2"),
        output_names=("y1", "y2"),
        wires={"torque": slice(0, 2), "force": slice(2, 4)},
        wire_names=("1", "2", "1", "2"),
        wire_delay=np.array([*late, 0.01, 0.01]),
        plant_states=tuple(range(2 * n)),
    )
    poles = np.linalg.eigvals(close_wires(sampled(both, 0.02))[0][0])
    for single in alone:
        for p in np.linalg.eigvals(close_wires(sampled(single, 0.02))[0][0]):
            assert np.abs(poles - p).min() < 1e-9


def test_what_cannot_be_sampled_is_refused() -> None:
    system = loop(*THIRD, 1.0, Ac=[[0.0]], Bc=[1.0], Cc=[0.1])
    with pytest.raises(BadArgument, match="sample_time"):
        sampled(system, 0.0)
    for long in (1e5, 1e100):  # a falling rod: exp(1e5) is beyond all numbers
        with pytest.raises(BadArgument, match="sample_time"):
            sampled(loop([[0, 1], [1, 0]], [0, 1], [1, 0], 1.0), long)
    with pytest.raises(Unsupported, match="already sampled"):
        sampled(sampled(system, 0.05), 0.05)
    with pytest.raises(Unsupported, match="torque or velocity"):
        sampled(replace(system, plant_states=()), 0.05)
    leaking = system.A.copy()
    leaking[0, 0, 3] = 0.1
    with pytest.raises(Unsupported, match="through its torque wires only"):
        sampled(replace(system, A=leaking), 0.05)
    with pytest.raises(Unsupported, match="dead time"):
        sampled(replace(double_integrator(1.0, 1.0), wire_delay=np.array([0.0, 0.1, 0.0])), 0.05)


def test_a_model_too_large_for_the_memory_is_refused():
    """Three points of six joints with 1500 samples each in transit took 6 GB."""
    late = loop([[-1.0]], [1.0], [1.0], 0.5, delays=(3.0, 0.0))
    with pytest.raises(Unsupported, match="at most 2100 states at 1 times; the samples in transit make 3001"):
        sampled(late, 1e-3)
    many = replace(late, times=np.zeros(100), **{name: np.repeat(getattr(late, name), 100, axis=0) for name in "ABCD"})
    with pytest.raises(Unsupported, match="at most 547 states at 100 times; the samples in transit make 601"):
        sampled(many, 5e-3)
    assert sampled(late, 5e-3).nx == 601
    assert sampled(late, 1e-3, on_wires=True).nx == 1
