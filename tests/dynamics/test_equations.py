"""The equations of the loop: layout of states, wires that can be cut, external inputs, friction, and the same lines for plain and dual arrays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.flow import Inputs
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.dual import Dual, value
from mfc_analysis.maths.se3 import exp6, inverse, log6
from mfc_analysis.trajectories import Hold, ToolHold
from tests.conftest import LAWS, Case, arm, fits, loop_of, moving, plant, regular_pose, seed, surfaces

T = np.array([0.1, 0.9])


def state(case: Case, name: str, **more: object) -> tuple[ClosedLoop, np.ndarray]:
    loop = loop_of(case, name, contact=case.law(6).plant == "torque", **more)
    x = loop.linearize(T).point.x
    return loop, x + 0.02 * seed(case.name).normal(size=x.shape)


def test_states_are_named_by_slot_and_channel_in_the_order_of_the_drawing() -> None:
    hardware = Hardware(torque_lag=1e-3, velocity_filter=1e-3, force_filter=1e-3, joint_stiffness=1e3, motor_inertia=0.1)
    law = L.HybridMotionForce(np.zeros(6), 90.0, 10.0, 18.0, 1.0, 2.0, constraints=np.eye(6)[[2]])
    e = ClosedLoop(arm("ur5"), law, Hold(regular_pose("ur5")), hardware=hardware).equations
    assert list(e.parts) == ["q", "v", "theta", "omega", "z", "z_f", "v_filter", "F_filter", "lag"]
    assert e.state_names[0] == "q_shoulder_pan_joint" and e.state_names[24:30] == ("z_vx", "z_vy", "z_vz", "z_wx", "z_wy", "z_wz")
    assert e.state_names[30:36] == ("z_f_fx", "z_f_fy", "z_f_fz", "z_f_mx", "z_f_my", "z_f_mz") and e.state_names[-1] == "lag_wrist_3_joint"
    assert e.nx == len(e.state_names) == 54 and e.integrals == tuple(range(24, 36))
    assert e.plant_states == (*range(24), *range(48, 54))
    assert e.wire_sizes() == {"torque": 6, "command": 6, "position": 6, "rate": 6, "force": 6}


ON_THREE = [(name, case) for name in ("planar_2r", "ur5", "panda") for case in LAWS if fits(case, name)]


@pytest.mark.parametrize(("name", "case"), [x for x in ON_THREE if x[1].name != "9.9 printed"], ids=str)  # its dual form needs the torque wire cut
def test_plain_and_dual_arrays_have_the_same_values(name: str, case: Case) -> None:
    loop, x = state(case, name)
    e = loop.equations
    plain, dual = e.flow(T, x), e.flow(T, Dual(x, np.zeros((*x.shape, 1))))
    for slot in e.parts:
        assert_allclose(value(dual.rates[slot]), value(plain.rates[slot]), rtol=1e-10, atol=1e-9 * max(1.0, np.abs(value(plain.rates[slot])).max()))
    assert_allclose(value(dual.error), value(plain.error), atol=1e-12)
    one = e.rates(T[1], x[1])  # a point alone, as a simulation asks
    assert_allclose(one, e.rates(T, x)[1], rtol=1e-10, atol=1e-9 * np.abs(one).max())


def test_a_joint_reference_under_a_tool_law_is_the_motion_of_its_tool() -> None:
    e = ClosedLoop(plant("ur5"), L.TaskVelocity(3.0), moving("ur5")).equations
    t, h = 0.4, 1e-4
    ref = e.reference(t)
    X = [arm("ur5").pose(moving("ur5")(t + s).q) for s in (-h, 0.0, h)]
    assert_allclose(ref.X.matrix, X[1], atol=1e-12)
    assert_allclose(ref.V, log6(inverse(X[0]) @ X[2]) / (2 * h), atol=1e-6)
    assert_allclose(ref.dV, (e.reference(t + h).V - e.reference(t - h).V) / (2 * h), atol=1e-6)


def test_a_reference_pose_moves_along_its_own_axes() -> None:
    q = regular_pose("ur5")
    loop = ClosedLoop(arm("ur5"), L.TaskVelocity(3.0), ToolHold(arm("ur5").pose(q)), q_start=q)
    twist = np.array([0.1, 0.2, -0.3, 0.3, -0.1, 0.2])
    lin = loop.linearize([0.0], coordinates="state")
    columns = [lin.input_names.index(f"X_d_{c}") for c in ("vx", "vy", "vz", "wx", "wy", "wz")]
    rows = [lin.output_names.index(f"X_e_{c}") for c in ("vx", "vy", "vz", "wx", "wy", "wz")]
    assert_allclose(lin.D[0][np.ix_(rows, columns)], np.eye(6), atol=1e-12)
    h = 1e-5
    moved = [log6(inverse(arm("ur5").pose(q)) @ arm("ur5").pose(q) @ exp6(s * h * twist)) for s in (-1, 1)]
    assert_allclose(lin.D[0][np.ix_(rows, columns)] @ twist, (moved[1] - moved[0]) / (2 * h), atol=1e-9)


def test_the_plants_own_friction_is_in_the_plant_and_only_the_models_viscous_part_in_the_law() -> None:
    robot = robots.single_joint(damping=0.4).with_friction(viscous=0.4, coulomb=0.7, coulomb_speed=0.05)
    model = robots.single_joint(damping=0.25)
    e = ClosedLoop(robot, L.ComputedTorque(50.0, kd=10.0), Hold([0.0]), model).equations
    q, v = 0.2, 0.6
    flow = e.flow(0.0, np.array([q, v]))
    tau = 0.5 * (50.0 * -q + 10.0 * -v) + 0.981 * np.cos(q) + 0.25 * v
    assert_allclose(value(flow.command), tau, atol=1e-12)
    assert_allclose(value(flow.rates["v"]), (tau - 0.981 * np.cos(q) - 0.4 * v - 0.7 * np.tanh(v / 0.05)) / 0.5, atol=1e-12)


def test_two_loops_with_shared_parts_do_not_disturb_each_other() -> None:
    q = regular_pose("ur5")
    first = ClosedLoop(plant("ur5"), L.DampedForcePI(np.ones(6), 1.0, 2.0, 20.0), Hold(q), arm("ur5"), surfaces("ur5", q))
    second = ClosedLoop(arm("ur5"), L.DampedForcePI(2 * np.ones(6), 1.0, 2.0, 20.0), Hold(q), plant("ur5"))
    x = np.r_[q, 0.1 * np.ones(12)]
    one = first.equations.rates(0.0, x)
    second.equations.rates(0.0, x + 0.1)
    assert_allclose(first.equations.rates(0.0, x), one, rtol=0)


def test_the_drawing_shows_every_wire() -> None:
    import mfc_analysis.dynamics.equations

    drawn = mfc_analysis.dynamics.equations.__doc__ or ""
    for wire in ("torque", "velocity", "command", "position", "rate", "force"):
        assert f'"{wire}"' in drawn


@pytest.mark.parametrize("case", LAWS, ids=lambda case: case.name)
def test_rates_and_signals_are_those_of_the_flow(case: Case) -> None:
    """Of one state, of several, and with hardware: the shorter ways of a simulation give the same numbers."""
    name = next(name for name in ("ur5", "panda", "planar_2r") if fits(case, name))
    loop, x = state(case, name)
    e = loop.equations
    disturbance = 0.3 * np.ones(e.n)
    flow = e.flow(T, x, None, Inputs(disturbance=disturbance))
    want = value(e.join(flow.rates))
    assert_allclose(e.rates(T, x, disturbance), want, rtol=1e-9, atol=1e-9)
    for i in range(len(T)):
        assert_allclose(e.rates(float(T[i]), x[i], disturbance), want[i], rtol=1e-7, atol=1e-9 * np.abs(want).max())
    signals = e.signals(T, x, Inputs(disturbance=disturbance))
    for one in ("error", "command", "F_tip"):
        assert_allclose(value(getattr(signals, one)), value(getattr(flow, one)), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("name", "case"), ON_THREE, ids=str)
def test_many_states_at_one_time_have_the_rates_that_each_has_alone(name: str, case: Case) -> None:
    loop, x = state(case, name)
    e, states = loop.equations, x[1] + 1e-3 * seed(name, case.name).standard_normal((4, x.shape[1]))
    together = e.rates(0.3, states)
    alone = np.array([e.rates(0.3, one) for one in states])
    assert_allclose(together, alone, rtol=1e-9, atol=1e-9 * np.abs(alone).max())
    np.testing.assert_array_equal(together, e.rates(np.full(4, 0.3), states))


def test_rates_of_some_slots_leave_the_others_at_0() -> None:
    e = ClosedLoop(arm("ur5"), L.ComputedTorque(100.0, 80.0, 20.0), Hold(regular_pose("ur5"))).equations
    out = e.state_rates({"z": np.ones(6)}, (3,))
    assert out.shape == (3, 18) and not out[:, :12].any() and np.all(out[:, 12:] == 1)
