"""From A, B, C, D and names to poles, stability, margins, responses. Knows no robot."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
