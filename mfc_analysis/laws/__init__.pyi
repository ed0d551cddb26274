from . import constraints as constraints
from .admittance import Admittance as Admittance
from .catalogue import LAWS as LAWS, by_equation as by_equation
from .force import DampedForcePI as DampedForcePI, ForcePI as ForcePI, OpenLoopForce as OpenLoopForce
from .gain import Gain as Gain
from .hybrid import HybridMotionForce as HybridMotionForce
from .impedance import Impedance as Impedance, JointImpedance as JointImpedance
from .joint_torque import (
    ComputedTorque as ComputedTorque,
    InverseDynamics as InverseDynamics,
    JointPID as JointPID,
    TorqueFeedforward as TorqueFeedforward,
)
from .law import (
    Action as Action,
    JointLaw as JointLaw,
    JointReference as JointReference,
    Law as Law,
    Measured as Measured,
    Slot as Slot,
    Tap as Tap,
    ToolLaw as ToolLaw,
    ToolReference as ToolReference,
    define as define,
)
from .task_torque import TaskComputedTorque as TaskComputedTorque
from .velocity import (
    TaskVelocity as TaskVelocity,
    VelocityFeedforward as VelocityFeedforward,
    VelocityFeedforwardPI as VelocityFeedforwardPI,
    VelocityP as VelocityP,
    VelocityPI as VelocityPI,
)
