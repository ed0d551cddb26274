"""The equations of the whole loop: plant, law, hardware and contact, for both simulation (plain arrays) and linearisation (dual arrays).

Every analysis point is a wire that can be cut (``Wires``). The loop is::

                     reference (q_d, v_d, a_d) or (X_d, V_d, V_d')
                                  |
                                  v
        +---------------------- law (controller's model) ----------------------+
        |   states z, z_f, outer          "command" is cut inside the law,     |
        |                                 after the outer loop: a_q, V' or V_b |
        +--^-----------^--------------------------------^----------------------+
           |           |                                |               | tau (or u)
     filter of v   encoder q, v             dead band, limit, filter    x  "torque" ("velocity")
           |           |                        of F_tip                |  dead time of the actuators
           +-- "rate"  x  "position"                    x  "force"      v
                       |                      dead time of the sensor  limit -> lag -> [elastic joint] (lag -> servo)
                       |                                |               |
                       |                                |               v
                       +-------- q, v ---------- plant: M q'' + h + friction + J^T F_tip = tau + disturbance (q' = u + disturbance)
                                                        |               ^
                                                        +--- F_tip ---- surfaces (contact)

States, in this order: q, v (torque plants), theta, omega (elastic joints), the law's own (z, z_f, outer, w), filters, actuator lag, servo.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mfc_analysis.dynamics.actuators import ACTUATOR_SLOTS, Actuators
from mfc_analysis.dynamics.coded import difference, summed
from mfc_analysis.dynamics.environment import Contact, Environment, LoseContact, contact
from mfc_analysis.dynamics.flow import NO_INPUTS, Flow, Inputs, Wires, uncut
from mfc_analysis.dynamics.hardware import Hardware, JointHardware
from mfc_analysis.errors import MfcWarning, NearPi, NearSingular, NotConverged
from mfc_analysis.laws.law import WRENCH, Action, JointReference, Law, Measured, Slot, Tap, ToolReference
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, Vector, concatenate, times, value
from mfc_analysis.maths.se3 import Pose, exp6
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.robot import Robot
from mfc_analysis.robots.singularity import WARN_CONDITION, nearest_singular
from mfc_analysis.robots.tool_task import selected_task, task_singular_values

#: slots of the plant; the others belong to the controller
PLANT_SLOTS = ("q", "v", "theta", "omega", *ACTUATOR_SLOTS)
NO_WRENCH = np.zeros(6)  #: F_d under a law without a force reference


@contextmanager
def timed(t: float | Array) -> Iterator[None]:
    """Adds the time to NearSingular, NearPi and numpy's LinAlgError raised inside: t [s], one for each point or one for all."""
    try:
        yield
    except (NearSingular, NearPi, np.linalg.LinAlgError) as why:
        raise at_time(why, t) from None


def at_time(why: NearSingular | NearPi | np.linalg.LinAlgError, t: float | Array) -> NearSingular | NearPi | NotConverged:
    """The error with the time of its point: t [s], one for each point or one for all. numpy's is that of a state far away, or of a user's law."""
    times = np.ravel(t)
    if isinstance(why, np.linalg.LinAlgError):
        return NotConverged(f"the loop cannot be evaluated at t = {float(times[0]):.4g} s: {why}")
    return why.at(float(times[why.index]) if why.index < times.size else None)


class Part(NamedTuple):
    """Position of a slot in the state."""

    where: slice
    slot: Slot


@dataclass(frozen=True, eq=False)
class Equations:
    """A robot, a law with its model, a reference, surfaces and hardware, as one system of differential equations."""

    robot: Robot
    model: Robot  #: the controller's model
    law: Law
    reference_source: Any  #: a reference of ``trajectories``
    surfaces: Sequence[Environment]
    hardware: Hardware
    q_start: Array | None = None  #: (n,) joint position from which a tool reference is followed
    plant: Primitives = field(init=False)
    controller: Primitives = field(init=False)
    joints: JointHardware = field(init=False)
    actuators: Actuators = field(init=False)
    parts: Mapping[str, Part] = field(init=False)
    _where: tuple[tuple[str, slice], ...] = field(init=False, repr=False)
    _still: Array = field(init=False, repr=False)  #: (n,) zeros
    state_names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "plant", Primitives(self.robot))
        set_(self, "controller", Primitives(self.model, self.plant) if self.model is not self.robot else self.plant)
        set_(self, "joints", self.hardware.for_joints(self.n))
        set_(self, "actuators", Actuators.of(self.law.plant, self.hardware, self.joints))
        parts, names, start = {}, [], 0
        for slot in self._slots():
            parts[slot.name] = Part(slice(start, start + len(slot.channels)), slot)
            names += [f"{slot.name}_{channel}" for channel in slot.channels]
            start += len(slot.channels)
        set_(self, "parts", parts)
        set_(self, "_where", tuple((name, where) for name, (where, _) in parts.items()))
        set_(self, "state_names", tuple(names))
        set_(self, "_still", np.zeros(self.n))

    # --- the layout ----------------------------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.state_names)

    @property
    def actuator(self) -> str:
        """The wire of the plant's input: "torque" or "velocity"."""
        return self.law.plant

    @property
    def sample_time(self) -> float:
        """[s] of the law; 0 in continuous time."""
        return float(self.hardware.sample_time or 0.0)

    @property
    def delays(self) -> dict[str, float]:
        """[s] dead time of each wire that has one."""
        late = {self.actuator: self.actuators.delay, "force": self.hardware.force_delay}
        return {name: float(delay) for name, delay in late.items() if delay}

    @property
    def delayed(self) -> bool:
        """True where the loop has dead time and no sample time: infinitely many roots."""
        return bool(self.delays) and not self.sample_time

    def _slots(self) -> list[Slot]:
        joints, hardware = self.robot.joint_names, self.hardware
        torque = self.actuator == "torque"
        out = [Slot("q", joints, False)]
        if torque:
            out.append(Slot("v", joints, False))
        if torque and self.joints.springs is not None:
            out += [Slot("theta", joints, False), Slot("omega", joints, False)]
        out += self.law.slots(joints)
        differs = hardware.derivative_rule is not None
        if torque and differs:
            out.append(Slot("q_before", joints, False, stepped=True))
        if torque and self.joints.velocity_filter is not None:
            out.append(Slot("v_filter", joints, False, stepped=differs))
        if self.law.senses_force and hardware.force_filter is not None:
            out.append(Slot("F_filter", WRENCH, False))
        return [*out, *self.actuators.slots(joints)]

    @property
    def integrals(self) -> tuple[int, ...]:
        """Indices of the states that are integrals of an error."""
        return tuple(i for where, slot in self.parts.values() if slot.integral for i in range(where.start, where.stop))

    @property
    def plant_states(self) -> tuple[int, ...]:
        """Indices of the plant's states."""
        return tuple(i for name, (where, _) in self.parts.items() if name in PLANT_SLOTS for i in range(where.start, where.stop))

    @property
    def stepped(self) -> tuple[int, ...]:
        """Indices of the states of sampled code: x + T x' at the next sample."""
        return tuple(i for where, slot in self.parts.values() if slot.stepped for i in range(where.start, where.stop))

    @cached_property
    def start(self) -> Array:
        """(nx,) the joints at the start of the reference, every other state 0."""
        x = np.zeros(self.nx)
        q = self.q_start if self.reference_source.space == "tool" else self.reference_source(0.0).q
        for name in ("q", "theta"):
            if name in self.parts:
                x[self.parts[name].where] = q
        return x

    @cached_property
    def _own_wires(self) -> dict[str, int]:
        """Analysis points of a user's law that no other law has, and their numbers of channels."""
        names = [point for point in self.law.opens_at if point not in (self.actuator, "command", "position", "force")]
        if not names:
            return {}
        wires = Wires()
        self.flow(0.0, self.start, wires)
        return {name: value(wires.recorded[name]).shape[-1] for name in names}

    def wire_channels(self, name: str) -> tuple[str, ...]:
        """Names of the channels of a wire."""
        joints = self.robot.joint_names
        if name in self._own_wires:
            size = self._own_wires[name]
            return joints if size == self.n else tuple(f"{name}_{i + 1}" for i in range(size))
        return {"command": self.law.command_channels(joints), "force": WRENCH}.get(name, joints)

    def wire_sizes(self) -> dict[str, int]:
        """The wires of this loop and their numbers of channels."""
        law, n = self.law, self.n
        sizes = {self.actuator: n}
        if "command" in law.opens_at:
            sizes["command"] = len(law.command_channels(self.robot.joint_names))
        sizes |= self._own_wires
        sizes["position"] = n
        if self.actuator == "torque" and self.hardware.derivative_rule is None:
            sizes["rate"] = n
        if law.senses_force:
            sizes["force"] = 6
        return sizes

    def split(self, x: Vector) -> dict[str, Vector]:
        """The state by slots."""
        if isinstance(x, Dual):
            return {name: x[where] for name, (where, _) in self.parts.items()}
        plain = value(x)
        return {name: plain[..., where] for name, (where, _) in self.parts.items()}

    def join(self, slots: Mapping[str, Vector]) -> Array | Dual:
        """The slots as one state."""
        return concatenate([slots[name] for name in self.parts])

    def state_rates(self, slots: Mapping[str, Any], lead: tuple[int, ...] = ()) -> Array:
        """x' (*lead, nx) for plain arrays, where only some of the slots have rates; the others have none."""
        out = np.zeros((*lead, self.nx))
        for name, rate in slots.items():
            out[..., self.parts[name].where] = rate
        return out

    # --- the reference -------------------------------------------------------------------------------------------

    def reference(self, t: float | Array, inputs: Inputs | None = None) -> JointReference | ToolReference:
        """The reference at t [s], for joint or tool laws; for a tool law a joint reference gives the motion of its tool."""
        shift, F_d = (None, None) if inputs is None else (inputs.reference, inputs.F_d)
        if F_d is None:
            F_d = NO_WRENCH if self.law.desired_wrench is None else self.law.desired_wrench
        point = self.reference_source(t)
        if self.reference_source.space == "tool":
            return ToolReference(_shifted(Pose.of(np.asarray(point.X)), shift), point.V, point.dV, F_d)
        if self.law.space == "joint":
            return JointReference(point.q if shift is None else point.q + shift, point.v, point.a, F_d)
        q, v, a = (np.asarray(x) for x in point)
        X = self.plant.pose(q)
        V, dV = self.plant.jacobian(q, v), self.plant.jacobian(q, a) + self.plant.jacobian_dot(q, v)
        return ToolReference(_shifted(X, shift), V, dV, F_d)

    # --- the loop ------------------------------------------------------------------------------------------------

    def flow(
        self, t: float | Array, x: Vector, wires: Wires | None = None, inputs: Inputs | None = None, *, lose_contact: LoseContact = False
    ) -> Flow:
        """Rates and signals of the loop at state x (..., nx) and time t (...,), plain or dual; wires may be cut.

        Raises NearSingular and NearPi with the time.
        """
        try:
            return self._flow(t, self.split(x), wires, NO_INPUTS if inputs is None else inputs, lose_contact)
        except (NearSingular, NearPi, np.linalg.LinAlgError) as why:
            raise at_time(why, t) from None

    def _flow(self, t: float | Array, s: dict[str, Vector], wires: Wires | None, inputs: Inputs, lose_contact: LoseContact) -> Flow:
        touched = self.touch(s, lose_contact=lose_contact)
        action, rates = self.control(t, s, touched.wrench, wires or uncut, inputs)
        command = action.command
        if self.law.needs_acceleration:
            command = self._with_measured_acceleration(t, s, command, touched.wrench, inputs, wires or Wires())
        elif wires is not None:
            command = wires(self.actuator, command)
        rates.update(self.move(s, command, touched.wrench, inputs.disturbance))
        return Flow(rates, action.error, command, touched.wrench, touched)

    def touch(self, s: Mapping[str, Vector], *, lose_contact: LoseContact = False) -> Contact:
        """The tool's wrench on the surfaces. Their dampers feel the velocity that the drives of a velocity law give, without its disturbance."""
        if not self.surfaces:
            return Contact(np.zeros((*value(s["q"]).shape[:-1], 6)), (), ())
        v = s["v"] if "v" in s else self.actuators.output(s)
        return contact(self.surfaces, self.plant, s["q"], self._still if v is None else v, lose_contact=lose_contact)

    def control(
        self, t: float | Array, s: Mapping[str, Vector], F: Vector, wires: Tap, inputs: Inputs, *, unwind: bool = True
    ) -> tuple[Action, dict[str, Vector]]:
        """Sensors, filters and the law: its action, and the rates of the controller's states (without those of anti-windup unless ``unwind``)."""
        ref = self.reference(t, inputs)
        rates: dict[str, Vector] = {}
        joints, hardware = self.joints, self.hardware
        motor = joints.springs is not None and joints.springs.motor_encoder
        q = wires("position", s["theta"] if motor else s["q"])
        v: Vector = self._still
        if hardware.derivative_rule is not None:
            v, differences = difference(s, q, self.sample_time, hardware.derivative_rule, joints.velocity_filter)
            rates.update(differences)
        elif self.law.plant == "torque":
            v = wires("rate", s["omega"] if motor else s["v"])
            if joints.velocity_filter is not None:
                rates["v_filter"] = (v - s["v_filter"]) * (1 / joints.velocity_filter)
                v = s["v_filter"]
        measured: Vector = NO_WRENCH
        if self.law.senses_force:
            measured = wires("force", F)
            if hardware.force_filter is not None:
                rates["F_filter"] = (measured - s["F_filter"]) * (1 / float(hardware.force_filter))
                measured = s["F_filter"]
            measured = joints.sensed(measured)
        now = Measured(q, v, measured, s)
        action = self.law.act(self.controller, now, ref, wires)
        if hardware.integral_rule != "forward" and self.integrals:
            names = tuple(name for name, (_, slot) in self.parts.items() if slot.integral)
            now = Measured(q, v, measured, summed(s, action.rates, names, self.sample_time, hardware.integral_rule))
            action = self.law.act(self.controller, now, ref, wires)
        rates.update(action.rates)
        if unwind and self.law.anti_windup is not None and joints.torque_limit is not None:
            lost = self.actuators.limited(action.command) - action.command
            rates["z"] = rates["z"] + self.law.unwinding(self.controller, now, ref, lost)
        return action, rates

    def move(self, s: Mapping[str, Vector], command: Vector, F: Vector, disturbance: Vector | None) -> dict[str, Vector]:
        """The plant: rates of its states under the commanded torque (velocity) that arrives at the joints."""
        drive, rates = self.actuators.drive(s, command)
        springs = self.joints.springs
        if self.law.plant == "velocity":
            rates["q"] = drive if disturbance is None else drive + disturbance
            return rates
        if springs is not None:
            spring = self._spring(s)
            rates["theta"] = s["omega"]
            rates["omega"] = (drive - spring) * (1 / springs.motor_inertia)
            drive = spring
        rates["q"] = s["v"]
        rates["v"] = self.plant.aba(s["q"], s["v"], self._net(s, drive, F, disturbance))
        return rates

    def _spring(self, s: Mapping[str, Vector]) -> Vector:
        """Torque of the elastic joints on the links."""
        springs = self.joints.springs
        assert springs is not None
        return (s["theta"] - s["q"]) * springs.stiffness + (s["omega"] - s["v"]) * springs.damping

    def _net(self, s: Mapping[str, Vector], drive: Vector, F: Vector, disturbance: Vector | None) -> Vector:
        """Net torque M q'' + C v + g: drive + disturbance - friction - J^T F_tip."""
        net = drive if disturbance is None else drive + disturbance
        if self.plant.rubs:
            net = net - self.plant.friction(s["v"])
        if self.surfaces:
            net = net - self.plant.jacobian_transpose(s["q"], F)
        return net

    def _with_measured_acceleration(
        self, t: float | Array, s: Mapping[str, Vector], command: Vector, F: Vector, inputs: Inputs, wires: Wires
    ) -> Vector:
        """tau = command - E a, E a the law's ``acceleration_torque``, with the acceleration a of the joint, or of the motor that has the encoder,
        under this same torque tau.
        """
        law, ref, springs = self.law, self.reference(t, inputs), self.joints.springs
        disturbance = inputs.disturbance
        assert isinstance(ref, JointReference)
        spring = None if springs is None else self._spring(s)
        link = springs is not None and not springs.motor_encoder  # its acceleration is that of the spring, whatever tau
        if link or "lag" in s or wires.cuts("torque"):
            drive = spring if link else s["lag"] if "lag" in s else wires.inputs["torque"]
            assert drive is not None
            a: Vector
            if springs is None or link:
                a = self.plant.aba(s["q"], s["v"], self._net(s, drive, F, disturbance))
            else:
                assert spring is not None
                a = (drive - spring) * (1 / springs.motor_inertia)
            return wires("torque", command - law.acceleration_torque(self.controller, ref, a))
        if isinstance(s["q"], Dual):
            raise TypeError("a law that needs the acceleration is linearised with its torque wire cut")
        rest: Vector
        if springs is None:
            rest = self._net(s, command, F, disturbance) - self.plant.rnea(s["q"], s["v"], np.zeros(self.n))
            inertia = self.plant.at(value(s["q"])).M
        else:
            assert spring is not None
            rest, inertia = value(command) - value(spring), np.diag(springs.motor_inertia)
        E = np.stack([value(law.acceleration_torque(self.controller, ref, one)) for one in np.eye(self.n)], axis=-1)
        a = np.asarray(np.linalg.solve(inertia + E, value(rest)[..., None])[..., 0], float)
        return command - law.acceleration_torque(self.controller, ref, a)

    def signals(self, t: float | Array, x: Vector, inputs: Inputs, *, lose_contact: LoseContact = False) -> Flow:
        """``flow`` without the rates of a torque plant, which no signal needs."""
        if self.actuator == "velocity" or self.law.needs_acceleration:
            return self.flow(t, x, None, inputs, lose_contact=lose_contact)
        with timed(t):
            s = self.split(x)
            touched = self.touch(s, lose_contact=lose_contact)
            action, rates = self.control(t, s, touched.wrench, Wires(), inputs)
            return Flow(rates, action.error, action.command, touched.wrench, touched)

    # --- for plain arrays ----------------------------------------------------------------------------------------

    def rates(self, t: float | Array, x: Array, disturbance: Array | None = None, *, lose_contact: LoseContact = False) -> Array:
        """x' (..., nx) for plain arrays, as a simulation integrates it (no dead time, no sampling)."""
        s = {name: x[..., where] for name, where in self._where}
        try:
            F = self.touch(s, lose_contact=lose_contact).wrench if self.surfaces else NO_WRENCH
            action, rates = self.control(t, s, F, uncut, NO_INPUTS)
            command = action.command
            if self.law.needs_acceleration:
                command = self._with_measured_acceleration(t, s, command, F, Inputs(disturbance=disturbance), Wires())
            rates.update(self.move(s, command, F, disturbance))
        except (NearSingular, NearPi, np.linalg.LinAlgError) as why:
            raise at_time(why, t) from None
        if x.ndim > 1:
            return self.state_rates(rates, x.shape[:-1])
        out: Array = np.empty(x.shape)
        plain: dict[str, Any] = rates
        for name, where in self._where:
            out[where] = plain[name]
        return out


def _shifted(X: Pose, shift: Vector | None) -> Pose:
    """X exp(shift), the shift a body twist (..., 6); a dual one is zero, with its tangent."""
    if shift is None:
        return X
    if isinstance(shift, Dual):
        return Pose(X.R, X.p, shift.tangent)
    return X @ Pose.of(exp6(value(shift)))


def warn_near_singular(equations: Equations, times: Array, q: Array) -> None:
    """Warns where a tool law that inverts J without damping is near a singularity: at times (m,) [s] and joint positions q (m, n)."""
    if equations.law.space == "tool" and not equations.law.inverse_damping:
        sigma = task_singular_values(equations.law.selection, equations.plant, q)
        found = nearest_singular(equations.robot.tool, sigma)
        if found.condition > WARN_CONDITION:
            warnings.warn(str(found.at(float(times[found.index]))), MfcWarning, stacklevel=3)


def reference_channels(equations: Equations) -> tuple[str, ...]:
    """Names of the reference's input channels: q_d of each joint, or X_d along the axes (selected directions) of the reference tool frame."""
    return tuple(f"{'X' if equations.law.space == 'tool' else 'q'}_d_{c}" for c in equations.law.error_channels(equations.robot.joint_names))


def reference_moves(equations: Equations, times: Array, x: Array) -> Array:
    """(..., r, k) what a unit of each of the k reference channels adds to the reference: to q_d (r = n), or the body twist of X_d (r = 6).

    A selection moves X_d so that the error seen from x (..., nx) moves along one direction at a time.
    """
    law = equations.law
    if law.space == "joint":
        return np.broadcast_to(np.eye(equations.n), (len(times), equations.n, equations.n))
    if law.selection is None:
        return np.broadcast_to(np.eye(6), (len(times), 6, 6))
    ref = equations.reference(times)
    assert isinstance(ref, ToolReference)
    q = np.ascontiguousarray(x[:, equations.parts["q"].where])
    return selected_task(law.selection, equations.plant, q, ref.X, ref.V, ref.dV).reference_twists()


def solve_command_for_slots(jacobian: Array, gap: Array) -> Array:
    """Smallest-norm least-squares states z (..., k) with jacobian (..., n, k) z = gap (..., n)."""
    if jacobian.shape[-1] == jacobian.shape[-2]:
        try:
            inverse = np.asarray(np.linalg.inv(jacobian), float)
        except np.linalg.LinAlgError:
            pass
        else:
            with np.errstate(invalid="ignore", over="ignore"):  # of a gain of 1e-310
                size = np.linalg.norm(jacobian, axis=(-2, -1)) * np.linalg.norm(inverse, axis=(-2, -1))
            if np.all(size < 1e7):
                return times(inverse, gap)
    return times(np.asarray(np.linalg.pinv(jacobian, rcond=1e-10), float), gap)
