"""A user's own law at the door: its attributes, and once what ``act`` gives, for plain and for dual arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from mfc_analysis.dynamics.equations import PLANT_SLOTS, Equations
from mfc_analysis.dynamics.flow import Wires
from mfc_analysis.errors import BadArgument, MfcError, NearPi, NearSingular
from mfc_analysis.laws.law import Action, Law, Measured, Slot
from mfc_analysis.maths import checks
from mfc_analysis.maths.dual import Seed, Vector, value

TAKEN = (*PLANT_SLOTS, "q_before", "v_filter", "F_filter")  #: names of states that are not the law's
OPERATIONS = "+, -, *, slices [..., a:b], gain @ x, the methods of model, and elementwise for any other function"


def is_own(law: Law) -> bool:
    """True for a law that is not one of this package."""
    return not type(law).__module__.startswith("mfc_analysis.")


def check_attributes(law: Law, joints: tuple[str, ...]) -> None:
    """Raises BadArgument where an attribute or the slots of a user's law are not what the loop takes."""
    checks.choice("law.plant", law.plant, ("torque", "velocity"))
    checks.choice("law.space", law.space, ("joint", "tool"))
    if not isinstance(law.equation, str):
        raise BadArgument("law.equation", law.equation, 'a few words, such as equation = "own: PD with gravity compensation"')
    if not isinstance(law.opens_at, tuple) or not all(isinstance(point, str) for point in law.opens_at):
        raise BadArgument("law.opens_at", law.opens_at, 'a tuple of names, such as ("torque", "position")')
    if law.sample_time is not None:
        checks.number("law.sample_time", law.sample_time, low=0.0, strict=True)
    slots = law.slots(joints)
    if not isinstance(slots, (tuple, list)) or not all(isinstance(slot, Slot) for slot in slots) or isinstance(slots, Slot):
        raise BadArgument("law.slots", slots, "a tuple of Slot")
    names = [slot.name for slot in slots]
    for i, name in enumerate(names):
        if name in TAKEN or name in names[:i]:
            raise BadArgument("law.slots", name, f"different names, none of {', '.join(TAKEN)}")


def check_action(e: Equations) -> None:
    """Raises BadArgument where ``act`` fails at the start of the reference, or what it gives does not fit the loop."""
    law, n = e.law, e.n
    name, m = type(law).__name__, 3 if n != 3 else 4
    x = np.repeat(e.start[None], m, axis=0)
    try:
        plain, wires = _acted(e, x, m)
    except (NearPi, NearSingular):  # said with its time where it is evaluated
        return
    if not isinstance(plain, Action):
        raise BadArgument("law", f"{name}.act returns a {type(plain).__name__}", "an Action(command, rates, error)")
    joints = e.robot.joint_names
    sizes = {"command": (plain.command, n), "error": (plain.error, len(law.error_channels(joints)))}
    slots = {slot.name: len(slot.channels) for slot in law.slots(joints)}
    if set(plain.rates) != set(slots):
        raise BadArgument("law", f"{name}.act gives rates of {sorted(plain.rates)}", f"the rate of each of its slots: {sorted(slots)}")
    sizes |= {f"rate of {slot!r}": (plain.rates[slot], size) for slot, size in slots.items()}
    for what, (given, size) in sizes.items():
        if np.shape(value(given)) not in ((size,), (m, size)):
            raise BadArgument("law", f"{name}.act of {m} points: {what} of shape {np.shape(value(given))}", f"one of shape ({m}, {size})")
        if not np.isfinite(np.asarray(value(given), float)).all():
            raise BadArgument("law", f"{name}.act: {what} that is not finite, on the reference", "finite numbers")
    missing = [point for point in law.opens_at if point not in (e.actuator, "position", "force") and point not in wires.recorded]
    if missing:
        raise BadArgument("law.opens_at", missing[0], f"a point that {name}.act names with tap, {e.actuator!r}, or 'position' and 'force'")
    _acted(e, Seed(x, 0, e.nx), m)


def _acted(e: Equations, x: Vector, m: int) -> tuple[Any, Wires]:
    """What ``act`` gives at m states x, and the wires that it named."""
    wires, s = Wires(), e.split(x)
    try:
        now = Measured(s["q"], s.get("v", np.zeros(e.n)), np.zeros(6), s)
        return e.law.act(e.controller, now, e.reference(np.zeros(m)), wires), wires
    except MfcError:
        raise
    except (TypeError, AttributeError, LookupError, ValueError) as why:  # of numpy and of Dual, which say what they got and not what they take
        kind = "dual arrays" if isinstance(x, Seed) else "arrays of several points"
        raise BadArgument("law", f"{type(e.law).__name__}.act on {kind}: {type(why).__name__}: {why}", OPERATIONS) from why
