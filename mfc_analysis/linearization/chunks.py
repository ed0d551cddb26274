"""Results at many operating points, in chunks: bounded memory, and several processes where asked for.

The chunks are the same for any number of processes, and so are the numbers, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from typing import Any, TypeVar, cast

import numpy as np

EACH_POINT = ("slow_roots", "motion", "walks")  #: tuples with one entry for each point

Part = TypeVar("Part")
Result = TypeVar("Result")


def each(call: Callable[[Part], Result], parts: Iterator[Part], n_jobs: int | None) -> list[Result]:
    """The call on every part, in order."""
    import joblib

    return cast("list[Result]", joblib.Parallel(n_jobs=n_jobs)(joblib.delayed(call)(part) for part in parts))


def joined(parts: list[Result], **chosen: Any) -> Result:
    """One result at all points from those of the chunks: arrays over times joined, ``chosen`` fields as given, others of the first."""
    first = parts[0]
    values = {f.name: getattr(first, f.name) for f in fields(cast(Any, first))}
    for name, one in values.items():
        if isinstance(one, np.ndarray):
            values[name] = np.concatenate([getattr(part, name) for part in parts])
        elif isinstance(one, tuple) and name in EACH_POINT:
            values[name] = tuple(value for part in parts for value in getattr(part, name))
    return cast(Result, replace(cast(Any, first), **{**values, **chosen}))
