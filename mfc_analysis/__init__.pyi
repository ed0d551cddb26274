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

__version__: str
