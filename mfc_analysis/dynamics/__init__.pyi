from .environment import Environment as Environment
from .equations import Equations as Equations
from .hardware import Hardware as Hardware, Servo as Servo
from .operating_point import Nominal as Nominal, OperatingPoint as OperatingPoint
from .quasi_static import QuasiStatic as QuasiStatic
