"""Poles, stability, margins and responses from A, B, C, D and names. Independent of any robot."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
