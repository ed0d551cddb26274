"""What is slow in words: what slides on a smooth wall, what a free position is, and what would hold them."""

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.requirements.evidence import Evidence
from mfc_analysis.requirements.slow import slow_words

Z = np.eye(6)[2]
Q = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.2])


def on_a_wall(axes: str = "z", **hardware: float) -> mfc.ClosedLoop:
    law = mfc.laws.DampedForcePI(10 * Z, Z, 2 * Z, kdamp=40.0)
    wall = mfc.Environment(stiffness=1e4, axes=axes, preload=10.0)
    return mfc.ClosedLoop(mfc.robots.load("ur10"), law, mfc.trajectories.Hold(Q), environment=wall, hardware=mfc.Hardware(**hardware))


@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 1e-3}], ids=["ideal", "lag"])
def test_a_tool_on_a_smooth_wall_slides_and_the_cure_is_named(hardware: dict[str, float]) -> None:
    words = slow_words(Evidence(on_a_wall(**hardware).equations, np.zeros(1)))
    assert "slow root" in words.roots and "0.01 1/s" in words.roots
    assert "slides" in words.means and "add a foot" in words.means and "100 s" in words.means
    assert "along z" not in words.means  # the wall holds it there


@pytest.mark.parametrize("q", [[0.68, -0.81, -2.3, -2.46, 1.57, 2.28, 0.53], [1.15, -1.14, 1.82, -1.18, -1.0, 1.05, -2.36]], ids=["first", "second"])
@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 2e-3}], ids=["ideal", "lag"])
def test_a_redundant_arm_never_slides_into_the_wall(q: list[float], hardware: dict[str, float]) -> None:
    """The wall gives way by F/k only: joints that move together leave its normal alone, whichever of them moves the most."""
    damping = np.array([200.0, 200.0, 200.0, 4.0, 4.0, 4.0])
    law = mfc.laws.DampedForcePI(20 * Z, Z, 5 * Z, kdamp=damping)
    wall = mfc.Environment(1e4, axes="z", preload=20.0)
    loop = mfc.ClosedLoop(mfc.robots.load("panda"), law, mfc.trajectories.Hold(q), environment=wall, hardware=mfc.Hardware(**hardware))
    found = Evidence(loop.equations, np.zeros(1))
    moved = found.stability.motion[0][loop.equations.parts["q"].where]
    tool = np.abs(loop.robot.jacobian(np.array(q)) @ moved).max(axis=1)
    assert tool[2] < 1e-4 * tool[:2].max()
    words = slow_words(found)
    assert "slides along" in words.moves and "along z" not in words.moves


def test_a_verdict_on_a_smooth_wall_says_what_slides() -> None:
    verdict = mfc.Requirements().check(on_a_wall(), [0.0])
    assert verdict.status == "WATCH" and "slides" in verdict.line("stable").note
    assert any("add a foot" in note for note in verdict.notes)


def test_free_positions_stay_where_they_are_put() -> None:
    loop = mfc.ClosedLoop(
        mfc.robots.load("panda"), mfc.laws.ComputedTorque(kp=0.0, kd=5.0), mfc.trajectories.Hold(np.full(7, 0.3) * [1, 1, 1, -5, 1, 5, 1])
    )
    words = slow_words(Evidence(loop.equations, np.zeros(1)))
    assert words.roots.startswith("7 slow roots") and "zero to rounding" in words.roots and words.moves == words.fastest == ""
    assert words.means.startswith("nothing brings all 7 joints back within 100 s: they stay nearly where they are put; add position feedback")
    assert mfc.Requirements().check(loop, [0.0]).status == "PASS" and words.means in str(mfc.Requirements().check(loop, [0.0]))


@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 2e-3}, {"delay": 2e-3}, {"sample_time": 2e-3}], ids=str)
def test_a_joint_that_is_free_and_does_not_drift_is_named(hardware: dict[str, float]) -> None:
    law = mfc.laws.ComputedTorque(kp=[100.0, 100.0, 0.0, 100.0, 100.0, 100.0], kd=20.0)
    loop = mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold(Q), hardware=mfc.Hardware(**hardware))
    found = Evidence(loop.equations, np.zeros(1))  # at rest gravity is cancelled with any hardware: the elbow keeps what it is given
    assert found.stability.slow[0] == 1 and not found.stability.drifts[0]
    assert slow_words(found).means.startswith("nothing brings elbow_joint back")


def test_a_prismatic_joint_that_is_free_is_named() -> None:
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.ComputedTorque(kp=0.0, kd=5.0), mfc.trajectories.Hold([0.0]))
    assert slow_words(Evidence(loop.equations, np.zeros(1))).means.startswith(
        "nothing brings slide back within 100 s: it stays nearly where it is put"
    )


def test_a_gripped_tool_turns_freely_about_its_grip_and_a_redundant_arm_keeps_its_posture() -> None:
    """A wall in x, y and z holds no rotation; a wall in all six directions leaves the panda one self-motion."""
    words = slow_words(Evidence(on_a_wall("xyz").equations, np.zeros(1)))
    assert words.means.startswith("nothing brings the tool back about x") and "along" not in words.means and "add a foot" in words.means
    assert "time constant" in words.fastest  # the rotations creep
    q = np.array([0.3, 0.3, 0.3, -1.5, 0.3, 1.5, 0.3])
    grip = mfc.Environment([1e4, 1e4, 1e4, 100.0, 100.0, 100.0], axes="xyzrxryrz", preload=[0, 0, 10.0, 0, 0, 0])
    law = mfc.laws.DampedForcePI(10 * Z, Z, 2 * Z, kdamp=40.0)
    held = mfc.ClosedLoop(mfc.robots.load("panda"), law, mfc.trajectories.Hold(q), environment=grip)
    found = Evidence(held.equations, np.zeros(1))
    assert found.stability.slow[0] == 7 - 6 and not found.stability.drifts[0]
    assert slow_words(found).means.startswith("nothing brings the posture (")


@pytest.mark.parametrize(("kd", "said"), [(20.0, "nothing brings the tool back along y (tool axes)"), (0.0, "nothing holds the tool along y within")])
def test_of_a_tool_law_the_axes_of_its_error_are_named(kd: float, said: str) -> None:
    """9.16 with kp = 0 along y: its states are X_e and V_e in tool axes, not joint positions."""
    law = mfc.laws.TaskComputedTorque(kp=[100.0, 0.0, 100.0, 100.0, 100.0, 100.0], kd=[20.0, kd, 20.0, 20.0, 20.0, 20.0])
    found = Evidence(mfc.ClosedLoop(mfc.robots.load("ur10"), law, mfc.trajectories.Hold(Q)).equations, np.zeros(1))
    assert found.linearization.coordinates == "error" and bool(found.stability.drifts[0]) == (kd == 0)
    assert slow_words(found).means.startswith(said)


def test_a_joint_that_ramps_is_named_and_a_loop_without_slow_roots_says_so() -> None:
    arm = mfc.robots.planar_2r()
    free = mfc.ClosedLoop(arm, mfc.laws.ComputedTorque(kp=[100.0, 0.0], kd=[20.0, 0.0]), mfc.trajectories.Hold([0.2, 0.4]))
    words = slow_words(Evidence(free.equations, np.zeros(1)))
    assert arm.joint_names[1] in words.means and arm.joint_names[0] not in words.means
    held = mfc.ClosedLoop(arm, mfc.laws.ComputedTorque(kp=100.0, kd=20.0), mfc.trajectories.Hold([0.2, 0.4]))
    assert slow_words(Evidence(held.equations, np.zeros(1))) == ("no slow root", "", "", "")


@pytest.mark.parametrize(
    ("kp", "asked", "best", "margins"), [([100.0, 0.0], {}, True, True), ([100.0, 0.0], {"phase_deg": 179.0}, False, True), (0.0, {}, False, False)]
)
def test_a_note_promises_no_watch_to_a_loop_that_fails(kp: object, asked: dict[str, float], best: bool, margins: bool) -> None:
    kd = [20.0, 0.0] if kp else 0.0
    loop = mfc.ClosedLoop(mfc.robots.planar_2r(), mfc.laws.ComputedTorque(kp=kp, kd=kd), mfc.trajectories.Hold([0.2, 0.4]))
    verdict = mfc.Requirements(**asked).check(loop, [0.0])
    (note,) = (note for note in verdict.notes if "nothing holds" in note)
    assert ("WATCH at best" in note, "margins" in note) == (best, margins)
    assert (verdict.status == "FAIL") is not best
