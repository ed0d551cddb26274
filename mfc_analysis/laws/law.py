"""What every law offers to the loop: its equation, its states, where it can be opened, and its action.

A law is a value. ``act`` is pure: the equation of the chapter, over the primitives of the controller's own model, for plain
and dual arrays alike. States of the loop (integrals, an LTI outer loop) come in by ``Measured`` and their rates go out by
``Action``; nothing is stored in the law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.laws.gain import Gain
from mfc_analysis.maths.dual import Vector
from mfc_analysis.maths.se3 import Pose
from mfc_analysis.robots.primitives import Primitives

Array = NDArray[np.float64]

#: names a wire: returns what goes on behind it (the same signal, unless the wire is cut)
Tap = Callable[[str, Vector], Vector]

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


class Slot(NamedTuple):
    """A named group of controller states."""

    name: str  #: "z", "z_f", "outer"
    channels: tuple[str, ...]
    integral: bool = True  #: an integral of an error (trimmed at the operating point, dropped where it acts on nothing)


@dataclass(frozen=True, eq=False)
class JointReference:
    """Desired joint motion at the evaluated times."""

    q: Vector  #: (..., n)
    v: Vector
    a: Vector


@dataclass(frozen=True, eq=False)
class ToolReference:
    """Desired tool motion at the evaluated times."""

    X: Pose
    V: Vector  #: (..., 6) body twist of the reference, in its own frame
    dV: Vector  #: (..., 6)


@dataclass(frozen=True, eq=False)
class Measured:
    """What the law sees: measured signals and its own states."""

    q: Vector  #: (..., n)
    v: Vector  #: (..., n)
    F: Vector | None = None  #: (..., 6) measured F_tip, tool frame
    states: Mapping[str, Vector] = field(default_factory=dict)

    def __getitem__(self, slot: str) -> Vector | None:
        return self.states.get(slot)


class Action(NamedTuple):
    """What the law commands and how its states move."""

    command: Vector  #: torque or joint velocity (..., n)
    rates: Mapping[str, Vector]  #: slot -> rate
    error: Vector  #: e (..., n) or X_e (..., 6)


class Law:
    """Base of all laws. Subclasses are frozen dataclasses; fields annotated with ``Gain`` become one."""

    equation: ClassVar[str]  #: number in the chapter
    plant: ClassVar[Literal["velocity", "torque"]] = "torque"
    space: ClassVar[Literal["joint", "tool"]] = "joint"
    opens_at: ClassVar[tuple[str, ...]] = ("torque", "position")
    senses_force: ClassVar[bool] = False
    forms: ClassVar[tuple[str, ...]] = ("standard",)
    sources: ClassVar[tuple[str, ...]] = (
        "Lynch & Park, Modern Robotics, ch. 11",
        "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 8",
    )
    typst: ClassVar[str] = ""  #: the equation, as Typst math
    units: ClassVar[Mapping[str, str]] = {}  #: gain -> unit

    def __post_init__(self) -> None:
        self._coerce(*(f.name for f in fields(self) if "Gain" in str(f.type)))  # type: ignore[arg-type]  # subclasses are dataclasses

    def act(self, model: Primitives, now: Measured, ref: JointReference | ToolReference, tap: Tap) -> Action:
        """The law: command, rates of its states and error, from the controller's model and what is measured."""
        raise TypeError(f"{type(self).__name__} is not a law: it defines no act()")

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """The law's own states, for an arm with these joints."""
        if not getattr(self, "ki", None):
            return ()
        return (Slot("z", joints if self.space == "joint" else TWIST),)

    def command_channels(self, joints: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the channels of the wire "command"."""
        return joints if self.space == "joint" else TWIST

    def check(self, n: int) -> None:
        """Raise BadArgument unless the gains fit an arm of n joints."""
        for gain in self.gains().values():
            gain.check(n if self.space == "joint" else 6, "joints" if self.space == "joint" else "components of the twist")

    def gains(self) -> dict[str, Gain]:
        """The gains by name, in the order of the fields."""
        return {f.name: g for f in fields(self) if isinstance(g := getattr(self, f.name), Gain)}  # type: ignore[arg-type]

    def _coerce(self, *names: str) -> None:
        for name in names:
            object.__setattr__(self, name, Gain(name, getattr(self, name)))

    def __str__(self) -> str:
        gains = ", ".join(f"{k} = {g!r}" for k, g in self.gains().items() if g)
        form = getattr(self, "form", "standard")
        shown = "" if form == "standard" else f", form={form!r}"
        return f"{type(self).__name__}({gains}{shown}) [eq. {self.equation}]"
