from .contact import admittance as admittance, cartesian_damping as cartesian_damping, impedance as impedance
from .formulas import force_pi as force_pi, joint_pid as joint_pid, p as p, pd as pd, pi as pi, pid as pid
from .joints import CoupledLoop as CoupledLoop
from .result import Achieved as Achieved, DampingMatrix as DampingMatrix, Gains as Gains
