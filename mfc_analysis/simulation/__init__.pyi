from .run import Event as Event, Outcome as Outcome
from .simulation import Simulation as Simulation, simulate as simulate
from .validation import Validation as Validation, validate as validate
