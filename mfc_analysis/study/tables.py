"""The building blocks of a study file: numbers, vectors, tables with fixed keys; and the tables of poses and references.

Every reader of studies imports this file. It raises MissingExtra where the libraries of studies are not installed.

Units are SI and radians, except for keys that end in ``_deg`` or ``_hz``.
"""

from __future__ import annotations

import math
import sys
from typing import Annotated, Any, ClassVar, Literal, get_args

from mfc_analysis.dynamics.coded import Rule
from mfc_analysis.errors import require

require("study")

from pydantic import (  # noqa: E402  the only import of pydantic, after the check that it is installed
    BaseModel,
    BeforeValidator as BeforeValidator,
    ConfigDict,
    Discriminator,
    Field as Field,
    PlainValidator as PlainValidator,
    Tag,
    ValidationError as ValidationError,
    WithJsonSchema,
    model_validator as model_validator,
)
from pydantic_core import PydanticCustomError  # noqa: E402


def takes(what: str) -> PydanticCustomError:
    """A validation error that names the values allowed."""
    return PydanticCustomError("takes", "{what}", {"what": what})


def is_number(value: Any) -> bool:
    """Whether a value is a finite number, and not a boolean."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _number(value: Any) -> float:
    if not is_number(value):
        raise takes("a finite number")
    return float(value)


def _values(value: Any) -> Any:
    if is_number(value):
        return float(value)
    rows = value if isinstance(value, list) else None
    if rows and all(is_number(x) for x in rows):
        return [float(x) for x in rows]
    if rows and all(isinstance(row, list) and row and all(is_number(x) for x in row) and len(row) == len(rows[0]) for row in rows):
        return [[float(x) for x in row] for row in rows]
    raise takes("a finite number, a list of them, or a list of rows of equal length")


def _vector(value: Any) -> list[float]:
    if not isinstance(value, list) or not value or not all(is_number(x) for x in value):
        raise takes("a list of finite numbers, one for each joint or component")
    return [float(x) for x in value]


def _three(value: Any) -> list[float]:
    if not isinstance(value, list) or len(value) != 3 or not all(is_number(x) for x in value):
        raise takes("a list of 3 finite numbers")
    return [float(x) for x in value]


def _directions(value: Any) -> Any:
    return value if isinstance(value, str) else _values(value)


_A_NUMBER: dict[str, Any] = {"type": "number"}
_A_LIST: dict[str, Any] = {"type": "array", "items": _A_NUMBER, "minItems": 1}
_ROWS: dict[str, Any] = {"type": "array", "items": _A_LIST, "minItems": 1}

Number = Annotated[float, PlainValidator(_number), WithJsonSchema(_A_NUMBER)]
#: a number, a vector or a matrix
Values = Annotated[Any, PlainValidator(_values), WithJsonSchema({"anyOf": [_A_NUMBER, _A_LIST, _ROWS]})]
#: "xyz", "xyzrz", or the rows of a matrix
Directions = Annotated[Any, PlainValidator(_directions), WithJsonSchema({"anyOf": [{"type": "string"}, _ROWS]})]
Vector = Annotated[list[float], PlainValidator(_vector), WithJsonSchema(_A_LIST)]
Three = Annotated[list[float], PlainValidator(_three), WithJsonSchema({**_A_LIST, "minItems": 3, "maxItems": 3})]


class Table(BaseModel):
    """A table of a study, with fixed keys and types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    #: keys that may also be given as ``key_deg`` or ``key_hz``; never both
    in_units: ClassVar[dict[str, str]] = {}

    @model_validator(mode="after")
    def _one_unit(self) -> Table:
        for key, other in self.in_units.items():
            if getattr(self, key) is not None and getattr(self, other) is not None:
                raise takes(f"{key} or {other}, not both")
        return self

    def given(self) -> dict[str, Any]:
        """The keys that the file has, with their values, in the schema's order."""
        return {key: getattr(self, key) for key in type(self).model_fields if key in self.model_fields_set}

    def si(self, key: str) -> Any:
        """The value of a key in SI and radians, from either unit; None if it was not given."""
        other = self.in_units.get(key)
        if other is None or getattr(self, other) is None:
            return getattr(self, key)
        return scaled(getattr(self, other), math.pi / 180 if other.endswith("_deg") else 2 * math.pi)

    def in_degrees(self) -> str | None:
        """The first key given in degrees, None if there is none."""
        return next((other for other in self.in_units.values() if other.endswith("_deg") and getattr(self, other) is not None), None)


def scaled(value: Any, factor: float) -> Any:
    """A number, or numbers in lists, times a factor."""
    return [scaled(x, factor) for x in value] if isinstance(value, list) else value * factor


# --- poses and references ------------------------------------------------------------------------------------------------


class PoseTable(Table):
    """A pose: of the tool at a joint position (default: q_start), or position and orientation; then shifted and turned."""

    in_units: ClassVar[dict[str, str]] = {"q": "q_deg", "rpy": "rpy_deg", "turn": "turn_deg"}
    matrix: Values | None = None  #: 4x4
    position: Three | None = None  #: [m]
    rpy: Three | None = None  #: [rad] R = Rz(yaw) Ry(pitch) Rx(roll)
    rpy_deg: Three | None = None
    quaternion_xyzw: Vector | None = None
    q: Vector | None = None
    q_deg: Vector | None = None
    shift: Three = Field(default_factory=lambda: [0.0, 0.0, 0.0])  #: [m] added to the position, base axes
    turn: Three | None = None  #: [rad] rotation vector, in the frame of the pose
    turn_deg: Three | None = None

    @model_validator(mode="after")
    def _one_base(self) -> PoseTable:
        bases = [self.matrix, self.position, self.q, self.q_deg]
        if sum(base is not None for base in bases) > 1:
            raise takes("at most one of matrix, position, q and q_deg")
        turned = sum(x is not None for x in (self.rpy, self.rpy_deg, self.quaternion_xyzw))
        if turned > 1 or (turned and self.position is None):
            raise takes("one of rpy, rpy_deg and quaternion_xyzw, together with position")
        return self


def _pose(value: Any) -> Any:
    return {"matrix": value} if isinstance(value, list) else value


Pose = Annotated[PoseTable, BeforeValidator(_pose, json_schema_input_type=PoseTable | list[list[float]])]


class HoldTable(Table):
    """``Hold(q)``; q omitted: q_start."""

    in_units: ClassVar[dict[str, str]] = {"q": "q_deg"}
    kind: Literal["Hold"]
    q: Vector | None = None
    q_deg: Vector | None = None


class QuinticTable(Table):
    """``Quintic(q0, q1, duration)``; q0 omitted: q_start."""

    in_units: ClassVar[dict[str, str]] = {"q0": "q0_deg", "q1": "q1_deg"}
    kind: Literal["Quintic"]
    q0: Vector | None = None
    q0_deg: Vector | None = None
    q1: Vector | None = None
    q1_deg: Vector | None = None
    duration: Number = 2.0

    @model_validator(mode="after")
    def _has_end(self) -> QuinticTable:
        if self.q1 is None and self.q1_deg is None:
            raise takes("q1 or q1_deg: the joint position at the end")
        return self


class SinusoidTable(Table):
    """``Sinusoid(center, amplitude, frequency, phase)``; center omitted: q_start."""

    in_units: ClassVar[dict[str, str]] = {"center": "center_deg", "amplitude": "amplitude_deg", "frequency": "frequency_hz", "phase": "phase_deg"}
    kind: Literal["Sinusoid"]
    center: Vector | None = None
    center_deg: Vector | None = None
    amplitude: Values | None = None
    amplitude_deg: Values | None = None
    frequency: Values | None = None  #: [rad/s]
    frequency_hz: Values | None = None
    phase: Values | None = None
    phase_deg: Values | None = None

    @model_validator(mode="after")
    def _has_all(self) -> SinusoidTable:
        for key in ("amplitude", "frequency"):
            if self.si(key) is None:
                raise takes(f"{key} or {self.in_units[key]}")
        return self


class WaypointsTable(Table):
    """``Waypoints(times, positions)``."""

    in_units: ClassVar[dict[str, str]] = {"positions": "positions_deg"}
    kind: Literal["Waypoints"]
    times: Vector
    positions: Values | None = None
    positions_deg: Values | None = None

    @model_validator(mode="after")
    def _has_all(self) -> WaypointsTable:
        if self.si("positions") is None:
            raise takes("positions or positions_deg: a row for each time")
        return self


class CsvTable(Table):
    """``from_csv(file)``: time [s], then a joint [rad or m] in each column."""

    kind: Literal["csv"]
    file: str  #: relative to the study


class ToolTable(Table):
    """Common keys of the tool references: ``inverse_kinematics = true`` turns them into a joint trajectory (9.14), of all directions or of axes."""

    inverse_kinematics: bool = False
    axes: Directions | None = None

    @model_validator(mode="after")
    def _axes_followed(self) -> ToolTable:
        if self.axes is not None and not self.inverse_kinematics:
            raise takes("axes only with inverse_kinematics = true; a tool law has axes of its own, a key of [law]")
        return self


class ToolHoldTable(ToolTable):
    """``ToolHold(X)``; X omitted: the tool's pose at q_start."""

    kind: Literal["ToolHold"]
    X: Pose = PoseTable()


class ToolLineTable(ToolTable):
    """``ToolLine(X0, X1, duration)``; X0 omitted: the tool's pose at q_start."""

    kind: Literal["ToolLine"]
    X0: Pose = PoseTable()
    X1: Pose
    duration: Number = 2.0


class ToolSinusoidTable(ToolTable):
    """``ToolSinusoid(X0, amplitude, frequency, axis, angle, phase)``."""

    in_units: ClassVar[dict[str, str]] = {"frequency": "frequency_hz", "angle": "angle_deg", "phase": "phase_deg"}
    kind: Literal["ToolSinusoid"]
    X0: Pose = PoseTable()
    amplitude: Values = 0.0  #: [m], base axes
    frequency: Number | None = None
    frequency_hz: Number | None = None
    axis: Three = Field(default_factory=lambda: [0.0, 0.0, 1.0])
    angle: Number | None = None
    angle_deg: Number | None = None
    phase: Number | None = None
    phase_deg: Number | None = None

    @model_validator(mode="after")
    def _has_frequency(self) -> ToolSinusoidTable:
        if self.si("frequency") is None:
            raise takes("frequency [rad/s] or frequency_hz")
        return self


class ToolCircleTable(ToolTable):
    """``ToolCircle(X0, radius, frequency, normal)``."""

    in_units: ClassVar[dict[str, str]] = {"frequency": "frequency_hz"}
    kind: Literal["ToolCircle"]
    X0: Pose = PoseTable()
    radius: Number  #: [m]
    frequency: Number | None = None
    frequency_hz: Number | None = None
    normal: Three = Field(default_factory=lambda: [0.0, 0.0, 1.0])

    @model_validator(mode="after")
    def _has_frequency(self) -> ToolCircleTable:
        if self.si("frequency") is None:
            raise takes("frequency [rad/s] or frequency_hz")
        return self


REFERENCES: dict[str, type[Table]] = {
    "Hold": HoldTable, "Quintic": QuinticTable, "Sinusoid": SinusoidTable, "Waypoints": WaypointsTable, "csv": CsvTable,
    "ToolHold": ToolHoldTable, "ToolLine": ToolLineTable, "ToolSinusoid": ToolSinusoidTable, "ToolCircle": ToolCircleTable,
}  # fmt: skip


def _kind(value: Any) -> str | None:
    kind = value.get("kind") if isinstance(value, dict) else None
    return kind if isinstance(kind, str) else None


ReferenceTable = Annotated[
    Annotated[HoldTable, Tag("Hold")]
    | Annotated[QuinticTable, Tag("Quintic")]
    | Annotated[SinusoidTable, Tag("Sinusoid")]
    | Annotated[WaypointsTable, Tag("Waypoints")]
    | Annotated[CsvTable, Tag("csv")]
    | Annotated[ToolHoldTable, Tag("ToolHold")]
    | Annotated[ToolLineTable, Tag("ToolLine")]
    | Annotated[ToolSinusoidTable, Tag("ToolSinusoid")]
    | Annotated[ToolCircleTable, Tag("ToolCircle")],
    Discriminator(_kind),
]


# --- contact and hardware ------------------------------------------------------------------------------------------------


class EnvironmentTable(Table):
    """A surface; pose omitted: the tool's start pose."""

    stiffness: Values
    damping: Values = 0.0
    pose: Pose | None = None
    axes: str = "z"
    preload: Values = 0.0
    one_sided: bool = False


class ServoTable(Table):
    """Fields of ``Servo``: the arm's own servo under a velocity law."""

    in_units: ClassVar[dict[str, str]] = {"bandwidth": "bandwidth_hz"}
    bandwidth: Values | None = None  #: [rad/s] -3 dB
    bandwidth_hz: Values | None = None
    damping: Values | None = None
    delay: Number | None = None  #: [s]

    @model_validator(mode="after")
    def _has_bandwidth(self) -> ServoTable:
        if self.si("bandwidth") is None:
            raise takes("bandwidth [rad/s] or bandwidth_hz: where the servo falls to -3 dB")
        return self

    def values(self) -> dict[str, Any]:
        """The arguments of ``Servo``."""
        return {key: value for key in ("bandwidth", "damping", "delay") if (value := self.si(key)) is not None}


class HardwareTable(Table):
    """Fields of ``Hardware``; SI."""

    torque_lag: Values | None = None
    velocity_lag: Values | None = None
    servo: ServoTable | None = None
    delay: Number | None = None
    force_delay: Number | None = None
    sample_time: Number | None = None
    force_filter: Number | None = None
    velocity_filter: Values | None = None
    joint_stiffness: Values | None = None
    joint_damping: Values | None = None
    motor_inertia: Values | None = None
    torque_limit: Values | None = None
    velocity_limit: Values | None = None
    force_limit: Values | None = None
    force_deadband: Values | None = None
    feedback: Literal["motor", "link"] = "motor"
    integral_rule: Rule = "forward"
    derivative_rule: Rule | None = None


def tables_of(annotation: Any) -> list[type[Table]]:
    """The tables among the types that a field takes."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return [annotation]
    return [found for part in get_args(annotation) for found in tables_of(part)]
