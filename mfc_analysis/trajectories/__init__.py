"""References: joint-space and tool-space trajectories, and the way from one to the other."""

from mfc_analysis.trajectories.inverse_kinematics import JointPath, follow, from_tool_path, solve_pose
from mfc_analysis.trajectories.joint import (
    Hold,
    JointPoint,
    JointReference,
    Quintic,
    Sinusoid,
    Waypoints,
    from_csv,
    warn_outside_limits,
)
from mfc_analysis.trajectories.tool import ToolCircle, ToolHold, ToolLine, ToolPoint, ToolReference, ToolSinusoid

__all__ = [
    "Hold",
    "JointPath",
    "JointPoint",
    "JointReference",
    "Quintic",
    "Sinusoid",
    "ToolCircle",
    "ToolHold",
    "ToolLine",
    "ToolPoint",
    "ToolReference",
    "ToolSinusoid",
    "Waypoints",
    "follow",
    "from_csv",
    "from_tool_path",
    "solve_pose",
    "warn_outside_limits",
]
