"""Motion control with torque inputs in joint space: equations 9.8 to 9.13."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.law import Action, JointLaw, JointReference, Measured, Slot, Tap, define
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector, matvec
from mfc_analysis.robots.primitives import Primitives


@define
class JointPID(JointLaw):
    r"""Independent joint PID: equation 9.8, :math:`\tau = K_p e + K_i \int e + K_d \dot e`.

    Args:
        kp: [Nm/rad], ki: [Nm/(rad s)], kd: [Nm s/rad]; scalar, (n,) or (n, n); None: no such term.
        anti_windup: time constant T [s] of back-calculation, where a torque limit of the hardware cuts the torque: z' = e + Ki^-1 lost / T, lost =
            sat(tau) - tau. None: the integral winds up. It acts only while a torque saturates, so not in the linear model of a loop whose torques
            do not.

    Closed form on one joint about th0: I s^3 + (b + kd) s^2 + (kp - m g r sin th0) s + ki. Stable iff all coefficients are positive and ki < (b +
    kd)(kp - m g r sin th0)/I.
    """

    kp: Gain
    ki: Gain = Gain()
    kd: Gain = Gain()
    anti_windup: float | None = None
    equation = "9.8"
    typst = "tau = K_p e + K_i integral e dif t + K_d dot(e)"
    units = {"kp": "Nm/rad", "ki": "Nm/(rad s)", "kd": "Nm s/rad"}

    def __post_init__(self) -> None:
        self.check_anti_windup()

    def lost_command(self, model: Primitives, now: Measured, ref: JointReference, lost: Vector) -> Vector:
        """The torque itself."""
        return lost

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = Kp e + Ki z + Kd e'."""
        e, e_dot = ref.q - now.q, ref.v - now.v
        return Action(self.kp @ e + self.ki @ now["z"] + self.kd @ e_dot, {"z": e} if self.ki else {}, e)


@define
class TorqueFeedforward(JointLaw):
    r"""Feedforward torque only: equation 9.9, :math:`\tau = \hat M(q_d) \ddot q_d + \hat h(q_d, \dot q_d)`.

    ``form="printed"``: the page writes the acceleration of the error, tau = M^(q_d)(q_d'' - q'') + h^(q_d, v_d). This is an algebraic loop, solved
    together with q'', and changes the inertia to M + M^(q_d).
    """

    form: Literal["standard", "printed"] = "standard"
    equation = "9.9"
    forms = ("standard", "printed")
    typst = "tau = hat(M)(q_d) dot.double(q)_d + hat(h)(q_d, dot(q)_d)"

    def __post_init__(self) -> None:
        checks.choice("form", self.form, self.forms)

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = M^(q_d) a_d + h^(q_d, v_d); the printed form's - M^(q_d) q'' is ``acceleration_torque``."""
        return Action(model.inverse_dynamics(ref.q, ref.v, ref.a), {}, ref.q - now.q)

    @property
    def needs_acceleration(self) -> bool:
        """True for the printed form."""
        return self.form == "printed"

    def acceleration_torque(self, model: Primitives, ref: JointReference, a: Vector) -> Vector:
        """M^(q_d) a (..., n): the torque that the printed form subtracts for the measured acceleration a."""
        return model.mass(ref.q, a)


@define
class ComputedTorque(JointLaw):
    r"""Computed torque with PID error feedback: equations 9.10 and 9.12.

    .. math:: \tau = \hat M(q)\,(a_d + K_p e + K_i z + K_d \dot e) + \hat h

    Args:
        kp: [1/s^2], ki: [1/s^3], kd: [1/s]; scalar, (n,) or (n, n).
        form: "standard": h^ at the measured (q, v); with an exact model the error obeys e''' + kd e'' + kp e' + ki e = 0.
            "printed": h^ at (q_d, v_d), as the page says; dh/dq and dh/dv stay in the loop.
        mass: a constant (n, n) matrix [kg m^2] instead of M^(q): the decentralised case when it is diagonal.
        anti_windup: time constant T [s] of back-calculation, where a torque limit of the hardware cuts the torque: z' = e + Ki^-1 (M^)^-1 lost / T,
            lost = sat(tau) - tau. None: the integral winds up. It acts only while a torque saturates, so not in the linear model of a loop whose
            torques do not.

    Sources: chapter, eq. 9.10, 9.12; Lynch & Park, Modern Robotics, ch. 11.
    """

    kp: Gain
    ki: Gain = Gain()
    kd: Gain = Gain()
    form: Literal["standard", "printed"] = "standard"
    mass: ArrayLike | None = None
    anti_windup: float | None = None
    equation = "9.10"
    opens_at = ("torque", "command", "position")
    forms = ("standard", "printed")
    typst = "tau = hat(M)(q) (dot.double(q)_d + K_p e + K_i integral e dif t + K_d dot(e)) + hat(h)(q, dot(q))"
    units = {"kp": "1/s^2", "ki": "1/s^3", "kd": "1/s"}

    def __post_init__(self) -> None:
        checks.choice("form", self.form, self.forms)
        if self.mass is not None:
            object.__setattr__(self, "mass", mass_matrix(self.mass))
        self.check_anti_windup()

    def lost_command(self, model: Primitives, now: Measured, ref: JointReference, lost: Vector) -> Vector:
        """(M^)^-1 lost: the acceleration that is lost."""
        return acceleration_of(model, now.q, lost, self.mass)

    def check(self, n: int) -> None:
        """Raises BadArgument unless gains and mass fit n joints."""
        super().check(n)
        check_mass(self.mass, n)

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = M^ (a_d + Kp e + Ki z + Kd e') + h^."""
        e, e_dot = ref.q - now.q, ref.v - now.v
        a_q = tap("command", ref.a + self.kp @ e + self.ki @ now["z"] + self.kd @ e_dot)
        rates: Mapping[str, Vector] = {"z": e} if self.ki else {}
        if self.form == "standard" and self.mass is None:
            return Action(model.inverse_dynamics(now.q, now.v, a_q), rates, e)
        at = ref if self.form == "printed" else now
        h = model.bias(at.q, at.v)
        inertial = model.mass(now.q, a_q) if self.mass is None else matvec(np.asarray(self.mass), a_q)
        return Action(inertial + h, rates, e)


@define
class InverseDynamics(JointLaw):
    r"""Inverse dynamics with any outer loop: equations 9.11 and 9.13.

    .. math:: u = \hat M(q)\,a_q + \hat C \dot q + \hat g,\quad a_q = a_d + \mathrm{outer}(e)

    With an exact model q'' = a_q: n decoupled double integrators.

    Args:
        outer: e -> a_q [1/s^2], one of: a proper python-control LTI system (SISO: a copy for each joint; or n x n); its matrices (A, B, C, D) or
            (A, B, C, D, dt); ``dict(kp=, ki=, kd=)`` for a PID. A discrete system is the difference equation as it is coded: its dt [s] must be the
            ``sample_time`` of the hardware.

    Raises:
        BadArgument: the system is improper, discrete without its dt, or neither 1 x 1 nor n x n; an unknown key.
    """

    outer: Any
    kp: Gain = field(init=False, repr=False)
    ki: Gain = field(init=False, repr=False)
    kd: Gain = field(init=False, repr=False)
    system: tuple[Array, Array, Array, Array] | None = field(init=False, repr=False)  #: A, B, C, D; None: a PID
    sample_time: float | None = field(init=False, repr=False)  #: [s] of a discrete outer loop
    equation = "9.11"
    opens_at = ("torque", "command", "position")
    typst = "u = hat(M)(q) a_q + hat(C)(q, dot(q)) dot(q) + hat(g)(q)"
    units = {"kp": "1/s^2", "ki": "1/s^3", "kd": "1/s"}

    def __post_init__(self) -> None:
        given: Mapping[str, Any] = {}
        system, dt = None, None
        if isinstance(self.outer, Mapping):
            given = self.outer
            unknown = set(given) - {"kp", "ki", "kd"}
            if unknown or not given:
                raise BadArgument("outer", dict(given), "dict(kp=, ki=, kd=) with at least one of them, or a python-control LTI system")
        else:
            system, dt = state_space("outer", self.outer)
        for name in ("kp", "ki", "kd"):
            object.__setattr__(self, name, Gain(name, given.get(name)))
        object.__setattr__(self, "system", system)
        object.__setattr__(self, "sample_time", dt)

    def __getstate__(self) -> dict[str, Any]:  # a control system does not pickle; its matrices do
        return vars(self) if self.system is None else {**vars(self), "outer": (*self.system, self.sample_time or 0)}

    def gains(self) -> dict[str, Gain]:
        """The PID's gains; empty for an LTI outer loop."""
        return {name: gain for name, gain in super().gains().items() if gain}

    def check(self, n: int) -> None:
        """Raises BadArgument unless the outer loop fits n joints."""
        super().check(n)
        if self.system is not None and self.system[3].shape not in ((1, 1), (n, n)):
            got = f"{self.system[3].shape[1]} inputs and {self.system[3].shape[0]} outputs"
            raise BadArgument("outer", got, f"a system with one input and output, or {n} of each")

    @property
    def joint_by_joint(self) -> bool:
        """True for a PID and for an outer loop that is the same for each joint."""
        return self.system is None or self.system[3].shape == (1, 1)

    def matrices(self, n: int) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D of the LTI outer loop for n joints."""
        assert self.system is not None
        A, B, C, D = self.system
        if D.shape == (n, n):
            return A, B, C, D
        one = np.eye(n)
        A, B, C, D = (np.asarray(np.kron(one, M), float) for M in self.system)
        return A, B, C, D

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """z of the PID, or the states of the LTI outer loop, of which the integrators are trimmed."""
        if self.system is None:
            return super().slots(joints)
        discrete = self.sample_time is not None
        A = self.matrices(len(joints))[0]
        _, sigma, right = np.linalg.svd(A - np.eye(len(A)) if discrete else A)
        at_rest = right[sigma <= 1e-10 * max(1.0, float(sigma.max(initial=0.0)))].T
        return (Slot("outer", tuple(str(i) for i in range(len(A))), integral=False, trim=at_rest, stepped=discrete),) if len(A) else ()

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = M^(q) (a_d + outer(e)) + h^(q, v)."""
        e = ref.q - now.q
        outer, rates = self._outer(model.n, e, ref.v - now.v, now)
        a_q = tap("command", ref.a + outer)
        return Action(model.inverse_dynamics(now.q, now.v, a_q), rates, e)

    def _outer(self, n: int, e: Vector, e_dot: Vector, now: Measured) -> tuple[Vector, dict[str, Vector]]:
        """outer(e), and the rates of its states."""
        if self.system is None:
            return self.kp @ e + self.ki @ now["z"] + self.kd @ e_dot, {"z": e} if self.ki else {}
        A, B, C, D = self.matrices(n)
        x = now["outer"]
        if x is None:
            return matvec(D, e), {}
        rate = matvec(A, x) + matvec(B, e)
        if self.sample_time is not None:
            rate = (rate - x) * (1 / self.sample_time)
        return matvec(D, e) + matvec(C, x), {"outer": rate}


def state_space(argument: str, system: Any) -> tuple[tuple[Array, Array, Array, Array], float | None]:
    """A, B, C, D of a proper LTI system, and its dt [s], None: continuous. Raises BadArgument."""
    import control

    takes = "a proper python-control LTI system (StateSpace or TransferFunction), continuous or with its dt in seconds, or dict(kp=, ki=, kd=)"
    if isinstance(system, tuple) and len(system) in (4, 5):
        A, B, C, D = (checks.array(argument, M) for M in system[:4])
        dt = checks.number(argument, system[4], low=0.0) if len(system) == 5 else 0
        try:
            system = control.ss(A, B, C, D, dt)
        except (ValueError, TypeError) as why:
            raise BadArgument(argument, f"shapes {', '.join(str(M.shape) for M in (A, B, C, D))}", "A, B, C, D that fit together") from why
    if isinstance(system, (int, float)):
        system = control.ss([], [], [], [[checks.number(argument, system)]])
    if not isinstance(system, (control.StateSpace, control.TransferFunction)):
        raise BadArgument(argument, system, takes)
    if system.dt is True:
        raise BadArgument(argument, "a discrete system without its dt", takes)
    if isinstance(system, control.TransferFunction):
        for row in range(system.noutputs):
            for column in range(system.ninputs):
                num, den = (np.trim_zeros(np.asarray(p[row][column], float), "f") for p in (system.num, system.den))
                if num.size > den.size:
                    raise BadArgument(argument, f"an improper transfer function (degree {num.size - 1} over {den.size - 1})", takes)
        system = control.ss(system) if system.issiso() else control.tf2ss(system)
    A, B, C, D = (checks.array(argument, M) for M in (system.A, system.B, system.C, system.D))
    return (A, B, C, D), float(system.dt) if system.dt else None


def mass_matrix(given: ArrayLike) -> Array:
    """A symmetric positive definite matrix [kg m^2]. Raises BadArgument."""
    M = checks.array("mass", given)
    takes = "a symmetric positive definite (n, n) matrix [kg m^2]"
    if M.ndim != 2 or M.shape[0] != M.shape[1] or np.abs(M - M.T).max() > 1e-9 * np.abs(M).max() or np.linalg.eigvalsh(M)[0] <= 0:
        raise BadArgument("mass", given, takes)
    return M


def acceleration_of(model: Primitives, q: Vector, tau: Vector, mass: ArrayLike | None) -> Vector:
    """(..., n) (M^)^-1 tau by the controller's model, or by its constant mass matrix."""
    return model.solve_mass(q, tau) if mass is None else matvec(np.asarray(np.linalg.inv(np.asarray(mass)), float), tau)


def check_mass(mass: ArrayLike | None, n: int) -> None:
    """Raises BadArgument unless a constant mass matrix fits n joints."""
    if mass is not None and np.shape(mass) != (n, n):
        raise BadArgument("mass", f"shape {np.shape(mass)}", f"a matrix of shape ({n}, {n})")
