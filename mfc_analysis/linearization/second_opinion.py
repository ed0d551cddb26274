"""A second opinion: the figures that python-control finds for the same StateSpace, beside ours, with the rule behind each difference.

python-control gets the closed loop and the loop opened in one channel as ``StateSpace``. It takes no dead time: its margins then come from
``FrequencyResponseData`` on a grid, and its poles, encirclements, disk margin and step from a Pade approximation.

A difference is explained where a rule says why and a number confirms it, such as |L| evaluated at the frequency that it gives. Any other
difference is WATCH: one of the two is wrong, and neither is taken to be right.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, cast

import numpy as np

from mfc_analysis.analysis.channels import channel_number
from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.frequency.response import frequency_response
from mfc_analysis.analysis.frequency.window import window
from mfc_analysis.analysis.loop_step import loop_step
from mfc_analysis.analysis.margins import Margins, margins
from mfc_analysis.analysis.pade import with_pade
from mfc_analysis.analysis.plain import disk_margin
from mfc_analysis.analysis.spectrum import rates as rates_of, spectrum
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.step_metrics import Outcome
from mfc_analysis.analysis.steps import step
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument, NotConverged, Unsupported
from mfc_analysis.linearization.exported import closed_model, loop_model, measured_model
from mfc_analysis.maths.arrays import Complex

if TYPE_CHECKING:
    from control import StateSpace

PADE = 8  #: order of the approximation of dead time
CLOSE = 1e-4  #: relative difference up to which two figures agree,
FROM_GRID, FROM_PADE = 1e-2, 2e-2  #: and those that a grid of frequencies and a Pade approximation explain
ROUNDING = 1e-9  #: of the norm of A: smallest singular value of A - s I up to which s is an eigenvalue
LIGHTLY = 1e-2  #: damping ratio of a pole beside which a contour needs many points
CROSSES, NEARLY = 1e-3, 1e-2  #: | |L| - 1 | or |sin arg L| up to which L crosses there, and crosses there but for rounding of the frequency
MOST_SAMPLES = 20_000  #: of a sampled loop's step response, which is left out where it takes more
SAMPLES, FREQUENCIES = 4000, 1500  #: of a step response and of a grid
LOST = "its polynomials have too few correct digits"
UNSTABLE = "no stability flag: it gives the figure of an unstable loop as it does of a stable one"


class Judgement(Enum):
    """Outcome of a comparison; the value is a sentence."""

    AGREES = "the two metrics agree"
    EXPLAINED = "they differ, and a rule that was checked says why"
    WATCH = "they differ, and no rule explains it"


@dataclass(frozen=True)
class Comparison:
    """One metric, ours and that of python-control. NaN: not defined."""

    name: str  #: with its unit
    function: str  #: of python-control
    ours: float  #: in that unit
    theirs: float  #: in that unit
    judgement: Judgement  #: whether they agree
    why: str  #: the rule; "" where they agree

    def __str__(self) -> str:
        why = f": {self.why}" if self.why else ""
        return f"{self.name:<30} {_written(self.ours):>12} {_written(self.theirs):>12}  {self.judgement.name}{why} ({self.function})"


@dataclass(frozen=True, eq=False)
class SecondOpinion:
    """The metrics of one loop at one time by this library and by python-control."""

    time: float  #: [s]
    at: str  #: the analysis point
    channel: str  #: of it
    model: str  #: name of the loop's model as python-control has it
    version: str  #: of python-control
    comparisons: tuple[Comparison, ...]  #: one for each metric

    @property
    def watch(self) -> tuple[Comparison, ...]:
        """Those that no rule explains; empty where the two agree."""
        return tuple(one for one in self.comparisons if one.judgement is Judgement.WATCH)

    def __getitem__(self, name: str) -> Comparison:
        """A comparison by the first words of its name. Raises KeyError."""
        for one in self.comparisons:
            if one.name.startswith(name):
                return one
        raise KeyError(name)

    @property
    def _title(self) -> str:
        counts = ", ".join(f"{sum(one.judgement is kind for one in self.comparisons)} {kind.name}" for kind in Judgement)
        return f"python-control {self.version} on {self.model}, t = {self.time:.4g} s: {counts}"

    def __str__(self) -> str:
        head = f"{'':<30} {'ours':>12} {'its':>12}"
        return "\n".join([self._title, head, *map(str, self.comparisons)])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        rows = [(c.name, _written(c.ours), _written(c.theirs), c.function, c.judgement.name, c.why) for c in self.comparisons]
        return table(self._title, ("figure", "ours", "python-control", "its function", "", "why"), rows)


def second_opinion(system: OpenSystem, at: str, channel: int | str | None = None) -> SecondOpinion:
    """Implements ``Linearization.second_opinion`` of a system with one point. Raises UnknownPoint, UnknownName."""
    import control

    found = margins(system, at)
    k = int(np.argmin(np.nan_to_num(found.phase_deg[0], nan=np.inf))) if channel is None else channel_number(channel, found.channels)
    case = _Case(system, at, k, found)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # its warnings on accuracy: what they are about is checked here
        lines = (*_poles(case), _stable(case), *_margins(case), _disk(case), *_steps(case))
    return SecondOpinion(float(system.times[0]), at, found.channels[k], str(case.L.name), control.__version__, lines)


class _Case:
    """A loop in one channel, and its models for python-control."""

    def __init__(self, system: OpenSystem, at: str, k: int, found: Margins) -> None:
        self.system, self.at, self.k, self.found = system, at, k, found
        self.approximate = with_pade(system, PADE, at) if system.delayed else system
        self.L: StateSpace = loop_model(self.approximate, at, k)
        self.closed: StateSpace = closed_model(self.approximate)
        self.verdict = stability(system)
        self.judged = bool(self.verdict.nonzero_stable[0])
        marks = np.array([self.ours(name) for name in ("crossover", "reduction_frequency", "increase_frequency")])
        self.grid = window(spectrum(system).rates[0], marks, self.ours("crossover"), system.dt, FREQUENCIES)

    def ours(self, name: str) -> float:
        return float(getattr(self.found, name)[0, self.k])

    def response(self, w: float) -> complex:
        """L(jw), dead time included; NaN where it is not defined."""
        if not 0 < w < (np.pi / self.system.dt if self.system.dt else np.inf):
            return complex(np.nan, np.nan)
        return complex(frequency_response(self.system, np.array([w]), self.at, self.k)[0, 0, 0])

    def beyond(self, w: float) -> complex:
        """L at an end of the frequency axis: at s, |s| = 1/horizon, Im s = w, where a slow root leaves the disc, or at the highest frequency."""
        dt, s = self.system.dt, complex(np.sqrt(self.radius**2 - w**2), w) if w <= self.radius else complex(np.inf)
        if np.isinf(s):
            return complex(np.real(self.L(-1.0))) if dt else complex(np.asarray(self.L.D, float)[0, 0])
        return complex(cast("complex", self.L(np.exp(s * dt) if dt else s)))

    def poles(self, of: StateSpace) -> Complex:
        """The poles that python-control finds, in the s plane [1/s]."""
        return rates_of(np.asarray(of.poles(), np.complex128), float(of.dt or 0.0))

    @property
    def reach(self) -> float:
        """[1/s] up to which the Pade approximation holds, |s| T = its order: beyond, it has roots of its own."""
        return PADE / float(self.system.wire_delay.max()) if self.system.delayed else np.inf

    @property
    def last(self) -> float:
        """[rad/s] the end of the frequency axis, but for rounding."""
        return np.pi / self.system.dt * (1 - ROUNDING) if self.system.dt else np.inf

    @property
    def radius(self) -> float:
        return self.system.radius


def _compared(name: str, function: str, ours: float, theirs: float, rules: Iterable[tuple[bool, str]], close: float = CLOSE) -> Comparison:
    same = ours == theirs or (np.isnan(ours) and np.isnan(theirs)) or abs(ours - theirs) <= close * max(abs(ours), abs(theirs)) < np.inf
    if same:
        return Comparison(name, function, ours, theirs, Judgement.AGREES, "")
    why = next((said for holds, said in rules if holds), "")
    return Comparison(name, function, ours, theirs, Judgement.EXPLAINED if why else Judgement.WATCH, why)


# --- poles and stability ---------------------------------------------------------------------------------------------


def _poles(case: _Case) -> list[Comparison]:
    system, late = case.system, case.system.delayed
    mine = delay_roots(system, max(6, system.nx))[0] if late else spectrum(system).rates[0]
    its = case.poles(case.closed)
    ours, theirs = (s[np.isfinite(s) & (np.abs(s) >= case.radius) & (np.abs(s) <= case.reach)] for s in (mine, its))
    if not ours.size or not theirs.size:
        return []
    rightmost = [s[int(np.argmax(s.real))] for s in (ours, theirs)]
    off = abs(rightmost[0] - rightmost[1]) / abs(rightmost[0])
    A = np.asarray(case.closed.A, float)
    z = np.exp(rightmost[1] * system.dt) if system.dt else rightmost[1]
    gap = float(np.linalg.svd(A - z * np.eye(len(A)), compute_uv=False)[-1])
    close = bool(gap <= ROUNDING * np.linalg.norm(A, 2))
    rules = [
        (late and off < FROM_PADE, f"Pade approximation of order {PADE}; ours is the exact root"),
        (not late and close, "a multiple pole: rounding moves it, and both are eigenvalues to rounding"),
    ]
    # the damping of the pairs that our root and the Pade approximation have in common: those right of the fastest exact root
    damping = [_least_damping(s[s.real >= ours.real.min()]) for s in (ours, _damped(case))]
    more = [*rules, (late and abs(damping[0] - damping[1]) < FROM_PADE, f"Pade approximation of order {PADE}; ours is of the exact roots")]
    return [
        _compared("rightmost pole [1/s]", "poles", float(rightmost[0].real), float(rightmost[1].real), rules),
        _compared("least damping ratio [-]", "damp", damping[0], damping[1], more),
    ]


def _damped(case: _Case) -> Complex:
    """The poles as ``damp`` gives them: by natural frequency and damping ratio."""
    import control

    wn, zeta, _ = control.damp(case.closed, doprint=False)
    s = np.asarray(-zeta * wn + 1j * wn * np.sqrt(np.maximum(0.0, 1 - zeta**2)), np.complex128)
    return s[np.isfinite(s) & (np.abs(s) >= case.radius) & (np.abs(s) <= case.reach)]


def _least_damping(s: Complex) -> float:
    return float(np.min(-s.real / np.abs(s), initial=1.0))


def _stable(case: _Case) -> Comparison:
    import control

    L, dt = case.L, case.system.dt
    poles = case.poles(L)
    count = int(control.nyquist_response(L, warn_encirclements=False, warn_nyquist=False).count)
    theirs = count + int((poles.real > 0).sum()) == 0
    size = np.abs(poles[np.isfinite(poles)]).max(initial=1.0)
    near = bool(((np.abs(poles) < case.radius) | (np.abs(poles.real) < ROUNDING * size)).any())
    closed = case.poles(case.closed)
    same = bool((closed.real[np.abs(closed) >= case.radius] < 0).all()) == case.judged
    lightly = poles[int(np.argmin(np.where(np.isfinite(poles), np.abs(poles.real) / np.maximum(np.abs(poles), 1e-300), np.inf)))]
    rules = [
        (near, "L has poles on the axis or within 1/horizon of 0: whether its contour passes them on the left or on the right depends on rounding"),
        (case.system.delayed, f"Pade approximation of order {PADE}"),
        (bool(case.verdict.slow[0]), "slow roots: our verdict leaves them out"),
        (
            same and abs(lightly.real) < LIGHTLY * abs(lightly),
            f"too few points beside the pole {_complex(lightly)} of L; its poles of the closed loop say what ours do",
        ),
    ]
    at = "nyquist_response, poles" if not dt else "nyquist_response, poles in z"
    return _compared("stable (1: yes)", at, float(case.judged), float(theirs), rules)


# --- margins ---------------------------------------------------------------------------------------------------------


def _margins(case: _Case) -> list[Comparison]:
    import control

    late = case.system.delayed
    data = measured_model(case.system, case.grid, case.at, case.k) if late else case.L
    gm, pm, sm, _, w_phase, w_peak = (float(np.real(x)) for x in control.stability_margins(data))
    gains, *_, at_gains, _, _ = (np.asarray(x, float) for x in control.stability_margins(data, returnall=True))
    function = "stability_margins of FRD" if late else "stability_margins"
    low, high = case.ours("gain_reduction"), case.ours("gain_increase")
    above, below = gains > 1, gains < 1
    up, down = float(gains[above].min(initial=np.inf)), float(gains[below].max(initial=0.0))
    ends = [
        _gain(case, function, name, metric, theirs, float(at_gains[gains == theirs][0]) if theirs in gains else np.nan)
        for name, metric, theirs in (("gain increase [-]", "increase", up), ("gain reduction [-]", "reduction", down))
    ]
    first = ends[0] if gm > 1 else ends[1]
    if gm < 1 and first.judgement is Judgement.AGREES:
        why = f"one end of the gain interval ({_written(low)}, {_written(high)}), its lower one"
        first = replace(first, judgement=Judgement.EXPLAINED, why=why, ours=high)
    return [
        replace(first, name="gain margin [-]", theirs=gm),
        *ends,
        _phase(case, function, abs(pm), w_phase),
        _peak(case, function, 1 / sm if np.isfinite(sm) else np.nan, w_peak),
    ]


def _gain(case: _Case, function: str, name: str, end: str, theirs: float, w: float) -> Comparison:
    ours, at = case.ours(f"gain_{end}"), case.ours(f"{end}_frequency")
    none, inside = theirs in (0.0, np.inf), case.radius < at < case.last
    L, mine = case.response(w), case.response(at) if inside else case.beyond(at)
    false = not none and not (abs(L.imag) < CROSSES * abs(L) and abs(abs(L) * theirs - 1) < CROSSES)
    missed = bool(abs(mine * ours + 1) < NEARLY) and (none or abs(np.log(theirs)) > abs(np.log(ours)) * (1 - CLOSE))
    rules = [
        (not case.judged, UNSTABLE),
        (case.system.delayed and abs(ours - theirs) < FROM_GRID * ours, "read from a grid of frequencies; ours is exact"),
        (w < case.radius, f"at {_written(w)} rad/s, below 1/horizon"),
        (false, f"no crossing: L({_written(w)}j) is {_complex(L)}, not {_written(-1 / (theirs or np.nan))}; {LOST}"),
        (missed and not inside, f"it misses the end of the axis at {_written(at)} rad/s, where L is {_complex(mine)}"),
        (missed, f"it misses the crossing at {_written(at)} rad/s, where L is {_complex(mine)}"),
    ]
    return _compared(name, function, ours, theirs, rules)


def _phase(case: _Case, function: str, theirs: float, w: float) -> Comparison:
    ours, at = case.ours("phase_deg"), case.ours("crossover")
    L, crossing = abs(case.response(w)), case.response(at)
    mine, right = abs(crossing), abs(abs(np.degrees(np.angle(-crossing))) - ours) < 100 * CROSSES
    off = 100 * max(abs(mine - 1), ROUNDING)
    rules = [
        (not case.judged, UNSTABLE),
        (case.system.delayed and abs(ours - theirs) < FROM_GRID * ours, "read from a grid of frequencies; ours is exact"),
        (w < case.radius, f"at {_written(w)} rad/s, below 1/horizon"),
        (np.isfinite(theirs) and not abs(L - 1) < min(CROSSES, off), f"no crossover: |L({_written(w)}j)| is {L:.9g}; {LOST}"),
        (right and abs(mine - 1) < CROSSES and not theirs < ours, f"it misses the crossover at {_written(at)} rad/s, where |L| is {mine:.9g}"),
    ]  # fmt: skip
    return _compared("phase margin [deg]", function, ours, theirs, rules)


def _peak(case: _Case, function: str, theirs: float, w: float) -> Comparison:
    ours, at = case.ours("sensitivity_peak"), case.ours("peak_frequency")
    S, mine = (1 / abs(1 + case.response(x)) for x in (w, at))
    rules = [
        (not case.judged, UNSTABLE),
        (case.system.delayed and abs(ours - theirs) < FROM_GRID * ours, "read from a grid of frequencies; ours is exact"),
        (w < case.radius, f"at {_written(w)} rad/s, below 1/horizon"),
        (not theirs > ours and (ours < 1 + CLOSE or not case.radius < at < case.last), "a supremum at the end of the axis, where it does not look"),
        (bool(np.isfinite(theirs) and not abs(S - theirs) < CROSSES * theirs), f"1/|1 + L({_written(w)}j)| is {_written(S)}: {LOST}"),
        (bool(abs(mine - ours) < CROSSES * ours and not theirs > ours), f"it misses the peak {_written(mine)} of 1/|1 + L| at {_written(at)} rad/s"),
    ]  # fmt: skip
    return _compared("sensitivity peak [-]", function, ours, theirs, rules)


def _disk(case: _Case) -> Comparison:
    import control

    grid = case.grid[case.grid >= case.radius]
    alpha = float(np.real(control.disk_margins(case.L, grid)[0]))
    late = case.system.delayed
    ours = float(disk_margin(case.L, horizon=case.system.horizon).alpha[0]) if case.judged else np.nan
    rules = [
        (not case.judged, UNSTABLE),
        (alpha > ours, f"a grid of {grid.size} frequencies: the peak of |S - 1/2| lies between them or beyond; ours is over all frequencies"),
        (abs(alpha - ours) < 1e-3 * ours, "it iterates for a bound of mu, to its own tolerance"),
    ]
    function = f"disk_margins{f', Pade of order {PADE}' if late else ''}"
    return _compared("disk margin, this channel [-]", function, ours, alpha, rules)


# --- step ------------------------------------------------------------------------------------------------------------


def _steps(case: _Case) -> list[Comparison]:
    """The step response of T = L/(1 + L)."""
    import control

    name, dt, late = case.found.channels[case.k], case.system.dt, case.system.delayed
    try:
        system, delays = loop_step(case.system, case.at)
    except Unsupported:
        return []
    if name not in system.output_names:  # no loop
        return []
    try:
        ours = step(system, 0, name, name)
    except (BadArgument, NotConverged):  # more steps than a loop with dead time affords
        return []
    wait = float(delays[system.output_names.index(name)])
    end = ours.settling + wait if np.isfinite(ours.settling) and ours.settling > 0 else float(ours.t[-1])
    count = SAMPLES if not dt else max(2, int(1.5 * end / dt) + 1)
    if count > MOST_SAMPLES:
        return []
    t = np.arange(count + 1) * (dt or 1.5 * end / count)
    T = cast("StateSpace", control.feedback(case.L, 1))
    y, its = np.asarray(control.step_response(T, t).outputs, float), dict[str, float]()
    with suppress(IndexError):  # of a response that never comes to 90 % of its final value
        its = cast("dict[str, float]", control.step_info(T, timepts=t))  # of one input and one output
    final = float(its.get("SteadyStateValue", np.nan))
    grain, jump = 2 * float(t[1]), float(np.abs(np.diff(y)).max()) / max(abs(final), 1e-300)
    slow, beyond = ours.outcome is Outcome.RAMPS, 1e-3 * case.radius
    tends = float(np.real(T(np.exp(1j * beyond * dt) if dt else 1j * beyond))) if beyond else np.nan
    falls = abs(tends - ours.steady_state) < CROSSES * abs(tends) < abs(tends - final)
    s = case.poles(T)
    turn = np.pi / max(float(np.abs(s.imag[np.argmax(np.where(np.abs(s) < case.radius, -np.inf, s.real))])), 1e-300)
    out: list[Comparison] = []
    for words, mine, theirs, off in (
        ("rise time of T [s]", ours.rise, float(its.get("RiseTime", np.nan)), grain),
        ("settling time of T [s]", ours.settling + wait, float(its.get("SettlingTime", np.nan)), grain),
        ("overshoot of T [%]", 100 * ours.overshoot, float(its.get("Overshoot", np.nan)), 100 * jump),
    ):
        rules = [
            (not case.judged, UNSTABLE),
            (slow, "a slow root integrates the step: the response has no final value within the horizon"),
            (abs(mine - theirs) <= off, f"read from samples every {_written(t[1])} s; ours is of the response itself"),
            (late and abs(mine - theirs) < FROM_PADE * max(mine, grain), f"Pade approximation of order {PADE}; ours has the exact dead time"),
            (
                bool(case.verdict.slow[0]) and abs(final - ours.steady_state) > CROSSES * abs(ours.steady_state),
                f"slow roots are left out of our final value, {_written(ours.steady_state)}, and not of its, {_written(final)}",
            ),
            (np.isnan(final), "it finds no final value: T has poles that are 0 to rounding"),
            (not its, "it finds no figures: its response does not come to 90 % of the final value that it takes"),
            (falls, f"it takes {_written(final)} for the final value, by poles of T that are 0 to rounding; T(jw) tends to {_written(tends)}"),
            ("settling" in words and mine - turn < theirs < mine, f"its samples, every {_written(t[1])} s, miss the last peak beyond the band"),
            (abs(final) < 1e-6, "the final value is zero to rounding: a fraction of it is not defined"),
        ]
        out.append(_compared(words, f"step_info{f', Pade of order {PADE}' if late else ''}", mine, theirs, rules))
    return out


def _written(x: float) -> str:
    return "-" if np.isnan(x) else f"{x:.5g}"


def _complex(z: complex) -> str:
    return f"{z.real:.4g}{z.imag:+.2g}j"
