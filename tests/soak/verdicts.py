"""Soak: verdicts, margins, gain intervals and the stiffest wall of six arms at 100 random poses each, against numpy's eigenvalues.

The cases of ``tests/test_arms.py`` in full; with dead time, at every 25th pose, against an independent count of the roots; and
``max_stiffness`` at every 25th pose against a bisection on those eigenvalues (or that count). Not collected by pytest and not part of CI:
``python tests/soak/verdicts.py [poses] [first] [arm ...]``. Exit code 1 where something is wrong.
"""

from __future__ import annotations

import re
import sys
import time
import warnings
from collections import Counter
from dataclasses import replace

import numpy as np

import mfc_analysis as mfc
from tests.soak.contour import Undecided, decays
from tests.test_arms import ARMS, HORIZON, check, decays as decay, loops, rates

SECOND = 25  #: every so many poses the slower comparisons are made
TOP = 1e8  #: [N/m] upper end of the search for the stiffest wall


def holds(loop: mfc.ClosedLoop, stiffness: float) -> bool:
    """Whether the loop decays, a slow part aside, on a wall of this stiffness [N/m] and the same force, by a way of its own."""
    wall = loop.environment
    assert isinstance(wall, mfc.Environment)
    lin = replace(loop, environment=replace(wall, stiffness=stiffness)).linearize([0.0], horizon=HORIZON)
    if lin.delay:
        return decays(lin)
    return decay(rates(lin.A[0], lin.dt))


def stiffest(loop: mfc.ClosedLoop, said: str) -> str:
    """``max_stiffness`` of a loop against a scan and a bisection; what is wrong, or ''."""
    limit = mfc.design.max_stiffness(loop, TOP, horizon=HORIZON)
    softer = [float(x) for note in limit.notes for x in re.findall(r"also not stable from .* up to (\S+)", note)]  # it says so
    first = max([1e-3 * limit if np.isfinite(limit) else 1e2, 1e-8 * TOP, *(1.34 * x for x in softer)])  # the next step of its scan
    try:
        if limit == 0:
            return "" if not holds(loop, 1e-8 * TOP) else f"max_stiffness 0, but it holds at the softest wall: {said}"
        if np.isinf(limit):
            lost = [k for k in np.geomspace(first, TOP, 7) if not holds(loop, float(k))]
            return f"max_stiffness inf, but unstable at {lost}: {said}" if lost else ""
        if not holds(loop, 0.999 * limit) or holds(loop, 1.001 * limit):
            return f"max_stiffness {limit:.6g}: 0.999 {holds(loop, 0.999 * limit)}, 1.001 {holds(loop, 1.001 * limit)}: {said}"
        lost = [k for k in np.geomspace(first, 0.99 * limit, 5) if first < k and not holds(loop, float(k))]
        return f"max_stiffness {limit:.6g}, but unstable below, at {lost}: {said}" if lost else ""
    except Undecided:
        return ""


def pose(arm: str, seed: int, found: Counter[str]) -> None:
    """All cases of one arm at one pose, counted in ``found``; what is wrong is printed."""
    full = seed % SECOND == 0
    for name, kind, loop in loops(arm, seed):
        said = f"{arm} {seed} {name} {kind}"
        start = time.perf_counter()
        try:
            compared, intervals = check(name, kind, loop)
            took = time.perf_counter() - start
            if kind == "dead time" and full:
                lin = loop.linearize([0.0], horizon=HORIZON)
                try:
                    assert bool(lin.stability.nonzero_stable[0]) == decays(lin), "the count says otherwise"
                    compared = True
                except Undecided:
                    found["undecided"] += 1
            if full and loop.environment is not None and name[:4] in ("9.22", "9.23", "9.24"):
                wrong = stiffest(loop, said)
                found["stiffest walls"] += 1
                assert not wrong, wrong
        except Exception as why:
            found["WRONG"] += 1
            sys.stdout.write(f"WRONG {said}: {type(why).__name__}: {str(why)[:600]}\n")
            sys.stdout.flush()
            continue
        found["cases"] += 1
        found["verdicts compared"] += compared
        found["ends of gain intervals"] += intervals
        if took > 20:
            found["SLOW"] += 1
            sys.stdout.write(f"SLOW {said}: {took:.1f} s\n")


def main() -> int:
    """``poses`` poses from seed ``first`` on, of the arms named."""
    warnings.simplefilter("ignore")
    given = sys.argv[1:]
    poses, first = int(given[0]) if given else 100, int(given[1]) if given[1:] else 0
    found: Counter[str] = Counter()
    for arm in given[2:] or ARMS:
        for seed in range(first, first + poses):
            pose(arm, seed, found)
        sys.stdout.write(f"{arm}: so far {dict(found)}\n")
        sys.stdout.flush()
    return int(any(k.isupper() for k in found))


if __name__ == "__main__":
    sys.exit(main())
