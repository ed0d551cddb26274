"""The chain of the actuators: the servo of a velocity-controlled arm in closed form, on its own and with lag, dead time, sampling and limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

import mfc_analysis as mfc
from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.hardware import Hardware, Servo
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold
from tests.conftest import Case, arm, loop_of, moving, named, seed
from tests.dynamics.test_jacobians import misfit

FEW = settings(max_examples=12, deadline=None)
gains, bandwidths, zetas, lags = st.floats(0.5, 30), st.floats(20, 300), st.floats(0.2, 3), st.floats(1e-3, 0.1)
VELOCITY = named("9.1", "9.2", "9.3", "9.4", "9.5 standard", "9.5 printed", "9.5 no_adjoint", "9.5 damped")


def slider(law: L.Law, **hardware: object) -> ClosedLoop:
    return ClosedLoop(robots.slider(1.0), law, Hold([0.1]), hardware=Hardware(**hardware))


def assert_polynomial(A: np.ndarray, want: np.ndarray) -> None:
    want = np.asarray(want) / want[0]
    scale = np.abs(np.linalg.eigvals(A)).max() ** np.arange(len(want))
    assert np.max(np.abs(np.poly(A) - want) / scale) < 1e-9


@FEW
@given(b=bandwidths, z=zetas)
def test_the_servo_is_3_db_down_at_its_bandwidth_and_has_unit_gain(b: float, z: float) -> None:
    servo = Servo(b, z)
    w = servo.natural_frequency
    gain = abs(w**2 / (w**2 - b**2 + 2j * z * w * b))
    assert_allclose(gain, 0.5**0.5, rtol=1e-9)
    system = slider(L.VelocityFeedforward(), servo=servo).linearize()
    i = system.input_names.index("q_d_slide")  # u = q_d' = 0: the response is that of the disturbance alone
    assert not system.system(0).B[:, i].any()
    found = slider(L.VelocityP(2.0), servo=servo).linearize().frequency_response([b], "velocity")[0, 0, 0]
    assert_allclose(abs(found), 2.0 / b * 0.5**0.5, rtol=1e-9)  # L = k G/s


def test_at_one_over_the_root_of_two_the_bandwidth_is_the_natural_frequency() -> None:
    assert_allclose(Servo(50.0).natural_frequency, 50.0, rtol=1e-12)
    assert_allclose(Servo([50.0, 20.0], [0.5**0.5, 1.0]).natural_frequency, [50.0, 20.0 / np.sqrt(np.sqrt(2) - 1)], rtol=1e-12)
    assert_allclose(Servo(1.0, 1000.0).natural_frequency, 2000.0, rtol=1e-6)  # two poles far apart: the slow one at w / (2 zeta)


@FEW
@given(k=gains, ki=gains, b=bandwidths, z=zetas, T=lags)
def test_each_velocity_loop_behind_a_servo_has_its_polynomial(k: float, ki: float, b: float, z: float, T: float) -> None:
    servo = Servo(b, z)
    w = servo.natural_frequency
    G, lag = np.array([1.0, 2 * z * w, w * w]), np.array([T, 1.0])
    assert_polynomial(slider(L.VelocityP(k), servo=servo).linearize().A[0], np.polyadd(np.polymul(G, [1, 0]), [k * w * w]))
    assert_polynomial(slider(L.VelocityPI(k, ki), servo=servo).linearize().A[0], np.polyadd(np.polymul(G, [1, 0, 0]), [k * w * w, ki * w * w]))
    both = np.polyadd(np.polymul(np.polymul(G, lag), [1, 0]), [k * w * w])
    assert_polynomial(slider(L.VelocityP(k), servo=servo, velocity_lag=T).linearize().A[0], both)
    assert_polynomial(slider(L.TaskVelocity(k, axes="z"), servo=servo).linearize().A[0], np.polyadd(np.polymul(G, [1, 0]), [k * w * w]))


@pytest.mark.parametrize("z", [0.3, 1.0])
def test_a_proportional_loop_is_stable_below_twice_zeta_w_by_poles_and_by_runs(z: float) -> None:
    """s^3 + 2 zeta w s^2 + w^2 s + k w^2 (Routh)."""
    servo = Servo(20.0, z)
    bound = 2 * z * servo.natural_frequency
    for factor, stable in ((0.99, True), (1.01, False)):
        assert bool(slider(L.VelocityP(factor * bound), servo=servo).linearize().stable[0]) == stable
    for factor, grows in ((0.8, False), (1.2, True)):
        run = slider(L.VelocityP(factor * bound), servo=servo).simulate(np.linspace(0, 2, 1001), 1e-3)
        assert (np.abs(run.error[800:]).max() > np.abs(run.error[200:400]).max()) == grows


def test_a_servo_may_differ_from_joint_to_joint() -> None:
    b, z = np.linspace(30, 80, 6), np.linspace(0.5, 1.0, 6)
    loop = ClosedLoop(arm("ur5"), L.VelocityP(4.0), moving("ur5"), hardware=Hardware(servo=Servo(b, z)))
    w = Servo(b, z).natural_frequency
    poles = np.sort_complex(loop.linearize([0.3]).poles()[0])
    want = np.sort_complex(np.concatenate([np.roots([1, 2 * zi * wi, wi * wi, 4 * wi * wi]) for wi, zi in zip(w, z, strict=True)]))
    assert_allclose(poles, want, rtol=1e-8)
    for bad in (Servo(b[:3]), Servo(30.0, z[:2])):
        with pytest.raises(BadArgument, match="servo"):
            replace(loop, hardware=Hardware(servo=bad))


def test_its_dead_time_is_that_of_the_command() -> None:
    """The same roots, margins and runs whether the dead time is the servo's, the command's or shared between them."""
    whole = Servo(50.0, 0.7)
    shares = [Hardware(servo=replace(whole, delay=0.02)), Hardware(servo=whole, delay=0.02), Hardware(servo=replace(whole, delay=0.012), delay=0.008)]
    loops = [ClosedLoop(robots.slider(1.0), L.VelocityP(8.0), Hold([0.1]), hardware=h) for h in shares]
    lins = [loop.linearize() for loop in loops]
    for loop, lin in zip(loops, lins, strict=True):
        assert_allclose(lin.delay, 0.02)
        assert_allclose(lin.delay_roots(3), lins[0].delay_roots(3), rtol=1e-9)
        assert_allclose(loop.simulate(np.linspace(0, 1, 51), 0.01).q, loops[0].simulate(np.linspace(0, 1, 51), 0.01).q, atol=1e-9)
    bound = lins[1].delay + lins[1].margins().delay[0, 0]
    for factor, stable in ((0.99, True), (1.01, False)):
        late = Hardware(servo=Servo(50.0, 0.7, factor * bound))
        assert bool(replace(loops[0], hardware=late).linearize().stable[0]) == stable
    assert "0.02 s" in shares[2].dead_time


def test_sampled_it_moves_between_the_samples_as_the_servo_does() -> None:
    """q, y, y' under the held command advance by the exponential, the command one dead time of a whole sample old."""
    h, k = 0.05, 3.0
    w, z = Servo(30.0, 0.6).natural_frequency, 0.6
    loop = slider(L.VelocityP(k), servo=Servo(30.0, 0.6, h), sample_time=h)
    F = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, -w * w, -2 * z * w, w * w], [0, 0, 0, 0]])
    E = expm(F * h)
    A = np.zeros((4, 4))
    A[:3, :3], A[:3, 3], A[3, 0] = E[:3, :3], E[:3, 3], -k
    lin = loop.linearize()
    assert_polynomial(np.diag(lin.poles()[0]), np.poly(A))
    run = loop.simulate(np.arange(0, 1.0001, h), 0.01)
    x, u = np.array([0.1 - 0.01, 0.03, 0.0]), 0.03
    for row in run.q[:, 0]:
        assert_allclose(row, x[0], atol=1e-7)
        x, u = E[:3, :3] @ x + E[:3, 3] * u, k * (0.1 - x[0])


@pytest.mark.parametrize("case", VELOCITY, ids=str)
def test_the_jacobian_behind_a_servo_is_exact(case: Case) -> None:
    hardware = Hardware(servo=Servo(np.linspace(40, 60, 6), 0.7, 4e-3), velocity_lag=3e-3, velocity_limit=1e3)
    found = misfit(loop_of(case, "ur5", hardware=hardware), seed(case.name, "servo"))
    assert found.error < 1e-7
    assert np.isnan(found.order) or abs(found.order - 2.0) <= 0.05


def test_a_velocity_limit_holds_in_simulation_and_the_linear_model_has_its_slope() -> None:
    loop = slider(L.VelocityP(10.0), velocity_limit=0.2, servo=Servo(100.0))
    run = loop.simulate(np.linspace(0, 1, 201), 0.5)
    assert np.abs(run.command).max() > 4.9 and np.abs(run.tau).max() < 0.2 * 1.05  # the servo overshoots by 4.3 % at most
    assert_allclose(loop.linearize().A[0], slider(L.VelocityP(10.0), servo=Servo(100.0)).linearize().A[0])
    far = loop.linearize(about=np.array([[-0.4, 0.2, 0.0]]))  # the command of 5 m/s is cut
    assert not far.A[0, 2, 0]


def test_the_start_and_the_operating_point_of_a_servo() -> None:
    loop = ClosedLoop(arm("ur5"), L.VelocityFeedforwardPI(4.0), moving("ur5"), hardware=Hardware(servo=Servo(60.0)))
    lin, parts = loop.linearize([0.4]), loop.equations.parts
    assert_allclose(lin.point.x[0, parts["servo"].where], loop.nominal([0.4]).v[0])
    assert_allclose(lin.residual, 0.0, atol=1e-12)
    run = loop.simulate(0.1, actuator=np.full(6, 0.1))
    assert_allclose(run.tau[0], 0.1)
    assert_allclose(run.v[0], 0.1)
    assert loop.validate(time=0.1).taylor_order == pytest.approx(2.0, abs=0.05) or np.isinf(loop.validate(time=0.1).taylor_order)


@pytest.mark.parametrize("law", [L.JointPID(1.0), L.Impedance(1.0, 1.0, axes="z"), L.DampedForcePI(np.zeros(6), 1.0)], ids=str)
def test_a_torque_law_has_no_servo(law: L.Law) -> None:
    for hardware in (Hardware(servo=Servo(50.0)), Hardware(velocity_limit=1.0)):
        with pytest.raises(Unsupported, match="velocity inputs") as info:
            ClosedLoop(robots.slider(1.0), law, Hold([0.1]), hardware=hardware)
        assert info.value.argument in ("hardware.servo", "hardware.velocity_limit")


@pytest.mark.parametrize(("given", "argument"), [
    *(({"bandwidth": bad}, "bandwidth") for bad in (0.0, -1.0, np.nan, np.eye(2), [])),
    ({"bandwidth": 9.0, "damping": 0.0}, "damping"), ({"bandwidth": 9.0, "delay": -1e-3}, "delay"), ({"bandwidth": 9.0, "delay": [1e-3]}, "delay"),
])  # fmt: skip
def test_a_servo_that_cannot_be_is_refused_by_name(given: dict, argument: str) -> None:
    with pytest.raises(BadArgument, match=f"servo.{argument}"):
        mfc.Servo(**given)
    with pytest.raises(BadArgument, match=r"servo: .*Servo"):
        Hardware(servo=50.0)
