"""The tables and keys of a study file, as pydantic models. ``read.py`` turns them into loops."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from mfc_analysis.analysis.loop_step import SettlingStep
from mfc_analysis.robots.catalogue import EMBEDDED
from mfc_analysis.study.tables import (
    BeforeValidator,
    Directions,
    EnvironmentTable,
    Field,
    HardwareTable,
    Number,
    PlainValidator,
    Pose,
    ReferenceTable,
    Table,
    Three,
    Values,
    Vector,
    is_number,
    model_validator,
    takes,
)


def _locked(value: Any) -> list[str] | dict[str, float]:
    if isinstance(value, list) and all(isinstance(x, str) for x in value):
        return value
    if isinstance(value, dict) and all(is_number(x) for x in value.values()):
        return {name: float(x) for name, x in value.items()}
    raise takes("a list of joint names (locked at 0), or a table of names and positions [rad or m]")


def _span(value: Any) -> Any:
    if isinstance(value, list):
        return {"values": value}
    return value


def _several(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


Locked = Annotated[Any, PlainValidator(_locked, json_schema_input_type=list[str] | dict[str, float])]

# --- robot ---------------------------------------------------------------------------------------------------------------


class PayloadTable(Table):
    """A body at the tool."""

    mass: Number  #: [kg]
    com: Three = Field(default_factory=lambda: [0.0, 0.0, 0.0])  #: [m], tool frame
    inertia: Values = 0.0  #: [kg m^2] scalar or 3x3 about the com, tool axes


class FrictionTable(Table):
    """Friction of the joints."""

    viscous: Values | None = None  #: [N m s/rad, N s/m]
    coulomb: Values = 0.0  #: [N m, N]
    coulomb_speed: Number | None = None  #: [rad/s, m/s] width of its sign change


def _payloads(value: Any) -> Any:
    if value is False:
        return []
    if value is True:
        raise takes("a table with mass, com, inertia, or false for none")
    return [value] if isinstance(value, dict) else value


def _friction(value: Any) -> Any:
    if isinstance(value, str):
        if value not in ("urdf", "none"):
            raise takes("'urdf', 'none', or a table with viscous, coulomb, coulomb_speed")
        return FrictionTable(viscous=0.0) if value == "none" else FrictionTable()
    return value


Payloads = Annotated[list[PayloadTable], BeforeValidator(_payloads, json_schema_input_type=PayloadTable | list[PayloadTable] | Literal[False])]


class BodyTable(Table):
    """The quantities in which plant and controller's model can differ."""

    name: str | None = None  #: an embedded robot, or one of ``mfc-analysis robots``
    load: str | None = None  #: an arm of example-robot-data
    urdf: str | None = None  #: a file, relative to the study
    mjcf: str | None = None  #: as urdf, of MuJoCo
    parameters: dict[str, Values] = Field(default_factory=dict)  #: of an embedded robot, such as inertia and mass of single_joint
    tool: str | None = None
    locked: Locked | None = None
    joints: list[str] | None = None
    friction: Annotated[FrictionTable | None, BeforeValidator(_friction, json_schema_input_type=FrictionTable | Literal["urdf", "none"])] = None
    gravity: Three | None = None  #: [m/s^2], base axes
    armature: Values | None = None  #: [kg m^2, kg]
    inertia_scale: Number = 1.0  #: of every mass and inertia, payload not included
    payload: Payloads = Field(default_factory=list)


class RobotTable(BodyTable):
    """The plant."""

    @model_validator(mode="after")
    def _one_source(self) -> RobotTable:
        if sum(source is not None for source in (self.name, self.load, self.urdf, self.mjcf)) != 1:
            raise takes("exactly one of name, load, urdf and mjcf")
        if self.parameters and self.name not in EMBEDDED:
            raise takes(f"parameters only with the name of an embedded robot ({', '.join(EMBEDDED)})")
        return self


class ModelTable(BodyTable):
    """The controller's model: the plant's table with these keys changed (``payload = false``: a model without payload)."""


# --- law ------------------------------------------------------------------------------------------------------------------


class GainsTable(Table):
    """Gains from a design helper: exactly one of bandwidth, natural_frequency, crossover (also ``_hz``) and settling_time."""

    in_units: ClassVar[dict[str, str]] = {
        "bandwidth": "bandwidth_hz",
        "natural_frequency": "natural_frequency_hz",
        "crossover": "crossover_hz",
        "servo": "servo_hz",
    }
    helper: Literal["p", "pi", "pd", "pid", "joint_pid", "force_pi", "impedance", "admittance"]
    bandwidth: Number | None = None
    bandwidth_hz: Number | None = None
    natural_frequency: Number | None = None
    natural_frequency_hz: Number | None = None
    crossover: Number | None = None
    crossover_hz: Number | None = None
    settling_time: Number | None = None
    step: SettlingStep | None = None  #: of settling_time, "reference" if omitted
    damping: Number | None = None
    inertia: Values | None = None  #: p, pi, pd, pid
    stiffness: Values | None = None  #: of the surface: force_pi, as the next three, and admittance; of the tool: impedance
    mass: Number | None = None
    lag: Number | None = None  #: also admittance
    friction: Number | None = None
    ratio: Values | None = None  #: impedance
    servo: Number | None = None  #: admittance, as the next two
    servo_hz: Number | None = None
    servo_damping: Number | None = None
    delay: Number | None = None  #: [s] also joint_pid


class OuterTable(Table):
    """Outer loop of 9.11: a PID, a transfer function (num, den), or matrices A, B, C, D; the latter two with their dt [s] where discrete."""

    kp: Values | None = None
    ki: Values | None = None
    kd: Values | None = None
    num: Vector | None = None
    den: Vector | None = None
    A: Values | None = None
    B: Values | None = None
    C: Values | None = None
    D: Values | None = None
    dt: Number | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> OuterTable:
        kinds = [{"kp", "ki", "kd"}, {"num", "den"}, {"A", "B", "C", "D"}]
        used = [kind for kind in kinds if kind & self.model_fields_set]
        if len(used) != 1 or (used[0] != kinds[0] and used[0] != self.model_fields_set - {"dt"}) or (used[0] == kinds[0] and self.dt is not None):
            raise takes("some of kp, ki, kd; or num and den; or A, B, C and D, with dt where discrete")
        return self


class ConstraintsTable(Table):
    """A constraint set of 9.17-9.18."""

    set: Literal["peg_in_hole", "surface_sliding"] | None = None
    natural: list[str] | None = None
    artificial: dict[str, Number] | None = None
    frame: Pose | None = None  #: compliance frame in the tool frame
    rows: Values | None = None  #: (k, 6) instead: rows A with A V_b = 0

    @model_validator(mode="after")
    def _one_kind(self) -> ConstraintsTable:
        if sum(x is not None for x in (self.set, self.natural, self.rows)) != 1:
            raise takes("exactly one of set, natural and rows")
        return self


def _constraints(value: Any) -> Any:
    return {"rows": value} if isinstance(value, list) else {"set": value} if isinstance(value, str) else value


_SAID_ROWS = ConstraintsTable | str | list[list[float]]
Constraints = Annotated[ConstraintsTable, BeforeValidator(_constraints, json_schema_input_type=_SAID_ROWS)]


class LawTable(Table):
    """The law, by equation number or class name, with its parameters."""

    equation: str | None = None
    name: str | None = None
    gains: GainsTable | None = None
    kp: Values | None = None
    ki: Values | None = None
    kd: Values | None = None
    form: str | None = None
    mass: Values | None = None
    outer: OuterTable | None = None
    stiffness: Values | None = None  #: impedance, as the next two
    damping: Values | None = None  #: of 9.5 and 9.16 a number: of the inverse of J
    inertia: Values | None = None
    feedforward: bool | None = None
    null_damping: Number | None = None
    inverse_damping: Number | None = None
    inverse: str | None = None
    anti_windup: Number | None = None  #: [s]
    axes: Directions | None = None  #: "xyz", "xyzrz", or (k, 6) orthonormal rows
    F_d: Vector | None = None
    kfp: Values | None = None
    kfi: Values | None = None
    kdamp: Values | None = None
    constraints: Annotated[
        ConstraintsTable | None, BeforeValidator(_constraints, json_schema_input_type=ConstraintsTable | str | list[list[float]])
    ] = None
    projection: str | None = None

    @model_validator(mode="after")
    def _one_name(self) -> LawTable:
        if (self.equation is None) == (self.name is None):
            raise takes('exactly one of equation (a string, such as "9.10") and name (a class, such as "Impedance")')
        return self


# --- times, requirements, ranges -----------------------------------------------------------------------------------------


class TimesTable(Table):
    """Times at which the loop is analysed [s]: a list, or ``count`` of them from start to stop."""

    values: Vector | None = None
    start: Number = 0.0
    stop: Number | None = None
    count: Annotated[int, Field(ge=2, le=100_000)] = 101

    @model_validator(mode="after")
    def _complete(self) -> TimesTable:
        if (self.values is None) == (self.stop is None):
            raise takes("a list of times, or a table with start, stop and count [s]")
        return self

    def points(self) -> list[float]:
        """The times [s]."""
        if self.values is not None:
            return self.values
        assert self.stop is not None
        return [self.start + (self.stop - self.start) * i / (self.count - 1) for i in range(self.count)]


class RequirementsTable(Table):
    """Fields of ``Requirements``."""

    gain_increase_db: Number | None = None
    gain_reduction_db: Number | None = None
    phase_deg: Number | None = None
    delay: Number | None = None
    sensitivity_peak: Number | None = None
    damping_ratio: Number | None = None
    disk_margin: Number | None = None
    settling_time: Number | None = None
    overshoot: Number | None = None
    tracking_error: Number | None = None
    torque_fraction: Number | None = None
    step: SettlingStep | None = None  #: of settling_time and overshoot, "reference" if omitted


class SpanTable(Table):
    """Values of a range: a list, or ``count`` of them from low to high."""

    values: Vector | None = None
    low: Number | None = None
    high: Number | None = None
    count: Annotated[int, Field(ge=2, le=1000)] = 3

    @model_validator(mode="after")
    def _complete(self) -> SpanTable:
        if (self.values is None) == (self.low is None or self.high is None):
            raise takes("a list of values, or a table with low, high and count")
        return self

    def points(self) -> list[float]:
        """The values."""
        if self.values is not None:
            return self.values
        assert self.low is not None and self.high is not None
        return [self.low + (self.high - self.low) * i / (self.count - 1) for i in range(self.count)]


Span = Annotated[SpanTable, BeforeValidator(_span, json_schema_input_type=SpanTable | list[float])]


class RangesTable(Table):
    """The plant parameters that vary while the controller's model stays fixed. Every combination is checked."""

    payload: Span | None = None  #: [kg] mass of the (first) payload
    inertia_scale: Span | None = None
    viscous: Span | None = None  #: [N m s/rad] of every joint
    stiffness: Span | None = None  #: [N/m] of every surface
    damping: Span | None = None  #: [N s/m] of every surface
    delay: Span | None = None  #: [s]
    force_delay: Span | None = None
    torque_lag: Span | None = None
    sample_time: Span | None = None


class TuneTable(Table):
    """Gains to tune, each from low to high: of ``law.gains`` (bandwidth, damping) or of the law; the requirements are met over the ranges."""

    in_units: ClassVar[dict[str, str]] = {"bandwidth": "bandwidth_hz", "wanted": "wanted_hz"}
    bandwidth: Vector | None = None  #: [rad/s]
    bandwidth_hz: Vector | None = None
    damping: Vector | None = None
    kp: Vector | None = None
    ki: Vector | None = None
    kd: Vector | None = None
    kfp: Vector | None = None
    kfi: Vector | None = None
    kdamp: Vector | None = None
    wanted: Number | None = None  #: [rad/s] bandwidth to come nearest to; omitted: the fastest gains
    wanted_hz: Number | None = None


class DesignTable(Table):
    """What to search for: edges of stability, limits at which the requirements are met, and gains."""

    max_stiffness: bool = False
    max_delay: bool = False
    max_payload: bool = False
    min_sample_rate: bool = False
    max_bandwidth: bool = False  #: of law.gains, meeting the requirements over the ranges
    limits: bool = False  #: of every quantity, with the requirements met, and the cost of each imperfection: a section of the report
    tune: TuneTable | None = None


class MeasuredTable(Table):
    """A measured loop to compare with the model: columns of a CSV file by name or number, or sums of them such as "tau + r"."""

    file: str  #: relative to the study
    time: str = "t"  #: [s]
    input: str = "u"  #: the signal after the excitation
    output: str = "y"  #: minus the signal before it, as in "-tau": L is in negative feedback
    excitation: str | None = None  #: needed where the loop was closed
    period: Number | None = None  #: [s] of a periodic excitation
    averages: Annotated[int, Field(ge=2)] = 8
    cycles: Annotated[float, Field(ge=2)] = 50.0
    window: str = "hann"
    at: str | None = None  #: analysis point; default: that of the loop
    channel: str | None = None  #: joint; default: the first
    when: Number | None = None  #: [s] of the linearisation; default: the first of the times


Format = Literal["html", "pdf", "json"]
FORMATS: tuple[Format, ...] = ("html", "pdf", "json")


class ReportTable(Table):
    """Options of the report."""

    name: str | None = None  #: of the files; default: the study's own
    sections: list[Literal["loop", "margins", "poles", "path", "run", "validation", "pose"]] | None = None  #: default: all
    formats: list[Format] = Field(default_factory=lambda: list(FORMATS))


Surfaces = Annotated[list[EnvironmentTable], BeforeValidator(_several, json_schema_input_type=EnvironmentTable | list[EnvironmentTable])]
Measurements = Annotated[list[MeasuredTable], BeforeValidator(_several, json_schema_input_type=MeasuredTable | list[MeasuredTable])]


class LoopTable(Table):
    """One loop of a study, and its requirements."""

    in_units: ClassVar[dict[str, str]] = {"q_start": "q_start_deg"}
    name: str | None = None
    robot: RobotTable
    controller_model: ModelTable | None = None
    law: LawTable
    q_start: Vector | None = None
    q_start_deg: Vector | None = None
    reference: ReferenceTable
    environment: Surfaces = Field(default_factory=list)
    hardware: HardwareTable | None = None
    times: Annotated[TimesTable | None, BeforeValidator(_span, json_schema_input_type=TimesTable | list[float])] = None
    at: str | None = None
    horizon: Annotated[float, Field(gt=0)] | None = None  #: [s] of the verdict; inf: every root is judged by its sign
    requirements: RequirementsTable = RequirementsTable()
    ranges: RangesTable = RangesTable()
    design: DesignTable = DesignTable()
    measured: Measurements = Field(default_factory=list)


class StudyTable(LoopTable):
    """A whole study: one loop, or several as ``[[loop]]`` tables that change some keys of it."""

    title: str | None = None
    text: str | None = None  #: a paragraph of the report
    report: ReportTable = ReportTable()
    loop: list[dict[str, Any]] = Field(default_factory=list)
