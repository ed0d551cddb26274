"""Lower bounds: the least work in Python that gives the same numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import mfc_analysis as mfc
from benchmarks.loops import GAINS, Q0


def joint_loop(loop: mfc.ClosedLoop, times: np.ndarray, *, inputs: bool) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """A, and B from q_d and torque disturbances where ``inputs``, of 9.10: Pinocchio's derivative calls in a bare loop, and batched products.

    The operating points are given.
    """
    robot = loop.robot
    plant, model = robot.model, loop.controller_model.model
    pdata, mdata = plant.createData(), model.createData()
    n, m = robot.n, len(times)
    x = loop.linearize(times).point.x
    q, v, z = (np.ascontiguousarray(x[:, i : i + n]) for i in (0, n, 2 * n))
    ref = loop.ref(times)
    kp, ki, kd = GAINS
    viscous = np.diag(robot.viscous) if np.any(robot.viscous) else None
    low = np.tril_indices(n, -1)

    def run() -> tuple[np.ndarray, np.ndarray]:
        a_q = ref.a + kp * (ref.q - q) + ki * z + kd * (ref.v - v)
        Mc, tq, tv = (np.empty((m, n, n)) for _ in range(3))
        aq, av, Mi = (np.empty((m, n, n)) for _ in range(3))
        for i in range(m):
            pin.computeRNEADerivatives(model, mdata, q[i], v[i], a_q[i])
            tq[i], tv[i], Mc[i] = mdata.dtau_dq, mdata.dtau_dv, mdata.M
            pin.computeABADerivatives(plant, pdata, q[i], v[i], mdata.tau)
            aq[i], av[i], Mi[i] = pdata.ddq_dq, pdata.ddq_dv, pdata.Minv
        Mc[:, low[0], low[1]] = Mc[:, low[1], low[0]]
        Mi[:, low[0], low[1]] = Mi[:, low[1], low[0]]
        if viscous is not None and not np.array_equal(robot.viscous, loop.controller_model.viscous):
            av = av - Mi @ (viscous - np.diag(loop.controller_model.viscous))
        MM = Mi @ Mc
        A = np.zeros((m, 3 * n, 3 * n))
        A[:, :n, n : 2 * n] = np.eye(n)
        A[:, 2 * n :, :n] = -np.eye(n)
        A[:, n : 2 * n, :n] = aq + Mi @ tq - kp * MM
        A[:, n : 2 * n, n : 2 * n] = av + Mi @ tv - kd * MM
        A[:, n : 2 * n, 2 * n :] = ki * MM
        B = np.zeros((m, 3 * n, 2 * n if inputs else 0))
        if inputs:
            B[:, n : 2 * n, :n] = kp * MM
            B[:, n : 2 * n, n:] = Mi
            B[:, 2 * n :, :n] = np.eye(n)
        return A, B

    return run


def tool_calls(loop: mfc.ClosedLoop, times: np.ndarray, mass_calls: int) -> Callable[[], object]:
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


def propagated(lin: mfc.Linearization, t: np.ndarray) -> Callable[[], np.ndarray]:
    """Samples of 6 outputs and 6 inputs at all points from one batched matrix exponential, sample by sample."""
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
