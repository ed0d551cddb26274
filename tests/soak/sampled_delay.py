"""Soak: the delay margins of random sampled loops against a scan and a bisection on the exact resampled loop, written apart.

Joint, task, force and hybrid laws, lag, dead time of torque and force, filters, rules of code, elastic joints, walls; every channel of every analysis
point. Not collected by pytest and not part of CI: ``python tests/soak/sampled_delay.py [count] [first]``. Exit code 1 on a difference above
1e-6 or an exception.

The second way steps the loop through one sample, event by event: a torque, a command or a sensor's record switches where its dead time
ends. The eigenvalues of that step are the roots; a scan in small steps up to the margin finds whatever is lost before it.
"""

from __future__ import annotations

import itertools
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import expm

import mfc_analysis as mfc
from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import OpenSystem
from tests.analysis.test_sampled import loop as plant_loop

L, Z = mfc.laws, np.eye(6)[2]
ARMS = ("single_joint", "planar_2r", "ur5", "panda", "ur10", "xarm7")
WALLS = ("9.21", "9.22", "9.23", "9.24")
CLOSE = 1e-6
ATTEMPTS = 8  #: loops tried until one is stable
STEPS = 240  #: of the scan
MOST = 400  #: largest model of the second way
SLOW = 1e-4  #: relative: of a root that leaves the disc of the slow ones, a cluster of which eigenvalues keep few digits
EDGE = 9e-7  #: relative: how far beyond the margin the loss must have come


class Resampled:
    """One point of a continuous open loop under a sampled controller, with any dead time on one wire."""

    def __init__(self, held, h: float, horizon: float) -> None:
        self.h, self.horizon = h, horizon
        nu, ny = held.nu, held.ny
        A, self.B, self.C, self.D = held.A[0], held.B[0][:, nu:], held.C[0][ny:], held.D[0][ny:, nu:]
        self.p = np.array(sorted(held.plant_states))
        self.c = np.setdiff1d(np.arange(held.nx), self.p)
        self.A, self.nw = A, held.nw
        self.drive = np.arange(held.nw)[held.wires.get("torque", held.wires.get("velocity"))]
        self.command = np.arange(held.nw)[held.wires["command"]] if "command" in held.wires else np.zeros(0, int)
        sensed = [name for name in ("force", "position") if name in held.wires and not (name == "position" and "rate" in held.wires)]
        self.sensors = np.concatenate([np.zeros(0, int), *(np.arange(held.nw)[held.wires[name]] for name in sensed)])
        self.T = held.wire_delay.copy()
        coded = np.isin(self.c, held.stepped)
        own = A[np.ix_(self.c, self.c)]
        smooth = np.where(coded[:, None] | coded, 0.0, own)
        self.Ac = expm(np.block([[smooth, np.eye(self.c.size)], [np.zeros((self.c.size, 2 * self.c.size))]]) * h)
        self.code = own - smooth
        self.idle = np.array([i for i in held.integrals if not A[:, i].any() and not self.C[:, i].any()], int)

    def step(self, wire: int, extra: float) -> np.ndarray:
        """The map of [plant, controller, records] over one sample."""
        h, p, c = self.h, self.p, self.c
        late = self.T.copy()
        late[wire] += extra
        sources = [(self.B[p, w], late[w], ("held", w)) for w in self.drive]  # each holds a value per sample, late
        if wire in self.command:  # what this command puts on the drives goes by a held value of its own
            b = self.B[np.ix_(p, self.drive)] @ self.D[self.drive, wire]
            assert np.ptp(late[self.drive]) == 0
            sources.append((b, late[self.drive[0]] + late[wire], ("held", wire)))
        split = [(int(np.floor(T / h + 1e-9)), T / h - np.floor(T / h + 1e-9)) for _, T, _ in sources]
        split = [(whole, part if part > 1e-9 else 0.0) for whole, part in split]
        slow = []
        for w in self.sensors:
            whole = int(np.floor(late[w] / h + 1e-9))
            part = late[w] / h - whole
            slow.append((w, whole, part if part > 1e-9 else 0.0))
        size, past = p.size + c.size, []
        for whole, part in split:
            depth = whole + (part > 0)
            past.append(np.arange(size, size + depth))
            size += depth
        seen = []
        for _, whole, part in slow:
            depth = whole + (part > 0)
            seen.append(np.arange(size, size + depth))
            size += depth
        one = np.eye(size)
        x, xc = one[: p.size], one[p.size : p.size + c.size]
        # direct terms of the drives into the sensors at the start of the sample
        Dfd = self.D[np.ix_(self.sensors, self.drive)] if self.sensors.size else np.zeros((0, self.drive.size))
        assert not Dfd.any() and not self.D[np.ix_(self.drive, self.drive)].any()
        w_out = np.zeros((self.nw, size))
        F = self.C[np.ix_(self.sensors, p)] @ x
        arrived = np.array([F[k] if not seen[k].size else one[seen[k][-1]] for k in range(self.sensors.size)]).reshape(-1, size)
        w_out[self.sensors] = arrived
        others = np.setdiff1d(np.arange(self.nw), np.concatenate([self.sensors, self.drive]))
        known = self.C[np.ix_(others, np.r_[p, c])] @ np.concatenate([x, xc]) + self.D[np.ix_(others, self.sensors)] @ arrived
        w_out[others] = np.linalg.solve(np.eye(others.size) - self.D[np.ix_(others, others)], known)
        through = w_out.copy()
        if wire in self.command:
            through[wire] = 0.0
        torque = self.C[np.ix_(self.drive, np.r_[p, c])] @ np.concatenate([x, xc]) + self.D[self.drive] @ through
        values = [*torque, *([w_out[wire]] if wire in self.command else [])]
        rest = np.setdiff1d(np.arange(self.nw), self.drive)
        held = self.A[np.ix_(c, p)] @ x + self.B[np.ix_(c, rest)] @ w_out[rest]
        assert not self.B[np.ix_(c, self.drive)].any() and not (wire in self.command and self.B[c, wire].any())
        held = held + self.code @ xc
        new = np.zeros((size, size))
        new[p.size : p.size + c.size] = self.Ac[: c.size, : c.size] @ xc + self.Ac[: c.size, c.size :] @ held

        def active(k: int, at: float) -> np.ndarray:
            whole, part = split[k]
            age = whole + int(at < part * (1 - 1e-12))
            return values[k] if age == 0 else one[past[k][age - 1]]

        records = {round(1 - part, 15): None for _, _, part in slow if part}
        events = sorted({0.0, 1.0, *(part for _, part in split if part), *records})
        columns = np.array([s[0] for s in sources]).T
        X = x
        for a, b in itertools.pairwise(events):
            u = np.array([active(k, a) for k in range(len(sources))])
            E = expm(np.block([[self.A[np.ix_(p, p)], columns], [np.zeros((len(sources), p.size + len(sources)))]]) * (b - a) * h)
            X = E[: p.size, : p.size] @ X + E[: p.size, p.size :] @ u
            if b in records:
                records[b] = X
        new[: p.size] = X
        for k in range(len(split)):
            for i, place in enumerate(past[k]):
                new[place] = values[k] if i == 0 else one[past[k][i - 1]]
        for k, (w, _, part) in enumerate(slow):
            row = self.C[w, p]
            for i, place in enumerate(seen[k]):
                new[place] = (row @ records[round(1 - part, 15)] if part else F[k]) if i == 0 else one[seen[k][i - 1]]
        keep = np.setdiff1d(np.arange(size), p.size + np.searchsorted(c, self.idle))
        return new[np.ix_(keep, keep)]

    def worst(self, wire: int, extra: float) -> float:
        """Largest growth [1/sample] of the roots that are not slow."""
        s = np.log(np.linalg.eigvals(self.step(wire, extra)).astype(complex) + 1e-300)
        judged = np.abs(s) >= self.h / self.horizon
        return float(s.real[judged].max()) if judged.any() else np.inf


def first_loss(loop: Resampled, wire: int, upper: float, steps: int) -> float:
    """[s] of the extra dead time at the first loss up to ``upper``, or inf: a scan, then a bisection."""
    grid = np.linspace(0, upper, steps + 1)[1:]
    low = 0.0
    for T in grid:
        if loop.worst(wire, float(T)) >= 0:
            high = float(T)
            while high - low > 1e-8 * high:
                middle = (low + high) / 2
                low, high = (middle, high) if loop.worst(wire, middle) < 0 else (low, middle)
            return high
        low = float(T)
    return np.inf


def drawn(seed: int) -> tuple[str, mfc.ClosedLoop]:
    """A random sampled loop, stable if one of a few is, and what it is."""
    for attempt in range(ATTEMPTS):
        said, loop = one_drawn(seed, attempt)
        try:
            if attempt == ATTEMPTS - 1 or loop.linearize([0.0]).stability.nonzero_stable[0]:
                break
        except mfc.errors.MfcError:
            continue
    return said, loop


def one_drawn(seed: int, attempt: int) -> tuple[str, mfc.ClosedLoop]:
    rng = np.random.default_rng([31, seed, attempt])

    def g(low: float, high: float) -> float:
        return float(10 ** rng.uniform(low, high))

    w = g(0.3, 1.7)
    kp, kd, ki = w**2 * rng.uniform(0.5, 2), w * rng.uniform(0.7, 3), w**3 * rng.uniform(0, 0.4)
    force = {"F_d": 10 * Z}
    kf, kfi = g(-2, 0.3), g(-1, 1.3)
    laws: dict[str, Callable[[], object]] = {
        "9.8": lambda: L.JointPID(kp, ki, kd), "9.10": lambda: L.ComputedTorque(kp, ki, kd),
        "9.3": lambda: L.VelocityPI(w, w**2 * rng.uniform(0.05, 0.5)), "9.4": lambda: L.VelocityFeedforwardPI(w, 0.2 * w**2),
        "9.5": lambda: L.TaskVelocity(w, 0.2 * w**2),
        "9.16": lambda: L.TaskComputedTorque(kp, ki, kd, null_damping=g(0, 1.5)),
        "9.22": lambda: L.ForcePI(**force, kfp=kf * Z, kfi=kfi * Z), "9.23": lambda: L.DampedForcePI(**force, kfp=kf * Z, kfi=kfi * Z, kdamp=g(0, 2)),
        "9.24": lambda: L.HybridMotionForce(**force, kp=kp, kd=kd, ki=ki, kfp=kf, kfi=kfi, kdamp=g(0, 1.5), constraints=[Z]),
    }  # fmt: skip
    name = list(laws)[seed % len(laws)]
    arm = str(rng.choice(ARMS))
    if name in ("9.5", "9.16", "9.24") and arm in ("single_joint", "planar_2r"):
        arm = "ur5"
    if name in ("9.22", "9.23") and arm in ("single_joint", "planar_2r"):
        arm = "slider"
    robot = getattr(mfc.robots, arm)() if hasattr(mfc.robots, arm) else mfc.robots.load(arm)
    q = np.array([0.1]) if robot.n == 1 else rng.uniform(-1.2, 1.2, robot.n)
    velocity = name in ("9.3", "9.4", "9.5")
    if name == "9.8" and robot.n > 1:
        M = np.diag(robot.mass(q))
        laws["9.8"] = lambda: L.JointPID(kp * M, ki * M, kd * M)
    h = float(np.clip(g(-1.6, 0.3) / w, 1e-4, 1.0)) * (0.3 if name in WALLS else 1)
    hardware: dict[str, object] = {"sample_time": h}
    if rng.random() < 0.5:
        hardware["delay"] = h * float(rng.choice([1.0, 2.0, 5.0, g(-2, 0.7), g(-2, 0.7)]))
    if name in WALLS and rng.random() < 0.5:
        hardware["force_delay"] = h * float(rng.choice([1.0, 3.0, g(-2, 0.7), g(-2, 0.7)]))
    if rng.random() < 0.4:
        hardware["velocity_lag" if velocity else "torque_lag"] = h * g(-1.5, 0.7)
    if not velocity and rng.random() < 0.3:
        hardware |= {"joint_stiffness": g(2, 5), "motor_inertia": g(-2, 0), "joint_damping": g(-1, 2), "feedback": str(rng.choice(["motor", "link"]))}
    if rng.random() < 0.2 and not velocity:
        hardware["velocity_filter"] = h * g(-1, 1)
    if seed % 3 == 0:  # as it is coded
        hardware["integral_rule"] = str(rng.choice(["backward", "tustin"]))
        if not velocity:
            hardware["derivative_rule"] = "backward"
    wall = mfc.Environment(stiffness=g(2, 5), damping=g(0, 3), axes="z", preload=10.0) if name in WALLS else None
    model = robot.with_inertia_scaled(rng.uniform(0.8, 1.1)) if name in ("9.10", "9.16", "9.24") and rng.random() < 0.7 else None
    task = name in ("9.5", "9.16")
    reference = mfc.trajectories.ToolHold(robot.pose(q)) if task else mfc.trajectories.Hold(q)
    start = {"q_start": q} if task else {}
    given = {"environment": wall, "hardware": mfc.Hardware(**hardware), "controller_model": model, **start}  # type: ignore[arg-type]
    loop = mfc.ClosedLoop(robot, laws[name](), reference, **given)  # type: ignore[arg-type]
    shown = {k: round(x, 6) if isinstance(x, float) else x for k, x in hardware.items()}
    return f"{name} on {robot.name}, {shown}", loop


def random_plant(seed: int) -> OpenSystem:
    """A stable loop, to be sampled every second, whose plant turns up to 2.5 times a sample."""
    rng = np.random.default_rng([77, seed])
    n = int(rng.integers(1, 6))
    A, k = np.zeros((n, n)), 0
    while k < n:
        if n - k > 1 and rng.random() < 0.7:
            w, damping = 10 ** rng.uniform(-1, 1.2), 10 ** rng.uniform(-2.5, 0)
            A[k : k + 2, k : k + 2] = [[0, 1], [-w * w, -2 * damping * w]]
            k += 2
        else:
            A[k, k] = 0.0 if rng.random() < 0.2 else -(10 ** rng.uniform(-1.5, 1.3))
            k += 1
    T = np.linalg.qr(rng.normal(size=(n, n)))[0]
    B, C, gain = rng.normal(size=n), rng.normal(size=n), 10 ** rng.uniform(-1, 1) * rng.choice([-1, 1])
    controller = {"Ac": [[-(10 ** rng.uniform(-1, 0.5))]], "Bc": [1.0], "Cc": [rng.normal()]} if rng.random() < 0.3 else {}
    delays = tuple(float(rng.choice([0.0, 0.0, 1.0, rng.uniform(0, 3)])) for _ in range(2))
    for _ in range(40):
        system = plant_loop(T @ A @ T.T, B, C, gain, delays=delays, **controller)
        if Resampled(system, 1.0, system.horizon).worst(0, 0.0) < -1e-6:
            break
        gain *= rng.uniform(0.6, 1.0) if rng.random() < 0.8 else -1
    return system


def wrong_delays(system: OpenSystem, h: float, horizon: float, found: Counter[str], steps: int = STEPS) -> list[str]:
    """What is wrong with the delay margins of a loop of one torque and one force, counted in ``found``."""
    second, now = Resampled(system, h, horizon), sampled(replace(system, horizon=horizon), h)
    wrong = []
    for wire, at in enumerate(("torque", "force")):
        of = margins(now, at)
        T = float(of.delay[0, 0])
        if np.isnan(T):
            if of.stable[0] or (second.worst(0, 0.0) < -1e-6 and stability(now).held[0]):
                wrong.append(f"{at}: not a number")
            continue
        upper, count = (T * (1 + EDGE), int(np.clip(25 * T / h, 30, steps))) if np.isfinite(T) else (12 * h, steps)
        lost = first_loss(second, wire, upper, count)
        found[f"plant, {at}{': unlimited' if np.isinf(T) else ''}"] += 1
        if np.isfinite(T) and abs(of.delay_frequency[0, 0] * h - np.pi) < 1e-9:
            found["through z = -1"] += 1
        if not (np.isinf(T) and np.isinf(lost)) and not abs(lost - T) <= CLOSE * T:
            wrong.append(f"{at}: margin {T / h:.10g} samples, lost at {lost / h:.10g}")
    return wrong


def compared(loop: mfc.ClosedLoop, found: Counter[str], steps: int = STEPS, channels: int = 99) -> list[str]:
    """The first ``channels`` of all analysis points of a loop, counted in ``found``; what is wrong."""
    lin = loop.linearize([0.0])
    wrong = []
    if not lin.stability.nonzero_stable[0]:
        found["unstable loops"] += 1
        return [] if np.isnan(lin.margins().delay).all() else ["unstable, but not NaN"]
    h = lin.dt
    held = lin.opened.held
    assert held is not None
    second = Resampled(held, h, lin.horizon)
    for at in lin.opened.points:
        of = lin.margins(at)
        wires = np.arange(held.nw)[held.wires[at]]
        for channel, wire in enumerate(wires[:channels]):
            T = float(of.delay[0, channel])
            if np.isnan(T):
                continue
            kind = f"{at}"
            if (np.isfinite(T) and T / h > MOST) or second.step(int(wire), T if np.isfinite(T) else 0.0).shape[0] > MOST:
                found["too large"] += 1
                continue
            samples = T / h
            if np.isinf(T):
                lost = first_loss(second, int(wire), 40 * h, steps)
                found[f"{kind}: unlimited"] += 1
            else:
                fine = int(np.clip(6 * samples, 12, steps))
                edge = SLOW if of.delay_frequency[0, channel] < 1 / lin.horizon else EDGE
                lost = first_loss(second, int(wire), T * (1 + edge), fine)
                found[f"{kind}"] += 1
                if samples > 20:
                    found["more than 20 samples"] += 1
            if np.isinf(T) and np.isinf(lost):
                continue
            slow = of.delay_frequency[0, channel] < 1 / lin.horizon  # leaves the disc of slow roots: a cluster, known to fewer digits
            found["of these slow"] += slow
            if not abs(lost - T) <= (SLOW if slow else CLOSE) * T:
                wrong.append(f"{at} {of.channels[channel]}: margin {T:.10g} s, {samples:.6g} samples; lost at {lost:.10g} s")
    return wrong


def main() -> int:
    """``count`` loops from seed ``first`` on."""
    warnings.simplefilter("ignore")
    given = sys.argv[1:]
    number, first = int(given[0]) if given else 200, int(given[1]) if given[1:] else 0
    found: Counter[str] = Counter()
    for seed in range(first, first + number):
        start = time.perf_counter()
        try:
            said, loop = drawn(seed)
            before, wrong = found["unstable loops"], compared(loop, found)
            found["loops"] += 1
            found[f"{said[:4]} stable"] += found["unstable loops"] == before
            wrong += wrong_delays(random_plant(seed), 1.0, 100.0, found)
        except mfc.errors.MfcError as why:
            found["refused"] += 1
            sys.stdout.write(f"refused {seed}: {why}\n")
            continue
        for text in wrong:
            found["WRONG"] += 1
            sys.stdout.write(f"WRONG {seed}: {said}: {text}\n")
        took = time.perf_counter() - start
        if took > 60:
            sys.stdout.write(f"long {seed}: {said}: {took:.0f} s\n")
        sys.stdout.flush()
    sys.stdout.write(f"{dict(found)}\n")
    return int(found["WRONG"] > 0)


if __name__ == "__main__":
    sys.exit(main())
