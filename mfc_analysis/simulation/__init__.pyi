from .run import Outcome as Outcome
from .simulation import Simulation as Simulation, simulate as simulate
from .touching import Event as Event
from .validation import Validation as Validation, validate as validate
