"""One figure of each kind, with long names and awkward numbers: what the tests of all figures go through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mfc_analysis import plots
from mfc_analysis.plots import Panel


@dataclass(frozen=True, eq=False)
class Margins:
    """As ``mfc.analysis.margins.Margins``."""

    times: np.ndarray
    channels: tuple[str, ...]
    stable: np.ndarray
    gain_reduction: np.ndarray
    gain_increase: np.ndarray
    phase_deg: np.ndarray
    delay: np.ndarray
    sensitivity_peak: np.ndarray
    crossover: np.ndarray


UR5 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")


def history(m: int = 101, n: int = 6, unstable: bool = False) -> Margins:
    t, j = np.linspace(0, 2, m)[:, None], np.arange(n)
    phase = 60 - 12 * np.cos(np.pi * t + 0.6 * j) - 3 * j
    w = 48 + 6 * np.sin(np.pi * t + j)
    stable = np.ones(m, bool)
    if unstable:
        stable[m // 3 : m // 2] = False
        phase[~stable] = np.nan
    increase = 8 + 0.05 * phase
    increase[:, 0] = np.where(stable, np.inf, np.nan)
    peak = 1 / (2 * np.sin(np.radians(phase) / 2)) + 0.2
    return Margins(t[:, 0], UR5[:n], stable, 1 / 9 + 0 * phase, increase, phase, np.radians(phase) / w, peak, w)


def pid(w: np.ndarray, delay: float = 0.75e-3) -> np.ndarray:
    s = 1j * w
    return (820 + 1900 / s + 62 * s / (1 + s / 400)) / (1.35 * s**2 + 2.1 * s) / (0.637e-3 * s + 1) * np.exp(-s * delay)


def _run() -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0, 3, 301)
    return t, np.stack([np.exp(-2 * t) * np.cos(5 * t + j) * 0.1 for j in range(6)], axis=1)


def _map() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    k, g = np.geomspace(1e2, 1e6, 61), np.geomspace(1e-2, 1e2, 41)
    return k, g, np.log(k[None, :] * g[:, None] / 3e4) * 40


def every_kind() -> dict[str, Callable[[], Any]]:
    w = np.geomspace(0.1, 1e4, 400)
    L = pid(w)
    known = {"crossover": 47.6, "phase_margin": 66.0, "gain_increase": 17.0, "gain_reduction": 0.11}
    t, q = _run()
    k, g, growth = _map()
    p = np.array([-0.0297, -14.7, -40.9, -306.8, 12.0, -3993 + 2308j, -3993 - 2308j])
    rng = np.random.default_rng(1)
    origins = np.cumsum(rng.normal(size=(40, 7, 3)) * 0.05 + np.array([0.02, 0, 0.1]), axis=1)
    return {
        "bode": partial(plots.bode, w, L, **known),
        "bode, unstable, no margins": partial(plots.bode, w, 50 * L, title='Opened at "torque", joint 6: wrist_3_joint'),
        "bode at the right edge": partial(plots.bode, w, L, crossover=9000.0, phase_margin=-12.0),
        "nyquist": partial(plots.nyquist, w, L, sensitivity_peak=1.17, **known),
        "margins": partial(plots.margins, history(), asked=45.0),
        "margins, some unstable": partial(plots.margins, history(unstable=True), metric="delay", asked=2e-3),
        "margins at one time": partial(plots.margins, history(1)),
        "margins at one time of a loop alone": partial(plots.margins, history(1, 1), metric="delay", title="Margins at torque"),
        "margins with a title": partial(plots.margins, history(), title="Margins at position"),
        "margins, no limit": partial(plots.margins, history(21, 1), metric="gain_increase_db"),
        "margin history": partial(plots.margin_history, history(unstable=True), {"phase_deg": 45.0, "sensitivity_peak": 1.7}),
        "admittance": partial(plots.admittance, w, [(name, 1 / (1j * w + 3 + j)) for j, name in enumerate(("fx", "fy", "fz", "mx", "my", "mz"))]),
        "passivity": partial(plots.passivity, w, 2e3 - 1e5 / w, crossings=[50.0], said="not passive below 50 rad/s"),
        "poles": partial(plots.poles, p, damping=0.5),
        "poles, one": partial(plots.poles, np.array([-3.0])),
        "poles, tiny and huge": partial(plots.poles, np.array([-1e-6, -1e6 + 1e6j, -1e6 - 1e6j])),
        "poles in z": partial(plots.poles, np.array([0.9, 0.5 + 0.5j, 0.5 - 0.5j, -1.1]), discrete=True),
        "step": partial(
            plots.step, t, 0.2 - q[:, 0], nonlinear=(t, 0.2 - 0.9 * q[:, 0]), torque=(t, 12345 * q[:, 0]), torque_limit=1000.0, target=0.2, band=0.004
        ),
        "step, linear only": partial(plots.step, t, 1e-5 * q[:, 0]),
        "responses": partial(plots.responses, t, 0.2 - q.T, worst=2, worst_time=1.25, title="Unit step of q_d_shoulder_pan_joint"),
        "roots with dead time": partial(plots.poles, p, path=p + 1, note="grey: poles without dead time", title="Roots with dead time, t = 1.25 s"),
        "run": partial(
            plots.traces,
            t,
            (Panel("error [rad]", q), Panel("torque [Nm]", 3e4 * q, limit=150.0, beside=2e4 * q)),
            UR5,
            events=((0.4, "touch"), (2.9, "lifted off")),
            said=("nonlinear", "linear"),
        ),
        "four panels": partial(
            plots.traces,
            t,
            (Panel("q [rad]", q), Panel("v [rad/s]", q), Panel("force [N]", -1e6 * q), Panel("|e|", np.abs(q) + 1e-9, log=True)),
            title="Run",
        ),
        "curves": partial(
            plots.curves, k, (("torque", 1 / k), ("force", 2 / k)), xlabel="stiffness [N/m]", ylabel="phase margin [deg]", log="xy", limit=1e-4
        ),
        "map": partial(
            plots.stability_map,
            k,
            g,
            growth,
            xlabel="stiffness [N/m]",
            ylabel="force gain kfp [-]",
            points=((1e3, 1.0, True), (1e5, 30.0, False)),
            title="9.23",
        ),
        "map, all stable": partial(plots.stability_map, k, g, 0 * growth - 1, xlabel="stiffness [N/m]", ylabel="gain [-]"),
        "arm": partial(plots.arm, origins, worst=10, worst_time=1.234),
        "floquet": partial(plots.multipliers, np.array([-1.0738, 0.3 + 0.2j, 0.3 - 0.2j])),
        "disk": partial(plots.disk, (0.61, 1.64), 27.3, alpha=0.486),
        "disk, unstable": partial(plots.disk, (np.nan, np.nan), np.nan, alpha=np.nan, title="All loops at torque, t = 0 s"),
        "disk, no upper end": partial(plots.disk, (0.0, np.inf), 90.0, alpha=2.0),
        "costs": partial(
            plots.costs, ("lag", "dead time", "flexibility"), (4.6, 12.25, -1.0), (3.1, np.nan, np.inf), 21.0, xlabel="cost [deg]", title="Margin"
        ),
        "block": partial(
            plots.block,
            (("PID + feedforward\n9.12", "command"), ("inverse\ndynamics", ""), ("lag 2 ms\ndelay 1 ms", "torque"), ("UR5 + 2 kg", "")),
            back="position",
            at="torque",
            inputs=((3, "F_tip"),),
        ),
        "block, full": partial(plots.block, tuple((f"a very long name {i}", "command") for i in range(6)), at="command"),
    }
