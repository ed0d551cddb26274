"""The neck of the house: the equations of the whole loop, what it touches, and where it is looked at."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
