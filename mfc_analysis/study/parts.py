"""The parts of a loop from the tables of a study: robot, model, law, reference, contact, hardware."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cached_property
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.errors import BadArgument, MfcError, UnknownName
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots import catalogue
from mfc_analysis.robots.catalogue import EMBEDDED
from mfc_analysis.robots.robot import Robot
from mfc_analysis.study.errors import StudyError
from mfc_analysis.study.schema import (
    BodyTable,
    ConstraintsTable,
    GainsTable,
    LoopTable,
    OuterTable,
    PayloadTable,
)
from mfc_analysis.study.tables import EnvironmentTable, PoseTable, Table

if TYPE_CHECKING:
    from mfc_analysis.dynamics.environment import Environment
    from mfc_analysis.dynamics.hardware import Hardware
    from mfc_analysis.gains.result import Gains
    from mfc_analysis.laws.law import Law
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.requirements.requirements import Requirements


POINTS = 101  #: number of times if the study has none and the reference moves


@dataclass(frozen=True, eq=False)
class Parts:
    """Builds a loop from its tables, each once; ``varied`` builds it with other plant parameters."""

    table: LoopTable
    folder: Path  #: files are read relative to it
    file: str  #: for messages
    prefix: str = ""  #: "loop[1]" in a study of several

    @contextmanager
    def within(self, key: str) -> Iterator[None]:
        """Turns errors of a part into errors of the study that name its file and key; "": the loop as a whole."""
        try:
            yield
        except StudyError:
            raise
        except BadArgument as why:
            argument = _argument(why, key)
            place = ".".join(part for part in (self.prefix, key, argument) if part)
            said = str(why).removeprefix(f"{why.argument}: ") if argument or why.argument == key else str(why)
            raise StudyError(self.file, place, said, getattr(why, "known", ())) from why
        except MfcError as why:
            raise StudyError(self.file, ".".join(part for part in (self.prefix, key) if part), str(why)) from why

    # --- parts ---------------------------------------------------------------------------------------------------------

    @cached_property
    def robot(self) -> Robot:
        """The plant."""
        with self.within("robot"):
            return self._body(self.table.robot)

    @cached_property
    def model(self) -> Robot:
        """The controller's model: the plant with the keys of ``controller_model`` changed; without keys, the plant itself."""
        given = self.table.controller_model
        changes = {} if given is None else given.given()
        if not changes:
            return self.robot
        if {"name", "load", "urdf", "mjcf"} & set(changes):
            changes = {"name": None, "load": None, "urdf": None, "mjcf": None, "parameters": {}} | changes
        with self.within("controller_model"):
            return self._body(self.table.robot.model_copy(update=changes))

    def _body(self, table: BodyTable) -> Robot:
        robot = self._source(table)
        if table.friction is not None and table.friction.model_fields_set:
            robot = robot.with_friction(**table.friction.given())
        if table.armature is not None:
            robot = robot.with_armature(table.armature)
        if table.inertia_scale != 1.0:
            robot = robot.with_inertia_scaled(table.inertia_scale)
        for body in table.payload:
            robot = robot.with_payload(body.mass, body.com, body.inertia)
        return robot

    def _source(self, table: BodyTable) -> Robot:
        options: dict[str, Any] = {key: value for key in ("tool", "locked", "joints", "gravity") if (value := getattr(table, key)) is not None}
        if table.urdf is not None:
            return Robot.from_urdf(self.folder / table.urdf, **options)
        if table.mjcf is not None:
            try:
                return Robot.from_mjcf(self.folder / table.mjcf, **options)
            except BadArgument as why:
                if why.argument != "source":
                    raise
                raise BadArgument("mjcf", why.got, why.takes) from why
        name = table.name if table.name is not None else str(table.load)
        if table.load is None and name in EMBEDDED:
            build = EMBEDDED[name]
            known = tuple(signature(build).parameters)
            for key in table.parameters:
                if key not in known:
                    raise UnknownName(f"parameters.{key}", key, known)
            robot: Robot = build(**table.parameters)
        else:
            robot = catalogue.load(name, options.pop("tool", None), options.pop("locked", None))
        return _changed(robot, options) if options else robot

    @cached_property
    def q_start(self) -> Array | None:
        """(n,) joint position at the start, None if the study has none."""
        given = self._si(self.table, "q_start")
        with self.within(""):
            return None if given is None else checks.array("q_start", given, (self.robot.n,))

    def _si(self, table: Table, key: str) -> Any:
        other = table.in_units.get(key, "")
        if other.endswith("_deg") and key in _JOINT_KEYS and getattr(table, other) is not None:
            turns = np.abs(self.robot.jacobian(np.zeros(self.robot.n))[3:]).max(axis=0) > 1e-9
            sliding = [name for name, turning in zip(self.robot.joint_names, turns, strict=True) if not turning]
            if sliding:
                where = ".".join(part for part in (self.prefix, other) if part)
                raise StudyError(self.file, where, f"joint {sliding[0]!r} slides; use {key} instead, in rad and m")
        return table.si(key)

    def _start(self, key: str) -> Array:
        if self.q_start is None:
            raise BadArgument(key, None, "a joint position, or q_start in the study")
        return self.q_start

    def pose(self, key: str, table: PoseTable) -> Array:
        """(4, 4) pose of a table. Raises BadArgument."""
        from mfc_analysis.maths.se3 import exp3, pose_matrix

        if table.matrix is not None:
            X = np.array(pose_matrix(key, table.matrix))
        elif table.position is not None:
            X = np.eye(4)
            X[:3, 3] = table.position
            X[:3, :3] = _rotation(key, table)
        else:
            q = self._si(table, "q")
            X = np.array(self.robot.pose(self._start(f"{key}.q") if q is None else checks.array(f"{key}.q", q, (self.robot.n,))))
        X[:3, 3] += table.shift
        turn = table.si("turn")
        if turn is not None:
            X[:3, :3] = X[:3, :3] @ exp3(np.array(turn))
        return X

    @cached_property
    def reference(self) -> Any:
        """The reference."""
        with self.within("reference"):
            return self._reference(self.table.reference)

    def _reference(self, table: Any) -> Any:
        from mfc_analysis import trajectories

        kind = table.kind
        if kind == "csv":
            return trajectories.from_csv(self.folder / table.file)
        values: dict[str, Any] = {}
        for f in fields(getattr(trajectories, kind)):
            if not f.init or f.name not in type(table).model_fields:
                continue
            if f.name in ("X", "X0", "X1"):
                values[f.name] = self.pose(f.name, getattr(table, f.name))
            elif (value := self._si(table, f.name)) is not None:
                values[f.name] = value
            elif f.name in ("q", "q0", "center"):
                values[f.name] = self._start(f.name)
        ref = getattr(trajectories, kind)(**values)
        if not getattr(table, "inverse_kinematics", False):
            return ref
        return trajectories.from_tool_path(self.robot, ref, self._start("q_start"), self._times_of(ref), table.axes)

    def times(self) -> Array:
        """(m,) [s] at which the loop is analysed: those of the study, else along the reference."""
        with self.within("times"):
            return self._times_of(self.reference)

    def _times_of(self, ref: Any) -> Array:
        if self.table.times is not None:
            return checks.times(self.table.times.points())
        span = 0.0 if ref.is_hold else ref.duration or ref.period
        if span is None:
            raise BadArgument("stop", None, "the end of the times [s], because the reference has neither duration nor period")
        return np.linspace(0.0, span, POINTS) if span else np.zeros(1)

    @cached_property
    def law(self) -> Law:
        """The law."""
        from mfc_analysis import laws

        table = self.table.law
        with self.within("law"):
            if table.equation is not None:
                kind = laws.by_equation(table.equation)
            else:
                known = sorted({law.__name__ for law in laws.LAWS.values()})
                if table.name not in known:
                    raise UnknownName("name", table.name, known)
                kind = getattr(laws, str(table.name))
            given = {key: value for key, value in table.given().items() if key not in ("equation", "name") and value is not None}
            takes = (*kind.parameters(), "gains")
            if table.gains is not None:
                given.pop("gains")
                for key, value in self.designed(table.gains).items():
                    if key in given:
                        raise BadArgument(key, given[key], f"no value, because law.gains also sets {key}")
                    given[key] = value
            for key in given:
                if key not in takes:
                    place = ".".join(part for part in (self.prefix, "law", key) if part)
                    said = f"{kind.__name__} ({kind.numbered()})"
                    raise StudyError(self.file, place, f"{said} has no such key; allowed: {', '.join(takes)}", takes)
            if table.outer is not None:
                given["outer"] = _outer(table.outer)
            if table.constraints is not None:
                given["constraints"] = self._constraints(table.constraints)
            for name in kind.parameters():
                if name not in given and _is_required(kind, name):
                    raise BadArgument(name, None, f"a value, required by {kind.__name__} ({kind.numbered()})")
            law: Law = kind(**given)
            law.check(self.robot.n)
            return law

    def at(self) -> str | None:
        """The analysis point of the study. Raises StudyError if the law does not have it."""
        if self.table.at is not None:
            with self.within(""):
                checks.choice("at", self.table.at, self.law.opens_at)
        return self.table.at

    def designed(self, table: GainsTable) -> Gains:
        """The gains of a helper. Raises BadArgument or a subclass."""
        from mfc_analysis import gains

        helper = getattr(gains, table.helper)
        asked = {key: table.si(key) for key in type(table).model_fields if key != "helper" and not key.endswith("_hz") and table.si(key) is not None}
        known = tuple(signature(helper).parameters)
        for key in asked:
            if key not in known:
                raise UnknownName(f"gains.{key}", key, [name for name in known if name in type(table).model_fields])
        for key, parameter in signature(helper).parameters.items():
            if parameter.default is parameter.empty and key not in asked and key not in ("robot", "q"):
                raise BadArgument(f"gains.{key}", None, f"a number, required by {table.helper}")
        if table.helper == "impedance":
            asked |= {"robot": self.model, "q": self.reference(0.0).q if self.reference.space == "joint" else self._start("q_start")}
        if table.helper == "joint_pid":
            asked |= {"robot": self.model, "q": self.reference if self.reference.space == "joint" else self._start("q_start")}
        found: Gains = helper(**asked)
        return found

    def _constraints(self, table: ConstraintsTable) -> Any:
        from mfc_analysis.laws import constraints

        if table.rows is not None:
            return table.rows
        frame = None if table.frame is None else self.pose("constraints.frame", _in_the_tool(table.frame))
        if table.set is not None:
            return getattr(constraints, table.set)(frame)
        return constraints.ConstraintSet(table.natural, table.artificial, frame)

    def surfaces(self, tables: list[EnvironmentTable]) -> list[Environment]:
        """The surfaces."""
        from mfc_analysis.dynamics.environment import Environment

        out = []
        for i, table in enumerate(tables):
            with self.within("environment" if len(tables) == 1 else f"environment[{i}]"):
                pose = None if table.pose is None else self.pose("pose", table.pose)
                out.append(Environment(table.stiffness, table.damping, pose, table.axes, table.preload, table.one_sided))
        return out

    def hardware(self, changes: Mapping[str, float] | None = None) -> Hardware | None:
        """Hardware of the study with some fields changed; None: ideal."""
        from mfc_analysis.dynamics.hardware import Hardware, Servo

        table = self.table.hardware
        given: dict[str, Any] = {**({} if table is None else table.given()), **(changes or {})}
        with self.within("hardware"):
            if table is not None and table.servo is not None:
                given["servo"] = Servo(**table.servo.values())
            return Hardware(**given) if given else None

    def files(self) -> tuple[Path, ...]:
        """The files that the tables name."""
        bodies = [body for body in (self.table.robot, self.table.controller_model) if body is not None]
        named = [*(body.urdf for body in bodies), *(body.mjcf for body in bodies), getattr(self.table.reference, "file", None)]
        named += [one.file for one in self.table.measured]
        return tuple(self.folder / name for name in named if name)

    @cached_property
    def requirements(self) -> Requirements:
        """The requirements."""
        from mfc_analysis.requirements.requirements import Requirements

        with self.within("requirements"):
            horizon: dict[str, Any] = {} if self.table.horizon is None else {"horizon": self.table.horizon}
            return Requirements(**self.table.requirements.given(), **horizon)

    # --- loops ---------------------------------------------------------------------------------------------------------

    def loop(self) -> ClosedLoop:
        """The loop that the study describes. Raises StudyError."""
        return self._loop(self.robot, self.surfaces(self.table.environment), self.hardware())

    def varied(self, values: Mapping[str, float]) -> ClosedLoop:
        """The loop with these plant parameters (keys of ``ranges``); the controller's model does not change."""
        plant: dict[str, Any] = {}
        if "payload" in values:
            plant["payload"] = [*self._payload_of(values["payload"]), *self.table.robot.payload[1:]]
        if "inertia_scale" in values:
            plant["inertia_scale"] = values["inertia_scale"]
        if "viscous" in values:
            old = self.table.robot.friction
            plant["friction"] = _with_viscous(old, values["viscous"])
        with self.within("ranges"):
            robot = self._body(self.table.robot.model_copy(update=plant)) if plant else self.robot
        change = {key: values[key] for key in ("stiffness", "damping") if key in values}
        surfaces = self.surfaces([t.model_copy(update=change) for t in self.table.environment])
        hardware = self.hardware({key: values[key] for key in ("delay", "force_delay", "torque_lag", "sample_time") if key in values})
        return self._loop(robot, surfaces, hardware)

    def _payload_of(self, mass: float) -> list[PayloadTable]:
        bodies = self.table.robot.payload
        return [bodies[0].model_copy(update={"mass": mass})] if bodies else [PayloadTable(mass=mass)]

    def _loop(self, robot: Robot, surfaces: list[Environment], hardware: Hardware | None) -> ClosedLoop:
        from mfc_analysis.loop import ClosedLoop

        law, ref, model, q_start = self.law, self.reference, self.model, self.q_start
        with self.within(""):
            return ClosedLoop(robot, law, ref, model, surfaces or None, q_start, hardware)


_JOINT_KEYS = ("q", "q0", "q1", "q_start", "center", "amplitude", "positions")


def _argument(why: BadArgument, key: str) -> str:
    """The argument of an error as a key under its table."""
    name = {"ref": "reference", "number": "equation", "source": "urdf", "path": "file", "loop": ""}.get(why.argument, why.argument)
    if name == key or not name.replace("_", "").replace(".", "").isidentifier():
        return ""
    return name.removeprefix(f"{key}.")


def _in_the_tool(table: PoseTable) -> PoseTable:
    """A pose in the tool frame; default: the origin."""
    said = any(base is not None for base in (table.matrix, table.position, table.q, table.q_deg))
    return table if said else table.model_copy(update={"position": [0.0, 0.0, 0.0]})


def _changed(robot: Robot, options: dict[str, Any]) -> Robot:
    """A robot of the catalogue with another tool, order of joints, gravity, or locked joints; its joint damping stays."""
    model = type(robot.model)(robot.model)
    damping = np.zeros(robot.n)
    damping[robot.order] = robot.viscous
    model.damping = damping
    given: dict[str, Any] = {"tool": robot.tool, **options}
    return Robot.from_pinocchio(model, **given)


def _with_viscous(old: Any, viscous: float) -> Any:
    from mfc_analysis.study.schema import FrictionTable

    given = {} if old is None else old.given()
    return FrictionTable(**(given | {"viscous": viscous}))


def _is_required(kind: type, name: str) -> bool:
    return signature(kind).parameters[name].default is signature(kind).empty


def _outer(table: OuterTable) -> Any:
    import control

    dt = table.dt or 0
    if table.num is not None:
        return control.tf(table.num, table.den, dt)
    if table.A is not None:
        return control.ss(table.A, table.B, table.C, table.D, dt)
    return table.given()


def _rotation(key: str, table: PoseTable) -> Array:
    """(3, 3) of rpy (Rz Ry Rx) or of a quaternion (x, y, z, w); the identity without either."""
    rpy = table.si("rpy")
    if table.quaternion_xyzw is not None:
        given = checks.array(f"{key}.quaternion_xyzw", table.quaternion_xyzw, (4,))
        length = float(np.linalg.norm(given))
        if abs(length - 1.0) > 1e-3:
            raise BadArgument(f"{key}.quaternion_xyzw", table.quaternion_xyzw, "four numbers of length 1: x, y, z, w")
        x, y, z, w = given / length
        W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.asarray(np.eye(3) + 2 * w * W + 2 * W @ W)
    if rpy is None:
        return np.eye(3)
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(Rz @ Ry @ Rx)
