"""Gains from a bandwidth, a natural frequency, a crossover or a settling time, with the metrics they achieve."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
