"""Python's garbage collector, run less often: each run visits the objects created since the last one, and now and then all of them."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

NEW = 50_000  #: objects created between two runs; with Python's default of 700 it takes a tenth of the time of a report


@contextmanager
def rare_collections() -> Iterator[None]:
    """Within, the collector runs every ``NEW`` objects; a higher number of the user, or none, is kept."""
    before = gc.get_threshold()
    rarer = 0 < before[0] < NEW
    if rarer:
        gc.set_threshold(NEW, *before[1:])
    try:
        yield
    finally:
        if rarer:  # else another thread may have set it, and sets it back
            gc.set_threshold(*before)
