"""The equilibrium of a loop at a reference at rest: where it comes to rest when it starts on the reference.

Newton from the reference finds it where the loop is stiff. A soft loop sags far: Newton then ends at an unstable rest point, at one that the
loop never comes to, or nowhere. There the loop's own simulation decides.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.dynamics.operating_point import OperatingPoint, on_reference, rest_point
from mfc_analysis.dynamics.start_state import start_state
from mfc_analysis.errors import MfcError, MfcWarning, NearPi, NearSingular, NotConverged, Unsupported
from mfc_analysis.maths.arrays import Array

NEAR = 0.25  #: [rad, m] sag up to which a rest point that Newton finds is taken without a simulation
ALONG = (0.0, 0.5, 1.0, 1.5, 2.0)  #: of the sag: the loop must hold there, out to where an undamped joint swings
LONGEST = 200.0  #: [s] of the simulation
SHARE = 20  #: the simulation takes a share of 1/20 of the evaluations that a run may take
STILL = 1e-3  #: [rad/s, m/s] largest velocity at the end of a simulation that has come to rest
CLOSE = 1e-2  #: [rad, m] largest distance of its end from the rest point that Newton makes of it
LEFT = "unstable: the loop leaves it at the smallest disturbance"
SAME = 1e-6  #: [rad, m] distance of two rest points that are one


@dataclass(frozen=True, eq=False)
class Rest:
    """A rest point of a loop."""

    x: Array  #: (1, nx)
    stable: bool  #: no root of A, dead time and sampling left out, grows, except slow ones (over 1/100 s)
    notes: tuple[str, ...] = ()  #: how it was found where Newton alone does not decide, and other rest points met


def at_rest(e: Equations) -> Rest:
    """The equilibrium of a reference at rest: the one that the loop comes to from there, its integrals starting at 0.

    Newton's point counts where the sag is at most ``NEAR`` and the frozen loop grows nowhere on the way there and as far beyond; else a
    simulation of up to ``LONGEST`` decides. Where that does not come to rest: the rest point it moves about, or Newton's, with a note.

    Raises Unsupported on a moving reference, NotConverged where there is none to be found.
    """
    if not e.reference_source.is_hold:
        raise Unsupported("about", "equilibrium", "a reference at rest (Hold, ToolHold): a moving reference has no equilibrium")
    start = on_reference(e, np.zeros(1))
    near, failure = _newton(e, start.x)
    if near is not None and _certain(e, start.x, near):
        return Rest(near, _holds(e, near))
    found, said = _released(e)
    if found is None and near is None:
        raise NotConverged(f"{failure}; {said}")
    if found is None or (near is not None and _apart(e, found, near) <= SAME):
        assert near is not None
        stable = _holds(e, near)
        notes = () if stable else (LEFT,)
        return Rest(near, stable, notes if found is not None else (*notes, said))
    others = "" if near is None else f"another rest point lies near the reference, at q = {_shown(e, near)}, {_word(_holds(e, near))}"
    return Rest(found, _holds(e, found), (said, others) if others else (said,))


def _newton(e: Equations, x: Array) -> tuple[Array | None, str]:
    """(1, nx) the rest point near x, or None and why."""
    try:
        return rest_point(e, OperatingPoint(np.zeros(1), x, None), lambda x: closed_matrix(e, np.zeros(1), x)).x, ""
    except (NearPi, NearSingular, NotConverged) as why:  # near none, or the search leaves for where the law cannot be evaluated
        return None, f"equilibrium: not found near the reference: {why}" if not isinstance(why, NotConverged) else str(why)


def _holds(e: Equations, x: Array) -> bool:
    """No root of the frozen loop at x (1, nx) grows, except slow ones."""
    roots = np.linalg.eigvals(closed_matrix(e, np.zeros(1), x)[0])
    size = np.abs(roots)
    return bool(np.all((roots.real <= 1e-9 * size.max(initial=0.0)) | (size < 1 / HORIZON)))


def _certain(e: Equations, start: Array, near: Array) -> bool:
    """Newton's point is the one that the loop comes to."""
    sag = _apart(e, start, near)
    if sag <= SAME and e.integrals:
        return True  # an integral leaves no other
    try:
        return sag <= NEAR and all(_holds(e, start + share * (near - start)) for share in ALONG)
    except MfcError:  # the law cannot be evaluated beyond the rest point
        return False


def _apart(e: Equations, one: Array, other: Array) -> float:
    """[rad, m] largest distance of a joint."""
    return float(np.abs((one - other)[0, e.parts["q"].where]).max())


def _released(e: Equations) -> tuple[Array | None, str]:
    """(1, nx) the rest point that a simulation from the reference comes to or moves about, or None; and a sentence."""
    from mfc_analysis.simulation.run import most_evaluations
    from mfc_analysis.simulation.simulation import asked_times, simulate

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MfcWarning)
            run = simulate(e, asked_times(LONGEST), start_state(e, 0.0), max_evaluations=most_evaluations(e) // SHARE)
    except MfcError as why:
        return None, f"the loop cannot be simulated from the reference: {why}"
    end = run.x[-1:]
    found, _ = _newton(e, end)
    if found is not None and np.abs(run.v[-1]).max() <= STILL and _apart(e, found, end) <= CLOSE:
        return found, "the loop comes to rest here when it starts on the reference"
    said = f"a simulation from the reference has not come to rest: {run.message}"
    late = run.x[run.t >= 0.8 * run.end]
    found, _ = _newton(e, late.mean(axis=0, keepdims=True)) if not run.diverged else (None, "")
    within = found is not None and bool(np.all(np.abs(found - late.mean(axis=0))[0, e.parts["q"].where] <= np.ptp(late, axis=0)[e.parts["q"].where]))
    if found is not None and within and _holds(e, found):
        return found, f"the loop still moves about this rest point {run.end:g} s after it starts on the reference"
    return None, said


def _word(stable: bool) -> str:
    return "stable" if stable else "unstable"


def _shown(e: Equations, x: Array) -> str:
    return "[" + ", ".join(f"{q:.4g}" for q in x[0, e.parts["q"].where]) + "]"
