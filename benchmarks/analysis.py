"""Poles, margins, step responses, disk margins and Floquet multipliers; two processes; memory."""

from __future__ import annotations

import os
import time
from dataclasses import replace

import control
import numpy as np
from scipy.linalg import expm

import mfc_analysis as mfc
from benchmarks import floors
from benchmarks.loops import computed_torque, hybrid
from benchmarks.table import Found, Row, paired, peak
from mfc_analysis.analysis.floquet import period_map
from mfc_analysis.analysis.spectrum import poles
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.simulation.along import Along

GIB = 2.0**30
LATE = mfc.Hardware(delay=4e-3)


def contact_poles() -> Found:
    """Poles of 9.24 in contact, whose A is badly scaled."""
    lin = hybrid().linearize(np.linspace(0.0, 4.0, 500))
    reduced = lin.reduced
    return paired(lambda: poles(replace(reduced)), lambda: np.linalg.eigvals(reduced.A), 500)


def python_control_margins() -> Found:
    """One loop at a time, at a few of the points."""
    lin, few = computed_torque().linearize(np.linspace(0.0, 4.0, 200)), range(0, 200, 40)
    singles = [lin.loop(k, "torque", i) for k in few for i in range(6)]
    _ = lin.opened
    return paired(lin.margins, lambda: [control.stability_margins(L) for L in singles], 200, len(few))


def late_margins() -> Found:
    """The same loop with dead time and without."""
    times = np.linspace(0.0, 4.0, 50)
    late, alone = (computed_torque(hardware=h).linearize(times) for h in (LATE, None))
    _ = late.opened, alone.opened
    return paired(lambda: replace_opened(late).margins(), lambda: replace_opened(alone).margins(), len(times))


def replace_opened(lin: mfc.Linearization) -> mfc.Linearization:
    """The same linearisation without its verdicts, which the margins with dead time use."""
    fresh = replace(lin)
    vars(fresh)["opened"] = lin.opened
    return fresh


def one_step() -> Found:
    """One response, on the samples that ours chooses."""
    lin = computed_torque().linearize([0.0])
    one = lin.system(0)[lin.output_names[0], lin.input_names[0]]
    found = lin.step(0, input=0, output=0)
    grid = np.linspace(0.0, found.t[-1], len(found.t))
    return paired(lambda: lin.step(0, input=0, output=0), lambda: control.step_response(one, grid))


def late_steps() -> Found:
    """Metrics of 36 responses with dead time at one point; the rival's responses have a Pade approximation of it, and no metrics."""
    lin, t, joints = computed_torque(hardware=LATE).linearize([0.0]), np.linspace(0.0, 4.0, 4001), range(6)
    one = lin.system(0, pade=5)[:6, :6]
    assert np.isfinite(lin.steps(t, joints, joints).settling).all()
    return paired(lambda: lin.steps([0.0, 1.0], joints, joints).settling, lambda: control.step_response(one, t), 36)


def all_steps(reference: str) -> Found:
    """36 responses at 20 points, 301 samples."""
    lin, t, joints = computed_torque().linearize(np.linspace(0.0, 4.0, 20)), np.linspace(0.0, 4.0, 301), range(6)
    held = floors.propagated(lin, t)
    assert np.abs(lin.steps(t, joints, joints).y - held()).max() < 1e-9
    if reference == "expm":
        return paired(lambda: lin.steps(t, joints, joints).y, held, 20)
    if reference == "control":
        few = [lin.system(i)[:6, :6] for i in (0, 7, 14)]
        return paired(lambda: lin.steps(t, joints, joints).y, lambda: [control.step_response(one, t) for one in few], 20, 3)
    singles = lambda: [lin.step(0, joint, joint) for joint in joints]  # noqa: E731
    return paired(lambda: lin.steps(t, joints, joints).settling, singles, 20 * 36, 6)


def disk() -> Found:
    """Six loops opened together, on given frequencies."""
    lin, w = computed_torque().linearize(np.linspace(0.0, 4.0, 8)), np.logspace(-2, 3, 300)
    s = lin.opened
    keep = np.zeros(s.nw, bool)
    keep[s.wires["torque"]] = True
    A, B, C, D = close_wires(s, keep)
    L = control.ss(A[0], B[0][:, s.nu :], -C[0][s.ny :], -D[0][s.ny :, s.nu :])
    start = time.process_time()
    control.disk_margins(L, w)
    other = time.process_time() - start  # seconds: once is enough
    start = time.process_time()
    lin.disk_margin(frequencies=w)
    ours = (time.process_time() - start) / 8
    return Found(ours, other, ours / other)


def floquet_step() -> Found:
    """The period map, against one from 80 steps with A held."""
    loop = computed_torque()
    T = loop.ref.period
    nodes = np.linspace(0, T, 160)
    x, run = loop.linearize(nodes).point.x, loop.simulate([0.0, T], rtol=1e-8)

    def floor() -> None:
        A = closed_matrix(loop.equations, nodes, x)
        for k in range(80):
            expm(A[2 * k] * T / 80)

    return paired(lambda: period_map(Along(loop.equations, run).Phi), floor)


def two_processes() -> Found:
    """Margins of 2000 points: wall time with two processes, which are running already, and with one."""
    if (os.cpu_count() or 1) < 2:
        raise ImportError("one core")
    lin = computed_torque().linearize(np.linspace(0.0, 4.0, 2000))
    return paired(lambda: replace(lin).margins(n_jobs=2), lambda: replace(lin).margins(n_jobs=1), clock=time.perf_counter)


def memory(what: str, points: int) -> Found:
    """Peak resident memory of a process that does this at many points."""
    code = (
        "import numpy as np\nfrom benchmarks.loops import computed_torque\nloop = computed_torque()\n"
        f"loop.linearize([0.0]).{what}\nbegin()\nloop.linearize(np.linspace(0.0, 4.0, {points})).{what}"
    )
    return Found(float(peak(code)[1]))


def per_point(what: str, points: int = 50_000) -> Found:
    """Growth of the peak with the number of points, for each point."""
    small, large = (memory(what, m).ours for m in (points // 5, points))
    return Found((large - small) / (0.8 * points))


ROWS = (
    Row("poles of 9.24 in contact", "numpy eigvals", contact_poles, 2.0),
    Row("margins of 6 loops, with sensitivity peak, delay margin, gain interval", "control.stability_margins", python_control_margins, 1 / 15),
    Row("margins of 6 loops with 4 ms of dead time", "the same without dead time", late_margins, 4.0),
    Row("margins of 2000 points, two processes (wall time)", "one process", two_processes, 1 / 1.6),
    Row("a step response with its metrics", "control.step_response", one_step, 1.0),
    Row("36 step responses, 301 samples", "control.step_response", lambda: all_steps("control"), 1 / 20),
    Row("36 step responses, 301 samples", "batched expm, x[k+1] = Phi x[k] + Gamma", lambda: all_steps("expm"), 4.0),
    Row("36 step responses with metrics, per response", "lin.step one by one", lambda: all_steps("single"), 1 / 10),
    Row("metrics of 36 step responses with 4 ms of dead time, per response", "control.step_response, Pade, 4001 samples, per response", late_steps),
    Row("disk margin of 6 loops, 300 frequencies", "control.disk_margins", disk, 1 / 30),
    Row("the period map of a Floquet iteration", "A at 160 times + 80 expm", floquet_step, 3.0),
    Row("memory of A, B, C, D", "", lambda: per_point("A"), unit="bytes/point"),
    Row("memory of poles", "", lambda: per_point("poles()"), unit="bytes/point"),
    Row("peak memory, poles of 1e5 points", "", lambda: memory("poles()", 100_000), 2 * GIB, unit="bytes"),
    Row("peak memory, poles of 1e6 points", "", lambda: memory("poles()", 1_000_000), 2 * GIB, unit="bytes", slow=True),
    Row("peak memory, margins of 1e5 points", "", lambda: memory("margins()", 100_000), 2 * GIB, unit="bytes", slow=True),
)
