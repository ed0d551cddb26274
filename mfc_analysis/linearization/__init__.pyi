from .coupling import Coupling as Coupling, coupling as coupling
from .decentralised import Decentralised as Decentralised
from .linearization import Linearization as Linearization, linearize as linearize
from .second_opinion import Comparison as Comparison, Judgement as Judgement, SecondOpinion as SecondOpinion
