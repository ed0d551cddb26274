"""``ClosedLoop``: a robot, a law and a reference, with the contact surfaces and the hardware. Its methods call the functions of the rooms below."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.dynamics.applicability import refuse_what_does_not_apply
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.jacobians import Coordinates
from mfc_analysis.dynamics.operating_point import Nominal, nominal
from mfc_analysis.dynamics.own_law import check_action, check_attributes, is_own
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.law import Law
from mfc_analysis.linearization.linearization import Linearization, linearize
from mfc_analysis.linearization.start import About
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import value
from mfc_analysis.notebook import Shown
from mfc_analysis.robots.robot import Robot

if TYPE_CHECKING:
    from control import NonlinearIOSystem

    from mfc_analysis.dynamics.quasi_static import QuasiStatic
    from mfc_analysis.simulation.orbit import Floquet
    from mfc_analysis.simulation.simulation import Simulation
    from mfc_analysis.simulation.validation import Validation


@dataclass(frozen=True, eq=False)
class Equilibrium(Shown):
    """An equilibrium of the closed loop. ``notes`` tells how it was found where the loop is soft, and other rest points met."""

    q: Array  #: (n,)
    error: Array  #: e (n,) [rad, m] for joint laws, X_e (6,) [m, rad] for tool laws, (k,) with axes
    force: Array  #: (6,) F_tip, tool frame [N, Nm]
    torque: Array  #: (n,) commanded torque [Nm] (velocity [rad/s] for velocity laws)
    x: Array  #: (nx,) the full state
    stable: bool  #: no root grows, slow ones left out, dead time and sampling included
    notes: tuple[str, ...]  #: sentences

    def __str__(self) -> str:
        rows = [f"equilibrium, {'stable' if self.stable else 'not stable'}"]
        rows += [f"  {name:<7} ({', '.join(f'{v:.4g}' for v in getattr(self, name))})" for name in ("q", "error", "force", "torque")]
        return "\n".join([*rows, *(f"  {note}" for note in self.notes)])

    __repr__ = __str__


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A robot under one law of the chapter.

    Args:
        robot: the plant.
        law: one of ``mfc.laws``.
        ref: a reference of ``mfc.trajectories``: in joint space for joint laws, a ``Hold`` for force laws. Tool laws take a tool reference, or a
            joint reference, whose tool motion they then follow.
        controller_model: the controller's model of the plant; omitted: the plant itself.
        environment: an ``Environment``, or a list whose forces add up; surfaces without a pose lie at the tool's start pose.
        q_start: (n,) [rad, m] for tool references: the joint solution is followed from here.
        hardware: ``Hardware``; omitted: ideal.

    Raises:
        BadArgument: or a subclass, for inconsistent shapes, types or values; see the class of each argument.

    A warning is issued where the reference leaves the joint limits.
    """

    robot: Robot
    law: Law
    ref: Any
    controller_model: Robot | None = None
    environment: Environment | Sequence[Environment] | None = None
    q_start: ArrayLike | None = None
    hardware: Hardware | None = None
    equations: Equations = field(init=False, repr=False)

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        if not isinstance(self.robot, Robot):
            raise BadArgument("robot", self.robot, "a Robot, such as mfc.robots.ur5()")
        if not isinstance(self.law, Law):
            raise BadArgument("law", self.law, "one of mfc.laws, such as mfc.laws.ComputedTorque(kp=100, kd=20)")
        self.law.check(self.robot.n)
        if is_own(self.law):
            check_attributes(self.law, self.robot.joint_names)
        space = getattr(self.ref, "space", None)
        if space not in ("joint", "tool"):
            raise BadArgument("ref", self.ref, "a reference of mfc.trajectories")
        model = self.robot if self.controller_model is None else self.controller_model
        if not isinstance(model, Robot) or model.joint_names != self.robot.joint_names:
            raise BadArgument("controller_model", model, f"a Robot with the plant's joints {', '.join(self.robot.joint_names)}")
        if self.hardware is not None and not isinstance(self.hardware, Hardware):
            raise BadArgument("hardware", self.hardware, "a Hardware, such as mfc.Hardware(torque_lag=2e-3)")
        self._check_reference(space)
        q_start = None if self.q_start is None else checks.array("q_start", self.q_start, (self.robot.n,))
        set_(self, "q_start", q_start)
        surfaces = self._surfaces()
        set_(self, "equations", Equations(self.robot, model, self.law, self.ref, surfaces, self.hardware or Hardware(), q_start))
        refuse_what_does_not_apply(self.equations)
        if is_own(self.law):
            check_action(self.equations)

    def _check_reference(self, space: str) -> None:
        law, name = self.law, type(self.law).__name__
        if space == "joint" and self.ref.n != self.robot.n:
            raise BadArgument("ref", f"a reference of {self.ref.n} joints", f"one of {self.robot.n} joints, the number of {self.robot.name}")
        if law.space == "joint" and space == "tool":
            takes = f"a joint-space reference for {name}; mfc.trajectories.from_tool_path turns a tool path into one (eq 9.14)"
            raise BadArgument("ref", type(self.ref).__name__, takes)
        if not law.follows_motion and not self.ref.is_hold:
            raise BadArgument("ref", type(self.ref).__name__, f"a Hold: {name} has no motion reference")
        if space == "tool" and self.q_start is None:
            raise BadArgument("q_start", None, f"a joint position of shape ({self.robot.n},): a tool-space reference is followed from there")
        if space == "joint":
            from mfc_analysis.trajectories.joint import warn_outside_limits

            span = self.ref.duration or self.ref.period or 1.0
            warn_outside_limits(self.robot, self.ref, np.linspace(0.0, span, 101))

    def _surfaces(self) -> tuple[Environment, ...]:
        from dataclasses import replace

        given = self.environment
        if given is None:
            return ()
        surfaces: list[Environment] = []
        for surface in given if isinstance(given, (list, tuple)) else (given,):
            if not isinstance(surface, Environment):
                raise BadArgument("environment", surface, "an Environment or a list of them")
            surfaces.append(surface)
        point = self.ref(0.0)
        start = np.asarray(point.X) if self.ref.space == "tool" else self.robot.pose(point.q)
        return tuple(s if s.pose is not None else replace(s, pose=start) for s in surfaces)

    # --- the operating points ------------------------------------------------------------------------------------

    def nominal(self, times: ArrayLike) -> Nominal:
        """Reference motion of the joints (q, v, a), (m, n) each, at ``times`` (m,) [s]; tool references are followed from ``q_start`` (eq 9.14)."""
        return nominal(self.equations, checks.times(times))

    def equilibrium(self) -> Equilibrium:
        """The equilibrium that the loop comes to from the reference (a Hold), with gravity sag and steady force error.

        A stiff loop has it near the reference, where Newton finds it. A soft loop can have several: then a simulation from the reference, with its
        integrals at 0 and up to 200 s long, tells which, and ``notes`` says so. An equilibrium that is unstable, or at which the simulation does
        not come to rest, is named as such. Surfaces are two-sided, as in the linear model.

        Raises NotConverged where none is found, Unsupported on a moving reference.
        """
        from mfc_analysis.simulation.rest import LEFT, at_rest

        e = self.equations
        rest = at_rest(e)
        flow = e.flow(0.0, rest.x[0])
        error, force, torque = (np.array(value(x)) for x in (flow.error, flow.F_tip, flow.command))
        stable, notes = rest.stable, rest.notes
        if stable and (e.delayed or e.sample_time):
            stable = bool(self.linearize([0.0], about=rest.x, coordinates="state").stability.nonzero_stable[0])
            notes = notes if stable else (*notes, LEFT)
        return Equilibrium(rest.x[0][: self.robot.n], error, force, torque, rest.x[0], stable, notes)

    def quasi_static(self) -> QuasiStatic:
        """Equation 9.20's model of the same loop: g + J^T F_tip = tau. ``.force`` and ``.error`` = F_d - F_tip, each (6,) [N, Nm]."""
        from mfc_analysis.dynamics.quasi_static import quasi_static
        from mfc_analysis.simulation.rest import at_rest

        return quasi_static(self.equations, at_rest(self.equations).x if self.equations.surfaces else None)

    # --- linear --------------------------------------------------------------------------------------------------

    def linearize(
        self,
        times: ArrayLike = (0.0,),
        about: About | ArrayLike = "reference",
        coordinates: Coordinates | None = None,
        simulation: Simulation | None = None,
        horizon: float = HORIZON,
    ) -> Linearization:
        """The loop linearised exactly at m times [s].

        Args:
            times: (m,) strictly increasing.
            about: "reference" (integral trimmed), "equilibrium" (near a Hold), "simulation", or states of your
                own (m, nx) in the order of ``state_names`` of coordinates "state", one row for each time.
            coordinates: "state" (q, v, z, ...) or "error" (X_e, V_e, z, ...); None: "error" for tool laws where J (with axes: S J) is square
                and well conditioned, else "state".
            simulation: the run that is followed with ``about="simulation"``.
            horizon: [s] of the verdict: roots with |s| < 1/horizon are slow and judged by what they do within it; inf: by their sign.

        Raises BadArgument, NearSingular (names time, frame, smallest singular value), NotConverged.
        """
        return linearize(self.equations, checks.times(times), about, coordinates, simulation, horizon)

    @property
    def default_at(self) -> str:
        """The default analysis point: the plant input."""
        return self.law.plant

    def floquet(self, period: float | None = None, max_evaluations: int | None = None) -> Floquet:
        """Floquet multipliers on the periodic orbit of the nonlinear closed loop.

        Args:
            period: [s]; None: that of the reference.
            max_evaluations: largest number of evaluations of the equations over all runs of the search; None: about 10 s of work.

        Raises BadArgument without a period, Unsupported (dead time without a sample time), NotConverged (no orbit found, or not with this much work).
        """
        from mfc_analysis.simulation.orbit import floquet

        return floquet(self.equations, period, max_evaluations)

    # --- nonlinear -----------------------------------------------------------------------------------------------

    def simulate(
        self,
        times: float | ArrayLike,
        initial_error: ArrayLike = 0.0,
        disturbance: ArrayLike | Callable[[float], ArrayLike] | None = None,
        *,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        integral: Literal["trimmed"] | ArrayLike = 0.0,
        force_integral: ArrayLike = 0.0,
        actuator: ArrayLike | None = None,
        rtol: float = 1e-6,
        atol: float = 1e-9,
        method: str = "LSODA",
        x: ArrayLike | None = None,
        max_evaluations: int | None = None,
    ) -> Simulation:
        """Simulates the nonlinear loop with ``scipy.integrate.solve_ivp`` on Pinocchio's dynamics.

        Args:
            times: a duration [s], or an array of times that begins at the start time.
            initial_error: e at the start, scalar or (n,) (tool laws: X_e (6,), with axes (k,), or the joint error (n,));
                used where ``q`` is not given.
            disturbance: torque at the joints [Nm] (velocity laws: velocity [rad/s]), constant or a function of time.
            q: (n,) start position [rad, m]. v: (n,) start velocity [rad/s, m/s].
            integral: 0, "trimmed" or the integral state. force_integral: 0 or the integral of the force error [N s, Nm s], scalar or (6,).
            actuator: (n,) torque or velocity that the actuators with a lag or servo give at the start; None: the one commanded there.
            x: (nx,) the full start state, in place of all of these. rtol, atol: tolerances of ``solve_ivp``. method: of ``solve_ivp``.
            max_evaluations: largest number of evaluations of the equations; None: about 10 s of work, 400 000 for a joint law without surfaces,
                fewer where one takes longer. A Jacobian counts as 4, the plant alone under a held command as 1/4, and the time of a solver
                written in Python is added.

        A run that diverges, or that ``max_evaluations`` stops, keeps its results up to then and reports the time (``diverged``, ``outcome``,
        ``message``). Raises BadArgument; Unsupported for a dead time or sample time too short for the times of the run to tell apart.
        """
        from mfc_analysis.dynamics.start_state import start_state
        from mfc_analysis.simulation.simulation import asked_times, simulate

        asked = asked_times(times)
        if x is None:
            x0 = start_state(self.equations, float(asked[0]), initial_error, q, v, integral, force_integral, actuator)
        else:
            x0 = checks.array("x", x, (self.equations.nx,))
        return simulate(self.equations, asked, x0, disturbance, rtol=rtol, atol=atol, method=method, max_evaluations=max_evaluations)

    def nlsys(self) -> NonlinearIOSystem:
        """The nonlinear loop for python-control, a ``control.NonlinearIOSystem`` with the names of ``linearize(coordinates="state")``.

        The inputs are 0 on the reference: a shift of it (q_d [rad, m], or a body twist that moves X_d), a disturbance at the joints, and a change
        of F_d where the law has one. The outputs are q, error, command, and F_tip with a surface.

        Warns where dead time is left out. Raises Unsupported for a loop with a sample time.
        """
        from mfc_analysis.simulation.nonlinear_system import nonlinear_system

        return nonlinear_system(self.equations)

    def validate(self, time: float = 1.0, size: float = 1e-2, seed: int = 0, n_jobs: int | None = None) -> Validation:
        """Compares linear prediction and nonlinear simulation over ``time`` [s], from the operating point disturbed by ``size`` [rad, m].

        The disturbance is the worst one found. The search starts from the directions in which the linear model fails first to second order, with
        both signs. Where higher orders count, it climbs the misfit of the nonlinear response; runs decide among what it finds. The disturbance
        moves each joint by at most ``size``, and one of them by ``size``. It moves each other state (velocity, integral, filter, actuator) by at
        most what the linear model makes of a joint error of ``size``.

        Args:
            time: [s] of the runs. size: [rad, m] of the disturbance.
            seed: of the random starts of the search, an integer >= 0. The radius depends on it by a few percent; by more with steep friction or with
                light links on stiff walls: take the smallest of several there.
            n_jobs: processes for the runs on one-sided surfaces, which are independent; None: set by ``joblib.parallel_config``, else one. The runs
                of other loops are integrated together in one process. The numbers are the same.

        Raises BadArgument.
        """
        from mfc_analysis.simulation.validation import validate

        return validate(self.equations, time, size, seed, n_jobs)

    def __str__(self) -> str:
        count = len(self.equations.surfaces)
        extra = f", {count} surface{'s' * (count > 1)}" if count else ""
        return f"{self.law} on {self.robot.name}{extra}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        given = {f.name: getattr(self.equations.hardware, f.name) for f in fields(self.equations.hardware)}
        usual = {f.name: f.default for f in fields(self.equations.hardware)}
        hardware = ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None and value != usual[name]) or "ideal"
        model = "the plant" if self.equations.model is self.robot else self.equations.model.name
        rows = [("robot", f"{self.robot.name}, {self.robot.n} joints"), ("law", str(self.law)), ("reference", type(self.ref).__name__)]
        rows += [("controller's model", model), ("hardware", hardware), ("surfaces", str(len(self.equations.surfaces)))]
        return table(f"Closed loop of {type(self.law).__name__}, {self.law.numbered()}", ("part", "value"), rows)
