"""Soak: passivity of 200 random loops, in both directions.

Not collected by pytest and not part of CI, which runs a sample of it: ``python tests/soak/passivity.py [--count 200] [--seed 0]``. Exit code 1 if

- a loop that is called passive is not stable on some spring at its tool of 10 to 1e9 N/m (Nm/rad), alone or with a damper, of any orientation;
- a loop without dead time that is called not passive is stable, by the eigenvalues of the whole, on every environment tried of one degree of
  freedom (a mass, a spring and a damper at the tool along its worst real direction), or where only complex directions give energy, of several;
- with dead time, 9000 frequencies at random find less damping at the joints than the scan did;
- the extra damping leaves a loop that is not sampled not passive, or 1 % less of it makes it passive too.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import replace

import numpy as np

import mfc_analysis as mfc
from mfc_analysis.analysis.passivity import Passive, passivity
from mfc_analysis.analysis.port import PortSystem, admittance
from mfc_analysis.analysis.stability import stability
from mfc_analysis.errors import MfcError
from mfc_analysis.linearization.port import port_system
from mfc_analysis.maths.se3 import exp6

SPRINGS = np.geomspace(1e1, 1e9, 9)


def random_loop(rng: np.random.Generator) -> mfc.ClosedLoop:
    """A loop of one to six joints under one of seven laws, in contact or not, with lag, dead time, friction, elastic joints, sampling or none."""
    which = rng.integers(3)
    robot = (mfc.robots.slider(float(rng.uniform(0.5, 5))), mfc.robots.planar_2r(), mfc.robots.ur5())[which]
    size = ([1.0], [3.0, 1.0], [3.0, 3.0, 1.0, 0.3, 0.2, 0.1])[which]
    q = rng.uniform(0.3, 1.2, robot.n) if which < 2 else np.array([0.1, -1.0, 1.0, 0.3, 0.4, 0.5]) + rng.uniform(-0.2, 0.2, 6)
    if rng.random() < 0.5:
        robot = robot.with_friction(viscous=np.array(size) * 10 ** rng.uniform(-1, 2))
    parts: dict[str, object] = {}
    if rng.random() < 0.3:
        parts["torque_lag"] = float(10 ** rng.uniform(-3.5, -2))
    if rng.random() < 0.25:
        parts["delay"] = float(10 ** rng.uniform(-3.5, -2.3))
    if rng.random() < 0.2:
        parts |= {"joint_stiffness": 10 ** rng.uniform(3, 5), "joint_damping": 10 ** rng.uniform(-1, 1), "motor_inertia": 10 ** rng.uniform(-1.5, 0)}
    if rng.random() < 0.2:
        parts |= {"sample_time": 10 ** rng.uniform(-3.5, -2), "derivative_rule": "backward"}
    w, damping = 10 ** rng.uniform(0.5, 1.7), rng.uniform(0.3, 1.5)
    kp, kd = w**2, 2 * damping * w
    ki = kp * w * 0.1 if rng.random() < 0.15 else None
    kind = rng.integers(4 if which < 2 else 7)
    ref, environment, F = mfc.trajectories.Hold(q), None, np.array([0, 0, 5.0, 0, 0, 0])
    if kind == 3:
        law: mfc.laws.Law = mfc.laws.DampedForcePI(F, float(rng.uniform(0, 1)), float(rng.uniform(0, 5)), np.full(6, 10 ** rng.uniform(1, 2.5)))
        if rng.random() < 0.3:
            parts["force_delay"] = float(10 ** rng.uniform(-3.5, -2.3))
        environment = mfc.Environment([10 ** rng.uniform(2, 5)] * 6, 10 ** rng.uniform(0, 2), axes="xyzrxryrz", preload=[0, 0, 5.0, 0, 0, 0])
    elif kind == 4:
        law = mfc.laws.TaskComputedTorque(kp, ki, kd)
    elif kind == 5:
        law = mfc.laws.Impedance([10 * kp] * 3 + [kp] * 3, [10 * kd] * 3 + [kd] * 3, [5, 5, 5, 0.2, 0.2, 0.2] if rng.random() < 0.4 else None)
    elif kind == 6:
        law = mfc.laws.Admittance(np.zeros(6), np.array([5, 5, 5, 0.2, 0.2, 0.2]), 10 * kd, 10 * kp)
        parts = {"servo": mfc.Servo(10 ** rng.uniform(1.5, 2.5))} if rng.random() < 0.7 else {}
    elif kind == 0:
        law = mfc.laws.JointPID(kp * np.array(size), None if ki is None else ki * np.array(size), kd * np.array(size))
    else:
        law = mfc.laws.ComputedTorque(kp, ki, kd)
    model = robot.with_payload(float(rng.uniform(0.5, 3))) if rng.random() < 0.3 else robot
    return mfc.ClosedLoop(model, law, ref, controller_model=robot, environment=environment, q_start=q, hardware=mfc.Hardware(**parts))  # type: ignore[arg-type]


def on_spring(loop: mfc.ClosedLoop, k: float, damping: float, turn: np.ndarray) -> bool:
    """Whether it is stable with one more spring at the tool, not equally stiff in its directions, turned by a rotation vector; unloaded."""
    X, ratio = loop.robot.pose(loop.nominal([0.0]).q[0]), np.array([1.0, 0.3, 0.1])
    more = [
        mfc.Environment(k * ratio, damping * ratio, pose=X @ exp6(np.concatenate([np.zeros(3), turn])), axes="xyz"),
        mfc.Environment(0.1 * k * ratio, 0.1 * damping * ratio, pose=X, axes="rxryrz"),
    ]
    there = replace(loop, environment=[*loop.equations.surfaces, *more]).linearize(coordinates="state")
    return bool(there.stability.nonzero_stable[0])


def with_environment(port: PortSystem, M: np.ndarray, P: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Eigenvalues of a loop without dead time with f = -(M v' + P v + K x), x' = v, at its port; (p, p) each, M and K of a spring and a mass."""
    A, B, C, D = (x[0] for x in port.late[:4])
    assert not D.any()
    back = -np.linalg.solve(np.eye(len(M)) + M @ C @ B, np.hstack([M @ C @ A + P @ C, K]))  # v' = C A x + C B f
    return np.linalg.eigvals(
        np.block([[A, np.zeros((len(A), len(M)))], [C, np.zeros_like(M)]]) + np.vstack([B @ back, np.zeros((len(M), back.shape[1]))])
    )


def unsettled(port: PortSystem, w: np.ndarray) -> tuple[bool, bool]:
    """(the port gives energy along a real direction, a passive environment made from its worst direction is unstable).

    Along a real direction it has one degree of freedom. Where only complex directions give energy, it is a damper in all directions, masses,
    springs and a gyroscope: P = r I + G and X symmetric with (P + jX) V = -f, for r of the energy given; G and X by least squares.
    """
    Y = admittance(port, w)[0]
    size = np.abs(Y).max(axis=(1, 2))
    real = (Y.real + np.swapaxes(Y.real, 1, 2)) / 2
    along_real = bool((np.linalg.eigvalsh(real)[:, 0] < -1e-9 * size).any())
    values, vectors = np.linalg.eigh(real if along_real else (Y + np.swapaxes(Y, 1, 2).conj()) / 2)
    worst = np.argsort(values[:, 0] / size)[:40]
    for k in worst[values[worst, 0] < -1e-9 * size[worst]]:
        f = vectors[k, :, 0]
        if along_real:
            z = -1 / (f @ Y[k] @ f)
            r, X, G = z.real * np.outer(f, f), z.imag * np.outer(f, f), np.zeros_like(real[k])
        else:
            r, X, G = _gyroscopic(Y[k] @ f, -f)
        sizes, axes = np.linalg.eigh(X)
        for more in (0.0, 0.1, 1.0, 10.0, 100.0):  # springs beyond what is needed; masses make up for them
            spring = (np.maximum(-sizes, 0) + more * np.abs(sizes).max()) * w[k]
            mass = (sizes + spring / w[k]) / w[k]
            span = axes if not along_real else axes * (np.abs(axes.T @ f) > 0.5)
            M, K = ((span * x) @ span.T for x in (mass, spring))
            for part in (0.5, 0.0, 0.9, 0.99):
                if with_environment(port, M, part * r + G, K).real.max() > 1e-9:
                    return along_real, True
    return along_real, False


def _gyroscopic(V: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """r I, X and G, real, with (r I + G + jX) V = f."""
    p = len(V)
    r = float(np.real(V.conj() @ f)) / float(np.real(V.conj() @ V))
    columns, parts = [], []
    for i in range(p):
        for j in range(i, p):
            X, G = np.zeros((p, p)), np.zeros((p, p))
            X[i, j] = X[j, i] = 1
            G[i, j], G[j, i] = 1, -1
            parts += [(X, 0 * X)] + [(0 * G, G)] * (i < j)
    for X, G in parts:
        y = (G + 1j * X) @ V
        columns.append(np.concatenate([y.real, y.imag]))
    rest = f - r * V
    found = np.linalg.lstsq(np.array(columns).T, np.concatenate([rest.real, rest.imag]), rcond=None)[0]
    return r * np.eye(p), *(sum(c * part[k] for c, part in zip(found, parts, strict=True)) for k in range(2))


def judged(loop: mfc.ClosedLoop, rng: np.random.Generator) -> tuple[str, str]:
    """(kind of the verdict, what is wrong or "")."""
    lin = loop.linearize(coordinates="state")
    found = lin.passivity()
    outcome = found.outcome[0]
    late = max(lin.delay, lin.force_delay)
    if late and outcome in (Passive.PASSIVE, Passive.NOT_PASSIVE):  # many more frequencies, without a plan
        port = port_system(loop.equations, lin.opened, lin.point.x, "joints")
        by_joints = lin.passivity("joints")
        w = np.sort(np.concatenate([10 ** rng.uniform(-2, 5, 3000), rng.uniform(0.01, 30 * 2 * np.pi / late, 6000)]))
        Z = np.linalg.inv(admittance(port, w)[0])
        least = float((np.linalg.eigvalsh(Z + np.swapaxes(Z, 1, 2).conj())[:, 0] / 2).min())
        if by_joints.passive[0] and least < -1e-9 * np.abs(Z).max():
            return outcome.name, f"{least:.4g} was found at the joints"
        if by_joints.outcome[0] is Passive.NOT_PASSIVE and -least > by_joints.damping[0] * (1 + 1e-4):
            return outcome.name, f"{least:.6g} was found at the joints: {by_joints}"
    if outcome is Passive.PASSIVE:
        turn = rng.uniform(-1, 1, 3)
        bare = isinstance(loop.law, mfc.laws.Admittance) and loop.equations.actuators.servo is None  # its velocity jumps: a damper does not apply
        for k in SPRINGS:
            for damping in (0.0,) if bare else (0.0, float(10 ** rng.uniform(0, 4))):
                if not on_spring(loop, float(k), damping, turn):
                    return outcome.name, f"not stable on {k:.3g} N/m with {damping:.3g} Ns/m"
    if outcome is Passive.NOT_PASSIVE:
        port = port_system(loop.equations, lin.opened, lin.point.x, "tool")
        b = float(found.damping[0])
        if b < 1e7 and not lin.dt:  # with more the slow roots of an integral are rounding
            for part, enough in ((1.001, True), (0.99, False)):
                again = port.damped(part * b)
                known = stability(again.opened)
                known = replace(known, stable=known.nonzero_stable | ~known.held)  # a damper makes roots slow
                verdict = passivity(again, "tool", known)
                if bool(verdict.passive[0]) != enough and not (enough and verdict.outcome[0] is Passive.NOT_CERTIFIED):
                    return outcome.name, f"{part} of the extra damping {b:.4g}: {verdict}"
        if not (late or lin.dt):
            there, done = unsettled(port, found.frequencies[0])
            kind = outcome.name if there else "NOT_PASSIVE along complex directions"
            return kind, "" if done else f"no environment was found: {found}"
    return outcome.name, ""


def main() -> int:
    """The exit code."""
    takes = argparse.ArgumentParser()
    takes.add_argument("--count", type=int, default=200)
    takes.add_argument("--seed", type=int, default=0)
    asked = takes.parse_args()
    warnings.simplefilter("ignore")
    seen: dict[str, int] = {}
    wrong, start = 0, time.perf_counter()
    for i in range(asked.count):
        rng = np.random.default_rng([asked.seed, i])
        try:
            name, why = judged(random_loop(rng), rng)
        except MfcError as error:
            name, why = f"refused: {type(error).__name__}", ""
        seen[name] = seen.get(name, 0) + 1
        if why:
            wrong += 1
            print(f"{i}: {why}", flush=True)
    print(f"{asked.count} loops, {wrong} wrong, {time.perf_counter() - start:.0f} s: {seen}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
