"""The same loop in other libraries, where they are installed: CasADi (with CVODES) and Drake. None of them is a dependency."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import mfc_analysis as mfc
from benchmarks.loops import GAINS, Q0
from mfc_analysis.robots.catalogue import ur5_urdf


def _cross(ca: Any, w: Any) -> Any:
    """ad of a twist (linear, angular), 6 x 6."""
    v, o = ca.skew(w[:3]), ca.skew(w[3:])
    return ca.vertcat(ca.horzcat(o, v), ca.horzcat(ca.SX(3, 3), o))


def _joints(ca: Any, model: Any, q: Any) -> list[tuple[Any, Any, Any]]:
    """For each joint: the adjoint from its parent's frame into its own, its axis as a twist, and the spatial inertia of its body."""
    out = []
    for i in range(1, model.njoints):
        kind = model.joints[i].shortname()
        axis = np.array([float(kind.endswith(c)) for c in "XYZ"])
        W = ca.skew(axis)
        turn = ca.SX.eye(3) + ca.sin(q[i - 1]) * W + (1 - ca.cos(q[i - 1])) * (W @ W)
        R, p = ca.DM(model.jointPlacements[i].rotation) @ turn, ca.DM(model.jointPlacements[i].translation)
        back = ca.vertcat(ca.horzcat(R.T, -R.T @ ca.skew(p)), ca.horzcat(ca.SX(3, 3), R.T))
        out.append((back, ca.DM([0.0, 0.0, 0.0, *axis]), ca.DM(model.inertias[i].matrix())))
    return out


def _rnea(ca: Any, model: Any, q: Any, v: Any, a: Any) -> Any:
    """Recursive Newton-Euler (Featherstone, Rigid Body Dynamics Algorithms, table 5.1), for revolute joints in a chain."""
    V, dV = ca.SX(6, 1), ca.vertcat(-ca.DM(model.gravity.linear), ca.SX(3, 1))
    joints, forces = _joints(ca, model, q), []
    for i, (X, S, inertia) in enumerate(joints):
        V = X @ V + S * v[i]
        dV = X @ dV + S * a[i] + _cross(ca, V) @ (S * v[i])
        forces.append(inertia @ dV - _cross(ca, V).T @ (inertia @ V))
    tau = [None] * len(joints)
    for i in reversed(range(len(joints))):
        X, S, _ = joints[i]
        tau[i] = ca.dot(S, forces[i]) + model.armature[i] * a[i]
        if i:
            forces[i - 1] += X.T @ forces[i]
    return ca.vertcat(*tau)


def _aba(ca: Any, model: Any, q: Any, v: Any, tau: Any) -> Any:
    """The articulated-body algorithm (the same book, table 7.1)."""
    joints, V = _joints(ca, model, q), ca.SX(6, 1)
    bias, inertias, forces = [], [], []
    for i, (X, S, inertia) in enumerate(joints):
        V = X @ V + S * v[i]
        bias.append(_cross(ca, V) @ (S * v[i]))
        inertias.append(ca.SX(inertia))
        forces.append(-_cross(ca, V).T @ (inertia @ V))
    U, d, u = ([None] * len(joints) for _ in range(3))
    for i in reversed(range(len(joints))):
        X, S, _ = joints[i]
        U[i] = inertias[i] @ S
        d[i] = ca.dot(S, U[i]) + model.armature[i]
        u[i] = tau[i] - ca.dot(S, forces[i])
        if i:
            left = inertias[i] - U[i] @ U[i].T / d[i]
            inertias[i - 1] += X.T @ left @ X
            forces[i - 1] += X.T @ (forces[i] + left @ bias[i] + U[i] * u[i] / d[i])
    dV, out = ca.vertcat(-ca.DM(model.gravity.linear), ca.SX(3, 1)), []
    for i, (X, S, _) in enumerate(joints):
        dV = X @ dV + bias[i]
        out.append((u[i] - ca.dot(U[i], dV)) / d[i])
        dV = dV + S * out[i]
    return ca.vertcat(*out)


def casadi_loop(loop: mfc.ClosedLoop) -> tuple[Any, Any, Any]:
    """(t, x, x') of the loop under 9.10 on its sinusoid, as expressions."""
    import casadi as ca

    n = loop.robot.n
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 3 * n)
    q, v, z = x[:n], x[n : 2 * n], x[2 * n :]
    s, c = ca.sin(1.5 * t), ca.cos(1.5 * t)
    e = Q0 + 0.3 * s - q
    kp, ki, kd = GAINS
    a_q = -0.3 * 1.5**2 * s + kp * e + ki * z + kd * (0.3 * 1.5 * c - v)
    tau = _rnea(ca, loop.controller_model.model, q, v, a_q)
    return t, x, ca.vertcat(v, _aba(ca, loop.robot.model, q, v, tau), e)


def casadi_matrix(loop: mfc.ClosedLoop, times: np.ndarray, options: dict[str, Any] | None = None) -> Callable[[], np.ndarray]:
    """A at given operating points by CasADi's automatic differentiation, mapped over the points."""
    import casadi as ca

    t, x, rates = casadi_loop(loop)
    nx, m = x.numel(), len(times)
    call = ca.Function("A", [t, x], [ca.densify(ca.jacobian(rates, x))], options or {}).map(m)
    at, points = ca.DM(times).T, ca.DM(loop.linearize(times).point.x.T)
    return lambda: np.swapaxes(np.asarray(call(at, points)).T.reshape(m, nx, nx), 1, 2)


def casadi_compiled(loop: mfc.ClosedLoop, times: np.ndarray) -> Callable[[], np.ndarray]:
    """The same as C, compiled beforehand by the system's compiler."""
    return casadi_matrix(loop, times, {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O2"]}})


def cvodes(loop: mfc.ClosedLoop) -> Callable[[], np.ndarray]:
    """A simulation of 5 s by CasADi's CVODES with the tolerances of ours, from the same start."""
    import casadi as ca

    t, x, rates = casadi_loop(loop)
    n = loop.robot.n
    run = ca.integrator("run", "cvodes", {"t": t, "x": x, "ode": rates}, 0.0, np.linspace(0, 5, 501)[1:].tolist(), {"reltol": 1e-6, "abstol": 1e-9})
    x0 = np.concatenate([Q0 - 0.1, np.full(n, 0.3 * 1.5), np.zeros(n)])
    return lambda: np.asarray(run(x0=x0)["xf"])


def drake_matrix(loop: mfc.ClosedLoop, times: np.ndarray) -> Callable[[], np.ndarray]:
    """A at given operating points from Drake's inverse dynamics with AutoDiff: of the controller's model, and of the plant at its acceleration."""
    from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import SpatialInertia, UnitInertia

    def built(payload: float) -> tuple[Any, Any]:
        plant = MultibodyPlant(0.0)
        (arm,) = Parser(plant).AddModelsFromString(ur5_urdf(), "urdf")
        plant.mutable_gravity_field().set_gravity_vector(loop.robot.model.gravity.linear)
        if payload:
            body = plant.AddRigidBody("payload", arm, SpatialInertia(payload, np.zeros(3), UnitInertia(0.0, 0.0, 0.0)))
            plant.WeldFrames(plant.GetFrameByName("tool0"), body.body_frame())
        plant.Finalize()
        dual = plant.ToAutoDiffXd()
        return dual, dual.CreateDefaultContext()

    n = loop.robot.n
    (model, at_model), (plant, at_plant) = built(0.0), built(loop.robot.payloads[-1].mass)
    x, ref, (kp, ki, kd) = loop.linearize(times).point.x, loop.ref(times), GAINS
    a = np.stack([loop.equations.rates(float(t), one)[n : 2 * n] for t, one in zip(times, x, strict=True)])

    def slopes(plant: Any, context: Any, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(n, 3n) of M a + h along q, v and a."""
        from pydrake.multibody.tree import MultibodyForces_

        seeded = InitializeAutoDiff(np.concatenate([q, v, a])).ravel()
        plant.SetPositionsAndVelocities(context, seeded[: 2 * n])
        forces = MultibodyForces_[type(seeded[0])](plant)
        plant.CalcForceElementsContribution(context, forces)  # gravity
        return np.asarray(ExtractGradient(plant.CalcInverseDynamics(context, seeded[2 * n :], forces)))

    def run() -> np.ndarray:
        A = np.zeros((len(times), 3 * n, 3 * n))
        for i in range(len(times)):
            q, v, z = x[i, :n], x[i, n : 2 * n], x[i, 2 * n :]
            a_q = ref.a[i] + kp * (ref.q[i] - q) + ki * z + kd * (ref.v[i] - v)
            law, body = slopes(model, at_model, q, v, a_q), slopes(plant, at_plant, q, v, a[i])
            M = law[:, 2 * n :]
            command = np.concatenate([law[:, :n] - kp * M, law[:, n : 2 * n] - kd * M, ki * M], axis=1)
            command[:, : 2 * n] -= body[:, : 2 * n]
            A[i, :n, n : 2 * n] = np.eye(n)
            A[i, n : 2 * n] = np.linalg.solve(body[:, 2 * n :], command)
            A[i, 2 * n :, :n] = -np.eye(n)
        return A

    return run
