"""Soak: disk margins of 2000 random loops against a dense grid refined at its peaks, and against the sensitivity peaks.

Not collected by pytest and not part of CI, which runs a sample of it: ``python tests/soak/disk.py [--count 2000] [--seed 0] [--kind NAME]``. Exit
code 1 if an alpha is above the truth by more than 1e-4 or below by more than 1e-3 of it, or above 1/(Ms - 1/2) of a channel, or if an Ms is
wrong by more than 1e-4.

The truth is code of its own: S by one linear solution with all wires cut, at each frequency; of one channel mu is abs(S - 1/2).
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import dataclass

import numpy as np

import mfc_analysis as mfc
from mfc_analysis.analysis.disk import Bound, disk_margin
from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.mu import largest_bound, osborne_bound
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import MfcError

ABOVE, BELOW = 1e-4, 1e-3  #: what alpha may be off, relative
ROUNDS, FLAT = 9, 1 - 1e-6  #: a peak is refined until its neighbours are that near: a tall one with dead time is 1e-6 of its frequency wide
GRID = 1500  #: frequencies with logarithmic spacing, and as many even ones with dead time
KINDS = ("joint", "elastic", "arm", "elastic arm", "velocity", "plain")


def random_system(rng: np.random.Generator, kind: str) -> OpenSystem:
    """One loop, stable or not; about half of them with dead time, a fifth sampled."""
    if kind == "plain":
        return plain(rng)
    delay = float(10 ** rng.uniform(-3.5, -1.7)) if rng.random() < 0.55 else 0.0
    parts: dict[str, object] = {"delay": delay}
    if rng.random() < 0.4:
        parts["torque_lag"] = float(10 ** rng.uniform(-3.5, -1.8))
    if rng.random() < 0.2:
        parts["sample_time"] = float(10 ** rng.uniform(-3.3, -2))
    if kind.startswith("elastic"):
        parts |= {
            "joint_stiffness": float(10 ** rng.uniform(3, 5)),
            "joint_damping": float(10 ** rng.uniform(-1.5, 1.5)),
            "motor_inertia": float(10 ** rng.uniform(-1.5, 0)),
        }
    if kind in ("joint", "elastic"):
        robot = mfc.robots.single_joint(inertia=float(rng.uniform(0.2, 2)), mass=0.0, damping=0.0)
        size = np.array([1.0])
    elif rng.random() < 0.5:
        robot, size = mfc.robots.planar_2r(), np.array([3.0, 1.0])
    else:
        robot, size = mfc.robots.ur5(), np.array([3.0, 3.0, 1.0, 0.3, 0.2, 0.1])
    q = rng.uniform(-1.5, 1.5, robot.n)
    w = 10 ** rng.uniform(0.3, 1.7)
    kp = size * w**2 * rng.uniform(0.5, 2, robot.n)
    kd = 2 * rng.uniform(0.15, 1.0) * np.sqrt(kp * size)
    ki = None if rng.random() < 0.5 else kp * w * rng.uniform(0.02, 0.2)
    if kind == "velocity":
        parts = {"delay": delay}
        law = mfc.laws.VelocityPI(float(w), float(rng.uniform(0, 0.3) * w**2))
    elif rng.random() < 0.4 and kind != "elastic arm":
        law = mfc.laws.ComputedTorque(float(w**2), None if ki is None else float(0.1 * w**3), float(2 * rng.uniform(0.2, 1) * w))
    else:
        law = mfc.laws.JointPID(kp, ki, kd)
    return mfc.ClosedLoop(robot, law, mfc.trajectories.Hold(q), hardware=mfc.Hardware(**parts)).linearize([0.0]).opened


def plain(rng: np.random.Generator) -> OpenSystem:
    """Random matrices, 1 to 6 wires, each with a dead time of its own."""
    n, nx = int(rng.integers(1, 7)), int(rng.integers(2, 12))
    A = rng.normal(size=(nx, nx)) * 10 ** rng.uniform(-0.5, 1.0, (nx, 1))
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-1.5, 0.5)) * np.eye(nx)
    late = rng.uniform(0.02, 1.0, n) * (rng.random(n) < 0.6) if rng.random() < 0.6 else np.zeros(n)
    return OpenSystem(
        times=np.zeros(1),
        A=A[None],
        B=rng.normal(size=(1, nx, n)),
        C=rng.normal(size=(1, n, nx)) * 10 ** rng.uniform(-1.5, 0.3),
        D=np.zeros((1, n, n)),
        state_names=tuple(f"x{i}" for i in range(nx)),
        input_names=(),
        output_names=(),
        wires={"torque": slice(0, n)},
        wire_names=tuple(f"u{i}" for i in range(n)),
        wire_delay=late,
        points=("torque",),
    )


def sensitivities(system: OpenSystem, at: str, w: np.ndarray) -> np.ndarray:
    """S (k, n, n) at w (k,) [rad/s]: u = E (C x + D u) + r, all wires cut."""
    A, B, C, D = system.A[0], system.B[0, :, system.nu :], system.C[0, system.ny :], system.D[0, system.ny :, system.nu :]
    nx, nw, rows = len(A), len(D), system.wires[at]
    out = []
    for part in np.array_split(w, 1 + w.size * (nx + nw) ** 2 // 400_000):
        z = np.exp(1j * part * system.dt) if system.dt else 1j * part
        E = np.exp(-1j * part[:, None] * system.wire_delay)[:, :, None]
        F = np.zeros((part.size, nx + nw, nx + nw), complex)
        F[:, :nx, :nx], F[:, :nx, nx:] = z[:, None, None] * np.eye(nx) - A, -B
        F[:, nx:, :nx], F[:, nx:, nx:] = -E * C, np.eye(nw) - E * D
        right = np.zeros((nx + nw, nw))
        right[nx:] = np.eye(nw)
        out.append(
            np.linalg.solve(F, np.broadcast_to(right[:, rows].astype(complex), (part.size, nx + nw, right[:, rows].shape[1])))[:, nx:][:, rows]
        )
    return np.concatenate(out)


def peak(values, w: np.ndarray, found: np.ndarray) -> float:
    """Largest of ``values`` (a function of frequencies), ``found`` on w, refined at its five highest maxima."""
    order = np.argsort(-found)
    tops = [k for k in order if found[k] >= found[max(k - 1, 0)] and found[k] >= found[min(k + 1, w.size - 1)]][:5]
    best = float(found.max())
    for k in tops:
        a, b = w[max(k - 1, 0)], w[min(k + 1, w.size - 1)]
        for _ in range(ROUNDS):
            x = np.linspace(a, b, 21)
            y = values(x)
            i = int(y.argmax())
            best = max(best, float(y[i]))
            near = [max(i - 1, 0), min(i + 1, 20)]
            a, b = x[near]
            if y[near].min() > FLAT * y[i]:
                break
    return best


def grid(system: OpenSystem, count: int) -> np.ndarray:
    """Frequencies from 1/horizon to far above every pole, denser at open and closed poles."""
    poles = np.concatenate([np.linalg.eigvals(closed_loop(system)), np.linalg.eigvals(system.A[0])])
    if system.dt:
        with np.errstate(divide="ignore"):
            poles = np.log(np.abs(poles) + 1e-300) / system.dt + 1j * np.angle(poles) / system.dt
    poles = poles[np.abs(poles) < 1e7]
    late = system.wire_delay.max()
    top = np.pi / system.dt if system.dt else 30 * max(1.0, np.abs(poles).max(), 3 / late if late else 0.0)
    w = [np.geomspace(system.radius, top, count)]
    if late:
        w.append(np.linspace(system.radius, min(top, 60 / late + np.abs(poles).max()), count))
    near = poles[poles.imag > 0]
    w.append((near.imag[:, None] + np.abs(near.real)[:, None] * np.linspace(-3, 3, 13)).ravel())
    w = np.unique(np.concatenate(w))
    return w[(w >= system.radius) & (w <= top)]


def closed_loop(system: OpenSystem) -> np.ndarray:
    """A with all wires closed, dead time left out."""
    B, C, D = system.B[0, :, system.nu :], system.C[0, system.ny :], system.D[0, system.ny :, system.nu :]
    return system.A[0] + B @ np.linalg.solve(np.eye(len(D)) - D, C)


@dataclass(frozen=True)
class Judged:
    """A loop against its dense grid."""

    n: int
    kind: str
    bound: Bound
    alpha: float
    error: float  #: of alpha, relative, positive: too large
    over_Ms: float  #: largest alpha (Ms - 1/2) - 1
    Ms_error: float  #: worst relative error of Ms, positive: too large

    @property
    def good(self) -> bool:
        return bool(-BELOW <= self.error <= ABOVE and self.over_Ms <= 1e-6 and abs(self.Ms_error) <= 1e-4)


def judged(system: OpenSystem, kind: str, at: str, count: int = GRID) -> Judged | None:
    """None where the loop is not stable."""
    if not stability(system).nonzero_stable[0]:
        return None
    found, Ms = disk_margin(system, at), margins(system, at).sensitivity_peak[0]
    w = grid(system, count)
    n = len(found.channels)

    def M(x: np.ndarray) -> np.ndarray:
        return sensitivities(system, at, x) - np.eye(n) / 2

    S = M(w)
    if n == 1:
        truth = peak(lambda x: np.abs(M(x)[:, 0, 0]), w, np.abs(S[:, 0, 0]))
    else:
        rough = osborne_bound(S)[0]
        truth = largest_bound(S)[0]
        tops = 1 + np.flatnonzero((rough[1:-1] >= rough[:-2]) & (rough[1:-1] >= rough[2:]) & (rough[1:-1] > 0.8 * truth))
        for k in tops[np.argsort(-rough[tops])][:5]:
            a, b = w[k - 1], w[k + 1]
            for _ in range(ROUNDS):
                x = np.linspace(a, b, 21)
                here = M(x)
                mu, i, _ = largest_bound(here)
                truth = max(truth, mu)
                near = [max(i - 1, 0), i, min(i + 1, 20)]
                a, b = x[near[0]], x[near[2]]
                y = osborne_bound(here[near])[0]
                if y.min() > FLAT * y.max():
                    break
    truth = max(truth, 0.5 if not system.dt else 0.0)
    single = np.array([max(1.0, peak(lambda x, i=i: np.abs(M(x)[:, i, i] + 0.5), w, np.abs(S[:, i, i] + 0.5))) for i in range(n)])
    alpha = float(found.alpha[0])
    return Judged(
        n,
        kind,
        found.bound,
        alpha,
        alpha * truth - 1,
        float((alpha * (Ms - 0.5)).max() - 1),
        float((Ms / single - 1)[np.abs(Ms / single - 1).argmax()]),
    )


def run(count: int, seed: int, kinds: tuple[str, ...] = KINDS, say=None, frequencies: int = GRID) -> list[Judged]:
    """``count`` stable loops of the kinds in turn, each against a grid of that many frequencies."""
    rng = np.random.default_rng(seed)
    found: list[Judged] = []
    tried = 0
    while len(found) < count:
        kind = kinds[tried % len(kinds)]
        tried += 1
        try:
            system = random_system(rng, kind)
        except MfcError:
            continue
        at = "velocity" if "velocity" in system.points else "torque"
        one = judged(system, kind, at, frequencies)
        if one is None:
            continue
        found.append(one)
        if say is not None:
            say(len(found), tried, one)
    return found


def main() -> int:
    """The loops in turn; the bad ones and the worst figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    start = time.perf_counter()
    every: list[Judged] = []

    def say(k: int, tried: int, one: Judged) -> None:
        every.append(one)
        if not one.good:
            sys.stdout.write(f"BAD {tried}: {one}\n")
        if k % 50 == 0 or not one.good:
            bounds = {b.name: sum(x.bound is b for x in every) for b in Bound}
            error, over, Ms = (np.array([getattr(x, name) for x in every]) for name in ("error", "over_Ms", "Ms_error"))
            sys.stdout.write(
                f"{k} of {tried}, {time.perf_counter() - start:.0f} s: alpha error {error.min():.2e} .. {error.max():.2e}, "
                f"over 1/(Ms - 1/2) {over.max():.2e}, Ms error {np.abs(Ms).max():.2e}, {bounds}\n"
            )
            sys.stdout.flush()

    run(asked.count, asked.seed, (asked.kind,) if asked.kind else KINDS, say)
    bad = sum(not one.good for one in every)
    sys.stdout.write(f"{len(every)} loops, {bad} bad\n")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
