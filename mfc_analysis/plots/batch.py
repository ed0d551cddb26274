"""Drawing many figures: two processes draw them if there are more than 20."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from pickle import PicklingError
from typing import Any, TypeVar

from mfc_analysis.plots import figure as sheet

Made = TypeVar("Made")

MANY = 20  #: up to this number of figures one process is faster: starting others takes about a second
SHARE = 4  #: figures drawn between two calls of ``progress``


def drawn(recipes: Sequence[Any], *, progress: Callable[[int], None] | None = None) -> list[str]:
    """SVG of each recipe (a callable without arguments, or finished Axes), in order; the same bytes from any process.

    ``progress`` is called with the number of figures finished since the last call.
    """
    shares = [recipes[k : k + SHARE] for k in range(0, len(recipes), SHARE)]
    out: list[list[str]] = []

    def keep(found: Iterable[list[str]]) -> None:
        for some in found:
            out.append(some)
            if progress is not None:
                progress(len(some))

    if len(recipes) > MANY:
        with suppress(PicklingError):  # a recipe that does not pickle: it and those after it are drawn in this process
            keep(in_two_processes(partial(sheet.svgs, some) for some in shares))
    keep(map(sheet.svgs, shares[len(out) :]))
    return [text for some in out for text in some]


def in_two_processes(tasks: Iterable[Callable[[], Made]]) -> Iterable[Made]:
    """What each task returns, in order, as it comes; half of the tasks run in a second process, where there is a core for it."""
    from joblib import Parallel, cpu_count, delayed

    done: Any = Parallel(n_jobs=min(2, cpu_count()), return_as="generator")(delayed(task)() for task in tasks)
    found: Iterable[Made] = done
    return found
