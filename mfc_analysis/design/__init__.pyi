from .attribution import Attribution as Attribution, attribute as attribute
from .dead_time import DelayMap as DelayMap, delay_map as delay_map, over_delay as over_delay
from .impact import Impact as Impact, impact as impact
from .limits import (
    max_bandwidth as max_bandwidth,
    max_delay as max_delay,
    max_payload as max_payload,
    max_stiffness as max_stiffness,
    min_sample_rate as min_sample_rate,
)
from .searches import Limit as Limit, Outcome as Outcome
from .stiffness import (
    StabilityMap as StabilityMap,
    StiffnessSweep as StiffnessSweep,
    over_stiffness as over_stiffness,
    stiffness_map as stiffness_map,
)
from .sweeps import sweep as sweep
from .tuning import Tuned as Tuned, tune as tune
from .worst_case import WorstCase as WorstCase, worst_case as worst_case
