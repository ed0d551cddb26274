"""What a user asks of a linearised loop, against python-control and closed forms."""

from __future__ import annotations

import warnings

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis import laws as L, robots
from mfc_analysis.analysis.delay import verdict
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument, UnknownName, UnknownPoint
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold
from tests.conftest import LAWS, Case, arm, loop_of, moving, named, plant, regular_pose

T = np.array([0.1, 0.5, 0.9])
W = np.array([0.3, 2.0, 15.0, 200.0])
JOINT = ClosedLoop(robots.single_joint(), L.JointPID(20.0, 5.0, 3.0), Hold([0.4]))
PLANT = control.tf([1.0], [0.5, 0.1, -0.981 * np.sin(0.4)])
PID = control.tf([3.0, 20.0, 5.0], [1, 0])


def test_the_closed_loop_is_a_system_of_python_control_with_named_signals() -> None:
    lin = JOINT.linearize(T)
    system = lin.system(1)
    assert isinstance(system, control.StateSpace) and system.dt == 0
    assert system.state_labels == ["q_joint", "v_joint", "z_joint"]
    assert system.input_labels == ["q_d_joint", "disturbance_joint"] and system.output_labels == ["q_joint", "e_joint", "tau_joint"]
    found = system(1j * W)
    # q_d enters the error alone: its rate is not an input
    e_only = control.tf([20.0, 5.0], [1, 0]) * PLANT / (1 + PID * PLANT)
    assert_allclose(found[0, 0], e_only(1j * W), rtol=1e-9)
    assert_allclose(found[0, 1], (PLANT / (1 + PID * PLANT))(1j * W), rtol=1e-9)
    assert_allclose(found[1, 0], 1 - e_only(1j * W), rtol=1e-9)


def test_the_loop_broken_at_the_torque_is_the_controller_times_the_plant() -> None:
    lin = JOINT.linearize(T)
    assert_allclose(lin.loop(0)(1j * W), (PID * PLANT)(1j * W), rtol=1e-9)
    assert_allclose(lin.frequency_response(W)[0, 0], (PID * PLANT)(1j * W), rtol=1e-9)
    assert_allclose(lin.loop(2, at="position")(1j * W), (PID * PLANT)(1j * W), rtol=1e-9)  # the encoder and, through it, the rate
    m = lin.margins()
    _, pm, _, _, wgc, _ = control.stability_margins(PID * PLANT)
    assert_allclose(m.phase_deg, pm, rtol=1e-6)
    assert_allclose(m.crossover, wgc, rtol=1e-6)


@pytest.mark.parametrize("case", [c for c in LAWS if c.name not in ("9.1", "9.9 standard", "9.21")], ids=str)
def test_a_loop_broken_anywhere_and_closed_again_has_the_poles_of_the_closed_loop(case: Case) -> None:
    """1 + L of one channel, the others closed: det(sI - A_closed) / det(sI - A_broken) for every point and several channels."""
    loop = loop_of(case, "ur5", contact=case.law(6).plant == "torque")
    lin = loop.linearize(T[:1])
    for at in loop.law.opens_at:
        names = lin.margins(at).channels
        response = lin.frequency_response(W, at)
        for channel in (0, len(names) // 2):
            broken = lin.loop(0, at=at, channel=channel)
            assert_allclose(broken(1j * W), response[0, channel], rtol=1e-6, atol=1e-9)
            s = 2.0 + 3.0j
            ratio = np.exp(np.linalg.slogdet(s * np.eye(len(lin.A[0])) - lin.A[0])[1] - np.linalg.slogdet(s * np.eye(len(broken.A)) - broken.A)[1])
            if at != "position":  # whose rate is cut by s times the position
                assert_allclose(abs(1 + broken(s)), ratio * (1 + broken.D[0, 0]), rtol=1e-5)
            assert_allclose(lin.loop(0, at=at, channel=names[channel])(1j * W), broken(1j * W), rtol=1e-12)


@pytest.mark.parametrize(("case", "at"), [("9.10 printed", "torque"), ("9.16 standard", "command"), ("9.23", "force"), ("9.8", "position")])
def test_a_loop_with_one_gain_changed_goes_unstable_where_the_margin_says(case: str, at: str) -> None:
    """The gain at one wire, scaled in L: stable just inside (reduction, increase), unstable just outside."""
    if case == "9.23":
        q = regular_pose("ur5")
        held = Environment(2e3, 60.0, axes="xyzrxryrz")
        loop = ClosedLoop(arm("ur5"), L.DampedForcePI(np.zeros(6), 1.0, 3.0, 60.0), Hold(q), environment=held, hardware=Hardware(torque_lag=0.05))
    elif case == "9.16 standard":
        loop = ClosedLoop(arm("ur5"), named(case)[0].law(6), moving("ur5"), hardware=Hardware(torque_lag=5e-3))
    else:
        loop = loop_of(named(case)[0], "ur5", hardware=Hardware(torque_lag=5e-3))
    lin = loop.linearize(T[:1])
    m = lin.margins(at)
    assert m.stable.all()
    checked = 0
    for channel in range(len(m.channels)):
        broken = lin.loop(0, at=at, channel=channel)
        for limit, outside in ((m.gain_reduction[0, channel], -1), (m.gain_increase[0, channel], 1)):
            if not 0 < limit < 1e4:  # no limit: far out it is still stable
                A = broken.A - 10.0 ** (3 * outside) * broken.B @ broken.C
                assert broken.D[0, 0] or np.linalg.eigvals(A).real.max() < 1e-9
                continue
            for factor, stable in ((1 - 1e-3 * outside, True), (1 + 1e-3 * outside, False)):
                k = limit * factor
                A = broken.A - k * broken.B @ broken.C / (1 + k * broken.D[0, 0])
                assert bool(np.linalg.eigvals(A).real.max() < 1e-9) == stable
            checked += 1
    assert checked > 0


def test_step_responses_are_those_of_python_control() -> None:
    lin = JOINT.linearize([0.0])
    found = lin.step(0, "q_d_joint", "q_joint")
    reference = control.step_response(lin.system(0)[0, 0], T=found.t)
    assert_allclose(found.y, reference.outputs, atol=1e-6)
    info = control.step_info(lin.system(0)[0, 0], T=np.linspace(0, found.t[-1], 20001))
    assert_allclose(found.overshoot * 100, info["Overshoot"], rtol=1e-3)
    assert_allclose(found.peak_time, info["PeakTime"], atol=1e-2)
    assert_allclose(found.settling, info["SettlingTime"], atol=1e-2)
    assert_allclose(found.steady_state, 1.0, atol=1e-9)
    pushed = lin.step(0, "disturbance_joint", "q_joint")
    assert_allclose(pushed.steady_state, 0.0, atol=1e-9)  # the integral takes it
    assert_allclose(lin.step(0, 0, 0).y, found.y)
    ours = found.response
    assert isinstance(ours, control.TimeResponseData) and (ours.input_labels, ours.output_labels) == (["q_d_joint"], ["q_joint"])
    for name in ("time", "outputs", "inputs"):
        assert_allclose(getattr(ours, name), getattr(reference, name), atol=1e-6)
    t = np.linspace(0.0, 1.0, 11)
    every = lin.steps(t)
    (one,), theirs = every.responses, control.step_response(lin.system(0), T=t)
    assert (one.input_labels, one.output_labels, one.issiso) == (theirs.input_labels, theirs.output_labels, False)
    assert_allclose(one.y, theirs.y, atol=1e-6)
    assert_allclose(one.u, theirs.u)
    assert_allclose(control.step_info(one.y[0, 0], t)["PeakTime"], control.step_info(theirs.y[0, 0], t)["PeakTime"])
    assert every.y.shape == (1, len(lin.output_names), len(lin.input_names), 11) and every.outputs == lin.output_names
    assert_allclose(every.y[0], control.step_response(lin.system(0), T=t).outputs, atol=1e-6)
    assert_allclose(lin.step(0, "q_d_joint", "q_joint", times=t).y, every[0, "q_joint", "q_d_joint"].y, atol=1e-12)


def test_a_step_of_the_tool_reference_starts_with_the_whole_error() -> None:
    """X_d jumps, the tool does not: X_e is 1 at once and goes to 0, in coordinates of the error too."""
    lin = ClosedLoop(arm("ur5"), L.TaskComputedTorque(100.0, kd=20.0), Hold(regular_pose("ur5"))).linearize([0.0])
    assert lin.coordinates == "error"
    error, position = lin.step(0, "X_d_vz", "X_e_vz"), lin.step(0, "X_d_vz", "q_elbow_joint")
    assert_allclose(error.y[0], 1.0, atol=1e-9)
    t = error.t  # s^2 + 20 s + 100 on the error alone: Kd acts on the rate of the tool, not of the jump
    assert_allclose(error.y, (1 + 10 * t) * np.exp(-10 * t), atol=1e-6)
    assert_allclose(position.y[0], 0.0, atol=1e-9)
    assert_allclose(position.steady_state, np.linalg.inv(arm("ur5").jacobian(regular_pose("ur5")))[2, 2], rtol=1e-6)


def test_a_step_of_the_wrench_asked_for_is_followed() -> None:
    loop = ClosedLoop(robots.slider(1.0), L.DampedForcePI([0, 0, 5.0, 0, 0, 0], 1.0, [0, 0, 6.0, 0, 0, 0], 20.0), Hold([0.0]),
                      environment=Environment(400.0, preload=5.0))  # fmt: skip
    step = loop.linearize([0.0]).step(0, "F_d_fz", "F_tip_fz")
    assert_allclose(step.steady_state, 1.0, atol=1e-9)
    law = L.DampedForcePI([0, 0, 6.0, 0, 0, 0], 1.0, [0, 0, 6.0, 0, 0, 0], 20.0)
    harder = ClosedLoop(loop.robot, law, loop.ref, environment=loop.environment).simulate(step.t[::50], rtol=1e-9, atol=1e-12)
    assert_allclose(harder.force[:, 2] - 5.0, step.y[::50], atol=1e-6)  # the slider is linear


def test_poles_come_slowest_first_and_the_table_says_what_they_are() -> None:
    lin = JOINT.linearize(T)
    assert lin.poles().shape == (3, 3) and lin.poles().dtype == complex
    assert_allclose(np.sort(lin.poles()[0].real), np.sort(np.roots([0.5, 3.1, 20 - 0.981 * np.sin(0.4), 5.0]).real), rtol=1e-9)
    table = lin.pole_table(0)
    assert len(table) == 3 and "joint" not in str(table)
    assert len(lin) == 3 and "stable at 3 of 3 times" in str(lin)


def test_shapes_never_depend_on_the_data() -> None:
    for t in ([0.5], T):
        lin = ClosedLoop(plant("ur5"), L.ComputedTorque(100.0, 40.0, 20.0), moving("ur5"), arm("ur5")).linearize(t)
        m = len(np.atleast_1d(t))
        assert lin.A.shape == (m, 18, 18) and lin.B.shape == (m, 18, 12) and lin.C.shape == (m, 18, 18) and lin.D.shape == (m, 18, 12)
        assert lin.poles().shape == (m, 18) and lin.stable.shape == lin.neutral.shape == lin.drifts.shape == (m,)
        assert lin.residual.shape == (m, 6) and lin.times.shape == (m,) and lin.margins().phase_deg.shape == (m, 6)
        assert lin.frequency_response(W).shape == (m, 6, 4)
        assert lin.stable.dtype == bool and np.issubdtype(lin.neutral.dtype, np.integer)


@pytest.mark.parametrize("case", LAWS, ids=str)
def test_a_point_that_a_law_does_not_have_is_refused_with_those_it_has(case: Case) -> None:
    lin = loop_of(case, "ur5").linearize([0.0])
    law = case.law(6)
    known = {"torque", "command", "position", "force", "velocity"}
    for at in (known - set(law.opens_at)) | {"elbow", "rate", ""}:
        for ask in (lin.margins, lambda at: lin.loop(0, at=at), lambda at: lin.frequency_response(W, at), lin.disk_margin):
            with pytest.raises(UnknownPoint) as info:
                ask(at)
            assert info.value.known == law.opens_at and info.value.at == at and type(law).__name__ in str(info.value)


@pytest.mark.parametrize(("ask", "error", "argument"), [
    (lambda lin: lin.system(3), BadArgument, "index"), (lambda lin: lin.system(0.5), BadArgument, "index"),
    (lambda lin: lin.system(True), BadArgument, "index"),
    (lambda lin: lin.loop(0, channel=1), BadArgument, "channel"), (lambda lin: lin.loop(0, channel="elbow"), UnknownName, "channel"),
    (lambda lin: lin.step(0, "q_d_elbow", "q_joint"), UnknownName, "input"), (lambda lin: lin.step(0, 0, 99), BadArgument, "output"),
    (lambda lin: lin.step(0, 0, 0, duration=-1.0), BadArgument, "duration"), (lambda lin: lin.step(7, 0, 0), BadArgument, "index"),
    (lambda lin: lin.steps([1.0, 0.5]), BadArgument, "times"), (lambda lin: lin.steps([1.0], ["q_d_elbow"]), UnknownName, "inputs"),
    (lambda lin: lin.frequency_response([-1.0]), BadArgument, "frequencies"),
    (lambda lin: lin.frequency_response([np.nan]), BadArgument, "frequencies"),
])  # fmt: skip
def test_what_cannot_be_asked_is_refused_by_name(ask: object, error: type[Exception], argument: str) -> None:
    with pytest.raises(error) as info:
        ask(JOINT.linearize(T))
    assert info.value.argument == argument


@pytest.mark.parametrize("at", [3, np.ones(2), True, ["torque", 1]], ids=str)
def test_a_point_that_is_no_name_is_refused(at: object) -> None:
    lin = JOINT.linearize(T)
    asked = (lin.disk_margin,) if isinstance(at, list) else (lin.margins, lin.disk_margin, lambda at: lin.loop(0, at=at))
    for ask in asked:
        with pytest.raises(UnknownPoint):
            ask(at)


def test_indices_count_from_either_end() -> None:
    lin = ClosedLoop(arm("ur5"), L.JointPID(300.0, 50.0, 60.0), moving("ur5")).linearize(T)
    assert_allclose(lin.system(-1).A, lin.A[2])
    for model, A, B in zip(lin.systems(), lin.A, lin.B, strict=True):
        assert_allclose(model.A, A)
        assert_allclose(model.B, B)
    assert_allclose(lin.loop(-1).A, lin.loop(2).A)
    assert lin.loop(0, channel="elbow_joint").input_labels == ["torque_elbow_joint_in"]


def test_a_loop_without_feedback_has_nothing_to_break() -> None:
    m = ClosedLoop(robots.single_joint(), L.TorqueFeedforward(), Hold([-0.4])).linearize([0.0]).margins()
    assert (m.gain_reduction[0, 0], m.gain_increase[0, 0], m.phase_deg[0, 0], m.sensitivity_peak[0, 0]) == (0.0, np.inf, np.inf, 1.0)


def test_the_plant_input_loop_of_an_exact_model_is_not_the_pids() -> None:
    """The cancellation is inside it; at the command it is outside."""
    lin = ClosedLoop(robots.single_joint(), L.ComputedTorque(100.0, 200.0, 20.0), Hold([0.4])).linearize([0.0])
    s = 1j * W
    pid = (20 * s**2 + 100 * s + 200) / s**3
    assert_allclose(lin.frequency_response(W, "command")[0, 0], pid, rtol=1e-9)
    I, b, g = 0.5, 0.1, -0.981 * np.sin(0.4)
    torque = (I * pid * s**2 - (b * s + g)) / (I * s**2 + b * s + g)  # h^ feeds b v + g q back through the plant
    assert_allclose(lin.frequency_response(W, "torque")[0, 0], torque, rtol=1e-9)


def test_at_a_pole_of_the_other_loops_a_response_is_not_finite_and_raises_nothing() -> None:
    arm = mfc.robots.planar_2r()
    lin = mfc.ClosedLoop(arm, mfc.laws.VelocityPI([0.0, 3.0], 100.0), mfc.trajectories.Hold([0.1, 0.2])).linearize()  # joint 0: s^2 + 100
    found = lin.frequency_response([1.0, 10.0, 30.0])[0]
    assert np.isfinite(found[:, [0, 2]]).all()
    assert_allclose(found[0], -100.0 / np.array([1.0, 10.0, 30.0]) ** 2, rtol=1e-12)  # L = ki / s^2 of joint 0 itself


@pytest.mark.parametrize("hardware", [{}, {"delay": 0.02}, {"sample_time": 0.01, "delay": 0.02}], ids=str)
def test_what_is_handed_to_python_control_without_its_dead_time_says_so(hardware):
    """A sampled loop includes it: nothing is left out there."""
    lin = ClosedLoop(robots.planar_2r(), L.ComputedTorque(100.0, kd=20.0), Hold([0.2, 0.4]), hardware=Hardware(**hardware)).linearize()
    late = hardware == {"delay": 0.02}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        given = [lin.system(0), lin.loop(0, channel=1), *lin.systems()]
    assert given[1].name.startswith("L_torque_joint2") and all(("without_dead_time" in one.name) is late for one in given)
    assert [(str(w.message).startswith("the dead time, 0.02 s, is left out"), w.filename) for w in said] == [(True, __file__)] * (3 * late)
    if not lin.dt:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert len([lin.system(0, pade=3), lin.loop(0, pade=3), *lin.systems(pade=3), lin.frd([1.0])]) == 4
    assert ("without dead time" in str(lin)) is late and ("dead time 0.02 s" in str(lin)) is late


def test_the_table_of_roots_is_that_of_the_characteristic_equation():
    """s = -k e^(-s T) on 9.2: the roots are W(-k T) / T on the branches of Lambert's function."""
    from scipy.special import lambertw

    k, late = 5.0, 0.1
    loop = ClosedLoop(robots.single_joint(), L.VelocityP(k), Hold([0.3]), hardware=Hardware(delay=late))
    rows = loop.linearize([0.0, 1.0]).root_table(1, 4)
    for row, s in zip(rows[::2], (lambertw(-k * late, branch) / late for branch in (0, 1)), strict=True):
        assert row.value == pytest.approx(complex(s), rel=1e-9) and row.kind == "stable"
        assert (
            row.frequency == pytest.approx(abs(s))
            and row.damping == pytest.approx(-s.real / abs(s))
            and row.time_constant == pytest.approx(-1 / s.real)
        )


def test_the_unstable_roots_of_a_loop_with_dead_time_are_counted_once_for_all_its_margins(monkeypatch):
    counted = []
    count = verdict.unstable_counts
    monkeypatch.setattr(verdict, "unstable_counts", lambda points, *about: counted.append(points) or count(points, *about))
    law, path = mfc.laws.ComputedTorque(100, 80, 20), mfc.trajectories.Sinusoid([0.3, -0.4], 0.2, 1.0)
    lin = mfc.ClosedLoop(mfc.robots.planar_2r(), law, path, hardware=mfc.Hardware(delay=4e-3)).linearize([0.0, 0.3, 0.7])
    assert lin.stable.all() and all(np.isfinite(lin.margins(at).phase_deg).all() for at in ("torque", "command", "position"))
    assert [len(points.A) for points in counted] == [3]
