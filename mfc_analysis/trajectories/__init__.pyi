from .inverse_kinematics import JointPath as JointPath, follow as follow, from_tool_path as from_tool_path, solve_pose as solve_pose
from .joint import (
    Hold as Hold,
    JointPoint as JointPoint,
    JointReference as JointReference,
    Quintic as Quintic,
    Sinusoid as Sinusoid,
    Waypoints as Waypoints,
    from_csv as from_csv,
    warn_outside_limits as warn_outside_limits,
)
from .tool import (
    ToolCircle as ToolCircle,
    ToolHold as ToolHold,
    ToolLine as ToolLine,
    ToolPoint as ToolPoint,
    ToolReference as ToolReference,
    ToolSinusoid as ToolSinusoid,
)
