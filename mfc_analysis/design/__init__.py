"""Searches over a loop: the largest stiffness, payload, dead time and bandwidth, the slowest sampling, the worst case, sweeps and maps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
