"""Soak: the equilibrium of random soft loops against where their own simulation comes to rest.

Loops of ``tests/simulation/test_rest.py``: JointPID with low gains on one joint, planar_2r and ur5, and force loops of a ur5 on soft walls. Not
collected by pytest and not part of CI: ``python tests/soak/rest.py [loops of each kind] [first]``. Exit code 1 where one is wrong.
"""

from __future__ import annotations

import sys
from collections import Counter

from tests.simulation.test_rest import checked, pressing, soft

KINDS = ("single_joint", "planar_2r", "ur5", "force")


def main() -> int:
    """``count`` loops of each kind from seed ``first`` on."""
    given = sys.argv[1:]
    count, first = int(given[0]) if given else 100, int(given[1]) if given[1:] else 0
    found: Counter[str] = Counter()
    for kind in KINDS:
        for seed in range(first, first + count):
            said = checked(pressing(seed) if kind == "force" else soft(kind, seed))
            wrong = said not in ("", "moving")
            found[f"{kind}: {'WRONG' if wrong else said or 'rests'}"] += 1
            if wrong:
                sys.stdout.write(f"{kind} {seed}: {said}\n")
                sys.stdout.flush()
    sys.stdout.write(f"{dict(found)}\n")
    return int(any(name.endswith("WRONG") for name in found))


if __name__ == "__main__":
    sys.exit(main())
