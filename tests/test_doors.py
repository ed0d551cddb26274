"""Every public argument refuses what is no number, no list of numbers or no name with an error of this package that names the argument."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis import exercises
from mfc_analysis.analysis.disk import singular_values
from mfc_analysis.errors import BadArgument, MfcError, MfcWarning
from mfc_analysis.laws import constraints
from mfc_analysis.linearization.coupling import coupling, leak

Door = Callable[[Any], object]

NOT_NUMBERS: list[Any] = [
    10**400, -(10**400), 10**5000, True, np.True_, 1j, np.complex128(1 + 0j), "3", [True], [1.0, True], [1, 1j], [[1.0], [1.0, 2.0]], [["a"]],
    np.array([True]), np.array([1 + 0j]), np.array(["3"], dtype=object), [10**400], {"a": 1}, {1.0}, b"1", np.timedelta64(1, "s"), np.nan, [np.inf],
]  # fmt: skip
NOT_NAMES: list[Any] = [10**400, 10**5000, True, 1j, 1.5, [["a"]], [[1.0], [1.0, 2.0]], {"a": ["a"]}, b"a", np.array(["a", "b"]), "no such name"]

UR5, JOINT, SLIDER = mfc.robots.ur5(), mfc.robots.single_joint(), mfc.robots.slider()
Q = [0.1, -1.0, 1.0, 0.3, 0.4, 0.5]
X = UR5.pose(Q)
F = [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]
LOOP = mfc.ClosedLoop(JOINT, mfc.laws.JointPID(50, 100, 10), mfc.trajectories.Hold([0.3]))
TOUCH = mfc.ClosedLoop(
    SLIDER, mfc.laws.DampedForcePI(F, 1.0, 1.0, 50.0), mfc.trajectories.Hold([0.1]), environment=mfc.Environment(1e3, 10.0, preload=5.0)
)
BOUNCING = mfc.ClosedLoop(SLIDER, mfc.laws.OpenLoopForce(F), mfc.trajectories.Hold([0.1]), environment=mfc.Environment(1e3, one_sided=True))
LIN, LAG = LOOP.linearize(), TOUCH.linearize()
LAWS, PATHS, GAINS, DESIGN, ROBOTS = mfc.laws, mfc.trajectories, mfc.gains, mfc.design, mfc.robots
ONE = mfc.Requirements(phase_deg=1)
RUN = LOOP.simulate([0.0, 0.01])


def changed(function: Callable[..., object], name: str, /, *args: Any, **options: Any) -> Door:
    """A door: the function with the argument ``name`` replaced."""
    given = dict(signature(function).bind_partial(*args, **options).arguments)
    given |= given.pop("asked", {}) if isinstance(given.get("asked"), dict) else {}
    return lambda value: function(**(given | {name: value}))


def doors(function: Callable[..., object], names: str, /, *args: Any, **options: Any) -> dict[str, Door]:
    label = getattr(function, "__qualname__", "?")
    return {f"{label}({name}=)": changed(function, name, *args, **options) for name in names.split()}


NUMBERS: dict[str, Door] = {
    **doors(LAWS.VelocityP, "kp"),
    **doors(LAWS.VelocityPI, "kp ki", kp=1.0, ki=1.0),
    **doors(LAWS.VelocityFeedforwardPI, "kp ki", kp=1.0),
    **doors(LAWS.TaskVelocity, "kp ki damping axes", kp=1.0),
    **doors(LAWS.JointPID, "kp kd anti_windup", kp=1.0, ki=1.0),
    **doors(LAWS.ComputedTorque, "kp kd mass anti_windup", kp=1.0, ki=1.0),
    **doors(LAWS.InverseDynamics, "outer"),
    "InverseDynamics(outer[kp]=)": lambda value: LAWS.InverseDynamics({"kp": value}),
    "InverseDynamics_of_matrices(outer=)": lambda value: LAWS.InverseDynamics((value, value, value, value)),
    **doors(LAWS.TaskComputedTorque, "kp ki kd null_damping damping axes", kp=1.0),
    **doors(LAWS.OpenLoopForce, "F_d"),
    **doors(LAWS.ForcePI, "F_d kfp kfi", F_d=F, kfp=1.0),
    **doors(LAWS.DampedForcePI, "F_d kfp kfi kdamp", F_d=F, kfp=1.0, kdamp=1.0),
    **doors(LAWS.HybridMotionForce, "F_d kp ki kd kfp kfi kdamp constraints", F_d=F, kp=1.0, constraints=np.eye(6)[:1]),
    **doors(LAWS.Impedance, "stiffness damping inertia F_d null_damping inverse_damping axes", stiffness=1.0, damping=1.0),
    **doors(LAWS.Admittance, "F_d inertia damping stiffness inverse_damping axes", F_d=F, inertia=1.0, damping=1.0),
    **doors(LAWS.JointImpedance, "stiffness damping inertia", stiffness=1.0, damping=1.0),
    **doors(LAWS.JointPID(1.0).changed, "kp"),
    **doors(
        mfc.Hardware,
        "torque_lag velocity_lag delay force_delay sample_time force_filter velocity_filter joint_stiffness joint_damping motor_inertia torque_limit "
        "velocity_limit force_limit force_deadband",
    ),
    **doors(mfc.Servo, "bandwidth damping delay", bandwidth=50.0),
    **doors(mfc.Environment, "stiffness damping pose preload", stiffness=1.0),
    **doors(mfc.Environment(1.0).with_stiffness, "stiffness"),
    **doors(ROBOTS.single_joint, "inertia mass com_distance damping gravity"),
    **doors(ROBOTS.slider, "mass friction"),
    **doors(ROBOTS.rp, "masses inertias com_distance gravity"),
    **doors(ROBOTS.planar_2r, "gravity"),
    **doors(JOINT.with_payload, "mass com inertia", mass=1.0),
    **doors(JOINT.with_friction, "viscous coulomb coulomb_speed"),
    **doors(JOINT.with_armature, "armature"),
    **doors(JOINT.with_inertia_scaled, "factor"),
    **doors(mfc.Robot.from_pinocchio, "gravity", JOINT.model, tool="tool"),
    **doors(mfc.Robot.from_urdf, "gravity", ROBOTS.catalogue.ur5_urdf(), tool="tool0"),
    "from_urdf(locked[name])": lambda value: mfc.Robot.from_urdf(ROBOTS.catalogue.ur5_urdf(), locked={"wrist_3_joint": value}),
    **{
        f"Robot.{name}(q=)": changed(getattr(UR5, name), "q")
        for name in ("configuration", "mass", "gravity", "pose", "jacobian", "task_inertia")
    },
    **{f"Robot.{name}({x}=)": changed(getattr(UR5, name), x, q=Q, v=Q) for name in ("bias", "jacobian_rate", "task_bias") for x in "qv"},
    **doors(UR5.friction, "v"),
    **doors(UR5.to_model, "x"),
    **doors(UR5.from_model, "x"),
    **doors(UR5.joint_torques, "q wrench", q=Q, wrench=F),
    **doors(PATHS.Hold, "q"),
    **doors(PATHS.Quintic, "q0 q1 duration", q0=[0.0], q1=[1.0]),
    **doors(PATHS.Sinusoid, "center amplitude frequency phase", center=[0.0], amplitude=1.0, frequency=1.0),
    **doors(PATHS.Waypoints, "times positions", times=[0.0, 1.0], positions=[0.0, 1.0]),
    **doors(PATHS.ToolHold, "X"),
    **doors(PATHS.ToolLine, "X0 X1 duration", X0=X, X1=X),
    **doors(PATHS.ToolSinusoid, "X0 amplitude frequency axis angle phase", X0=X, amplitude=0.1, frequency=1.0),
    **doors(PATHS.ToolCircle, "X0 radius frequency normal", X0=X, radius=0.1, frequency=1.0),
    **doors(PATHS.solve_pose, "X q_start", UR5, X=X, q_start=Q),
    **doors(PATHS.follow, "q_start times damping", UR5, PATHS.ToolHold(X), q_start=Q, times=[0.0]),
    **doors(PATHS.from_tool_path, "q_start times", UR5, PATHS.ToolHold(X), q_start=Q, times=[0.0, 1.0]),
    **doors(PATHS.JointPath, "times q v a", times=[0.0, 1.0], q=[[0.0], [0.0]], v=[[0.0], [0.0]], a=[[0.0], [0.0]]),
    **doors(PATHS.warn_outside_limits, "times", JOINT, PATHS.Hold([0.0])),
    "Hold()(t)": PATHS.Hold([0.0]),
    "ToolHold()(t)": PATHS.ToolHold(X),
    "hertz(f)": mfc.hertz,
    **doors(GAINS.pid, "bandwidth natural_frequency crossover settling_time"),
    **doors(GAINS.pid, "damping inertia", bandwidth=1.0),
    **doors(GAINS.p, "inertia", bandwidth=1.0),
    **doors(GAINS.force_pi, "bandwidth stiffness mass lag friction damping", bandwidth=1.0, stiffness=1e3, mass=1.0),
    **doors(GAINS.joint_pid, "q bandwidth damping", JOINT, q=[0.0], bandwidth=1.0),
    **doors(GAINS.cartesian_damping, "q stiffness ratio", UR5, q=Q, stiffness=1e3),
    **doors(GAINS.impedance, "q stiffness ratio", UR5, q=Q, stiffness=1e3),
    **doors(GAINS.admittance, "stiffness damping lag servo_damping delay", bandwidth=5.0, stiffness=1e3, servo=50.0),
    **doors(GAINS.admittance, "bandwidth", stiffness=1e3),
    **{f"Requirements({name}=)": changed(mfc.Requirements, name) for name in mfc.requirements.requirements.KINDS},
    **doors(ONE.check, "times", LOOP, times=[0.0]),
    **doors(constraints.peg_in_hole, "frame insertion_speed"),
    **doors(constraints.surface_sliding, "frame force"),
    **doors(constraints.projection, "A Lambda", A=np.eye(6)[:1], Lambda=np.eye(6)),
    **doors(constraints.selection, "A"),
    **doors(constraints.ConstraintSet, "natural artificial", natural=np.eye(6)[:, :3]),
    "ConstraintSet(artificial[name])": lambda value: constraints.ConstraintSet(constraints.peg_in_hole().natural, {"vz": value}),
    "ClosedLoop(q_start=)": lambda value: mfc.ClosedLoop(UR5, LAWS.TaskComputedTorque(1.0), PATHS.ToolHold(X), q_start=value),
    **doors(LOOP.nominal, "times"),
    **doors(LOOP.linearize, "times"),
    **doors(LOOP.floquet, "period"),
    **doors(
        LOOP.simulate,
        "times initial_error disturbance q v integral force_integral actuator rtol atol x",
        times=[0.0, 0.01],
    ),
    **doors(LOOP.validate, "time size seed"),
    **doors(RUN.state, "t"),
    **doors(RUN.operating_point, "times"),
    **doors(LIN.frequency_response, "frequencies"),
    **doors(LIN.port, "frequencies"),
    **doors(LIN.disk_margin, "frequencies"),
    "singular_values(frequencies=)": lambda value: singular_values(LIN.opened, "torque", value),
    **doors(LIN.step, "index input output duration"),
    **doors(LIN.loop, "index channel"),
    **doors(LIN.system, "index"),
    **doors(LIN.pole_table, "index"),
    **doors(LAG.delay_roots, "count"),
    **doors(TOUCH.quasi_static().departure, "frequencies"),
    "coupling(frequencies=)": lambda value: coupling(LIN, LIN.input_names[:1], LIN.output_names[:1], value),
    **doors(leak, "rows Lambda", rows=np.eye(6)[:1], Lambda=np.eye(6)),
    **doors(DESIGN.max_delay, "upper times horizon n_jobs", LOOP),
    **doors(DESIGN.max_payload, "upper com times horizon", LOOP),
    **doors(DESIGN.min_sample_rate, "lower upper times horizon", LOOP),
    **doors(DESIGN.max_stiffness, "upper times horizon", TOUCH),
    **doors(DESIGN.max_bandwidth, "times lower upper", lambda w: LOOP, ONE, times=[0.0]),
    **doors(DESIGN.over_delay, "delays time horizon", LOOP, delays=[0.1]),
    **doors(DESIGN.impact, "speeds stiffness duration", BOUNCING, speeds=[0.1], duration=0.01),
    **doors(DESIGN.over_stiffness, "stiffness time horizon", TOUCH, stiffness=[1e3]),
    **doors(DESIGN.delay_map, "delays values horizon", lambda v: LOOP, delays=[0.1], values=[1.0]),
    **doors(DESIGN.stiffness_map, "stiffness values horizon", lambda v: TOUCH, stiffness=[1e3], values=[1.0]),
    **doors(
        DESIGN.worst_case,
        "times points horizon",
        lambda payload: LOOP,
        {"payload": (0.0, 1.0)},
        times=[0.0],
        metric="phase_deg",
    ),
    "worst_case(ranges[name])": lambda value: DESIGN.worst_case(lambda payload: LOOP, {"payload": value}, [0.0], metric="phase_deg"),
    **doors(mfc.sweep, "n_jobs", lambda a: a, {"a": [1.0]}, lambda a: a),
    **doors(mfc.report.write, "times", LOOP, "no folder is made", formats=("json",)),
    **doors(exercises.pid, "target_deg kp ki kd velocity_deg duration", target_deg=45.0, kp=50.0),
    **doors(exercises.pid_with_inverse_dynamics, "kp ki kd", target_deg=45.0, kp=50.0),
    **doors(exercises.compare, "kp ki kd pid_gains", target_deg=45.0, kp=50.0),
    **{f"Link({name}=)": (lambda value, name=name: exercises.Link(**{name: value})) for name in ("inertia", "mass", "com_distance", "damping")},
    **doors(exercises.rp_torques, "theta_deg d force"),
    **doors(mfc.testing.assert_validated, "time nrmse order size seed", LOOP),
    **doors(mfc.report.render, "timestamp", mfc.report.document.document.Document("", "", ()), "no folder is made", ("pdf",)),
}  # fmt: skip


NAMES: dict[str, Door] = {
    **doors(ROBOTS.load, "name tool locked", name="ur5"),
    "load_panda(locked=)": lambda value: ROBOTS.load("panda", locked=value),
    **doors(mfc.Robot.from_urdf, "source tool locked joints friction", ROBOTS.catalogue.ur5_urdf()),
    **doors(mfc.Robot.from_pinocchio, "model tool locked joints friction", model=UR5.model, tool="tool0"),
    **doors(UR5.joint_torques, "frame", Q, F),
    **doors(PATHS.from_csv, "path"),
    **doors(mfc.Environment, "axes", 1.0),
    **doors(mfc.Hardware, "feedback servo"),
    **doors(LAWS.by_equation, "number"),
    **doors(LAWS.VelocityPI, "form", kp=1.0, ki=1.0),
    **doors(LAWS.TaskVelocity, "form", kp=1.0),
    **doors(LAWS.ComputedTorque, "form", kp=1.0),
    **doors(LAWS.TaskComputedTorque, "form", kp=1.0),
    **doors(LAWS.HybridMotionForce, "form projection", F, 1.0, constraints=np.eye(6)[:1]),
    **doors(constraints.ConstraintSet, "natural"),
    "ConstraintSet(artificial=)": lambda value: constraints.ConstraintSet(constraints.peg_in_hole().natural, value),
    **doors(mfc.ClosedLoop, "robot law ref controller_model environment hardware", JOINT, LAWS.JointPID(1.0), PATHS.Hold([0.0])),
    **doors(LOOP.linearize, "about coordinates"),
    **doors(LOOP.linearize, "simulation", about="simulation"),
    **doors(LOOP.simulate, "method", [0.0, 0.01]),
    **{f"Linearization.{name}(at=)": changed(getattr(LIN, name), "at") for name in ("margins", "disk_margin", "loop")},
    "frequency_response(at=)": lambda value: LIN.frequency_response([1.0], value),
    **doors(LIN.passivity, "at"),
    "port(at=)": lambda value: LIN.port([1.0], value),
    **doors(LIN.loop, "channel"),
    **doors(LIN.step, "input output"),
    "coupling(inputs=)": lambda value: coupling(LIN, value, LIN.output_names[:1], [1.0]),
    "coupling(outputs=)": lambda value: coupling(LIN, LIN.input_names[:1], value, [1.0]),
    **doors(leak, "projection", np.eye(6)[:1], np.eye(6)),
    **doors(ONE.check, "loop at", LOOP, [0.0]),
    **doors(mfc.Requirements.from_mapping, "asked"),
    **doors(ONE.check(LOOP, [0.0]).line, "name"),
    **doors(DESIGN.impact, "loop", speeds=[0.1]),
    **doors(DESIGN.max_delay, "loop"),
    **doors(DESIGN.over_delay, "loop", delays=[0.1]),
    **doors(DESIGN.over_stiffness, "loop", stiffness=[0.1]),
    **doors(DESIGN.max_bandwidth, "make_loop requirements at", lambda w: LOOP, ONE, [0.0]),
    **doors(DESIGN.worst_case, "build ranges metric at step", lambda payload: LOOP, {"payload": (0.0, 1.0)}, [0.0], metric="phase_deg"),
    **doors(mfc.sweep, "build measure", lambda a: a, {"a": [1.0]}, lambda a: a),
    **doors(GAINS.joint_pid, "robot", q=[0.0], bandwidth=1.0),
    **doors(GAINS.pid, "step", settling_time=1.0),
    **doors(GAINS.force_pi, "step", settling_time=1.0, stiffness=1e3, mass=1.0),
    **doors(mfc.Requirements, "step", settling_time=1.0),
    **doors(GAINS.cartesian_damping, "robot", q=[0.0], stiffness=1.0),
    **doors(GAINS.impedance, "robot", q=[0.0], stiffness=1.0),
    **doors(PATHS.solve_pose, "robot", X=X, q_start=Q),
    **doors(PATHS.follow, "robot tool_ref", UR5, PATHS.ToolHold(X), Q, [0.0]),
    **doors(mfc.study.read, "path"),
    **doors(mfc.report.render, "formats", mfc.report.document.document.Document("", "", ()), "no folder is made", ("json",)),
    **doors(mfc.report.write, "loop requirements at formats", LOOP, "no folder is made", formats=("json",)),
    **doors(mfc.testing.assert_margins, "loop at", LOOP, phase_deg=1.0),
    **doors(mfc.testing.assert_margins, "step", LOOP, settling_time=1.0),
    **doors(mfc.testing.assert_requirements, "requirements", LOOP),
    **doors(exercises.pid, "link", 45.0, 50.0),
}  # fmt: skip


EMPTY = mfc.report.document.document.Document("empty", "", ())
NAMES["render(folder=)"] = lambda value: mfc.report.render(EMPTY, "\0" if isinstance(value, str) else value, ("json",))
NAMES["write(folder=)"] = lambda value: mfc.report.write(LOOP, "\0" if isinstance(value, str) else value, formats=("json",))
BOUNDED = (
    *("single_joint", "slider", "max_delay", "max_stiffness", "max_payload", "min_sample_rate", "max_bandwidth", "over_delay", "over_stiffness"),
    *("delay_map", "stiffness_map", "Link", "Quintic", "ToolLine", "QuasiStatic.departure", "Environment"),
)
#: doors whose errors have another name for the argument
CALLED = {"from_mapping(asked=)": "requirements", "InverseDynamics(outer[kp]=)": "kp", "read(path=)": ""}


def assert_refused(door: str, values: Sequence[Any], doors: Mapping[str, Door]) -> None:
    name = next((called for end, called in CALLED.items() if door.endswith(end)), door.rpartition("(")[2].rstrip("=)").split("[")[0])
    for value in values:
        try:
            doors[door](value)
        except MfcError as why:
            assert isinstance(why, ValueError) and len(str(why)) < 2500
            assert name in str(why).partition(": got")[0], f"{door} does not name {name}: {why}"
        else:
            pytest.fail(f"{door} takes one of type {type(value).__name__}, shape {np.shape(value) if isinstance(value, np.ndarray) else ''}")


@pytest.mark.parametrize("door", NUMBERS)
def test_a_numeric_argument_refuses_what_is_not_real_numbers(door: str) -> None:
    assert_refused(door, NOT_NUMBERS, NUMBERS)


@pytest.mark.parametrize("door", NAMES)
def test_an_argument_that_is_a_name_or_an_object_refuses_everything_else(door: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(door, NOT_NAMES, NAMES)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("value", [1e-300, 9e-10, 1e10, 1e308, -1e-3], ids=str)
@pytest.mark.parametrize("field", ["torque_lag", "velocity_lag", "delay", "force_delay", "sample_time", "force_filter", "velocity_filter"])
def test_times_of_hardware_that_mean_nothing_are_refused(field: str, value: float) -> None:
    with pytest.raises(BadArgument, match=f"hardware.{field}: .*1e-09 to 1e\\+09 s; None or 0 turns it off"):
        mfc.Hardware(**{field: value})
    assert mfc.Hardware(**{field: 0}).ideal and mfc.Hardware(**{field: None}).ideal
    assert getattr(mfc.Hardware(**{field: 1e-9}), field) == 1e-9


@pytest.mark.parametrize("value", [1e308, 1e160, 5e-324])
@pytest.mark.parametrize("door", [door for door in NUMBERS if door.partition("(")[0] in BOUNDED])
def test_extreme_numbers_give_a_result_or_an_error_of_this_package(door: str, value: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MfcWarning)
        try:
            NUMBERS[door](value)
        except MfcError as why:
            assert str(why)
