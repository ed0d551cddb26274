"""A loop as it was given, for its report: block diagram, equations, gains, and robot, model, path, hardware and surfaces in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis import plots
from mfc_analysis.maths.arrays import Array
from mfc_analysis.plots.figure import without_prefix
from mfc_analysis.report.document.document import Block, Callout, Column, Equation, Figure, Section, Table, written
from mfc_analysis.report.loops.view import View
from mfc_analysis.requirements.line import Status

if TYPE_CHECKING:
    from mfc_analysis.laws.gain import Gain
    from mfc_analysis.laws.law import Law


HARDWARE = {
    "torque_lag": ("torque lag", "s"),
    "velocity_lag": ("velocity lag", "s"),
    "delay": ("dead time of the command", "s"),
    "force_delay": ("dead time of the force sensor", "s"),
    "sample_time": ("sample time", "s"),
    "force_filter": ("force filter", "s"),
    "velocity_filter": ("velocity filter", "s"),
    "joint_stiffness": ("joint stiffness", "Nm/rad"),
    "joint_damping": ("joint damping", "Nm s/rad"),
    "motor_inertia": ("motor inertia", "kg m²"),
    "torque_limit": ("torque limit", "Nm"),
    "velocity_limit": ("velocity limit", "rad/s"),
    "force_limit": ("limit of the force sensor", "N, Nm"),
    "force_deadband": ("dead band of the force", "N, Nm"),
}
TURNING = {"N": "N, Nm", "N/m": "N/m, Nm/rad", "Ns/m": "Ns/m, Nm s/rad", "kg": "kg, kg m²"}  #: units along and about the axes of the tool
LONG = 12  #: letters of a name that a block has room for
RULES = {"forward": "forward Euler", "backward": "backward Euler", "tustin": "Tustin"}


def the_loop(view: View) -> Section:
    """Block diagram, equation and parameters."""
    law = view.loop.law
    body: list[Block] = [diagram(view)]
    source = law.typst
    if source:
        body.append(Equation(source, f"control law, {law.numbered()}", law.equation if law.in_chapter() else ""))
    if law.chosen_form != "standard":
        body.append(Callout(Status.WATCH, f"form = {law.chosen_form!r}", "The equation above is the standard form. This loop uses another form."))
    if view.loop.equations.actuator == "torque":
        contact = ' + J_b^top F_"tip"' if view.loop.equations.surfaces else ""
        body.append(Equation(f"M(q) dot.double(q) + h(q, dot(q)){contact} = tau", "equation of motion", "9.19" if contact else "9.7"))
    else:
        servo = view.loop.equations.hardware.servo
        source, words = "dot(q) = u", "the joints follow the commanded velocity"
        if servo is not None:
            source, words = "dot.triple(q) + 2 zeta_s w_s dot.double(q) + w_s^2 dot(q) = w_s^2 u", "the servo of the arm makes the commanded velocity"
        body.append(Equation(source, words))
    body += parameters(view)
    return Section("The loop and its parameters", body=tuple(body))


def diagram(view: View) -> Figure:
    """Block diagram of the loop with its analysis points."""
    law, hardware = view.loop.law, view.loop.equations.hardware
    points = view.lin.opened.points
    name = type(law).__name__
    chain: list[tuple[str, str]] = []
    if "command" in points:
        chain += [
            ("error\nfeedback" if law.in_chapter() else name, "command"),
            ("inverse\ndynamics" if law.plant == "torque" else "inverse\nJacobian", law.plant),
        ]
    else:
        chain.append((_in_two_lines(name) if len(name) > LONG else f"{name}\n({law.numbered()})", law.plant if law.plant in points else ""))
    between = [
        word
        for word, there in (
            ("lag", "lag" in view.loop.equations.parts),
            ("servo", hardware.servo),
            ("dead time", hardware.command_delay),
            ("hold", hardware.sample_time),
        )
        if there
    ]
    if between:
        chain.append(("\n".join(between[:2]), ""))
    chain.append(("arm" if law.plant == "torque" else "joints\nq′ = u", ""))
    if view.loop.equations.surfaces:
        chain.append(("surface", ""))
    back = next((p for p in ("force", "position") if p in points), "")
    wanted = (["X_d"] if law.space == "tool" else []) + (["F_d"] if law.desired_wrench is not None else [])
    reference = ", ".join(wanted) or "q_d"
    output = "q, v" if law.plant == "torque" else "q"
    others = ", ".join(points)
    return Figure(
        partial(plots.block, tuple(chain), reference=reference, output=output, back=back, at=view.point),
        f"The loop of {law.numbered()}. Filled: the analysis point used here (“{view.point}”). Available analysis points: {others}.",
        f"Block diagram of {view.name}: {' to '.join(text.replace(chr(10), ' ') for text, _ in chain)}, opened at {view.point}; available: {others}.",
    )


def _in_two_lines(name: str) -> str:
    """The name of a class in two lines, broken at the capital nearest to its middle: Damped, ForcePI."""
    capitals = [i for i in range(1, len(name)) if name[i].isupper() and name[i - 1].islower()]
    at = min(capitals, key=lambda i: abs(2 * i - len(name)), default=len(name))
    return f"{name[:at]}\n{name[at:]}".rstrip()


def gain_unit(law: Law, name: str, value: ArrayLike) -> str:
    """The unit of a gain, as text: of forces at the tool also that about the axes where the gain acts there, "Ns/m, Nm s/rad"."""
    unit = law.units.get(name, "").replace("^2", "²").replace("^3", "³")
    if unit not in TURNING:
        return unit
    kinds = np.array(("m",) * 3 + ("rad",) * 3 if law.selection is None else law.selection.units)
    a = np.asarray(value, float)
    acts = np.full(kinds.shape, True) if a.size == 1 else (a != 0).reshape(len(a), -1).any(axis=1)
    along, about = (bool((acts & (kinds == kind)).any()) for kind in ("m", "rad")) if acts.shape == kinds.shape else (True, True)
    return TURNING[unit] if along and about else TURNING[unit].split(", ")[1] if about else unit


def parameters(view: View) -> tuple[Block, ...]:
    """Tables of the gains and of robot, model, path, hardware and surfaces."""
    out: list[Block] = []
    law, n = view.loop.law, view.loop.robot.n
    of_joints = law.space == "joint" and law.desired_wrench is None  # the gains of a force law are those of the six directions of the tool
    rows = []
    for name, gain in law.gains().items():
        unit = gain_unit(law, name, 0.0 if gain.array is None else gain.array)
        rows.append((name, unit_words(unit, view.loop.robot.joint_units) if of_joints else unit, gain_words(gain)))
    if rows:
        heads = (
            Column("Gain", numeric=False),
            Column("Unit", numeric=False),
            Column(f"Value ({'per joint' if of_joints and n > 1 else 'scalar, diagonal or matrix'})", numeric=False),
        )
        out.append(Table("Controller gains.", heads, tuple(rows)))
    facts = [("robot", robot_words(view)), ("controller's model", model_words(view)), ("reference", reference_words(view))]
    if law.selection is not None:
        facts.append(("controlled directions", directions_words(law.selection.axes)))
    if law.anti_windup is not None:
        facts.append(("anti-windup", f"back-calculation in {written(float(law.anti_windup), exact=True)} s where a torque saturates"))
    hardware = view.loop.equations.hardware
    for field in fields(hardware):
        given = getattr(hardware, field.name)
        if given is not None and field.name in HARDWARE:
            word, unit = HARDWARE[field.name]
            facts.append((word, f"{array_words(np.asarray(given, float))} {unit_words(unit, view.loop.robot.joint_units)}"))
    if hardware.servo is not None:
        w, z = (array_words(np.asarray(x, float)) for x in (hardware.servo.bandwidth, hardware.servo.damping))
        late = f", dead time {written(hardware.servo.delay, exact=True)} s" if hardware.servo.delay else ""
        facts.append(("servo of the arm", f"second order, bandwidth {w} rad/s (-3 dB), damping {z}{late}"))
    if hardware.elastic:
        facts.append(("encoder of the elastic joints", hardware.feedback))
    if hardware.sample_time:
        facts.append(("integrals of the sampled controller", f"{RULES[hardware.integral_rule]} sums"))
    if hardware.derivative_rule is not None:
        facts.append(("velocity of the sampled controller", f"differences of the encoder over a sample, {RULES[hardware.derivative_rule]} rule"))
    if hardware.ideal:
        facts.append(("hardware", "ideal: no lag, dead time, sampling, filter, flexibility or limit"))
    for k, surface in enumerate(view.loop.equations.surfaces):
        facts.append((f"surface {k + 1}", surface_words(surface)))
    columns = (Column("Item", numeric=False), Column("Value", numeric=False))
    out.append(Table("Robot, model, path and hardware.", columns, tuple(facts)))
    return tuple(out)


def unit_words(unit: str, joints: Sequence[str]) -> str:
    """A unit of turning joints, as it is for these joints ("rad" or "m"); of mixed joints both."""
    sliding = unit.replace("Nm", "N").replace("kg m²", "kg").replace("rad", "m")
    if sliding == unit or "m" not in joints:
        return unit
    return f"{unit} ({sliding} of sliding joints)" if "rad" in joints else sliding


def gain_words(gain: Gain) -> str:
    """A gain as text."""
    return "none" if gain.array is None else array_words(np.asarray(gain.array))


def directions_words(axes: str | Array) -> str:
    """Selected directions of the tool as text."""
    return f"{axes} of the tool frame" if isinstance(axes, str) else f"rows {array_words(axes)} on the twist in the tool frame"


def array_words(a: Array) -> str:
    """A scalar, vector or matrix as text."""
    if a.ndim == 0:
        return written(float(a), exact=True)
    if a.ndim == 1:
        return "(" + ", ".join(written(float(x), exact=True) for x in a) + ")"
    return "; ".join(array_words(row) for row in a)


def robot_words(view: View) -> str:
    """The plant as text."""
    robot = view.loop.robot
    payload = "".join(f", payload {written(float(p.mass), exact=True)} kg at {robot.tool}" for p in robot.payloads)
    prefix = robot.joint_names[0].removesuffix(without_prefix(robot.joint_names)[0])
    said = f"; in full with {prefix} before each" if prefix else ""
    return f"{robot.name}, {robot.n} {'joint' if robot.n == 1 else 'joints'} ({', '.join(robot.joint_names)}{said}), tool {robot.tool}{payload}"


def model_words(view: View) -> str:
    """The controller's model as text: whether it equals the plant, and if not, how they differ."""
    loop = view.loop
    model = loop.equations.model
    if model is loop.robot:
        return "exact (equal to the plant)"
    q = loop.nominal(view.times[:1]).q[0]
    gap = float(np.abs(model.mass(q) - loop.robot.mass(q)).max() / np.abs(loop.robot.mass(q)).max())
    payload = sum(float(p.mass) for p in loop.robot.payloads) - sum(float(p.mass) for p in model.payloads)
    said = f"{model.name}, without {written(payload, exact=True)} kg of the plant's payload; " if abs(payload) > 1e-12 else f"{model.name}; "
    return (
        said + f"its inertia differs from the plant's by up to {written(100 * gap)} % of the largest entry (t ="
        f" {written(float(view.times[0]), exact=True)} s)"
    )


def reference_words(view: View) -> str:
    """The reference as text."""
    ref = view.loop.ref
    kind = type(ref).__name__
    span = (
        f", {written(float(ref.duration), exact=True)} s"
        if ref.duration
        else f", period {written(float(ref.period), exact=True)} s"
        if ref.period
        else ""
    )
    if ref.is_hold:
        return f"{kind} (at rest)"
    speed = float(np.abs(view.loop.nominal(view.times).v).max())
    units = sorted(set(view.loop.robot.joint_units))
    return f"{kind}{span}; fastest joint {written(speed)} {' or '.join(u + '/s' for u in units)}"


def surface_words(surface: Any) -> str:
    """A surface as text."""
    k, d = (array_words(np.asarray(x, float)) if np.ndim(x) < 2 else "a 6 × 6 matrix" for x in (surface.stiffness, surface.damping))
    preload = np.asarray(surface.preload, float)
    pressed = f", preload {array_words(preload)} N" if preload.any() else ""
    return f"stiffness {k} N/m, damping {d} N s/m, axes {surface.axes}{pressed}, {'one-sided in simulation' if surface.one_sided else 'two-sided'}"
