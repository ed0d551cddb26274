"""Many figures at once: over 20, a second process draws half of them.

The second process is this Python running ``mfc_analysis.plots.worker``; it imports neither control nor pinocchio. A recipe that does not pickle, or a
process that cannot be started, costs time only: the figures are drawn here.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

from mfc_analysis.plots import figure as sheet

MANY = 20  #: up to so many figures one process is faster: starting another takes 0.6 s


def drawn(recipes: Sequence[Any], *, progress: Callable[[int], None] | None = None) -> list[str]:
    """SVG of each recipe (a callable without arguments, or Axes drawn already), in order; the same bytes whoever draws them.

    ``progress`` is called with the number of figures that came out since the last call.
    """
    out: list[str | None] = [None] * len(recipes)
    other = _sent(recipes) if len(recipes) > MANY and (os.cpu_count() or 1) > 1 else None
    away = other[1] if other is not None else frozenset()
    for i, recipe in enumerate(recipes):
        if i not in away:
            out[i] = sheet.svg(recipe)
            if progress is not None:
                progress(1)
    if other is not None:
        for i, text in _received(other[0]).items():
            out[i] = text
    for i, text_or_none in enumerate(out):
        if text_or_none is None:
            out[i] = sheet.svg(recipes[i])
    if progress is not None and away:
        progress(len(away))
    return [text for text in out if text is not None]


def _sent(recipes: Sequence[Any]) -> tuple[subprocess.Popen[bytes], frozenset[int]] | None:
    """Starts the second process on every other recipe that pickles."""
    parcels = {}
    for i in range(1, len(recipes), 2):
        if callable(recipes[i]):
            try:
                parcels[i] = pickle.dumps(recipes[i])
            except (pickle.PicklingError, AttributeError, TypeError):
                continue
    if not parcels or not sys.executable:
        return None
    paths = os.pathsep.join(p for p in sys.path if p)
    environment = os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "mfc_analysis.plots.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        assert process.stdin is not None
        pickle.dump(parcels, process.stdin)
        process.stdin.close()
    except OSError:
        return None
    return process, frozenset(parcels)


def _received(process: subprocess.Popen[bytes]) -> dict[int, str]:
    assert process.stdout is not None
    content = process.stdout.read()
    process.stdout.close()
    if process.wait() != 0:
        return {}
    found: dict[int, str] = pickle.loads(content)
    return found
