"""References: joint-space and tool-space trajectories, and the conversion of tool paths to joint space."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
