import mfc_analysis.analysis as analysis
import mfc_analysis.design as design
import mfc_analysis.errors as errors
import mfc_analysis.gains as gains
import mfc_analysis.laws as laws
import mfc_analysis.laws.constraints as constraints
import mfc_analysis.plots as plots
import mfc_analysis.report as report
import mfc_analysis.robots as robots
import mfc_analysis.testing as testing
import mfc_analysis.trajectories as trajectories
from mfc_analysis.environment import Environment as Environment
from mfc_analysis.hardware import Hardware as Hardware
from mfc_analysis.laws.constraints import ConstraintSet as ConstraintSet
from mfc_analysis.linearization import Linearization as Linearization
from mfc_analysis.loop import ClosedLoop as ClosedLoop
from mfc_analysis.requirements import Requirements as Requirements
from mfc_analysis.requirements import Verdict as Verdict
from mfc_analysis.robots.robot import Robot as Robot
from mfc_analysis.simulation import Simulation as Simulation
from mfc_analysis.sweeps import sweep as sweep
from mfc_analysis.units import hertz as hertz

__all__ = [
    "ClosedLoop",
    "ConstraintSet",
    "Environment",
    "Hardware",
    "Linearization",
    "Requirements",
    "Robot",
    "Simulation",
    "Verdict",
    "analysis",
    "constraints",
    "design",
    "errors",
    "gains",
    "hertz",
    "laws",
    "plots",
    "report",
    "robots",
    "sweep",
    "testing",
    "trajectories",
]

__version__: str
