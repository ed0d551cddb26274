"""A robot arm as a value: its dynamics (by Pinocchio), tool and friction. The base is fixed; every joint has one degree of freedom.

Angles are plain numbers, also for continuous joints (not Pinocchio's cosine and sine). Twists and wrenches are (linear, angular) in the
tool frame at the tool origin. ``q``, ``v`` may have any leading axes: ``(..., n)`` in, ``(..., n, n)`` and so on out.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from mfc_analysis.errors import BadArgument, BadRobot
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots import build
from mfc_analysis.robots.limits import Limits, limits_of
from mfc_analysis.robots.mjcf import checked_mjcf
from mfc_analysis.robots.singularity import check_regular
from mfc_analysis.robots.urdf import Urdf, checked_urdf, read_urdf

Friction = Literal["urdf", "none"]

COULOMB_SPEED = 1e-2  #: [rad/s or m/s] width of the sign change of friction, tanh(v / COULOMB_SPEED)
STANDARD_GRAVITY = (0.0, 0.0, -9.81)  #: [m/s^2]

_workspaces = threading.local()


@dataclass(frozen=True, eq=False)
class Payload:
    """A body added at the tool: mass [kg], com (3,) [m] and inertia (3, 3) [kg m^2] about the com, in tool axes."""

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A fixed-base arm. Created by :meth:`from_urdf`, :meth:`from_mjcf`, :meth:`from_pinocchio` or the catalogue; ``with_...`` return changed copies.

    The friction of the plant is ``viscous * v + coulomb * tanh(v / coulomb_speed)`` on each joint; mass, gravity and bias leave it out.
    In its methods ``q`` and ``v`` (..., n) are angles [rad or m] and velocities of the joints, in the order of ``joint_names``.
    """

    name: str  #: in reports
    model: pin.Model  #: a private copy; joints in Pinocchio's order
    tool: str  #: name of the tool frame
    frame_id: int  #: of the tool, in ``model.frames``
    order: NDArray[np.intp]  #: (n,) Pinocchio's velocity index of each joint in the user's order
    viscous: Array  #: (n,) [Nm s/rad or N s/m]
    coulomb: Array  #: (n,) [Nm or N]
    coulomb_speed: float = COULOMB_SPEED  #: [rad/s or m/s]
    payloads: tuple[Payload, ...] = field(default=())  #: already included in ``model``
    origin: tuple[str, dict[str, Any]] | None = None  #: file and arguments of :meth:`from_urdf` (:meth:`from_mjcf`), if made from a file; for replays

    # --- constructors ----------------------------------------------------------------------------------------------------

    @classmethod
    def from_urdf(
        cls,
        source: str | os.PathLike[str],
        tool: str | None = None,
        locked: build.Locked = None,
        joints: Sequence[str] | None = None,
        friction: Friction = "urdf",
        gravity: ArrayLike = STANDARD_GRAVITY,
    ) -> Robot:
        """A robot from a URDF: a path or the XML text. Meshes are never opened.

        Args:
            source: the path, or the text. tool: a link or frame name (where a link and a joint share it, the link); None: the last link, if unique.
            locked: joints to lock: names (locked at 0) or ``{name: value}`` [rad or m].
            joints: the order of ``q``; None: the order of the model.
            friction: "urdf": joint damping is the viscous friction of the plant; "none": no friction. Coulomb ``friction`` is not read.
            gravity: (3,) [m/s^2] in base axes.

        Warns (``MfcWarning``) of a link whose principal moments of inertia no body has. Raises ``BadRobot`` (not XML, no mass, an invalid number,
        mimic or floating joints), ``UnknownName`` (tool, locked, joints), ``BadArgument``.
        """
        urdf = checked_urdf(read_urdf(source))
        try:
            model = pin.buildModelFromXML(urdf.text)
        except (ValueError, RuntimeError) as why:
            raise BadRobot("Pinocchio cannot build a model from the links and joints of this URDF") from why
        robot = cls._from_model(model, tool, locked, joints, friction, gravity, urdf)
        if isinstance(source, str) and "<" in source:
            return robot
        given = {"tool": tool, "locked": locked, "joints": joints, "friction": friction, "gravity": tuple(np.asarray(gravity, float).tolist())}
        return replace(robot, origin=(os.fspath(source), given))

    @classmethod
    def from_mjcf(
        cls,
        source: str | os.PathLike[str],
        tool: str | None = None,
        locked: build.Locked = None,
        joints: Sequence[str] | None = None,
        friction: Literal["mjcf", "none"] = "mjcf",
        gravity: ArrayLike | None = None,
    ) -> Robot:
        """A robot from an MJCF (MuJoCo XML): a path or the XML text. Meshes are never opened: a body whose mass is that of a mesh is refused.

        Arguments as :meth:`from_urdf`; a tool may be a site as well. ``friction="mjcf"``: joint damping is the viscous friction of the plant;
        frictionloss is not read. Joint armature is read. Torque limits are those of ``actuatorfrcrange``, else the forcerange (of a motor the
        ctrlrange) of the joint's actuators times their gear. ``gravity=None``: that of the file.

        Warns (``MfcWarning``) of springs, tendons, equality constraints and gravity compensation, which are not read. Raises ``BadRobot`` (not
        XML, no mass, several robots, joints with several degrees of freedom, what Pinocchio reads differently from MuJoCo), ``UnknownName``,
        ``BadArgument``.
        """
        checks.choice("friction", friction, ("mjcf", "none"))
        mjcf = checked_mjcf(source)
        robot = cls._from_model(
            build.model_of_mjcf(mjcf.text, mjcf.name), tool, locked, joints, "urdf" if friction == "mjcf" else "none",
            mjcf.gravity if gravity is None else gravity,
        )  # fmt: skip
        if isinstance(source, str) and "<" in source:
            return robot
        own = None if gravity is None else tuple(np.asarray(gravity, float).tolist())
        given = {"tool": tool, "locked": locked, "joints": joints, "friction": friction, "gravity": own}
        return replace(robot, origin=(os.fspath(source), given))

    @classmethod
    def from_pinocchio(
        cls,
        model: pin.Model,
        tool: str | None = None,
        locked: build.Locked = None,
        joints: Sequence[str] | None = None,
        friction: Friction = "urdf",
        gravity: ArrayLike | None = None,
    ) -> Robot:
        """A robot from a copy of a Pinocchio model. Arguments as :meth:`from_urdf`; ``gravity=None`` keeps that of the model."""
        if not isinstance(model, pin.Model):
            raise BadArgument("model", type(model).__name__, "a pinocchio.Model")
        return cls._from_model(model, tool, locked, joints, friction, model.gravity.linear if gravity is None else gravity)

    @classmethod
    def _from_model(
        cls,
        model: pin.Model,
        tool: str | None,
        locked: build.Locked,
        joints: Sequence[str] | None,
        friction: str,
        gravity: ArrayLike,
        urdf: Urdf | None = None,
    ) -> Robot:
        checks.choice("friction", friction, ("urdf", "none"))
        gravity = checks.array("gravity", gravity, (3,))
        whole, model = model, build.lock(model, locked)
        model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
        build.check_joints(model, urdf.mimic if urdf else ())
        order = build.joint_order(model, joints)
        if tool is not None and not isinstance(tool, str):
            raise BadArgument("tool", tool, "the name of a link or frame")
        tool = build.default_tool(whole, model) if tool is None else tool
        fid = build.frame_id(model, tool)
        if model.frames[fid].parentJoint == 0:
            raise BadArgument("tool", tool, "a link that some joint moves")
        limits_of(model, order)
        if urdf:
            build.check_inertias(model, urdf.inertias)
        build.check_masses(model)
        viscous = model.damping[order] if friction == "urdf" else np.zeros(model.nv)
        viscous = checks.per_joint("friction", viscous, model.nv, low=0.0)
        return cls(model.name, model, tool, fid, order, viscous, checks.per_joint("coulomb", 0.0, model.nv))

    # --- properties ------------------------------------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(n,) names, in the order of ``q``."""
        by_index = {j.idx_v: name for j, name in zip(list(self.model.joints)[1:], self.model.names[1:], strict=True)}
        return tuple(by_index[int(i)] for i in self.order)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """(n,) "rad" for a revolute or continuous joint, "m" for a prismatic one."""
        kinds = ["m" if "JointModelP" in j.shortname() else "rad" for j in list(self.model.joints)[1:]]
        return tuple(kinds[i] for i in self.order)

    @property
    def limits(self) -> Limits:
        """Position, velocity and torque limits, in the order of ``q``; ``inf`` where there is none."""
        return limits_of(self.model, self.order)

    @property
    def total_mass(self) -> float:
        """Mass of all moving bodies [kg], payload included."""
        return float(sum(body.mass for body in list(self.model.inertias)[1:]))

    @property
    def armature(self) -> Array:
        """(n,) rotor inertia reflected to each joint [kg m^2 or kg]."""
        return checks.per_joint("armature", self.model.armature[self.order], self.n)

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, n={self.n}, tool={self.tool!r})"

    def __str__(self) -> str:
        joints = f"{self.n} joint{'s' if self.n > 1 else ''} ({', '.join(self.joint_names)})"
        parts = [f"{self.name}: {joints}", f"tool {self.tool}", f"{self.total_mass:.4g} kg moved"]
        if self.payloads:
            parts.append(f"of which payload {sum(p.mass for p in self.payloads):.4g} kg")
        if np.any(self.viscous):
            parts.append(f"viscous friction {_in_words(self.viscous)}")
        if np.any(self.coulomb):
            parts.append(f"Coulomb friction {_in_words(self.coulomb)} (tanh at {self.coulomb_speed:g})")
        if np.any(self.armature):
            parts.append(f"armature {_in_words(self.armature)}")
        return ", ".join(parts)

    # --- changed copies --------------------------------------------------------------------------------------------------

    def with_payload(self, mass: float, com: ArrayLike = (0.0, 0.0, 0.0), inertia: ArrayLike = 0.0) -> Robot:
        """The robot with a body fixed to its tool; payloads add up.

        Args:
            mass: [kg] >= 0. com: (3,) [m] in the tool frame. inertia: scalar or (3, 3) [kg m^2] about the com, in tool axes.
        """
        mass = checks.number("mass", mass, low=0.0)
        com = checks.array("com", com, (3,))
        I = build.rotational_inertia(inertia)
        frame = self.model.frames[self.frame_id]
        model = pin.Model(self.model)
        added = frame.placement.act(build.body(mass, com, I))
        model.inertias[frame.parentJoint] += added
        if not np.isfinite(model.inertias[frame.parentJoint].matrix()).all():
            raise BadArgument("mass, com, inertia", (mass, com, I), "a body whose inertia at the joint is a finite number")
        return replace(self, model=model, payloads=(*self.payloads, Payload(mass, com, I)))

    def with_payloads_scaled(self, factor: float) -> Robot:
        """The robot with the masses and inertias of the bodies that ``with_payload`` added multiplied by ``factor`` >= 0; 0: without them."""
        factor = checks.number("factor", factor, low=0.0)
        model = pin.Model(self.model)
        frame = model.frames[self.frame_id]
        held = np.zeros((6, 6))
        for p in self.payloads:
            held += frame.placement.act(build.body(p.mass, p.com, p.inertia)).matrix()
        model.inertias[frame.parentJoint] = build.reduced(model.inertias[frame.parentJoint], held)
        robot = replace(self, model=model, payloads=())
        for p in self.payloads if factor else ():
            robot = robot.with_payload(factor * p.mass, p.com, factor * p.inertia)
        return robot

    def with_friction(self, viscous: ArrayLike | None = None, coulomb: ArrayLike = 0.0, coulomb_speed: float = COULOMB_SPEED) -> Robot:
        """The robot with this joint friction in place of its own.

        Args:
            viscous: scalar or (n,) [Nm s/rad or N s/m] >= 0; None keeps the present one.
            coulomb: scalar or (n,) [Nm or N] >= 0, smoothed as ``coulomb * tanh(v / coulomb_speed)``.
            coulomb_speed: [rad/s or m/s] > 0.
        """
        new = self.viscous if viscous is None else checks.per_joint("viscous", viscous, self.n, low=0.0)
        speed = checks.number("coulomb_speed", coulomb_speed, low=0.0, strict=True)
        return replace(self, viscous=new, coulomb=checks.per_joint("coulomb", coulomb, self.n, low=0.0), coulomb_speed=speed)

    def with_armature(self, armature: ArrayLike) -> Robot:
        """The robot with this ``armature`` in place of its own: rotor inertia times gear ratio squared, scalar or (n,) [kg m^2 or kg] >= 0."""
        values = checks.per_joint("armature", armature, self.n, low=0.0)
        model = pin.Model(self.model)
        ours = np.zeros(self.n)
        ours[self.order] = values
        model.armature = ours
        return replace(self, model=model)

    def with_inertia_scaled(self, factor: float) -> Robot:
        """The robot with every mass and inertia multiplied by ``factor`` > 0, armature included: M, h and g scale exactly."""
        factor = checks.number("factor", factor, low=0.0, strict=True)
        model = pin.Model(self.model)
        for i, part in enumerate(list(model.inertias)):
            model.inertias[i] = build.body(factor * part.mass, part.lever, factor * part.inertia)
        model.armature = factor * np.array(model.armature)
        return replace(self, model=model, payloads=tuple(Payload(factor * p.mass, p.com, factor * p.inertia) for p in self.payloads))

    # --- angles ----------------------------------------------------------------------------------------------------------

    def configuration(self, q: ArrayLike) -> Array:
        """(..., nq) Pinocchio's configuration at angles q (..., n): its order of joints, (cos, sin) for a continuous joint."""
        return build.configuration(build.places(self.model), self.to_model(self._joints("q", q)))

    def to_model(self, x: ArrayLike) -> Array:
        """(..., n) a vector x from the user's joint order to Pinocchio's."""
        x = self._joints("x", x)
        out = np.empty_like(x)
        out[..., self.order] = x
        return out

    def from_model(self, x: ArrayLike) -> Array:
        """(..., n) a vector x from Pinocchio's joint order to the user's."""
        return self._joints("x", x)[..., self.order]

    # --- dynamics --------------------------------------------------------------------------------------------------------

    def mass(self, q: ArrayLike) -> Array:
        """(..., n, n) mass matrix M of equation 9.7 at q (..., n) [rad or m]: [kg m^2, kg m or kg], armature included."""
        x = self.configuration(q)
        data, pick = self._data(), np.ix_(self.order, self.order)
        return self._each(x, lambda i: build.upper_to_full(pin.crba(self.model, data, x[i]))[pick], (self.n, self.n))

    def gravity(self, q: ArrayLike) -> Array:
        """(..., n) gravity torque g [Nm or N] at q (..., n) [rad or m]."""
        x = self.configuration(q)
        data = self._data()
        return self._each(x, lambda i: pin.computeGeneralizedGravity(self.model, data, x[i])[self.order], (self.n,))

    def bias(self, q: ArrayLike, v: ArrayLike) -> Array:
        """(..., n) h(q, v) = C(q, v) v + g(q) [Nm or N] at q [rad or m] and v [rad/s or m/s], (..., n) each; without friction."""
        q, v = self._moving(q, v)
        x, v = self.configuration(q), self.to_model(v)
        data = self._data()
        return self._each(x, lambda i: pin.nonLinearEffects(self.model, data, x[i], v[i])[self.order], (self.n,))

    def friction(self, v: ArrayLike) -> Array:
        """(..., n) joint friction torque of the plant, opposing v: viscous v + coulomb tanh(v / coulomb_speed) [Nm or N]."""
        v = self._joints("v", v)
        return self.viscous * v + self.coulomb * np.tanh(v / self.coulomb_speed)

    def pose(self, q: ArrayLike) -> Array:
        """(..., 4, 4) pose X of the tool in the base, at q (..., n) [rad or m]."""
        x = self.configuration(q)
        data = self._data()

        def one(i: Any) -> Array:
            pin.forwardKinematics(self.model, data, x[i])
            return np.array(pin.updateFramePlacement(self.model, data, self.frame_id).homogeneous)

        return self._each(x, one, (4, 4))

    def jacobian(self, q: ArrayLike) -> Array:
        """(..., 6, n) body Jacobian at q (..., n) [rad or m]: V_b = J v, (linear, angular) in the tool frame."""
        x = self.configuration(q)
        data = self._data()

        def one(i: Any) -> Array:  # of a single joint Pinocchio returns (6,)
            J = np.reshape(pin.computeFrameJacobian(self.model, data, x[i], self.frame_id, pin.LOCAL), (6, self.n))
            return cast(Array, J[:, self.order])

        return self._each(x, one, (6, self.n))

    def jacobian_rate(self, q: ArrayLike, v: ArrayLike) -> Array:
        """(..., 6, n) J'(q, v), the rate of the body Jacobian: V_b' = J a + J' v."""
        q, v = self._moving(q, v)
        x, v = self.configuration(q), self.to_model(v)
        data = self._data()

        def one(i: Any) -> Array:
            pin.computeJointJacobiansTimeVariation(self.model, data, x[i], v[i])
            J_rate = np.reshape(pin.getFrameJacobianTimeVariation(self.model, data, self.frame_id, pin.LOCAL), (6, self.n))
            return cast(Array, J_rate[:, self.order])

        return self._each(x, one, (6, self.n))

    def task_inertia(self, q: ArrayLike) -> Array:
        """(..., 6, 6) Lambda = (J M^-1 J^T)^-1 of equation 9.15, J^-T M J^-1 where J is square.

        ``q`` (..., n) [rad or m]. Warns (``MfcWarning``) above a condition number of J of 1e4; raises ``NearSingular`` above 1e6 and for n < 6.
        """
        J = self.jacobian(q)
        check_regular(self.tool, J)
        return _task_inertia(self.mass(q), J)

    def task_bias(self, q: ArrayLike, v: ArrayLike) -> Array:
        """(..., 6) eta = Lambda (J M^-1 h - J' v) of equation 9.15: J^T (Lambda V' + eta) is 9.7.

        ``q``, ``v`` (..., n) [rad or m, and per s]. Warnings and errors as of ``task_inertia``.
        """
        q, v = self._moving(q, v)
        J, M = self.jacobian(q), self.mass(q)
        check_regular(self.tool, J)
        a_bias = np.linalg.solve(M, self.bias(q, v)[..., None])
        x: Array = _task_inertia(M, J) @ (J @ a_bias - self.jacobian_rate(q, v) @ v[..., None])
        return x[..., 0]

    def joint_torques(self, q: ArrayLike, wrench: ArrayLike, frame: str = "tool") -> Array:
        """(..., n) tau = J^T F [Nm or N] of a ``wrench`` F (..., 6), (force [N], moment [Nm]) at the tool origin, at ``q`` (..., n) [rad or m].

        ``frame``: "tool": components in tool axes; "world": in base axes, still at the tool origin.
        """
        checks.choice("frame", frame, ("tool", "world"))
        F = checks.array("wrench", wrench)
        x = self._joints("q", q)
        if F.ndim == 0 or F.shape[-1] != 6 or not _compatible(F.shape[:-1], x.shape[:-1]):
            raise BadArgument("wrench", f"shape {F.shape}", f"shape (..., 6), force and moment, with leading axes that match q of shape {x.shape}")
        if frame == "world":
            R = self.pose(q)[..., :3, :3]
            F = np.concatenate([(np.swapaxes(R, -1, -2) @ F[..., part, None])[..., 0] for part in (slice(0, 3), slice(3, 6))], axis=-1)
        tau: Array = np.swapaxes(self.jacobian(q), -1, -2) @ F[..., None]
        return tau[..., 0]

    # --- helpers ---------------------------------------------------------------------------------------------------------

    def _data(self) -> pin.Data:
        """Pinocchio's workspace of this robot in this thread; results are copied from it at once."""
        if not hasattr(_workspaces, "of"):
            _workspaces.of = WeakKeyDictionary()
        if self not in _workspaces.of:
            _workspaces.of[self] = self.model.createData()
        return _workspaces.of[self]

    def _joints(self, argument: str, value: ArrayLike) -> Array:
        out = checks.array(argument, value)
        if out.ndim == 0 and self.n == 1:
            return out.reshape(1)
        if out.ndim == 0 or out.shape[-1] != self.n:
            raise BadArgument(argument, f"shape {out.shape}", f"shape (..., {self.n}): a value for each of {', '.join(self.joint_names)}")
        return out

    def _moving(self, q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        q, v = self._joints("q", q), self._joints("v", v)
        if not _compatible(q.shape, v.shape):
            raise BadArgument("v", f"shape {v.shape}", f"leading axes that match q of shape {q.shape}")
        q, v = np.broadcast_arrays(q, v)
        return q, v

    def _each(self, x: Array, one: Any, shape: tuple[int, ...]) -> Array:
        out = np.empty((*x.shape[:-1], *shape))
        for i in np.ndindex(x.shape[:-1]):
            out[i] = one(i)
        return out


def _task_inertia(M: Array, J: Array) -> Array:
    Lambda: Array = np.asarray(np.linalg.inv(J @ np.linalg.solve(M, np.swapaxes(J, -1, -2))), float)
    return 0.5 * (Lambda + np.swapaxes(Lambda, -1, -2))


def _compatible(a: tuple[int, ...], b: tuple[int, ...]) -> bool:
    return all(x == y or 1 in (x, y) for x, y in zip(a[::-1], b[::-1], strict=False))


def _in_words(values: Array) -> str:
    return f"{values[0]:g}" if np.all(values == values[0]) else "(" + ", ".join(f"{x:g}" for x in values) + ")"
