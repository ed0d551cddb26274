"""Where a loop is linearised: trimmed on its reference, at its rest point, along a run; what is left over is reported."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.operating_point import rest_point, trimmed
from mfc_analysis.errors import BadArgument, NotConverged, Unsupported
from mfc_analysis.loop import ClosedLoop, Equilibrium
from mfc_analysis.maths.dual import value
from mfc_analysis.trajectories import Hold, Quintic, Sinusoid, ToolHold
from tests.conftest import LAWS, Case, arm, loop_of, moving, named, plant, regular_pose, surfaces

T = np.array([0.1, 0.5, 0.9])
WITH_INTEGRAL = named("9.8", "9.10 standard", "9.10 printed", "9.10 standard mass", "9.10 printed mass", "9.11 PID", "9.11 LTI", "9.16 standard")
WITHOUT = [c for c in LAWS if c.law(6).plant == "torque" and c not in WITH_INTEGRAL and not c.name.startswith("9.16")]
ELASTIC = Hardware(joint_stiffness=2e3, motor_inertia=0.2, feedback="link")
HOLDING = [L.JointPID(3000.0, kd=300.0), L.ComputedTorque(90.0, kd=18.0), L.ComputedTorque(90.0, kd=18.0, form="printed")]


@pytest.mark.parametrize("case", WITH_INTEGRAL, ids=str)
@pytest.mark.parametrize("hardware", [None, Hardware(torque_lag=5e-3, velocity_filter=2e-3), ELASTIC], ids=["ideal", "lag", "elastic"])
def test_the_trimmed_integral_carries_payload_friction_and_contact(case: Case, hardware: Hardware | None) -> None:
    """The law's torque at the operating point is the plant's inverse dynamics there: nothing is left over."""
    loop = loop_of(case, "ur5", contact=True, hardware=hardware)
    lin = loop.linearize(T)
    assert np.abs(lin.residual).max() < 1e-7
    e, x, ref = loop.equations, lin.point.x, moving("ur5")(T)
    flow = e.flow(T, x)
    robot, F = plant("ur5"), value(flow.F_tip)
    assert np.abs(F).max() > 1.0
    torque = (robot.mass(ref.q) @ ref.a[..., None])[..., 0] + robot.bias(ref.q, ref.v) + robot.friction(ref.v)
    torque = torque + (np.swapaxes(robot.jacobian(ref.q), 1, 2) @ F[..., None])[..., 0]
    if hardware is not None and hardware.elastic:
        torque = torque + 0.2 * ref.a  # the motors' own
    assert_allclose(value(flow.command), torque, atol=1e-7)
    assert_allclose(x[:, :6], ref.q)
    assert_allclose(x[:, 6:12], ref.v)


@pytest.mark.parametrize("case", WITHOUT, ids=str)
def test_without_an_integral_that_can_do_it_the_residual_is_the_acceleration_left_over(case: Case) -> None:
    loop = loop_of(case, "ur5", contact=True)
    lin = loop.linearize(T)
    e = loop.equations
    accelerations = value(e.flow(T, lin.point.x).rates["v"])
    desired = loop.ref(T).a
    assert_allclose(lin.residual, accelerations - desired, atol=1e-8)
    assert np.abs(lin.residual).max() > 1e-2
    if "z_f" in e.parts:
        assert not lin.point.x[:, e.parts["z_f"].where].any()  # the force integral starts at 0


def test_a_singular_ki_takes_the_smallest_integral_that_does_its_best() -> None:
    robot, model, q = plant("planar_2r"), arm("planar_2r"), regular_pose("planar_2r")
    Ki = np.array([[40.0, 40.0], [40.0, 40.0]])
    loop = ClosedLoop(robot, L.JointPID(300.0, Ki, 40.0), Hold(q), model)
    z = loop.linearize([0.0]).point.x[0, 4:]
    assert_allclose(z, np.linalg.pinv(Ki) @ robot.gravity(q), atol=1e-9)
    assert_allclose(z[0], z[1], atol=1e-12)
    left = np.linalg.solve(robot.mass(q), Ki @ z - robot.gravity(q))
    assert_allclose(loop.linearize([0.0]).residual[0], left, atol=1e-9)


def test_an_outer_loop_without_an_integrator_stays_at_rest() -> None:
    lead = control.tf([8.0, 120.0], [0.02, 1.0])
    lin = ClosedLoop(plant("planar_2r"), L.InverseDynamics(lead), Hold(regular_pose("planar_2r")), arm("planar_2r")).linearize([0.0])
    assert not lin.point.x[0, 4:].any() and np.abs(lin.residual).max() > 1e-2


def test_velocity_loops_leave_what_their_law_does_not_feed_forward() -> None:
    ref = Sinusoid([0.3], 0.5, 2.0)
    P = ClosedLoop(robots.single_joint(), L.VelocityP(3.0), ref).linearize(T)
    assert_allclose(P.residual, -ref(T).v, atol=1e-12)
    for law in (L.VelocityPI(3.0, 2.0), L.VelocityFeedforwardPI(3.0, 2.0), L.VelocityFeedforward()):
        assert_allclose(ClosedLoop(robots.single_joint(), law, ref).linearize(T).residual, 0, atol=1e-12)


def test_filters_and_lags_start_at_what_they_see() -> None:
    hardware = Hardware(torque_lag=5e-3, velocity_filter=2e-3, force_filter=1e-3)
    loop = loop_of(named("9.24 dynamic standard")[0], "ur5", contact=True, hardware=hardware)
    e, lin = loop.equations, loop.linearize(T)
    s = e.split(lin.point.x)
    flow = e.flow(T, lin.point.x)
    assert_allclose(s["v_filter"], s["v"])
    assert_allclose(s["F_filter"], value(flow.F_tip))
    assert_allclose(value(flow.rates["v"]), loop.ref(T).a, atol=1e-8)  # the lag is at the torque of the path


# --- rest points -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["planar_2r", "ur5", "panda"])
@pytest.mark.parametrize("law", HOLDING, ids=str)
def test_a_rest_point_is_where_every_rate_is_zero_and_simulations_go_there(name: str, law: L.Law) -> None:
    loop = ClosedLoop(plant(name), law, Hold(regular_pose(name)), arm(name))
    rest = loop.equilibrium()
    assert np.abs(loop.equations.rates(0.0, rest.x)).max() < 1e-8
    assert_allclose(rest.error, regular_pose(name) - rest.q)
    assert_allclose(rest.torque, plant(name).gravity(rest.q), atol=1e-7)
    assert np.abs(rest.error).max() > 1e-4  # the sag
    lin = loop.linearize([0.0, 1.0], about="equilibrium")
    assert_allclose(lin.point.x, np.stack([rest.x, rest.x]))
    assert_allclose(lin.residual, 0)
    if lin.stable.all():
        sim = loop.simulate([0.0, 8.0])
        slowest = lin.poles()[0].real.max()
        assert_allclose(sim.q[-1], rest.q, atol=np.abs(rest.error).max() * np.exp(8.0 * slowest) * 30 + 1e-5)


def test_a_tool_law_rests_with_its_pose_error() -> None:
    q = regular_pose("ur5")
    loop = ClosedLoop(plant("ur5"), L.TaskComputedTorque(90.0, kd=18.0), ToolHold(arm("ur5").pose(q)), arm("ur5"), q_start=q)
    rest = loop.equilibrium()
    J, model = arm("ur5").jacobian(rest.q), arm("ur5")
    assert_allclose(J.T @ model.task_inertia(rest.q) @ (90.0 * rest.error) + model.gravity(rest.q), plant("ur5").gravity(rest.q), atol=1e-7)
    with_integral = ClosedLoop(plant("ur5"), L.TaskComputedTorque(90.0, 40.0, 18.0), Hold(q), model).equilibrium()
    assert_allclose(with_integral.error, 0, atol=1e-9)


def test_a_steady_force_error_is_found() -> None:
    q = regular_pose("ur5")
    held = Environment(2e4, 10.0, pose=arm("ur5").pose(q), axes="xyzrxryrz")
    F_d = np.array([0, 0, 12.0, 0, 0, 0])
    loop = ClosedLoop(plant("ur5"), L.ForcePI(F_d, 3.0), Hold(q), arm("ur5"), held)
    rest = loop.equilibrium()
    missing = arm("ur5").gravity(rest.q) - plant("ur5").gravity(rest.q)
    assert_allclose(arm("ur5").jacobian(rest.q).T @ (4.0 * (rest.force - F_d)), missing, atol=1e-7)


def test_integrals_that_act_on_nothing_do_not_prevent_a_rest_point() -> None:
    q = regular_pose("planar_2r")
    loop = ClosedLoop(plant("planar_2r"), L.JointPID(3000.0, [200.0, 0.0], 300.0), Hold(q), arm("planar_2r"))
    rest = loop.equilibrium()
    assert abs(rest.error[0]) < 1e-10 and abs(rest.error[1]) > 1e-4
    assert_allclose(plant("planar_2r").gravity(rest.q)[1], 3000.0 * rest.error[1], rtol=1e-8)


def test_where_nothing_holds_the_arm_there_is_no_rest_point() -> None:
    with pytest.raises(NotConverged, match="not found near the reference"):
        ClosedLoop(robots.slider(), L.ForcePI([0, 0, 5.0, 0, 0, 0], 1.0), Hold([0.0])).equilibrium()
    with pytest.raises(Unsupported, match="at rest") as info:
        ClosedLoop(robots.single_joint(), L.JointPID(3.0), Sinusoid([0.0], 0.1, 1.0)).equilibrium()
    assert info.value.argument == "about"
    with pytest.raises(Unsupported):
        ClosedLoop(robots.single_joint(), L.JointPID(3.0), Quintic([0.0], [1.0])).linearize([0.0], about="equilibrium")


@pytest.mark.parametrize("part", [0.95, 1.05])
def test_dead_time_and_sampling_count_in_whether_a_rest_point_is_stable(part: float) -> None:
    """A slider of 1 kg under kp = 100, kd = 2 swings at the dead time of its delay margin. With its force held over a sample time T the
    determinant of a step is 1 - kd T + kp T^2 / 2: 1 at T = 2 kd / kp."""

    def rest(**hardware: float) -> Equilibrium:
        return ClosedLoop(robots.slider(1.0), L.JointPID(100.0, None, 2.0), Hold([0.0]), hardware=Hardware(**hardware)).equilibrium()

    assert rest().stable
    w = np.sqrt(2 + np.sqrt(4 + 1e4))  # |2 j w + 100| = w^2
    late = rest(delay=part * np.arctan(w / 50) / w)
    sampled = rest(sample_time=part * 2 * 2.0 / 100.0)
    for found in (late, sampled):
        assert found.stable == (part < 1) and str(found).startswith("equilibrium, stable") == (part < 1)
        assert any("unstable" in note for note in found.notes) == (part > 1)


def test_a_rest_point_found_by_hand_is_the_loops() -> None:
    loop = ClosedLoop(plant("ur5"), L.JointPID(3000.0, kd=300.0), Hold(regular_pose("ur5")), arm("ur5"), surfaces("ur5", regular_pose("ur5")))
    from mfc_analysis.dynamics.jacobians import closed_matrix

    start = trimmed(loop.equations, np.zeros(1), loop.nominal([0.0]))
    found = rest_point(loop.equations, start, lambda x: closed_matrix(loop.equations, np.zeros(1), x))
    assert_allclose(found.x[0], loop.equilibrium().x, atol=1e-12)
    assert_allclose(loop.equilibrium().force, value(loop.equations.flow(0.0, found.x[0]).F_tip))


# --- along a simulation ------------------------------------------------------------------------------------------------------


def test_a_loop_is_linearised_along_a_run() -> None:
    loop = loop_of(named("9.10 standard")[0], "ur5")
    sim = loop.simulate(1.0, 0.05)
    lin = loop.linearize(T, about="simulation", simulation=sim)
    assert_allclose(lin.point.x, sim.state(T))
    assert_allclose(lin.point.x[:, :6], np.stack([np.interp(T, sim.t, q) for q in sim.q.T], axis=1), atol=1e-4)
    on = loop.linearize(T)
    assert np.abs(lin.A - on.A).max() > 1e-3


def test_along_a_run_needs_a_run_of_this_loop() -> None:
    loop = loop_of(named("9.10 standard")[0], "ur5")
    other = ClosedLoop(robots.single_joint(), L.JointPID(3.0), Hold([0.0])).simulate(0.1)
    for wrong in (None, "run", other):
        with pytest.raises(BadArgument) as info:
            loop.linearize(T, about="simulation", simulation=wrong)
        assert info.value.argument == "simulation"
    with pytest.raises(BadArgument) as info:
        loop.linearize([0.5, 2.0], about="simulation", simulation=loop.simulate(1.0))
    assert info.value.argument == "times" and "1" in info.value.takes
