"""Requirements and verdicts: the limits set for a loop, the metrics it achieves along its path, and PASS, WATCH or FAIL.

A verdict always has the line "stable". It is

- FAIL where a limit is missed or a metric is not defined: NaN never passes;
- WATCH where every limit is met, but the loop drifts or the residual at its operating points matters;
- PASS otherwise.

A residual matters when the steady error it implies, abs(A^-1 r) of the linear loop, is above ``RESIDUAL_MATTERS`` [rad, m] (or above
the required tracking error, if that is smaller): the metrics then belong to an operating point where the loop does not stay. The
usual case is gravity under a law without model and integral; where no feedback holds the joint the implied error is infinite.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isinf, nan
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.loop_step import STEPS, SettlingStep
from mfc_analysis.analysis.system import HORIZON, checked_horizon
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.requirements.evidence import Evidence, Found
from mfc_analysis.requirements.line import Line, Status, worst
from mfc_analysis.requirements.slow import slow_words

RESIDUAL_MATTERS = 1e-3  #: [rad, m] implied steady error above which a verdict is WATCH at best


@dataclass(frozen=True)
class Kind:
    """A kind of requirement: its name in words, unit, direction and range."""

    label: str
    unit: str
    least: bool  #: True: at least (margins); False: at most
    low: float = 0.0
    high: float = inf
    of_step: bool = False  #: a metric of a step: ``Requirements.step`` says which

    def said(self, step: SettlingStep) -> str:
        """The name in words, with the step where it is of one."""
        return f"{self.label} ({STEPS[step]})" if self.of_step else self.label


KINDS: Mapping[str, Kind] = {
    "gain_increase_db": Kind("gain margin, up", "dB", True),
    "gain_reduction_db": Kind("gain margin, down", "dB", True),
    "phase_deg": Kind("phase margin", "deg", True, high=180.0),
    "delay": Kind("delay margin", "s", True),
    "sensitivity_peak": Kind("sensitivity peak", "", False, low=1.0),
    "damping_ratio": Kind("damping ratio", "", True, high=1.0),
    "disk_margin": Kind("disk margin", "", True, high=2.0),
    "settling_time": Kind("settling time", "s", False, of_step=True),
    "overshoot": Kind("overshoot", "", False, of_step=True),
    "tracking_error": Kind("tracking error", "rad or m", False),
    "torque_fraction": Kind("torque fraction", "", False),
}
SETTINGS = ("horizon", "step")  #: fields that say how the others are meant


@dataclass(frozen=True, eq=False)
class Verdict:
    """Result of a check: a line for each requirement, failures first, and the worst status."""

    lines: tuple[Line, ...]  #: one for each requirement, failures first
    loop: str  #: the loop in words
    at: str  #: analysis point of the margins and loop steps
    times: Array  #: (m,) [s]
    notes: tuple[str, ...]  #: remarks, a sentence each
    drifts: bool  #: a slow part of the loop keeps moving within the horizon
    evidence: Evidence  #: the numbers behind the lines

    @property
    def status(self) -> Status:
        """The worst of the lines."""
        return worst([line.status for line in self.lines])

    @property
    def passed(self) -> bool:
        """True only for PASS; read the note of a WATCH line before you accept it."""
        return self.status is Status.PASS

    @property
    def failed(self) -> tuple[Line, ...]:
        """The failed lines, worst first."""
        return tuple(line for line in self.lines if line.status is Status.FAIL)

    @property
    def worst(self) -> Line:
        """The first line: the worst by status and distance."""
        return self.lines[0]

    def line(self, name: str) -> Line:
        """The line of one requirement, by its field name. Raises UnknownName."""
        known = [line.name for line in self.lines]
        (found,) = checks.names("name", [name], known)
        return self.lines[known.index(found)]

    def __str__(self) -> str:
        m = len(self.times)
        when = f"t = {self.times[0]:.4g} s" if m == 1 else f"{m} times from {self.times[0]:.4g} to {self.times[-1]:.4g} s"
        rows = [("", "requirement", "found", "asked", "distance", "where", ""), *(line.cells() for line in self.lines)]
        wide = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        table = ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, wide, strict=True)).rstrip() for row in rows]
        judged = "margins and loop steps" if self.evidence.step == "loop" else "margins"
        return "\n".join([f"{self.status.value}: {self.loop}; {judged} at {self.at!r}; {when}", *table, *(f"  note: {note}" for note in self.notes)])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        signs = {"PASS": "✓", "WATCH": "!", "FAIL": "✗"}
        heads = ("", "requirement", "found", "asked", "distance", "where", "")
        rows = [(f"{signs[line.status]} {line.status}", *line.cells()[1:]) for line in self.lines]
        return table(str(self).splitlines()[0], heads, rows, self.notes)


@dataclass(frozen=True, kw_only=True)
class Requirements:
    """Requirements on a loop. Every field is optional; stability is always required.

    The margins hold at every time and channel of the analysis point, one loop at a time with the others closed.

    ``step`` says whose settling time and overshoot are meant, here and in ``mfc.gains``. "reference": a unit step of every reference
    channel to its coordinate, the derivatives of the reference zero (q_d -> q with v_d = 0), as ``lin.step`` gives it. "loop": the step
    response of T = L/(1 + L) of every channel of the analysis point. The L of a design helper is that of inverse dynamics at "command".

    Raises:
        BadArgument: a value is not a number, not finite, or outside the range of the metric; ``step="loop"`` with no metric of a step.
    """

    gain_increase_db: float | None = None  #: [dB] the gain may grow by at least this
    gain_reduction_db: float | None = None  #: [dB] the gain may fall by at least this: -20 log10(reduction)
    phase_deg: float | None = None  #: [deg] 0 .. 180
    delay: float | None = None  #: [s] delay margin: additional dead time at which the loop stays stable
    sensitivity_peak: float | None = None  #: at most; >= 1
    damping_ratio: float | None = None  #: of every closed-loop pole that is not slow; 0 .. 1 (dead time: of the rightmost roots)
    disk_margin: float | None = None  #: alpha, all channels at once; 0 .. 2
    settling_time: float | None = None  #: [s] 2 % settling of every linear step of the kind ``step``
    overshoot: float | None = None  #: fraction of the final value, of the same steps
    tracking_error: float | None = None  #: [rad, m] largest component of e (X_e) in a nonlinear run along the reference, integrals at 0
    torque_fraction: float | None = None  #: largest commanded torque / limit in that run (velocity laws: velocity / limit)
    horizon: float = HORIZON  #: [s] of the verdict: roots with |s| < 1/horizon are slow; inf: every root is judged by its sign
    step: SettlingStep = "reference"  #: of settling time and overshoot, as in ``mfc.gains``; see above

    def __post_init__(self) -> None:
        object.__setattr__(self, "horizon", checked_horizon(self.horizon))
        for name, kind in KINDS.items():
            given = getattr(self, name)
            if given is not None:
                object.__setattr__(self, name, checks.number(name, given, low=kind.low, high=kind.high))
        checks.choice("step", self.step, tuple(STEPS))
        if self.step != "reference" and not any(KINDS[name].of_step for name in self.asked()):
            raise BadArgument("step", self.step, "a settling_time or an overshoot with it: no other requirement is of a step")

    @classmethod
    def from_mapping(cls, asked: Mapping[str, Any]) -> Self:
        """Requirements from a mapping ``asked``, such as a table of a study. Raises UnknownName for an unknown key, BadArgument for a bad value."""
        if not isinstance(asked, Mapping):
            raise BadArgument("requirements", asked, f"a mapping of some of {', '.join(KINDS)} to numbers")
        for name in asked:
            if name not in (*KINDS, *SETTINGS):
                raise UnknownName("requirements", name, (*KINDS, *SETTINGS))
        return cls(**asked)

    def asked(self) -> dict[str, float]:
        """The limits that are set."""
        return {name: float(getattr(self, name)) for name in KINDS if getattr(self, name) is not None}

    @property
    def code(self) -> str:
        """Python code of this object."""
        horizon = {} if self.horizon == HORIZON else {"horizon": f"float({str(self.horizon)!r})" if isinf(self.horizon) else repr(self.horizon)}
        step = {} if self.step == "reference" else {"step": repr(self.step)}
        said = {name: repr(limit) for name, limit in self.asked().items()} | horizon | step
        return f"mfc.Requirements({', '.join(f'{name}={text}' for name, text in said.items())})"

    def check(self, loop: ClosedLoop, times: ArrayLike, at: str | None = None) -> Verdict:
        """The verdict over one loop.

        Args:
            loop: to be checked. times: (m,) [s] of the linearisation about the reference; the nonlinear run goes from the first to the last.
            at: analysis point of the margins and loop steps; None: the plant input.

        Raises BadArgument (not a loop, times), UnknownPoint for ``at``, NearSingular; Unsupported for loop steps at "position" through dead
        time without a velocity filter.
        """
        checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
        evidence = Evidence(loop.equations, checks.times(times), at, self.horizon, self.step)
        lines = [_stable(evidence)]
        lines += [compared(name, limit, evidence.found(name), self.step) for name, limit in self.asked().items()]
        lines += residual_lines(evidence, self.tracking_error)
        lines.sort(key=lambda line: line.severity, reverse=True)
        assert evidence.at is not None
        notes = _notes(evidence, worst([line.status for line in lines]))
        return Verdict(tuple(lines), str(loop), evidence.at, evidence.times, notes, bool(evidence.stability.drifts.any()), evidence)

    def __str__(self) -> str:
        parts = [
            f"{KINDS[name].said(self.step)} {'≥' if KINDS[name].least else '≤'} {limit:g} {KINDS[name].unit}".rstrip()
            for name, limit in self.asked().items()
        ]
        return "stable" if not parts else "stable, " + ", ".join(parts)


def compared(name: str, limit: float, found: Found, step: SettlingStep = "reference") -> Line:
    """The line of one requirement: the value found against the limit. NaN fails."""
    kind = KINDS[name]
    met = found.value >= limit if kind.least else found.value <= limit
    distance = found.value - limit if kind.least else limit - found.value
    status = Status.PASS if met else Status.FAIL
    sense = "≥" if kind.least else "≤"
    return Line(
        name, limit, found.value, found.unit or kind.unit, distance, status, found.where, found.when, sense, label=kind.said(step), note=found.note
    )


def _stable(evidence: Evidence) -> Line:
    """The line "stable": the rightmost root that is not slow lies in the left half plane, and nothing drifts."""
    verdict = evidence.stability
    neutral, drifting = int(verdict.neutral.max(initial=0)), verdict.drifts
    if evidence.nothing_else:
        does = "drifts" if drifting.any() else "neutral"
        note = f"{does}, not stable: every root is slow, nothing holds the loop within {verdict.horizon:g} s"
        return Line("stable", 0.0, nan, "1/s", nan, Status.FAIL, "", float(evidence.times[0]), "<", note=note)
    root = evidence.slowest_root()
    notes = [f"neutral: {neutral} slow root{'s' if neutral > 1 else ''}"] if neutral else []
    status = Status.PASS
    if not verdict.nonzero_stable.all():
        status = Status.FAIL
        bad = np.flatnonzero(~verdict.nonzero_stable)
        often = f"; not stable at {bad.size} of {evidence.times.size} times, first t = {evidence.times[bad[0]]:.4g} s"
        notes.insert(0, f"unstable: {evidence.unstable}{often if evidence.times.size > 1 else ''}")
    elif drifting.any():
        status = Status.WATCH
        first = float(evidence.times[int(np.argmax(drifting))])
        notes.append(f"drifts at {int(drifting.sum())} of {evidence.times.size} times, first t = {first:.4g} s: {slow_words(evidence).moves}")
    elif not verdict.stable.all():
        status = Status.FAIL
    return Line("stable", 0.0, root.value, "1/s", -root.value, status, root.where, root.when, "<", note="; ".join(notes))


def residual_lines(evidence: Evidence, tracking: float | None) -> list[Line]:
    """The line of the error at rest, or of the lag behind a moving reference, only where the residual matters. ``tracking``: its limit, if asked."""
    limit = RESIDUAL_MATTERS if tracking is None else min(RESIDUAL_MATTERS, tracking)
    found = evidence.implied_error()
    if found.value <= limit:
        return []
    residual, rate = np.abs(evidence.linearization.residual), "s" if evidence.equations.actuator == "velocity" else "s^2"
    joint = int(np.argmax(residual.max(axis=0)))
    largest = f"{residual.max():.3g} {evidence.equations.robot.joint_units[joint]}/{rate}"
    note = f"the loop does not stay at its operating point: the residual ({largest}) moves the joint this far"
    label = "error at rest" if evidence.equations.reference_source.is_hold else "lag behind the moving reference"
    distance = limit - found.value
    return [Line("residual", limit, found.value, found.unit, distance, Status.WATCH, found.where, found.when, "≤", label=label, note=note)]


def _notes(evidence: Evidence, status: Status) -> tuple[str, ...]:
    """Remarks on the metrics: frozen time, slow roots, dead time and idle integrals."""
    out, verdict, lin = [], evidence.stability, evidence.linearization
    if not evidence.equations.reference_source.is_hold:
        out.append(
            f"frozen-time metrics on a moving reference (coordinates {lin.coordinates!r}); floquet() and transient_growth() account for the motion"
        )
    if verdict.slow.any():
        out.append(slow_words(evidence).roots)
        if not verdict.drifts.any() and slow_words(evidence).means:
            out.append(slow_words(evidence).means)
    if verdict.idle.any():
        out.append(f"integrals that act on nothing, left out: {int(verdict.idle.max())}")
    if verdict.drifts.any():
        watch = "" if status is Status.FAIL else ", and the verdict is WATCH at best"
        out.append(slow_words(evidence).means + (f"; margins are those of the roots that are not slow{watch}" if evidence.judged.all() else ""))
    return tuple(out)
