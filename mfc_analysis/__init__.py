"""Control-design analysis of the motion and force controllers of a robot arm: stability, margins, gains, on any URDF.

Names resolve lazily (PEP 562): control, scipy, pinocchio and matplotlib load at first use.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

_MODULES = {
    name: f"mfc_analysis.{name}" for name in ("design", "errors", "gains", "laws", "report", "robots", "testing", "trajectories", "analysis", "plots")
} | {"constraints": "mfc_analysis.laws.constraints"}

_NAMES = {
    "ClosedLoop": "mfc_analysis.loop",
    "ConstraintSet": "mfc_analysis.laws.constraints",
    "Environment": "mfc_analysis.environment",
    "Hardware": "mfc_analysis.hardware",
    "Linearization": "mfc_analysis.linearization",
    "Requirements": "mfc_analysis.requirements",
    "Robot": "mfc_analysis.robots.robot",
    "Simulation": "mfc_analysis.simulation",
    "Verdict": "mfc_analysis.requirements",
    "hertz": "mfc_analysis.units",
    "sweep": "mfc_analysis.sweeps",
}

__all__ = sorted([*_MODULES, *_NAMES])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        found = importlib.import_module(_MODULES[name])
    elif name in _NAMES:
        found = getattr(importlib.import_module(_NAMES[name]), name)
    else:
        raise AttributeError(f"module 'mfc_analysis' has no attribute {name!r}; it has {', '.join(__all__)}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
