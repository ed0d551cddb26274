"""Soak: step metrics of random systems against their modal sums in extended precision.

Up to 12 states, time scales over eight decades, lightly damped pairs, zeros of both signs. Not collected by pytest and not part of CI:
``python tests/soak/steps.py [count] [first]``. Exit code 1 where a metric is off by more than 1e-6 of the response's size.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable

import mpmath
import numpy as np

from mfc_analysis.analysis.step_metrics import Outcome
from mfc_analysis.analysis.steps import step
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array

CLOSE = 1e-6
mpmath.mp.dps = 40


def drawn(seed: int) -> tuple[Array, Array, Array, float]:
    """A, b, c, d of a stable system in real modal form, then in other coordinates."""
    rng = np.random.default_rng([30, seed])
    n, spread = int(rng.integers(1, 13)), rng.uniform(0, 8)
    blocks: list[Array] = []
    while sum(len(x) for x in blocks) < n:
        w = 10 ** (rng.uniform(0, spread) - 1)
        if rng.random() < 0.5 or sum(len(x) for x in blocks) == n - 1:
            blocks.append(np.array([[-w]]))
        else:
            zeta = 10 ** rng.uniform(-3, 0)
            blocks.append(np.array([[0.0, w], [-w, -2 * zeta * w]]))
    A = np.zeros((n, n))
    k = 0
    for x in blocks:
        A[k : k + len(x), k : k + len(x)] = x
        k += len(x)
    T = np.linalg.qr(rng.normal(size=(n, n)))[0] if rng.random() < 0.5 and spread < 4 else np.diag(10 ** rng.uniform(-2, 2, n))
    rates = np.abs(np.linalg.eigvals(A)).min() if rng.random() < 0.2 else np.abs(np.diag(A)) + np.abs(A).max(axis=1) * 0.3
    b, c = rng.normal(size=n) * rates, rng.normal(size=n)
    return T @ A @ np.linalg.inv(T), T @ b, c @ np.linalg.inv(T), float(rng.choice([0.0, 0.0, rng.normal()]))


def modal(A: Array, b: Array, c: Array, d: float) -> tuple[Array, Array, float, Callable[[Array], Array]]:
    """Eigenvalues, residues and final value, in 40 digits and then rounded; and y(t)."""
    n = len(A)
    s, V = mpmath.eig(mpmath.matrix(A.tolist()))
    push = mpmath.lu_solve(V, mpmath.matrix(b.tolist()))
    r = [sum(mpmath.mpf(float(c[i])) * V[i, k] for i in range(n)) * push[k] / s[k] for k in range(n)]
    steady = mpmath.mpf(d) - sum(r)
    poles, parts = np.array([complex(x) for x in s]), np.array([complex(x) for x in r])
    return poles, parts, float(steady.real), lambda t: (np.exp(np.multiply.outer(t, poles)) @ parts).real + float(steady.real)


def grid(poles: Array, last: float) -> Array:
    """Times that resolve every mode while it is alive."""
    first = 1e-3 / np.abs(poles).max()
    out = [np.geomspace(first, last, 4000), [0.0]]
    for s in poles[poles.imag >= 0]:
        alive = min(last, -32 / s.real)
        out.append(np.linspace(0, alive, int(max(100, 40 * alive * abs(s) / (2 * np.pi)))))
    return np.unique(np.concatenate(out))


def wrong(seed: int) -> tuple[str, float]:
    """What is off in one case, '' where nothing is; and the time taken [s]."""
    A, b, c, d = drawn(seed)
    n = len(A)
    system = OpenSystem(
        times=np.zeros(1), A=A[None], B=np.append(b[:, None], np.zeros((n, 1)), axis=1)[None], C=np.stack([c, np.zeros(n)])[None],
        D=np.array([[[d, 0.0], [0.0, 0.0]]]), state_names=tuple(f"x{i}" for i in range(n)), input_names=("u",), output_names=("y",),
        wires={"torque": slice(0, 1)}, wire_names=("j",), wire_delay=np.zeros(1), points=("torque",), horizon=np.inf,
    )  # fmt: skip
    start = time.perf_counter()
    found = [step(system, 0, 0, 0, duration) for duration in (None, 1e-3 / np.abs(A).max())]
    took = time.perf_counter() - start
    poles, _, steady, y = modal(A, b, c, d)
    ours = found[0]
    if ours.outcome is not Outcome.SETTLES:
        return f"outcome {ours.outcome}", took
    last = 34 / np.abs(poles.real).min()
    t = grid(poles, last)
    size = max(abs(steady), np.abs(np.concatenate([y(part) for part in np.array_split(t, 1 + t.size // 100_000)])).max())
    values = np.concatenate([y(part) for part in np.array_split(t, 1 + t.size // 100_000)])
    out = []
    for name in ("rise", "settling", "overshoot", "undershoot", "peak", "peak_time", "steady_state"):
        if not np.array_equal(getattr(found[0], name), getattr(found[1], name), equal_nan=True):
            out.append(f"{name} depends on the duration")
    peak = max(highest(t, np.abs(values), lambda x: np.abs(y(x))), abs(steady))
    if abs(ours.peak - peak) > CLOSE * size:
        out.append(f"peak {ours.peak}, {peak}")
    if abs(ours.steady_state - steady) > CLOSE * size:
        out.append(f"steady {ours.steady_state}, {steady}")
    if np.isfinite(ours.overshoot):
        sign = np.sign(steady)
        top = highest(t, sign * values, lambda x: sign * y(x))
        low = -highest(t, -sign * values, lambda x: -sign * y(x))
        over, under = max(0.0, top / abs(steady) - 1), max(0.0, -low / abs(steady))
        if abs(ours.overshoot - over) * abs(steady) > CLOSE * size or abs(ours.undershoot - under) * abs(steady) > CLOSE * size:
            out.append(f"overshoot {ours.overshoot}, {over}; undershoot {ours.undershoot}, {under}")
        reached = [t[np.argmax(sign * values >= part * abs(steady))] for part in (0.1, 0.9)]
        gap = max(np.interp(x, t[1:], np.diff(t)) for x in reached)
        if abs(ours.rise - (reached[1] - reached[0])) > 2 * gap + 1e-9 * reached[1]:
            out.append(f"rise {ours.rise}, {reached[1] - reached[0]} +- {gap}")
    band = 0.02 * (abs(steady) if abs(steady) > 1e-9 * peak else peak)
    after = np.abs(values[t > ours.settling * (1 + 1e-9)] - steady)
    if after.size and after.max() > band + CLOSE * size:
        out.append(f"settling {ours.settling}: outside again later")
    if ours.settling > 0 and d == 0 and abs(abs(float(y(np.array(ours.settling))) - steady) - band) > CLOSE * size:
        out.append(f"settling {ours.settling}: not on the band")
    return "; ".join(out), took


def highest(t: Array, values: Array, f: Callable[[Array], Array]) -> float:
    """The largest f, from the hundred highest local maxima on the grid: each between its neighbours, on finer and finer grids."""
    tops = np.flatnonzero((values >= np.append(values[1:], -np.inf)) & (values >= np.append(-np.inf, values[:-1])))
    best = -np.inf
    for k in tops[np.argsort(values[tops])[-100:]]:
        low, high = t[max(0, k - 1)], t[min(t.size - 1, k + 1)]
        for _ in range(6):
            x = np.linspace(low, high, 41)
            found = f(x)
            j = int(found.argmax())
            low, high = x[max(0, j - 1)], x[min(40, j + 1)]
        best = max(best, float(found[j]))
    return best


def main() -> int:
    """``count`` systems from seed ``first`` on."""
    warnings.simplefilter("ignore")
    given = [int(x) for x in sys.argv[1:]]
    count, first = [*given, *(500, 0)[len(given) :]]
    bad, slowest = 0, 0.0
    for seed in range(first, first + count):
        said, took = wrong(seed)
        slowest = max(slowest, took)
        if said:
            bad += 1
            sys.stdout.write(f"{seed}: {said}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{count - bad} of {count} agree; slowest {slowest:.2f} s\n")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
