"""A function that a search asks at one argument after another, while what it may ask next is computed: by other processes, or together with it.

The search stays sequential, and so do its results, to the last bit. What is computed and never asked for is dropped, with its error and
its warnings.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Iterable, Sequence
from itertools import chain, islice
from typing import Any, Generic, NamedTuple, TypeVar, cast

from mfc_analysis.errors import MfcError
from mfc_analysis.maths import checks

X = TypeVar("X", bound=Hashable)
Y = TypeVar("Y")

TOGETHER = 3  #: arguments computed together: of a bisection the next two steps


class _Answer(NamedTuple):
    """What a call returned or raised, with its warnings as arguments of ``warn_explicit``."""

    value: Any
    error: Exception | None
    said: list[tuple[Warning | str, type[Warning], str, int]]


class Ahead(Generic[X, Y]):
    """``ahead(x, then)`` is ``call(x)``; with several processes the next of the arguments ``then`` are computed at the same time and kept.

    ``n_jobs``: processes, -1 for one on each core; None: set by ``joblib.parallel_config``, else one. ``together``: what ``call`` returns for
    several arguments, faster than one by one, or None where it cannot; for one process. Raises BadArgument.
    """

    def __init__(
        self, call: Callable[[X], Y], n_jobs: int | None = None, together: Callable[[Sequence[X]], Sequence[Y] | None] | None = None
    ) -> None:
        import joblib

        self.call, self.n_jobs, self.together = call, checks.jobs(n_jobs), together
        self.workers = int(joblib.effective_n_jobs(cast(int, n_jobs)))  # it takes None, whatever its types say
        self.known: dict[X, _Answer] = {}
        self.told: dict[Any, Any] = {}  #: registry of the warnings given

    def __call__(self, x: X, then: Iterable[X] = ()) -> Y:
        if self.workers == 1 and self.together is None:
            return self.call(x)
        if x not in self.known:
            many = max(self.workers, TOGETHER if self.workers == 1 else 0)
            new = (one for one in dict.fromkeys(chain([x], islice(then, 4 * many))) if one not in self.known)
            asked = list(islice(new, many))
            found = self._several(asked) if len(asked) > 1 else None  # else nothing to do at the same time
            if found is None:
                return self.call(x)
            self.known.update(zip(asked, found, strict=True))
        answer = self.known[x]
        for message, category, file, line in answer.said:
            warnings.warn_explicit(message, category, file, line, registry=self.told)
        if answer.error is not None:
            raise answer.error
        return cast(Y, answer.value)

    def _several(self, asked: list[X]) -> list[_Answer] | None:
        if self.workers > 1:
            import joblib

            return cast("list[_Answer]", joblib.Parallel(n_jobs=self.n_jobs)(joblib.delayed(answered)(self.call, one) for one in asked))
        try:
            found = None if self.together is None else self.together(asked)
        except MfcError:  # of one that may never be asked for
            return None
        return None if found is None else [_Answer(value, None, []) for value in found]


def answered(call: Callable[[X], Y], x: X) -> _Answer:
    """What ``call(x)`` does. A module-level function, so that every backend can send it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        value, error = None, None
        try:
            value = call(x)
        except Exception as why:  # raised where, and if, it is asked for
            error = why
    return _Answer(value, error, [(w.message, w.category, w.filename, w.lineno) for w in said])
