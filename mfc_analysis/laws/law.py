"""The interface of a law to the loop: its equation, its states, its analysis points and its action.

A law is a value. ``act`` is pure: the equation of the chapter, written over the primitives of the controller's model, for
both plain and dual arrays. States of the loop (integrals, an LTI outer loop) enter through ``Measured`` and their rates leave
through ``Action``; the law stores nothing.

All properties of a law that the loop uses are attributes or hooks here. No code depends on the equation number, so that a user-defined law
is treated like those of the chapter.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self, TypeVar, dataclass_transform

import numpy as np

from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.laws.gain import Gain
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.axes import TWIST as TWIST
from mfc_analysis.maths.dual import Vector, matvec
from mfc_analysis.maths.se3 import Pose
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.tool_task import Selection, ToolTask, tool_task

#: The last argument of ``act``: called with the name of a wire and its signal, it returns the signal after the wire, the same unless the wire is cut.
Tap = Callable[[str, Vector], Vector]

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")

AnyLaw = TypeVar("AnyLaw", bound="Law")


@dataclass_transform(eq_default=False, field_specifiers=(field,))
def define(cls: type[AnyLaw]) -> type[AnyLaw]:
    """Decorator of a law class: a frozen dataclass, compared by identity, whose ``Gain`` fields take any value that ``Gain`` accepts.

    Raises BadArgument for what is not a class of laws.
    """
    if not isinstance(cls, type) or not issubclass(cls, Law):
        raise BadArgument("cls", cls, "a class derived from mfc.laws.JointLaw or mfc.laws.ToolLaw")
    return dataclass(frozen=True, eq=False)(cls)


class Slot(NamedTuple):
    """A named group of controller states."""

    name: str  #: "z", "z_f", "outer"
    channels: tuple[str, ...]  #: k names, one for each state
    integral: bool = True  #: True: an integral of an error, dropped where it acts on nothing
    trim: Array | None = None  #: (k, r) directions that an operating point trims, so that the command fits the motion; None: all of an integral
    stepped: bool = False  #: True: a state of sampled code, x + T x' at the next sample; False: of a differential equation, advanced exactly

    @property
    def trimmed(self) -> Array:
        """(k, r) directions that an operating point trims."""
        if self.trim is not None:
            return self.trim
        return np.eye(len(self.channels)) if self.integral else np.zeros((len(self.channels), 0))


@dataclass(eq=False, slots=True)  # not frozen, as the next two: made at each evaluation, in a third of the time
class JointReference:
    """Desired joint motion and tool force at the evaluation times."""

    q: Vector  #: (..., n) [rad, m]
    v: Vector  #: (..., n) [rad/s, m/s]
    a: Vector  #: (..., n) [rad/s^2, m/s^2]
    F_d: Vector = field(default_factory=lambda: np.zeros(6))  #: (..., 6) desired wrench on the environment, tool frame; 0 without a force reference


@dataclass(eq=False, slots=True)
class ToolReference:
    """Desired tool motion and force at the evaluation times."""

    X: Pose  #: (..., 4, 4) pose in the base
    V: Vector  #: (..., 6) body twist of the reference [m/s, rad/s], in its own frame
    dV: Vector  #: (..., 6) rate of the components of V [m/s^2, rad/s^2]
    F_d: Vector = field(default_factory=lambda: np.zeros(6))  #: (..., 6) desired wrench on the environment, tool frame; 0 without a force reference


@dataclass(eq=False, slots=True)
class Measured:
    """Inputs of a law: measured signals and its own states."""

    q: Vector  #: (..., n) [rad, m]
    v: Vector  #: (..., n) [rad/s, m/s]
    F: Vector = field(default_factory=lambda: np.zeros(6))  #: (..., 6) measured F_tip [N, Nm], tool frame; 0 without a force sensor
    states: Mapping[str, Vector] = field(default_factory=dict)  #: state of each slot, by its name

    def __getitem__(self, slot: str) -> Vector | None:
        return self.states.get(slot)


class Action(NamedTuple):
    """Outputs of a law: command, rates of its states and error."""

    command: Vector  #: (..., n) torque [Nm, N] or joint velocity [rad/s, m/s]
    rates: Mapping[str, Vector]  #: rate of the state of each slot, by its name
    error: Vector  #: e (..., n) or X_e (..., 6), (..., k) of k selected directions


class Law(ABC):
    """Base class of all laws. Derive from ``JointLaw`` or ``ToolLaw`` and decorate with ``define``.

    In its methods ``model`` is the controller's model of the robot, ``now`` what is measured, and ``ref`` the reference at the same times. ``tap``
    names a signal at which the loop can be opened; ``joints`` are the names of the joints.
    """

    equation: ClassVar[str] = ""  #: number in the chapter, or a few words for a law that is not in it; "": the name of its class
    plant: ClassVar[Literal["velocity", "torque"]] = "torque"
    space: ClassVar[Literal["joint", "tool"]] = "joint"
    opens_at: ClassVar[tuple[str, ...]] = ("torque", "position")  #: analysis points of the class; a law without force feedback has no "force"
    senses_force: ClassVar[bool] = False
    follows_motion: ClassVar[bool] = True  #: False: the reference is a Hold, and a reference step is a step of F_d
    forms: ClassVar[tuple[str, ...]] = ("standard",)
    sources: ClassVar[tuple[str, ...]] = (
        "Lynch & Park, Modern Robotics, ch. 11",
        "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 8",
    )
    typst: ClassVar[str] = ""  #: the equation, as Typst math
    units: ClassVar[Mapping[str, str]] = {}  #: unit of each gain
    inverse_damping: float = 0.0  #: [-] of the inverse of J, where the law has one; 0: raises NearSingular near a singularity
    selection: Selection | None = None  #: the directions that a tool law controls; None: all six
    sample_time: float | None = None  #: [s] of a law that is a difference equation; None: it is a differential equation
    anti_windup: float | None = None  #: [s] time constant of back-calculation where a torque saturates, of laws that have it; None: none

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, annotation in inspect.get_annotations(cls).items():
            default = cls.__dict__.get(name, ...)
            if "Gain" in str(annotation) and not isinstance(default, (Gain, Field)):
                setattr(cls, name, Gain(name, required=True) if default is ... else Gain(name, default))

    @abstractmethod
    def act(self, model: Primitives, now: Measured, ref: Any, tap: Tap) -> Action:
        """The law: command, rates of its states and error, from the controller's model and the measured signals."""

    def lost_command(self, model: Primitives, now: Measured, ref: Any, lost: Vector) -> Vector:
        """(..., k) what a change of the torque by ``lost`` (..., n) takes from Kp e + Ki z + Kd e', by the controller's model."""
        raise Unsupported("anti_windup", type(self).__name__, "a law with an integral in its torque (9.8, 9.10, 9.16)")

    def unwinding(self, model: Primitives, now: Measured, ref: Any, lost: Vector) -> Vector:
        """The part of z' that takes the integral back where the actuators cut ``lost`` (..., n) from the torque: Ki^-1 lost / T."""
        assert self.anti_windup is not None
        size = len(self.error_channels(model.robot.joint_names))
        back = self.gains()["ki"].inverse(size) / self.anti_windup
        return matvec(back, self.lost_command(model, now, ref, lost))

    def check_anti_windup(self) -> None:
        """For ``__post_init__``: raises BadArgument unless ``anti_windup`` is None or positive, with an integral to act on."""
        if self.anti_windup is not None:
            checks.number("anti_windup", self.anti_windup, low=0.0, strict=True)
            if not self.gains().get("ki"):
                raise BadArgument("anti_windup", self.anti_windup, "a gain ki beside it: there is no integral here")

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """The states of the law, for an arm with these joints."""
        if not self.gains().get("ki"):
            return ()
        return (Slot("z", self.error_channels(joints)),)

    def error_channels(self, joints: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the components of the error: the joints, or the directions of the tool."""
        if self.space == "joint":
            return joints
        return TWIST if self.selection is None else self.selection.names

    def command_channels(self, joints: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the channels of the wire "command"."""
        return self.error_channels(joints)

    def check(self, n: int) -> None:
        """Raises BadArgument unless the gains fit an arm of n joints, and the arm has a joint for each selected direction."""
        size, what = (n, "joints") if self.space == "joint" else (6, "components of the twist")
        if self.selection is not None:
            size, what = len(self.selection.rows), "selected directions"
            if size > n:
                raise BadArgument("axes", self.selection.axes, f"at most {n} directions, one for each joint")
        for gain in self.gains().values():
            gain.check(size, what)

    def gains(self) -> dict[str, Gain]:
        """The gains by name, in the order of the fields."""
        return {name: gain for name, gain in vars(self).items() if isinstance(gain, Gain)}

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Names of the parameters of a law of this class, in order."""
        return tuple(f.name for f in fields(cls) if f.init)  # type: ignore[arg-type]  # subclasses are dataclasses

    def changed(self, **values: Any) -> Self:
        """The same law with these ``values`` of some parameters. Raises TypeError for an unknown parameter, BadArgument for a bad value."""
        return replace(self, **values)  # type: ignore[type-var]  # subclasses are dataclasses

    @classmethod
    def numbered(cls) -> str:
        """The equation in words: "eq. 9.16", or the name of a law that the chapter does not have."""
        return f"eq. {cls.equation}" if cls.in_chapter() else cls.equation or cls.__name__

    @classmethod
    def in_chapter(cls) -> bool:
        """True for a law with a number in the chapter."""
        return cls.equation[:1].isdigit()

    @classmethod
    def cited(cls) -> tuple[str, ...]:
        """The sources, the chapter first where it has the law."""
        return (f"chapter, {cls.numbered()}", *cls.sources) if cls.in_chapter() else cls.sources

    @property
    def chosen_form(self) -> str:
        """The selected one of ``forms``: the field ``form``, where the law has one."""
        return str(vars(self).get("form", "standard"))

    # --- properties used by the loop -------------------------------------------------------------------------------

    @property
    def desired_wrench(self) -> Array | None:
        """(6,) F_d [N, Nm], tool frame, of a law with a force reference; None: no force reference."""
        return None

    @property
    def force_directions(self) -> Array | None:
        """(k, 6) rows of the directions, tool frame, in which a tool law controls the force and not the motion; None: none."""
        return None

    @property
    def joint_by_joint(self) -> bool:
        """True where the law is n separate loops, if its gains are diagonal and the joints are not coupled."""
        return self.space == "joint" and self.follows_motion

    @property
    def needs_acceleration(self) -> bool:
        """True where ``acceleration_torque`` is part of the law: an algebraic loop, solved together with q''."""
        return False

    def acceleration_torque(self, model: Primitives, ref: JointReference, a: Vector) -> Vector:
        """(..., n) torque, linear in a, that the law subtracts for the measured acceleration a (..., n). Raises Unsupported without any."""
        raise Unsupported("law", type(self).__name__, "a law that needs the acceleration")

    def __str__(self) -> str:
        gains = ", ".join(f"{k} = {g!r}" for k, g in self.gains().items() if g)
        choices = {f.name: getattr(self, f.name) for f in fields(self) if isinstance(f.default, str)}  # type: ignore[arg-type]  # as above
        usual = {f.name: f.default for f in fields(self)}  # type: ignore[arg-type]
        if self.selection is not None:
            choices["axes"] = self.selection.axes if isinstance(self.selection.axes, str) else self.selection.rows.tolist()
        if self.anti_windup is not None:
            choices["anti_windup"] = self.anti_windup
        shown = ", ".join([gains] * bool(gains) + [f"{name}={chosen!r}" for name, chosen in choices.items() if chosen != usual[name]])
        return f"{type(self).__name__}({shown}) [{self.numbered()}]"


class JointLaw(Law):
    """A law in joint space: its reference is q_d, v_d, a_d."""

    space = "joint"

    @abstractmethod
    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """The law: command, rates of its states and error, from the controller's model and the measured signals."""


class ToolLaw(Law):
    """A law in tool space: its reference is X_d, V_d, V_d' on SE(3).

    One with a field ``axes`` controls only those directions of the tool where it is given (``Selection``).
    """

    space = "tool"

    def select(self) -> None:
        """Sets ``selection`` from the field ``axes``, for ``__post_init__``. Raises BadArgument."""
        axes = vars(self)["axes"]
        if axes is not None:
            object.__setattr__(self, "selection", chosen := Selection(axes))
            object.__setattr__(self, "axes", chosen.axes)

    def task(self, model: Primitives, q: Vector, ref: ToolReference) -> ToolTask:
        """The directions of this law at q: their error, its velocity, and the maps between them and the joints."""
        return tool_task(self.selection, model, q, ref.X, ref.V, ref.dV)

    @abstractmethod
    def act(self, model: Primitives, now: Measured, ref: ToolReference, tap: Tap) -> Action:
        """The law: command, rates of its states and error, from the controller's model and the measured signals."""
