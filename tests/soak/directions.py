"""Soak: the radius of ``validate`` against what random directions and a Nelder-Mead search on runs find, on the twelve loops of
``tests/simulation/test_validation.py`` and four more: 9.16 with the dynamic inverse, 9.10 on a ur5, 9.24 on a wall, 9.8 on an xarm7.

The radius is to be at most 1.02 times the smallest that anybody finds. Not collected by pytest and not part of CI:
``python -m tests.soak.directions [--count 300] [--polish 300] [name ...]``. Exit code 1 where a radius is larger.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from scipy.linalg import expm
from scipy.optimize import minimize

import mfc_analysis as mfc
from mfc_analysis.errors import MfcError
from mfc_analysis.simulation.directions import scaled_basis
from mfc_analysis.simulation.validation import MISFIT, Validation, misfit
from tests.simulation.test_validation import POSES, loop_on

TIME = 0.05  #: [s] of the runs
POSES |= {"ur5": [0.3, -1.25, 1.9, -2.2, -1.57, 0.2], "xarm7": [0.3, -0.4, 0.4, 1.2, -0.5, 1.0, 0.4]}


def hybrid(name: str) -> mfc.ClosedLoop:
    law = mfc.laws.HybridMotionForce([0, 0, 20, 0, 0, 0], 100, 100, 20, kfp=0.5, kfi=2.0, constraints=np.eye(6)[2:3], kdamp=20.0)
    wall = mfc.Environment(1e4, 50.0, axes="z", preload=20.0)
    return mfc.ClosedLoop(mfc.robots.load(name), law, mfc.trajectories.Hold(np.array(POSES[name])), environment=wall)


LOOPS = {f"{name} {eq}": lambda name=name, eq=eq: loop_on(name, eq) for eq in ("9.8", "9.10", "9.16", "9.23") for name in ("panda", "ur10", "kinova")}
LOOPS |= {
    "panda 9.16 dynamic": lambda: loop_on("panda", "9.16", "dynamic"),
    "ur5 9.10": lambda: loop_on("ur5", "9.10"),
    "ur5 9.24": lambda: hybrid("ur5"),
    "xarm7 9.8": lambda: loop_on("xarm7", "9.8"),
}


def smallest(loop: mfc.ClosedLoop, found: Validation, count: int, polish: int) -> float:
    """[rad] the smallest size at which some direction found by runs fails: below ``found.radius`` if the direction found is not the worst."""
    lin = loop.linearize([0.0], coordinates="state")
    rest, n, t = lin.point.x[0], loop.robot.n, found.t
    response = np.stack([expm(lin.A[0] * at) for at in t])
    basis = scaled_basis(loop.equations, response)
    k = basis.shape[1]

    def boxed(c: np.ndarray) -> np.ndarray:
        return np.clip(c / max(np.abs(c[:n]).max(), 1e-9), -1.0, 1.0)

    def fails_by(c: np.ndarray, size: float) -> float:
        d = size * basis @ boxed(c)
        try:
            run = loop.simulate(t, x=rest + d, rtol=1e-7, atol=1e-10)
        except MfcError:
            return 10.0
        return 10.0 if run.diverged else min(misfit(run.q - rest[:n], response[:, :n] @ d), 10.0)

    rng, size = np.random.default_rng(5), min(found.radius, 3.0)
    own = np.linalg.lstsq(basis, found.direction, rcond=None)[0]
    tried = [boxed(c if i % 2 else np.sign(c)) for i, c in enumerate(rng.uniform(-1, 1, (count, k)))]
    worst = sorted(tried, key=lambda c: -fails_by(c, size))[:2]
    best = size
    for start in (own, *worst):
        simplex = np.vstack([start, *(start - 0.4 * np.where(start[i] > 0, 1, -1) * np.eye(k)[i] for i in range(k))])
        options = {"maxfev": polish, "adaptive": True, "initial_simplex": simplex}
        end = boxed(minimize(lambda c, size=best: -fails_by(c, size), start, method="Nelder-Mead", options=options).x)
        for _ in range(20):
            now = fails_by(end, best)
            if now < MISFIT * 1.005:
                break
            best *= max(MISFIT / now, 0.7)
    return best


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", default=[])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--polish", type=int, default=300)
    given = parser.parse_args()
    bad = 0
    for name in given.names or LOOPS:
        loop, start = LOOPS[name](), time.time()
        found = loop.validate(time=TIME)
        least = smallest(loop, found, given.count, given.polish)
        ratio = min(found.radius, 3.0) / least
        bad += ratio > 1.02
        print(f"{name}: radius {found.radius:.4g} rad, {ratio:.3f} times the smallest found; {time.time() - start:.0f} s", flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
