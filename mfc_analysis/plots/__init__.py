"""Plots of results. A plot takes values and returns axes; it computes no control theory. matplotlib loads at first use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
