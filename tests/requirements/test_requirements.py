"""Requirements against loops whose metrics are known in closed form, from both sides of each limit."""

import math

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, UnknownName, UnknownPoint
from mfc_analysis.requirements.evidence import Found
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.requirements import KINDS, Requirements, compared

K = 5.0  # [1/s]
W = 4.0  # [rad/s] of the triple pole


def hold(n: int = 1, q: float = 0.3):
    return mfc.trajectories.Hold(np.full(n, q))


def velocity_p(k: float = K):
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(k), hold())


def triple_pole():
    """9.10 with an exact model: every pole at -W; conditionally stable."""
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.ComputedTorque(kp=3 * W**2, ki=W**3, kd=3 * W), hold())


def pressing(kdamp: float = 40.0, lag: float = 5e-3, stiffness: float = 1e3, kfp: float = 2.0, kfi: float | None = None):
    """One mass on a spring under 9.23; with kfi None the gain of the force signal may grow to kdamp / (T k kfp)."""
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=kfp, kfi=kfi, kdamp=kdamp)
    surface = mfc.Environment(stiffness, preload=5.0)
    return mfc.ClosedLoop(mfc.robots.slider(mass=2.0), law, hold(q=0.0), environment=surface, hardware=mfc.Hardware(torque_lag=lag))


def second_order(zeta: float = 0.5, w: float = 10.0):
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.ComputedTorque(kp=w**2, kd=2 * zeta * w), hold())


ZETA, W2 = 0.5, 10.0
PHASE_PD = math.degrees(math.atan(2 * ZETA * math.sqrt(2 * ZETA**2 + math.sqrt(4 * ZETA**4 + 1))))

#: field, loop, analysis point, its value in closed form
KNOWN = [
    ("phase_deg", velocity_p, "velocity", 90.0),
    ("delay", velocity_p, "velocity", math.pi / (2 * K)),
    ("disk_margin", velocity_p, "velocity", 2.0),
    ("settling_time", velocity_p, None, math.log(50.0) / K),
    ("gain_reduction_db", triple_pole, "command", 20 * math.log10(9.0)),
    ("gain_increase_db", pressing, "force", 20 * math.log10(40.0 / (5e-3 * 1e3 * 2.0))),
    ("damping_ratio", second_order, None, ZETA),
    ("phase_deg", second_order, "command", PHASE_PD),
]


def one_sided(field: str, value: float) -> tuple[Requirements, Requirements]:
    """Requirements that a metric of this value meets by 0.1 %, and misses by 0.1 %."""
    inside, outside = (0.999, 1.001) if KINDS[field].least else (1.001, 0.999)
    out = [value * inside, min(value * outside, KINDS[field].high)]
    return Requirements(**{field: out[0]}), Requirements(**{field: out[1]})


@pytest.mark.parametrize(("field", "make", "at", "value"), KNOWN, ids=lambda x: x if isinstance(x, str) else getattr(x, "__name__", ""))
def test_closed_forms_are_found_and_limits_hold_from_both_sides(field, make, at, value):
    loop = make()
    passes, fails = one_sided(field, value)
    verdict = passes.check(loop, [0.0], at=at)
    assert verdict.line(field).found == pytest.approx(value, rel=1e-6)
    assert verdict.passed and verdict.status == "PASS"
    if value * 1.001 <= KINDS[field].high:  # 1.001 of the largest disk margin cannot be asked for
        assert not fails.check(loop, [0.0], at=at).passed
        assert fails.check(loop, [0.0], at=at).status == "FAIL"


@pytest.mark.parametrize("field", [*KINDS])
def test_every_metric_passes_at_a_thousandth_inside_and_fails_at_a_thousandth_outside(field):
    robot = mfc.robots.ur5()
    loop = mfc.ClosedLoop(
        robot.with_payload(2.0),
        mfc.laws.ComputedTorque(kp=100, ki=100, kd=20),
        mfc.trajectories.Quintic(np.full(6, 0.5), np.full(6, 1.0), 1.0),
        controller_model=robot,
        hardware=mfc.Hardware(torque_lag=5e-3, velocity_filter=3e-3),
    )
    times = np.linspace(0, 1, 3)
    value = Requirements(**{field: KINDS[field].low}).check(loop, times).line(field).found
    assert math.isfinite(value) and value > 0
    passes, fails = one_sided(field, value)
    assert passes.check(loop, times).passed
    verdict = fails.check(loop, times)
    assert verdict.status is Status.FAIL and verdict.worst.name == field and verdict.worst.distance < 0
    assert verdict.worst.where and verdict.worst.when is not None


def test_margins_agree_with_those_of_the_linearised_loop_at_their_place_and_time():
    robot = mfc.robots.ur5()
    loop = mfc.ClosedLoop(robot.with_payload(3.0), mfc.laws.ComputedTorque(kp=100, ki=200, kd=20), hold(6), controller_model=robot)
    times = np.array([0.0, 0.5])
    line = Requirements(gain_reduction_db=6).check(loop, times, at="position").line("gain_reduction_db")
    margins = loop.linearize(times).margins("position")
    assert line.found == pytest.approx(margins.gain_reduction_db.min(), rel=1e-12)
    assert margins.gain_reduction_db[int(np.searchsorted(times, line.when)), margins.channels.index(line.where)] == line.found


def test_stability_is_always_asked():
    verdict = Requirements().check(velocity_p(), [0.0])
    assert [line.name for line in verdict.lines] == ["stable"]
    assert verdict.line("stable").found == pytest.approx(-K, rel=1e-12)
    assert verdict.passed


def test_an_unstable_loop_fails_in_every_margin_and_stable_comes_first():
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(5.0, 100.0, 2.0), hold())
    verdict = Requirements(phase_deg=0, gain_increase_db=0, sensitivity_peak=1e9, disk_margin=0, settling_time=1e9, overshoot=1e9).check(loop, [0.0])
    assert verdict.status == "FAIL" and not verdict.passed
    assert verdict.lines[0].name == "stable" and verdict.lines[0].found > 0
    assert all(line.status == "FAIL" and math.isnan(line.found) for line in verdict.lines[1:])


@pytest.mark.parametrize("field", [*KINDS])
def test_nan_never_passes(field):
    line = compared(field, KINDS[field].low, Found(math.nan))
    assert line.status is Status.FAIL


def test_nothing_but_neutral_roots_is_said_to_be_neutral_and_does_not_pass():
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityFeedforward(), hold())
    verdict = Requirements(phase_deg=0).check(loop, [0.0])
    assert verdict.status == "FAIL" and "neutral" in verdict.line("stable").note


def test_a_drifting_loop_keeps_its_metrics_and_is_watch_at_best():
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=2.0, kfi=3.0, kdamp=20.0)
    loop = mfc.ClosedLoop(mfc.robots.slider(), law, hold(q=0.0))  # 9.23 in free space: the speed ramps
    verdict = Requirements(phase_deg=45).check(loop, [0.0])
    assert verdict.status == "WATCH" and not verdict.passed and verdict.drifts
    assert verdict.line("phase_deg").status == "PASS"
    assert "drifts" in verdict.line("stable").note


def test_a_residual_that_matters_is_watch_with_the_sag_it_implies():
    inertia, mass, com, kp = 0.5, 1.0, 0.1, 40.0
    robot = mfc.robots.single_joint(inertia=inertia, mass=mass, com_distance=com)
    loop = mfc.ClosedLoop(robot, mfc.laws.JointPID(kp, kd=5.0), hold(q=0.3))
    verdict = Requirements(phase_deg=20).check(loop, [0.0])
    sag = mass * 9.81 * com * math.cos(0.3) / (kp - mass * 9.81 * com * math.sin(0.3))  # one Newton step of the equilibrium
    assert verdict.status == "WATCH" and verdict.line("phase_deg").status == "PASS"
    assert verdict.line("residual").found == pytest.approx(sag, rel=1e-9)
    assert sag == pytest.approx(abs(loop.equilibrium().error[0]), rel=0.01)


def test_a_displacement_has_the_unit_of_its_joint_or_direction():
    rp, slider = mfc.robots.rp(), mfc.robots.slider()
    path = mfc.trajectories.Sinusoid([0.3, 0.4], [0.2, 0.1], 4.0)
    line = Requirements(tracking_error=1.0).check(mfc.ClosedLoop(rp, mfc.laws.JointPID(900.0, kd=60.0), path), [0.0]).line("tracking_error")
    assert line.unit == dict(zip(rp.joint_names, ("rad", "m"), strict=True))[line.where]
    moving = mfc.ClosedLoop(slider, mfc.laws.JointPID(40.0, kd=5.0), mfc.trajectories.Sinusoid([0.3], [0.2], 2.0))
    verdict = Requirements(tracking_error=1.0).check(moving, [0.1])
    assert {verdict.line(name).unit for name in ("tracking_error", "residual")} == {"m"}
    assert verdict.line("residual").label == "lag behind the moving reference" and "m/s^2)" in verdict.line("residual").note

    arm, q = mfc.robots.ur5(), [0.3, -1.2, 1.5, -0.8, -1.4, 0.2]
    X = arm.pose(q)
    for kp, unit in (([100.0] * 3 + [1e4] * 3, "m"), ([1e4] * 3 + [100.0] * 3, "rad")):  # what is held softly gives way to the payload
        law = mfc.laws.TaskComputedTorque(kp, kd=2 * np.sqrt(kp))
        loop = mfc.ClosedLoop(arm.with_payload(1.0), law, mfc.trajectories.ToolHold(X), controller_model=arm, q_start=q)
        line = Requirements(tracking_error=1.0).check(loop, [0.0]).line("tracking_error")
        assert line.unit == unit and line.where.startswith("X_e_v" if unit == "m" else "X_e_w")


@pytest.mark.parametrize(("kp", "status"), [(0.981 / 1.01e-3, "WATCH"), (0.981 / 0.99e-3, "PASS")])
def test_the_residual_matters_from_a_thousandth_of_a_radian(kp, status):
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(kp, kd=50.0), hold(q=0.0))
    assert Requirements().check(loop, [0.0]).status == status


def test_an_integral_or_an_exact_model_leaves_no_residual():
    for law in (mfc.laws.JointPID(40.0, 5.0, 5.0), mfc.laws.ComputedTorque(40.0, kd=10.0)):
        assert Requirements().check(mfc.ClosedLoop(mfc.robots.single_joint(), law, hold()), [0.0]).passed


def test_a_moving_reference_is_said_to_be_judged_in_frozen_time():
    ref = mfc.trajectories.Sinusoid([0.3], [0.1], 2.0)
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.ComputedTorque(40.0, kd=10.0), ref)
    assert any("frozen-time" in note for note in Requirements().check(loop, [0.0, 0.1]).notes)
    assert not Requirements().check(second_order(), [0.0]).notes


@pytest.mark.parametrize(
    ("field", "bad"),
    [
        ("phase_deg", -1.0),
        ("phase_deg", 181.0),
        ("delay", math.nan),
        ("gain_increase_db", math.inf),
        ("sensitivity_peak", 0.5),
        ("damping_ratio", 1.1),
        ("overshoot", "0.1"),
    ],
)
def test_values_that_no_metric_can_have_are_refused_by_name(field, bad):
    with pytest.raises(BadArgument) as why:
        Requirements(**{field: bad})
    assert why.value.argument == field


def test_unknown_names_are_refused_with_the_nearest():
    with pytest.raises(UnknownName, match="phase_deg"):
        Requirements.from_mapping({"phase_degr": 45})
    with pytest.raises(TypeError):
        Requirements(phase=45)
    assert Requirements.from_mapping({"phase_deg": 45}) == Requirements(phase_deg=45.0)


def test_bad_loops_times_and_points_are_refused():
    with pytest.raises(BadArgument, match="loop"):
        Requirements().check(3, [0.0])
    with pytest.raises(BadArgument, match="times"):
        Requirements().check(velocity_p(), [1.0, 0.0])
    for req in (Requirements(phase_deg=1), Requirements()):
        with pytest.raises(UnknownPoint):
            req.check(velocity_p(), [0.0], at="force")
    with pytest.raises(BadArgument, match="requirements"):
        Requirements.from_mapping(45)


def test_the_table_has_failures_first_and_every_number():
    verdict = Requirements(phase_deg=95, delay=0.1).check(velocity_p(), [0.0])
    text = str(verdict)
    assert text.startswith("FAIL") and text.index("phase margin") < text.index("delay margin")
    assert "90 deg" in text and "≥ 95 deg" in text and "joint, t = 0 s" in text
    assert isinstance(verdict.lines[0], Line)


def test_a_notebook_shows_the_table_with_words_and_escaped_names():
    page = Requirements(phase_deg=95).check(velocity_p(), [0.0])._repr_html_()
    assert page.startswith("<table>") and "✗ FAIL" in page and "✓ PASS" in page and "≥ 95 deg" in page and "<script" not in page


# --- which step --------------------------------------------------------------------------------------------------------------

POSE = [0.0, 0.3, 0.0, -1.2, 0.0, 1.5, 0.3]


def inverse_dynamics(name: str, gains, **hardware):
    robot = mfc.robots.load(name)
    given = mfc.Hardware(**hardware) if hardware else None
    return mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(**gains), mfc.trajectories.Hold(POSE[: robot.n]), hardware=given)


@pytest.mark.parametrize("step", ["reference", "loop"])
@pytest.mark.parametrize("name", ["single_joint", "ur5", "panda"])
def test_gains_for_a_settling_time_meet_the_requirement_of_the_same_name_and_step(name, step):
    """Found by two ways: the polynomials of the helper, and the step responses of the linearised arm."""
    asked = 0.5
    loop = inverse_dynamics(name, mfc.gains.pid(settling_time=asked, step=step))
    verdict = Requirements(settling_time=1.001 * asked, step=step).check(loop, [0.0], at="command")
    line = verdict.line("settling_time")
    assert verdict.passed and line.found == pytest.approx(asked, rel=1e-9) and line.label == f"settling time ({step} step)"
    assert not Requirements(settling_time=0.999 * asked, step=step).check(loop, [0.0], at="command").passed
    other = {"reference": "loop", "loop": "reference"}[step]
    achieved = mfc.gains.pid(settling_time=asked, step=step).achieved
    expected = {"reference": achieved.settling_time, "loop": achieved.loop_settling_time}[other]
    assert Requirements(settling_time=1, step=other).check(loop, [0.0], at="command").line("settling_time").found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ["single_joint", "ur5", "panda"])
def test_by_default_the_helper_and_the_requirement_mean_the_step_of_the_reference(name):
    loop = inverse_dynamics(name, mfc.gains.pid(settling_time=0.5))
    assert Requirements(settling_time=0.501).check(loop, [0.0]).passed
    assert not Requirements(settling_time=0.499).check(loop, [0.0]).passed
    joint = loop.robot.joint_names[0]
    assert loop.linearize().step(0, f"q_d_{joint}", f"q_{joint}").settling == pytest.approx(0.5, rel=1e-9)


@pytest.mark.parametrize("lag", [2e-3, 1e-2])
def test_with_a_lag_both_steps_are_those_of_the_polynomials(lag):
    """On a mass the torque loop is kd s^2 + kp s + ki over s^3 (lag s + 1)."""
    from mfc_analysis.gains.scalar_loop import loop_metrics

    g = mfc.gains.pid(settling_time=0.5)
    loop = mfc.ClosedLoop(mfc.robots.slider(mass=3.0), mfc.laws.ComputedTorque(**g), hold(), hardware=mfc.Hardware(torque_lag=lag))
    f = loop_metrics([g.kd, g.kp, g.ki], [lag, 1.0, 0.0, 0.0, 0.0], reference=[g.kp, g.ki])
    for step, value in (("reference", f.settling_time), ("loop", f.loop_settling_time)):
        assert Requirements(settling_time=1.001 * value, step=step).check(loop, [0.0]).passed
        assert not Requirements(settling_time=0.999 * value, step=step).check(loop, [0.0]).passed
        assert Requirements(settling_time=1, step=step).check(loop, [0.0]).line("settling_time").found == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize(("step", "at"), [("reference", None), ("loop", "force")])
@pytest.mark.parametrize("lag", [0.0, 5e-3])
def test_force_gains_meet_the_requirement_of_the_same_step(step, at, lag):
    k, m = 2e3, 3.0
    g = mfc.gains.force_pi(settling_time=0.4, step=step, stiffness=k, mass=m, lag=lag)
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], **g)
    hardware = mfc.Hardware(torque_lag=lag) if lag else None
    loop = mfc.ClosedLoop(mfc.robots.slider(mass=m), law, hold(q=0.0), environment=mfc.Environment(k, preload=5.0), hardware=hardware)
    assert Requirements(settling_time=1, step=step).check(loop, [0.0], at=at).line("settling_time").found == pytest.approx(0.4, rel=1e-6)
    assert Requirements(settling_time=0.4004, step=step).check(loop, [0.0], at=at).passed
    assert not Requirements(settling_time=0.3996, step=step).check(loop, [0.0], at=at).passed


def test_the_step_is_said_wherever_the_requirement_is():
    req = Requirements(settling_time=0.5, overshoot=0.2, phase_deg=30, step="loop")
    assert req == eval(req.code, {"mfc": mfc}) and "step='loop'" in req.code
    assert Requirements.from_mapping({"settling_time": 0.5, "step": "loop"}) == Requirements(settling_time=0.5, step="loop")
    assert str(req) == "stable, phase margin ≥ 30 deg, settling time (loop step) ≤ 0.5 s, overshoot (loop step) ≤ 0.2"
    assert "settling time (reference step)" in str(Requirements(settling_time=0.5)) and "step" not in Requirements(settling_time=0.5).code
    said = str(req.check(triple_pole(), [0.0], at="command"))
    assert "margins and loop steps at 'command'" in said and "overshoot (loop step)" in said
    for kd, why in ((2.0, "T = L/(1 + L) does not reach a steady value"), (0.0, "no loop goes through 'torque'")):  # a link that hangs
        link = mfc.ClosedLoop(mfc.robots.single_joint(damping=1.0), mfc.laws.JointPID(0.0, kd=kd), hold(q=-math.pi / 2))
        assert Requirements(overshoot=1, step="loop").check(link, [0.0]).line("overshoot").note == why


@pytest.mark.parametrize("given", [{"step": "loop"}, {"step": "loop", "phase_deg": 30}, {"step": "T", "settling_time": 1}, {"step": 1}])
def test_a_step_that_no_requirement_is_of_and_an_unknown_one_are_refused(given):
    with pytest.raises(BadArgument, match="step: got"):
        Requirements(**given)


@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 1e-3}, {"delay": 2e-3}, {"sample_time": 2e-3}], ids=str)
def test_every_line_of_an_unstable_loop_names_joint_time_and_root(hardware):
    """s^3 + 20 s^2 + 100 s + ki, unstable above ki = 2000: the elbow has 3000, the others 100."""
    law = mfc.laws.ComputedTorque(kp=100.0, ki=[100, 100, 3000, 100, 100, 100], kd=20.0)
    loop = mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold([0, -0.9, 1.6, -0.7, 1.57, 0]), hardware=mfc.Hardware(**hardware))
    verdict = Requirements(phase_deg=30.0, disk_margin=0.2).check(loop, [1.2])
    lin = loop.linearize([1.2])
    s = lin.delay_roots(1)[0, 0] if lin.delay else max((np.log(lin.poles()[0]) / lin.dt if lin.dt else lin.poles()[0]), key=lambda x: x.real)
    said = f"root +{s.real:.3g} ± {abs(s.imag):.3g} j 1/s"
    assert len(verdict.failed) == 3
    for line in verdict.failed:
        assert line.note.startswith("unstable: joint 3 (elbow_joint) at t = 1.2 s: ") and said in line.note
        assert line.where == "elbow_joint" and line.when == 1.2
    assert said in str(verdict)
