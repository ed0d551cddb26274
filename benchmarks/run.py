"""Measure run times as ratios to a lower bound or an alternative, both measured in the same run.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/run.py [--out benchmarks/results.md]

Both programs of a pair use one BLAS thread. Run times vary on a shared machine, so the programs take turns, and the ratio is the median
of the ratios of all pairs.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

import mfc_analysis as mfc

Q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.3])
ROWS: list[tuple[str, str, float, float, float, str]] = []


def paired(ours: Callable[[], object], rival: Callable[[], object], rounds: int = 7) -> tuple[float, float, float]:
    """Median times of both [s], and the median of the ratios ours / rival of all pairs."""
    ours(), rival()
    a, b = [], []
    for _ in range(rounds):
        t0 = time.perf_counter()
        ours()
        t1 = time.perf_counter()
        rival()
        t2 = time.perf_counter()
        a.append(t1 - t0)
        b.append(t2 - t1)
    return statistics.median(a), statistics.median(b), statistics.median(x / y for x, y in zip(a, b, strict=True))


def row(what: str, rival: str, found: tuple[float, float, float], per: int, goal: str, rival_per: int | None = None) -> None:
    """Adds a line to the table: times per point [us] and their ratio."""
    ours, other, ratio = found
    scale = 1.0 if rival_per is None else rival_per / per
    ROWS.append((what, rival, 1e6 * ours / per, 1e6 * other / (rival_per or per), ratio * scale, goal))
    print(
        f"{what:58s} {1e6 * ours / per:10.1f} us  {rival:46s} {1e6 * other / (rival_per or per):10.1f} us  ratio {ratio * scale:8.3f}  ({goal})",
        flush=True,
    )


def wrong_model_loop() -> mfc.ClosedLoop:
    """UR5 under 9.10 with an unknown payload of 2 kg: 18 states."""
    robot = mfc.robots.ur5()
    path = mfc.trajectories.Sinusoid(Q0, 0.3, 1.5)
    return mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.ComputedTorque(100, 80, 20), path, controller_model=robot)


def bare(loop: mfc.ClosedLoop, times: np.ndarray) -> Callable[[], np.ndarray]:
    """The lower bound for the closed-loop A: Pinocchio's derivative calls in a bare loop at the same operating points, and a batched matmul."""
    plant, model = loop.robot.model, loop.controller_model.model
    pdata, mdata = plant.createData(), model.createData()
    x = loop.linearize(times).point.x
    q, v, z = (np.ascontiguousarray(x[:, i : i + 6]) for i in (0, 6, 12))
    ref = loop.ref(times)
    kp, ki, kd = 100.0, 80.0, 20.0
    m = len(times)

    def run() -> np.ndarray:
        a_q = ref.a + kp * (ref.q - q) + ki * z + kd * (ref.v - v)
        Mc, tq, tv = (np.empty((m, 6, 6)) for _ in range(3))
        aq, av, Mi = (np.empty((m, 6, 6)) for _ in range(3))
        for i in range(m):
            pin.computeRNEADerivatives(model, mdata, q[i], v[i], a_q[i])
            tq[i], tv[i], Mc[i] = mdata.dtau_dq, mdata.dtau_dv, mdata.M
            pin.computeABADerivatives(plant, pdata, q[i], v[i], mdata.tau)
            aq[i], av[i], Mi[i] = pdata.ddq_dq, pdata.ddq_dv, pdata.Minv
        low = np.tril_indices(6, -1)
        Mc[:, low[0], low[1]] = Mc[:, low[1], low[0]]
        Mi[:, low[0], low[1]] = Mi[:, low[1], low[0]]
        A = np.zeros((m, 18, 18))
        A[:, :6, 6:12] = np.eye(6)
        A[:, 12:, :6] = -np.eye(6)
        A[:, 6:12, :6] = aq + Mi @ (tq - kp * Mc)
        A[:, 6:12, 6:12] = av + Mi @ (tv - kd * Mc)
        A[:, 6:12, 12:] = ki * (Mi @ Mc)
        return A

    return run


def python_control_linearize(loop: mfc.ClosedLoop, times: np.ndarray) -> Callable[[], object]:
    """``control.linearize`` of a nonlinear system with the same right-hand side, at the same points."""
    e = loop.equations
    x = loop.linearize(times).point.x
    sys = control.nlsys(lambda t, x, u, params: e.rates(t, x), None, inputs=1, outputs=18, states=18)
    return lambda: [sys.linearize(x[i], [0.0], t=times[i]).A for i in range(len(times))]


def hand_written(loop: mfc.ClosedLoop) -> Callable[[], object]:
    """A simulation of 5 s with a hand-written right-hand side and its exact Jacobian, with the same solver and tolerances."""
    plant, model = loop.robot.model, loop.controller_model.model
    pdata, mdata = plant.createData(), model.createData()
    q_d, amplitude, w = Q0, 0.3, 1.5

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        q, v, z = x[:6], x[6:12], x[12:]
        s, c = np.sin(w * t), np.cos(w * t)
        e, e_dot = q_d + amplitude * s - q, amplitude * w * c - v
        tau = pin.rnea(model, mdata, q, v, -amplitude * w * w * s + 100 * e + 80 * z + 20 * e_dot)
        return np.concatenate([v, pin.aba(plant, pdata, q, v, tau), e])

    A = np.zeros((18, 18))
    A[:6, 6:12] = np.eye(6)
    A[12:, :6] = -np.eye(6)
    low = np.tril_indices(6, -1)

    def jacobian(t: float, x: np.ndarray) -> np.ndarray:
        q, v, z = x[:6], x[6:12], x[12:]
        s, c = np.sin(w * t), np.cos(w * t)
        e, e_dot = q_d + amplitude * s - q, amplitude * w * c - v
        pin.computeRNEADerivatives(model, mdata, q, v, -amplitude * w * w * s + 100 * e + 80 * z + 20 * e_dot)
        pin.computeABADerivatives(plant, pdata, q, v, mdata.tau)
        M, inverse = mdata.M.copy(), pdata.Minv.copy()
        M[low], inverse[low] = M.T[low], inverse.T[low]
        A[6:12, :6] = pdata.ddq_dq + inverse @ (mdata.dtau_dq - 100 * M)
        A[6:12, 6:12] = pdata.ddq_dv + inverse @ (mdata.dtau_dv - 20 * M)
        A[6:12, 12:] = 80 * (inverse @ M)
        return A

    x0 = np.concatenate([Q0 - 0.1, np.full(6, amplitude * w), np.zeros(6)])
    return lambda: solve_ivp(rates, (0.0, 5.0), x0, method="LSODA", jac=jacobian, rtol=1e-6, atol=1e-9, t_eval=np.linspace(0, 5, 501))


def bare_task(loop: mfc.ClosedLoop, times: np.ndarray, mass_calls: int) -> Callable[[], object]:
    """The Pinocchio calls that every tool-space law needs, with their values copied: kinematics, plant, controller, J' v."""
    plant, model = loop.robot.model, loop.equations.model.model
    pdata, mdata = plant.createData(), model.createData()
    frame = loop.robot.frame_id
    x = loop.linearize(times).point.x
    q, v = (np.ascontiguousarray(x[:, i : i + 6]) for i in (0, 6))
    zero = np.zeros(6)
    m = len(times)

    def run() -> object:
        J, out = np.empty((m, 6, 6)), np.empty((m, 6, 6))
        for i in range(m):
            pin.computeForwardKinematicsDerivatives(model, mdata, q[i], v[i], zero)
            pin.updateFramePlacement(model, mdata, frame)
            J[i] = pin.getFrameAccelerationDerivatives(model, mdata, frame, pin.LOCAL)[3]
            pin.computeRNEADerivatives(model, mdata, q[i], v[i], zero)
            out[i] = mdata.dtau_dq
            for _ in range(mass_calls):
                pin.computeABADerivatives(model, mdata, q[i], zero, zero)
                out[i] = mdata.ddq_dq
            pin.computeABADerivatives(plant, pdata, q[i], v[i], zero)
            out[i] = pdata.ddq_dq
        return J, out

    return run


def linearising() -> None:
    """Linearisation with joint laws."""
    loop = wrong_model_loop()
    times = np.linspace(0.0, 4.0, 1000)
    floor = bare(loop, times)
    A = loop.linearize(times).A
    assert np.abs(A - floor()).max() <= 1e-9 * np.abs(A).max()
    lin = loop.linearize(times)
    from mfc_analysis.dynamics.jacobians import closed_matrix

    x = lin.point.x
    row(
        "A of the closed loop, 18 states (9.10, wrong model)",
        "bare Pinocchio derivative loop + matmul",
        paired(lambda: closed_matrix(loop.equations, times, x), floor),
        1000,
        "<= 1.5, aim 1.25",
    )
    row(
        "the same with operating points: loop.linearize(t).A",
        "bare loop (operating points given)",
        paired(lambda: loop.linearize(times).A, floor),
        1000,
        "for information",
    )
    few = times[::20]
    rival = python_control_linearize(loop, few)
    row("loop.linearize(t).A", "control.linearize", paired(lambda: loop.linearize(times).A, rival, 3), 1000, "<= 1/20", rival_per=len(few))
    eigen = lambda: np.linalg.eigvals(floor())  # noqa: E731
    row("A and poles, operating points given", "bare loop + numpy eigvals", paired(lambda: replace(lin).poles(), eigen), 1000, "<= 1.15")
    row(
        "A and poles with operating points",
        "bare loop + numpy eigvals",
        paired(lambda: loop.linearize(times).poles(), eigen),
        1000,
        "for information",
    )


def margins() -> None:
    """Margins of six loops at 200 points."""
    loop = wrong_model_loop()
    times = np.linspace(0.0, 4.0, 200)
    lin = loop.linearize(times)
    few = range(0, 200, 20)
    singles = [lin.loop(k, "torque", i) for k in few for i in range(6)]
    _ = lin.opened

    def rival() -> None:
        for L in singles:
            control.stability_margins(L)

    row(
        "margins of 6 loops (with sensitivity peak, delay, gain interval)",
        "control.stability_margins",
        paired(lambda: lin.margins(), rival, 3),
        200,
        "<= 1/15, aim 1/25",
        rival_per=len(few),
    )


def steps() -> None:
    """Step responses: one of them, and all of 20 points."""
    loop = wrong_model_loop()
    lin = loop.linearize([0.0])
    sys = lin.system(0)
    one = sys[lin.output_names[0], lin.input_names[0]]
    found = lin.step(0, input=0, output=0)
    grid = np.linspace(0.0, found.t[-1], len(found.t))
    row(
        "step response with its metrics",
        "control.step_response",
        paired(lambda: lin.step(0, input=0, output=0), lambda: control.step_response(one, grid)),
        1,
        "< 1",
    )
    lin, t, joints = loop.linearize(np.linspace(0.0, 4.0, 20)), np.linspace(0.0, 4.0, 301), range(6)
    few = [lin.system(i)[:6, :6] for i in (0, 7, 14)]
    held = propagated(lin, t)
    assert np.abs(lin.steps(t, joints, joints).y - held()).max() < 1e-9

    def rival() -> None:
        for one in few:
            control.step_response(one, t)

    row("36 step responses, 301 samples", "control.step_response", paired(lambda: lin.steps(t, joints, joints).y, rival), 20, "<= 1/20", rival_per=3)
    row("36 step responses, 301 samples", "batched expm, x[k+1] = Phi x[k] + Gamma", paired(lambda: lin.steps(t, joints, joints).y, held), 20, "<= 4")

    def one_by_one() -> None:
        for joint in joints:
            lin.step(0, joint, joint)

    row(
        "36 step responses with their metrics, per response",
        "lin.step one by one",
        paired(lambda: lin.steps(t, joints, joints).settling, one_by_one, 5),
        20 * 36,
        "<= 1/10",
        rival_per=6,
    )


def propagated(lin: mfc.Linearization, t: np.ndarray) -> Callable[[], np.ndarray]:
    """Samples of 6 outputs and 6 inputs at all points from one batched matrix exponential, sample by sample."""
    from scipy.linalg import expm

    A, B, C, D = lin.A, lin.B[:, :, :6], lin.C[:, :6], lin.D[:, :6, :6]
    m, n = A.shape[:2]

    def run() -> np.ndarray:
        block = np.zeros((m, n + 6, n + 6))
        block[:, :n, :n], block[:, :n, n:] = A * t[1], B * t[1]
        E = expm(block)
        x = np.zeros((len(t), m, n, 6))
        for k in range(1, len(t)):
            x[k] = E[:, :n, :n] @ x[k - 1] + E[:, :n, n:]
        return np.moveaxis(C @ x + D, 0, -1)

    return run


def simulation() -> None:
    """Simulation of a UR5 for 5 s."""
    loop = wrong_model_loop()
    row(
        "simulation of 5 s, with all signals",
        "hand-written right-hand side and Jacobian, LSODA",
        paired(lambda: loop.simulate(5.0, initial_error=0.1), hand_written(loop), 15),
        1,
        "<= 2",
    )


def validation() -> None:
    """Linear prediction against disturbed runs over 1 s: about 20 runs."""
    alone = {"rtol": 1e-10, "atol": 1e-12}
    robot = mfc.robots.ur5()
    X0 = robot.pose(Q0)
    wall = mfc.Environment(1e4, 10.0, pose=X0, axes="z", preload=10.0)
    law = mfc.laws.HybridMotionForce([0, 0, 10, 0, 0, 0], 100, None, 20, 0.5, 2.0, 30, constraints=np.eye(6)[[2]])
    flat = mfc.trajectories.ToolSinusoid(X0, [0.05, 0.0, 0.0], 1.5)
    joint = wrong_model_loop()
    late = mfc.ClosedLoop(joint.robot, joint.law, joint.ref, controller_model=robot, hardware=mfc.Hardware(delay=2e-3))
    hybrid = mfc.ClosedLoop(joint.robot, law, flat, controller_model=robot, q_start=Q0, environment=wall)
    for name, loop, rounds in (("9.10", joint, 7), ("9.24", hybrid, 3), ("9.10 with 2 ms of dead time", late, 3)):
        row(
            f"validation over 1 s ({name})",
            "one of its runs alone, rtol 1e-10",
            paired(lambda loop=loop: loop.validate(1.0), lambda loop=loop: loop.simulate(1.0, 0.01, **alone), rounds),
            1,
            "<= 3" if loop is joint else "for information",
        )


def task_space() -> None:
    """Linearisation with tool-space and hybrid laws."""
    robot = mfc.robots.ur5()
    X0 = robot.pose(Q0)
    path = mfc.trajectories.ToolSinusoid(X0, [0.05, 0.0, 0.05], 1.5)
    times = np.linspace(0.0, 4.0, 1000)
    from mfc_analysis.dynamics.jacobians import closed_matrix

    task = mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.TaskComputedTorque(100, 80, 20), path, controller_model=robot, q_start=Q0)
    x = task.linearize(times).point.x
    row(
        "A of 9.16 (wrong model), state coordinates",
        "its bare Pinocchio calls",
        paired(lambda: closed_matrix(task.equations, times, x), bare_task(task, times, 0)),
        1000,
        "<= 3, aim 2",
    )
    wall = mfc.Environment(1e4, 10.0, pose=X0, axes="z", preload=10.0)
    law = mfc.laws.HybridMotionForce([0, 0, 10, 0, 0, 0], 100, None, 20, 0.5, 2.0, 30, constraints=np.eye(6)[[2]])
    flat = mfc.trajectories.ToolSinusoid(X0, [0.05, 0.0, 0.0], 1.5)
    hybrid = mfc.ClosedLoop(robot.with_payload(2.0), law, flat, controller_model=robot, q_start=Q0, environment=wall)
    xh = hybrid.linearize(times).point.x
    row(
        "A of 9.24 (dynamic projection, contact)",
        "its bare Pinocchio calls",
        paired(lambda: closed_matrix(hybrid.equations, times, xh), bare_task(hybrid, times, 2)),
        1000,
        "<= 4, aim 3",
    )


def robustness() -> None:
    """Disk margins and Floquet multipliers."""
    from scipy.linalg import expm

    from mfc_analysis.dynamics.jacobians import closed_matrix

    loop = wrong_model_loop()
    lin = loop.linearize(np.linspace(0.0, 4.0, 8))
    w = np.logspace(-2, 3, 300)
    sys = lin.opened
    one = loop.linearize([0.0])
    L = mimo(one)
    row(
        "disk margin, 6 joints, 300 frequencies",
        "control.disk_margins",
        paired(lambda: lin.disk_margin(frequencies=w), lambda: control.disk_margins(L, w), 1),
        8,
        "<= 1/30",
        rival_per=1,
    )
    del sys
    T = loop.ref.period
    nodes = np.linspace(0, T, 160)
    x = loop.linearize(nodes).point.x

    def floor() -> None:
        A = closed_matrix(loop.equations, nodes, x)
        for k in range(80):
            expm(A[2 * k] * T / 80)

    from mfc_analysis.simulation.orbit import transitions_along

    run = loop.simulate([0.0, T], rtol=1e-8)
    row(
        "one Floquet iteration (period map, 80 steps)",
        "its A(t) batch + 80 expm",
        paired(lambda: transitions_along(loop.equations, run, np.linspace(0, T, 81)), floor),
        1,
        "<= 3",
    )


def mimo(lin: mfc.Linearization) -> control.StateSpace:
    """The loop transfer matrix of the six torque loops, opened together, for negative feedback."""
    from mfc_analysis.analysis.system import close_wires

    s = lin.opened
    keep = np.zeros(s.nw, bool)
    keep[s.wires["torque"]] = True
    A, B, C, D = close_wires(s, keep)
    return control.ss(A[0], B[0][:, s.nu :], -C[0][s.ny :], -D[0][s.ny :, s.nu :])


def table() -> str:
    """The table as Markdown."""
    lines = ["| task | us per point | reference | us per point | ratio | target |", "|---|---:|---|---:|---:|---|"]
    lines += [f"| {a} | {x:.1f} | {b} | {y:.1f} | {r:.3g} | {goal} |" for a, b, x, y, r, goal in ROWS]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Runs all benchmarks, prints the ratios and writes the table to ``--out``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    for part in (linearising, margins, steps, simulation, validation, task_space, robustness):
        if not asked.only or part.__name__ in asked.only:
            part()
    if asked.out:
        versions = f"Python packages: control {control.__version__}, numpy {np.__version__}, pin {pin.__version__}. One BLAS thread.\n\n"
        asked.out.write_text(versions + table())


if __name__ == "__main__":
    main()
