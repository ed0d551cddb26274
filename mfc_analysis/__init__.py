"""Control-design analysis of the motion and force controllers of a robot arm: stability, margins, gains, on any URDF.

Names resolve lazily (PEP 562, from the stub beside each ``__init__``): control, scipy, pinocchio and matplotlib load at first use.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
