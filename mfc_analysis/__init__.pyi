from . import (
    analysis as analysis,
    design as design,
    errors as errors,
    gains as gains,
    laws as laws,
    plots as plots,
    report as report,
    requirements as requirements,
    robots as robots,
    simulation as simulation,
    study as study,
    testing as testing,
    trajectories as trajectories,
)
from .analysis import frf as frf
from .analysis.plain import delay_roots as delay_roots, disk_margin as disk_margin, margins as margins
from .design import sweep as sweep
from .dynamics import Environment as Environment, Hardware as Hardware, Servo as Servo
from .laws import constraints as constraints
from .laws.constraints import ConstraintSet as ConstraintSet
from .linearization import Linearization as Linearization
from .loop import ClosedLoop as ClosedLoop
from .requirements import Requirements as Requirements, Verdict as Verdict
from .robots import Robot as Robot
from .simulation import Simulation as Simulation
from .units import hertz as hertz

__version__: str
