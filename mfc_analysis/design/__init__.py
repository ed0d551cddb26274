"""Design searches: the largest stiffness, payload, dead time and bandwidth, the smallest sample rate, the worst case, sweeps and maps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
