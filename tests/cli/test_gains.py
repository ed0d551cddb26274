"""``mfc-analysis gains``: options become the arguments of a helper, and what it does not take is refused by name."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import gains as helpers, hertz, robots
from mfc_analysis.cli.gains import KINDS, designed, numbers
from mfc_analysis.errors import BadArgument, UnknownName
from tests.cli.commands import run


def test_gains_prints_what_the_helper_returns():
    from mfc_analysis import gains

    assert run("gains", "pid", "--bandwidth-hz", 4).stdout.strip() == str(gains.pid(bandwidth=hertz(4)))
    several = run("gains", "pd", "--natural-frequency-hz", 10, "--damping", 2, "--inertia", "0.003609725,0.00425").stdout
    assert "14.2506" in several and "16.7783" in several and "0.907223" in several and "1.068142" in several
    force = run("gains", "force-pi", "--bandwidth-hz", 1, "--stiffness", 1e4, "--mass", 2, "--lag", 0.001).stdout
    assert force.strip() == str(gains.force_pi(bandwidth=hertz(1), stiffness=1e4, mass=2, lag=0.001))
    loop = run("gains", "pid", "--settling-time", 0.5, "--step", "loop").stdout
    assert loop.strip() == str(gains.pid(settling_time=0.5, step="loop")) and "0.5 s (step of the loop, T)" in loop
    arm = run("gains", "joint-pid", "--robot", "ur5", "--q", "0,-1,1.4,-1.9,-1.57,0", "--bandwidth", 20)
    assert arm.exit_code == 0 and "[N" in arm.stdout
    wall = run("gains", "admittance", "--bandwidth-hz", 1, "--stiffness", 3000, "--servo-hz", 8, "--servo-damping", 0.7, "--delay", 0.016).stdout
    assert wall.strip() == str(gains.admittance(bandwidth=hertz(1), stiffness=3000, servo=hertz(8), servo_damping=0.7, delay=0.016))
    soft = run("gains", "impedance", "--robot", "ur5", "--q", "0,-1,1.4,-1.9,-1.57,0", "--stiffness", "900,900,900,40,40,40", "--ratio", 0.7).stdout
    assert soft.strip() == str(gains.impedance(robots.ur5(), [0, -1, 1.4, -1.9, -1.57, 0], [900, 900, 900, 40, 40, 40], 0.7))
    assert run("gains", "cartesian-damping", "--robot", "ur5", "--q", "0,-1,1.4,-1.9,-1.57,0", "--stiffness", 1000).exit_code == 0


def test_joint_gains_are_judged_on_the_coupled_arm_with_its_dead_time():
    asked = ("gains", "joint-pid", "--robot", "panda", "--q", "-2.2,0.6,0.9,-1.2,-0.7,2.5,2.5", "--bandwidth-hz", 4)
    done = run(*asked, "--delay", 4e-3)
    assert done.exit_code == 0 and "UNSTABLE with the loops of all joints closed (dead time 4 ms)" in done.stdout
    assert done.stderr.count("warning: panda: the URDF lacks rotor inertia; give armature") == 1
    assert "stable with the loops of all joints closed (lag 1 ms)" in run(*asked, "--torque-lag", 1e-3).stdout


def test_gains_take_the_robot_and_the_pose_of_a_study(tmp_path):
    study = tmp_path / "one.toml"
    assert run("init", "single_joint", "--out", study).exit_code == 0
    of_study = run("gains", "joint_pid", "--bandwidth-hz", 4, "--robot", study)
    (start,) = tomllib.loads(study.read_text())["q_start"]
    of_robot = run("gains", "joint-pid", "--bandwidth-hz", 4, "--robot", "single_joint", "--q", start)
    assert of_study.exit_code == 0 and of_study.stdout == of_robot.stdout
    refused = run("gains", "joint-pid", "--bandwidth-hz", 4, "--robot", study, "--tool", "tool")
    assert refused.exit_code == 2 and "--tool" in refused.stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("pdi", "--bandwidth", 1), "did you mean"),
        (("pid",), "exactly one of the four"),
        (("pid", "--bandwidth", 1, "--crossover", 2), "exactly one"),
        (("pid", "--bandwidth", 1, "--bandwidth-hz", 2), "--bandwidth"),
        (("pid", "--bandwidth", -1), "bandwidth"),
        (("pid", "--bandwidth", 1, "--step", "loop"), "step"),
        (("pid", "--settling-time", 1, "--step", "q_d"), "'reference', 'loop'"),
        (("p", "--bandwidth", 1, "--damping", 1), "--damping"),
        (("pid", "--bandwidth", 1, "--inertia", "a"), "--inertia"),
        (("joint-pid", "--bandwidth", 1), "--robot"),
        (("force-pi", "--bandwidth", 1, "--mass", 1), "--stiffness"),
        (("pid", "--bandwidth", 1, "--stiffness", 3), "--stiffness"),
    ],
)
def test_gains_that_cannot_be_are_bad_input(options, said):
    done = run("gains", *options)
    assert done.exit_code == 2 and said in done.stderr


def test_every_kind_is_a_helper_and_an_unknown_one_lists_them():
    assert all(callable(getattr(helpers, kind.replace("-", "_"))) for kind in KINDS)
    with pytest.raises(UnknownName) as why:
        designed("pdd", {})
    assert why.value.known == KINDS and why.value.got == "pdd"


@pytest.mark.parametrize("name", ["bandwidth", "natural_frequency", "crossover"])
def test_a_frequency_in_hertz_is_two_pi_of_it_in_radians(name):
    assert dict(designed("pid", {f"{name}_hz": 4.0})) == dict(designed("pid", {name: 8 * np.pi}))


def test_an_option_the_helper_does_not_take_names_those_it_takes():
    with pytest.raises(BadArgument) as why:
        designed("p", {"bandwidth": 1.0, "damping": 0.7})
    assert why.value.argument == "--damping" and "--natural-frequency" in why.value.takes
    with pytest.raises(BadArgument) as why:
        designed("pid", {"bandwidth": 1.0, "bandwidth_hz": 2.0})
    assert why.value.argument == "--bandwidth-hz" and why.value.got == 2.0


@pytest.mark.parametrize("kind", ["force-pi", "cartesian-damping"])
def test_a_stiffness_that_is_needed_is_asked_for_by_name(kind):
    with pytest.raises(BadArgument) as why:
        designed(kind, {})
    assert why.value.argument == "--stiffness" and kind in why.value.takes


def test_without_a_pose_the_inertia_is_that_of_the_pose_zero():
    asked = {"robot": "planar_2r", "natural_frequency": 3.0}
    assert_allclose(designed("joint-pid", asked).kp, 27 * np.diag(robots.planar_2r().mass(np.zeros(2))), rtol=1e-12)
    bent = designed("joint-pid", {**asked, "q": "0.3,1.2"})
    assert_allclose(bent.kp, 27 * np.diag(robots.planar_2r().mass([0.3, 1.2])), rtol=1e-12)
    one = designed("joint-pid", {"robot": "single_joint", "natural_frequency": 3.0, "q": "0.4"})
    assert_allclose(one.kp, 27 * robots.single_joint().mass([0.4])[0], rtol=1e-12)


def test_numbers_are_one_or_several_and_nothing_else():
    assert numbers("inertia", "0.5") == 0.5 and numbers("inertia", "1,-2e-3, 3") == [1.0, -2e-3, 3.0]
    for text in ("", "1,,2", "1;2", "one"):
        with pytest.raises(BadArgument) as why:
            numbers("motor_inertia", text)
        assert why.value.argument == "--motor-inertia" and why.value.got == text


def test_a_missing_or_negative_bandwidth_is_named_by_its_option():
    none, two, negative = (run("gains", "pid", *x) for x in ((), ("--bandwidth-hz", 4, "--crossover", 3), ("--bandwidth-hz", -4)))
    assert none.exit_code == two.exit_code == negative.exit_code == 2
    assert "none of them" in none.stderr and "mfc-analysis gains pid --bandwidth-hz 4" in none.stderr
    assert "--bandwidth and --crossover" in two.stderr
    assert negative.stderr == "error: --bandwidth-hz: got -4.0; takes a number above 0, in Hz\n"
