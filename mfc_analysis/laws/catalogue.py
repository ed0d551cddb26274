"""All laws, by equation number."""

from __future__ import annotations

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.laws.admittance import Admittance
from mfc_analysis.laws.force import DampedForcePI, ForcePI, OpenLoopForce
from mfc_analysis.laws.hybrid import HybridMotionForce
from mfc_analysis.laws.impedance import Impedance, JointImpedance
from mfc_analysis.laws.joint_torque import ComputedTorque, InverseDynamics, JointPID, TorqueFeedforward
from mfc_analysis.laws.law import Law
from mfc_analysis.laws.task_torque import TaskComputedTorque
from mfc_analysis.laws.velocity import TaskVelocity, VelocityFeedforward, VelocityFeedforwardPI, VelocityP, VelocityPI

#: equation -> law; 9.12 is 9.10 for one joint, 9.13 the closed loop of 9.11. Laws that the chapter does not have go by their names
LAWS: dict[str, type[Law]] = {
    "9.1": VelocityFeedforward,
    "9.2": VelocityP,
    "9.3": VelocityPI,
    "9.4": VelocityFeedforwardPI,
    "9.5": TaskVelocity,
    "9.8": JointPID,
    "9.9": TorqueFeedforward,
    "9.10": ComputedTorque,
    "9.11": InverseDynamics,
    "9.12": ComputedTorque,
    "9.13": InverseDynamics,
    "9.16": TaskComputedTorque,
    "9.21": OpenLoopForce,
    "9.22": ForcePI,
    "9.23": DampedForcePI,
    "9.24": HybridMotionForce,
    "impedance": Impedance,
    "joint impedance": JointImpedance,
    "admittance": Admittance,
}


def by_equation(number: str) -> type[Law]:
    """The class of the law with this equation number, such as "9.10" (as text: the number 9.10 equals 9.1). Raises UnknownName, BadArgument."""
    if not isinstance(number, str):
        raise BadArgument("number", number, 'the equation as text, such as "9.10": the number 9.10 equals 9.1')
    key = number.strip().removeprefix("eq").strip(" .()")
    if key not in LAWS:
        raise UnknownName("number", number, LAWS)
    return LAWS[key]
