"""The control laws of the chapter, one class for each equation."""

from mfc_analysis.laws.catalogue import LAWS, by_equation
from mfc_analysis.laws.force import DampedForcePI, ForcePI, OpenLoopForce
from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.hybrid import HybridMotionForce
from mfc_analysis.laws.joint_torque import ComputedTorque, InverseDynamics, JointPID, TorqueFeedforward
from mfc_analysis.laws.law import Action, Law, Measured, Slot, Tap
from mfc_analysis.laws.task_torque import TaskComputedTorque
from mfc_analysis.laws.velocity import TaskVelocity, VelocityFeedforward, VelocityFeedforwardPI, VelocityP, VelocityPI

__all__ = [
    "LAWS",
    "Action",
    "ComputedTorque",
    "DampedForcePI",
    "ForcePI",
    "Gain",
    "HybridMotionForce",
    "InverseDynamics",
    "JointPID",
    "Law",
    "Measured",
    "OpenLoopForce",
    "Slot",
    "Tap",
    "TaskComputedTorque",
    "TaskVelocity",
    "TorqueFeedforward",
    "VelocityFeedforward",
    "VelocityFeedforwardPI",
    "VelocityP",
    "VelocityPI",
    "by_equation",
]
