"""Where a loop is linearised, and in which coordinates."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import Coordinates
from mfc_analysis.dynamics.operating_point import OperatingPoint, chunks, on_reference
from mfc_analysis.errors import BadArgument, MfcWarning, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.singularity import REFUSE_CONDITION, WARN_CONDITION, nearest_singular
from mfc_analysis.robots.tool_task import task_singular_values
from mfc_analysis.simulation.simulation import Simulation

About = Literal["reference", "equilibrium", "simulation"]
NAMES: tuple[About, ...] = ("reference", "equilibrium", "simulation")


def operating_points(equations: Equations, times: Array, about: str | ArrayLike, run: Simulation | None) -> OperatingPoint:
    """Those at times (m,) [s]: by name, or states of one's own (m, nx). Raises BadArgument, NotConverged."""
    if not isinstance(about, str):
        states = f"{', '.join(map(repr, NAMES))}, or finite states of shape ({len(times)}, {len(equations.state_names)}), one row for each time"
        return OperatingPoint(times, checks.array("about", about, (len(times), len(equations.state_names)), states), None)
    checks.choice("about", about, NAMES)
    if about == "reference":
        return on_reference(equations, times)
    if about == "equilibrium":
        from mfc_analysis.simulation.rest import at_rest

        return OperatingPoint(times, np.repeat(at_rest(equations).x, len(times), axis=0), np.zeros((len(times), equations.n)))
    if run is None or getattr(run, "state_names", None) != equations.state_names:
        raise BadArgument("simulation", run, 'a Simulation of this loop to linearise along, with about="simulation"')
    return run.operating_point(times)


def start_at(about: str | Array, known: Array, times: Array) -> str | Array:
    """``about`` for other times: of states of one's own, known at times (m,), the rows of those asked for. Raises Unsupported between them."""
    if isinstance(about, str):
        return about
    rows = np.searchsorted(known, times).clip(max=len(known) - 1)
    if np.any(known[rows] != times):
        raise Unsupported("times", times, "times for which about= gave a state: nothing is known between them")
    return np.asarray(about[rows], float)


def _singular_values(equations: Equations, point: OperatingPoint) -> Array:
    """(m, k) of the Jacobian of a tool law; of one without damping that is nearly singular somewhere, warns or raises with the time."""
    if equations.law.space != "tool":
        return np.ones((len(point.times), 1))
    n, plant = equations.n, equations.plant
    selection = equations.law.selection
    sigma = np.concatenate([task_singular_values(selection, plant, np.ascontiguousarray(some.x[:, :n])) for some in chunks(point)])
    if not equations.law.inverse_damping:
        found = nearest_singular(equations.robot.tool, sigma)
        found = found.at(float(point.times[found.index]))
        if found.condition > REFUSE_CONDITION:
            raise found
        if found.condition > WARN_CONDITION:
            warnings.warn(str(found), MfcWarning, stacklevel=4)
    return sigma


def chosen_coordinates(equations: Equations, asked: Coordinates | None, point: OperatingPoint) -> Coordinates:
    """Those asked for, or the error of a tool law whose Jacobian is square and regular everywhere.

    Raises BadArgument, Unsupported, and NearSingular with time, frame and smallest singular value.
    """
    sigma = _singular_values(equations, point)
    size = len(equations.law.error_channels(equations.robot.joint_names))
    tool, square = equations.law.space == "tool", equations.n == size
    if asked is None:
        return "error" if tool and square and np.all(sigma[:, 0] < WARN_CONDITION * sigma[:, -1]) else "state"
    checks.choice("coordinates", asked, ("state", "error"))
    if asked == "error" and tool and not square:
        given = "" if equations.law.selection is None else f" for {size} selected directions"
        takes = f"a square Jacobian: {equations.robot.name} has {equations.n} joints{given}, so the error does not determine the state"
        raise Unsupported("coordinates", "error", takes)
    return asked
