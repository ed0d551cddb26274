"""Gains from bandwidth: what is asked is what the loop then does, measured here in other ways than in the package."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import gains
from mfc_analysis.errors import BadArgument
from mfc_analysis.robots import planar_2r, single_joint, ur5
from mfc_analysis.trajectories.joint import Sinusoid
from mfc_analysis.units import hertz

HELPERS = {"p": gains.p, "pi": gains.pi, "pd": gains.pd, "pid": gains.pid}
ORDER = {"p": ["kp"], "pi": ["kp", "ki"], "pd": ["kd", "kp"], "pid": ["kd", "kp", "ki"]}


def loop(kind: str, g: gains.Gains, inertia: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    num = np.array([float(g[name]) for name in ORDER[kind]])
    return num, np.r_[inertia, np.zeros(num.size)]


def T(num: np.ndarray, den: np.ndarray, w: float) -> complex:
    return np.polyval(num, 1j * w) / np.polyval(np.polyadd(num, den), 1j * w)


def test_pd_gives_the_printed_gains_of_four_inertias() -> None:
    g = gains.pd(natural_frequency=hertz(10), damping=2, inertia=[0.003609725, 0.010177520, 0.025101925, 0.00425])
    assert_allclose(g.kp, [14.2506, 40.1792, 99.0984, 16.7783], rtol=5e-6)
    assert_allclose(g.kd, [0.907223, 2.557890, 6.308802, 1.068142], rtol=1e-6)
    assert g.ki is None
    assert set(g) == {"kp", "kd"}


@pytest.mark.parametrize("kind", HELPERS)
def test_closed_forms_from_the_natural_frequency(kind: str) -> None:
    w, z, inertia = 7.0, 0.4, 3.0
    expected = {
        "p": {"kp": w},
        "pi": {"kp": 2 * z * w, "ki": w**2},
        "pd": {"kp": w**2, "kd": 2 * z * w},
        "pid": {"kp": (1 + 2 * z) * w**2, "ki": w**3, "kd": (1 + 2 * z) * w},
    }[kind]
    g = HELPERS[kind](natural_frequency=w, inertia=inertia, **({} if kind == "p" else {"damping": z}))
    assert {name: pytest.approx(inertia * value, rel=1e-15) for name, value in expected.items()} == dict(g)
    assert g.achieved.damping == pytest.approx(1.0 if kind == "p" else z, rel=1e-12)


def test_the_default_pid_is_a_triple_pole() -> None:
    g = gains.pid(natural_frequency=2.0)
    assert dict(g) == pytest.approx({"kp": 12.0, "ki": 8.0, "kd": 6.0})


@pytest.mark.parametrize("kind", HELPERS)
@pytest.mark.parametrize("damping", [0.2, 1.0, 2.5])
def test_the_bandwidth_asked_for_is_minus_three_decibel_of_t(kind: str, damping: float) -> None:
    g = HELPERS[kind](bandwidth=11.0, inertia=0.3, **({} if kind == "p" else {"damping": damping}))
    n, d = loop(kind, g, 0.3)
    assert abs(T(n, d, 11.0)) == pytest.approx(np.sqrt(0.5), rel=1e-10)
    assert np.all(np.abs([T(n, d, w) for w in np.linspace(0.01, 10.99, 200)]) > np.sqrt(0.5))  # and not before
    assert g.achieved.bandwidth == pytest.approx(11.0, rel=1e-10)


@pytest.mark.parametrize("kind", HELPERS)
@pytest.mark.parametrize("damping", [0.2, 1.0, 2.5])
def test_the_crossover_asked_for_is_where_the_loop_gain_is_one(kind: str, damping: float) -> None:
    import control

    g = HELPERS[kind](crossover=5.0, **({} if kind == "p" else {"damping": damping}))
    n, d = loop(kind, g)
    assert abs(np.polyval(n, 5j) / np.polyval(d, 5j)) == pytest.approx(1.0, rel=1e-10)
    _, pm, _, wc = control.margin(control.tf(n, d))
    assert wc == pytest.approx(5.0, rel=1e-6)
    assert g.achieved.phase_deg == pytest.approx(pm, rel=1e-6)


FIELD = {"reference": "settling_time", "loop": "loop_settling_time"}


def settles_at(num: np.ndarray, closed: np.ndarray, ts: float) -> None:
    """The step response of num/closed is 2 % away from 1 at ts, and nearer from then on."""
    from scipy.signal import StateSpace, TransferFunction, lsim

    t = np.linspace(0, 4 * ts, 4001)  # ts is sample 1000
    y = lsim(StateSpace(*_ss(TransferFunction(num, closed))), np.ones_like(t), t)[1]
    assert abs(y[1000] - 1) == pytest.approx(0.02, rel=1e-6)
    assert np.all(np.abs(y[1001:] - 1) < 0.02)


@pytest.mark.parametrize("step", FIELD)
@pytest.mark.parametrize("kind", HELPERS)
@pytest.mark.parametrize("damping", [0.2, 1.0, 2.5])
def test_after_the_settling_time_the_step_asked_for_stays_within_two_percent(kind: str, damping: float, step: str) -> None:
    ts = 0.8
    g = HELPERS[kind](settling_time=ts, step=step, **({} if kind == "p" else {"damping": damping}))
    n, d = loop(kind, g)
    settles_at(n[1:] if step == "reference" and "kd" in g else n, np.polyadd(n, d), ts)  # v_d = 0: kd acts on the measured velocity alone
    assert getattr(g.achieved, FIELD[step]) == pytest.approx(ts, rel=1e-9)


def test_the_default_step_is_that_of_the_reference_and_the_definition_names_the_step() -> None:
    g, looped = gains.pid(settling_time=0.5), gains.pid(settling_time=0.5, step="loop")
    assert dict(g) == dict(gains.pid(settling_time=0.5, step="reference"))
    assert g.kp / looped.kp == pytest.approx((looped.achieved.settling_time / 0.5) ** 2)
    assert "settling_time = 0.5: " in g.definition and "step of the reference (v_d = 0)" in g.definition
    assert "settling_time = 0.5: " in looped.definition and "step response of T = L/(1 + L)" in looped.definition


def _ss(transfer):
    from scipy.signal import tf2ss

    return tf2ss(transfer.num, transfer.den)


@pytest.mark.parametrize("asked", ["bandwidth", "natural_frequency", "crossover", "settling_time"])
@pytest.mark.parametrize("kind", HELPERS)
def test_every_metric_asked_for_is_the_one_achieved(kind: str, asked: str) -> None:
    g = HELPERS[kind](**{asked: 3.7}, inertia=np.array([0.01, 40.0]))
    assert_allclose(getattr(g.achieved, asked), [3.7, 3.7], rtol=1e-9)
    assert_allclose(g.kp[1] / g.kp[0], 4000)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: gains.pid(), "exactly one"),
        (lambda: gains.pid(bandwidth=3, crossover=2), "bandwidth, crossover"),
        (lambda: gains.pid(bandwidth=0), "bandwidth"),
        (lambda: gains.pid(bandwidth=np.nan), "bandwidth"),
        (lambda: gains.pd(bandwidth=3, damping=0), "damping"),
        (lambda: gains.pd(bandwidth=3, inertia=-1), "inertia"),
        (lambda: gains.p(settling_time="soon"), "settling_time"),
        (lambda: gains.pid(settling_time=1, step="q_d"), "step: got 'q_d'; takes one of 'reference', 'loop'"),
        (lambda: gains.pid(bandwidth=3, step="loop"), "step: .*a settling_time with it"),
        (lambda: gains.force_pi(settling_time=1e-9, step="loop", stiffness=1e3, mass=1), "^settling_time"),
        (lambda: gains.joint_pid(ur5(), np.zeros(5), bandwidth=3), "q"),
        (lambda: gains.joint_pid(ur5(), lambda t: t, bandwidth=3), "period"),
        (lambda: gains.cartesian_damping(ur5(), np.ones(6), -5.0), "stiffness"),
        (lambda: gains.cartesian_damping(ur5(), np.ones(6), 5.0, -1), "ratio"),
        (lambda: gains.force_pi(bandwidth=3, stiffness=0, mass=1), "stiffness"),
    ],
)
def test_bad_input_names_the_argument(call, says: str) -> None:
    with pytest.raises(BadArgument, match=says):
        call()


def test_joint_pid_is_pid_times_the_diagonal_of_the_mass_matrix_with_armature() -> None:
    robot = ur5().with_armature(0.2)
    q = np.array([0.1, -1.2, 1.4, -0.8, 1.3, 0.2])
    g, unit = gains.joint_pid(robot, q, natural_frequency=12.0, damping=0.8), gains.pid(natural_frequency=12.0, damping=0.8)
    diagonal = np.diag(robot.mass(q))
    assert_allclose(g.kp, unit.kp * diagonal, rtol=1e-12)
    assert_allclose(g.ki, unit.ki * diagonal, rtol=1e-12)
    assert_allclose(g.kd, unit.kd * diagonal, rtol=1e-12)
    assert_allclose(diagonal - np.diag(ur5().mass(q)), 0.2, rtol=1e-12)
    assert_allclose(gains.joint_pid(single_joint(inertia=0.5), [0.3], natural_frequency=2.0).kp, 12 * 0.5)


def test_joint_pid_takes_the_largest_inertia_along_a_path() -> None:
    robot = planar_2r()
    ref = Sinusoid(center=[0.0, 1.0], amplitude=[0.0, 1.5], frequency=2.0)  # the elbow passes 0, where M_11 is largest
    g = gains.joint_pid(robot, ref, natural_frequency=3.0)
    straight = np.diag(robot.mass(np.zeros(2)))
    assert_allclose(g.kp, 27 * straight, rtol=1e-9)
    assert_allclose(gains.joint_pid(robot, np.array([[0.0, 1.0], [0.0, 0.0]]), natural_frequency=3.0).kp, 27 * straight, rtol=1e-12)
    assert "lightest" in str(g)


@pytest.mark.parametrize("lag", [0.0, 1e-3])
@pytest.mark.parametrize(("stiffness", "asked"), [(1e3, 20.0), (1e4, 5.0), (1e5, 30.0)])
def test_force_gains_achieve_the_bandwidth_with_the_lag_in_the_loop(stiffness: float, asked: float, lag: float) -> None:
    m, b, zeta = 5.0, 2.0, 0.7
    g = gains.force_pi(bandwidth=asked, stiffness=stiffness, mass=m, lag=lag, friction=b, damping=zeta)
    assert set(g) == {"kfp", "kfi", "kdamp"}
    assert min(g.values()) >= 0
    # the loop of 9.19 + 9.23 by hand: the torque lags, the damping is inside it, the spring is not
    s = 1j * asked
    plant = stiffness / ((lag * s + 1) * (m * s**2 + b * s + stiffness) + g.kdamp * s)
    L = (g.kfp + g.kfi / s) * plant
    assert abs(L / (1 + L)) == pytest.approx(np.sqrt(0.5), rel=1e-8)
    poly = [m * lag, m + b * lag, b + g.kdamp + stiffness * lag, stiffness * (1 + g.kfp), stiffness * g.kfi]
    poles = np.roots(np.trim_zeros(poly, "f"))
    assert np.all(poles.real < 0)
    pair = poles[np.abs(poles.imag) > 1e-6]
    assert_allclose(-pair.real / np.abs(pair), zeta, rtol=1e-6)
    assert g.achieved.damping == pytest.approx(zeta, rel=1e-8)


def test_force_gains_put_three_poles_at_the_natural_frequency() -> None:
    k, m, w = 1e3, 4.0, 40.0
    g = gains.force_pi(natural_frequency=w, stiffness=k, mass=m)
    assert g.kfi == pytest.approx(m * w**3 / k)
    assert g.kfp == pytest.approx(3 * m * w**2 / k - 1)
    assert g.kdamp == pytest.approx(3 * m * w)


@pytest.mark.parametrize("step", FIELD)
@pytest.mark.parametrize(("ts", "lag"), [(0.25, 0.0), (0.4, 0.0), (1.2, 0.0), (0.25, 2e-3), (0.6, 2e-3), (1.2, 2e-3), (0.4, 8e-3), (0.6, 8e-3)])
def test_force_gains_settle_in_the_step_asked_for_over_the_lag(ts: float, step: str, lag: float) -> None:
    k, m = 2e3, 3.0
    g = gains.force_pi(settling_time=ts, step=step, stiffness=k, mass=m, lag=lag)
    closed = np.trim_zeros([m * lag, m, g.kdamp + k * lag, k * (1 + g.kfp), k * g.kfi], "f")
    forward = 1 + g.kfp if step == "reference" else g.kfp  # F_d is also fed forward
    settles_at(np.trim_zeros(k * np.array([forward, g.kfi]), "f"), closed, ts)
    assert getattr(g.achieved, FIELD[step]) == pytest.approx(ts, rel=1e-6)
    assert g.kfi > 0.5  # not the other solution, an integral so weak that the band hides it


@pytest.mark.parametrize("step", FIELD)
def test_joint_gains_settle_each_joint_alone_whatever_the_lag_and_delay_of_the_coupled_loop(step: str) -> None:
    q = [0.1, -1.2, 1.4, -0.8, 1.3, 0.2]
    g = [gains.joint_pid(ur5(), q, settling_time=0.7, step=step, torque_lag=lag, delay=T) for lag, T in ((0, 0), (2e-3, 0), (1e-3, 2e-3))]
    for one in g:
        assert_allclose(getattr(one.achieved, FIELD[step]), np.full(6, 0.7), rtol=1e-9)
        assert_allclose(one.kp, g[0].kp, rtol=0)
    n = np.array([g[0].kd[2], g[0].kp[2], g[0].ki[2]])
    settles_at(n[1:] if step == "reference" else n, np.polyadd(n, [ur5().mass(np.array(q))[2, 2], 0, 0, 0]), 0.7)


@pytest.mark.parametrize("asked", ["bandwidth", "crossover", "natural_frequency", "settling_time"])
def test_force_gains_achieve_each_metric(asked: str) -> None:
    value = 0.4 if asked == "settling_time" else 40.0
    g = gains.force_pi(**{asked: value}, stiffness=2e3, mass=3.0, lag=2e-3)
    assert getattr(g.achieved, asked) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: gains.force_pi(natural_frequency=1.0, stiffness=1e4, mass=5), "kfp = 0"),
        (lambda: gains.force_pi(settling_time=5.0, stiffness=2e3, mass=3, lag=2e-3), "to 1.5.* settles sooner, because F_d is fed forward"),
        (lambda: gains.force_pi(bandwidth=500.0, stiffness=1e4, mass=5, lag=5e-3), "not possible"),
        (lambda: gains.force_pi(natural_frequency=500.0, stiffness=1e4, mass=5, lag=5e-3), "lag must be the fastest"),
        (lambda: gains.force_pi(bandwidth=5.0, stiffness=1e5, mass=5, lag=5e-3), "smaller lag"),
        (lambda: gains.force_pi(bandwidth=5.0, stiffness=1e3, mass=1, friction=1e4), "friction 10000"),
    ],
)
def test_what_no_gains_attain_is_refused_with_the_reason(call, says: str) -> None:
    with pytest.raises(BadArgument, match=says):
        call()
