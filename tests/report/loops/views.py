"""Small loops whose numbers can be found by hand, as a report sees them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import mfc_analysis as mfc
from mfc_analysis.maths.checks import times as checked
from mfc_analysis.report.loops.view import View

L, T, H = mfc.laws, mfc.trajectories, mfc.Hardware
I, B, MGR = 0.5, 0.1, 0.981  # the single joint, equation 9.6
PUSH = (0.0, 0.0, 100.0, 0.0, 0.0, 0.0)


def view(loop: mfc.ClosedLoop, times: Sequence[float] = (0.0,), at: str | None = None, **asked: float) -> View:
    """A loop with its times and what is asked of it."""
    return View("the loop", loop, checked(times), mfc.Requirements(**asked), at)


@cache
def joint() -> mfc.Robot:
    return mfc.robots.single_joint()


@cache
def planar() -> mfc.Robot:
    return mfc.robots.planar_2r()


def velocity(k: float = 4.0, hardware: mfc.Hardware | None = None) -> View:
    """L = k / s."""
    return view(mfc.ClosedLoop(joint(), L.VelocityP(k), T.Hold([0.3]), hardware=hardware))


def open_loop() -> View:
    """Nothing is fed back."""
    return view(mfc.ClosedLoop(joint(), L.VelocityFeedforward(), T.Hold([0.3])))


def mass(kp: float = 25.0, kd: float = 6.0) -> View:
    """One mass of 1 kg under PD: s^2 + kd s + kp."""
    return view(mfc.ClosedLoop(mfc.robots.slider(), L.JointPID(kp, kd=kd), T.Hold([0.0])))


def triple() -> View:
    """(s + 8)^3 at the command."""
    return view(mfc.ClosedLoop(joint(), L.ComputedTorque(192.0, 512.0, 24.0), T.Hold([0.3])), at="command")


def unstable() -> View:
    """I s^3 + (b + kd) s^2 + (kp - m g r sin th) s + ki with ki far too large."""
    return view(mfc.ClosedLoop(joint(), L.JointPID(10.0, 1e3, 1.0), T.Hold([0.3])))


def falling() -> View:
    """A joint that its PD holds below 0.42 rad and not above: kp = m g r sin th."""
    return view(mfc.ClosedLoop(joint(), L.JointPID(0.4, kd=1.0), T.Quintic([-0.5], [1.3], 2.0)), (0.0, 0.5, 1.0, 1.5, 2.0))


def links(times: Sequence[float] = (0.0,)) -> View:
    """Two decoupled double integrators under PD, (s + 8)^2 each, at the command."""
    ref = T.Hold([0.3, 0.2]) if len(times) == 1 else T.Quintic([0.3, 0.2], [0.8, -0.4], 2.0)
    return view(mfc.ClosedLoop(planar(), L.ComputedTorque(64.0, kd=16.0), ref), times, "command", phase_deg=45.0)


def pushing() -> View:
    """One mass pressing with 100 N on a spring of 1 kN/m under 9.23."""
    law = L.DampedForcePI(PUSH, 1.0, 5.0, kdamp=60.0)
    return view(mfc.ClosedLoop(mfc.robots.slider(), law, T.Hold([0.0]), environment=mfc.Environment(1e3, 0.0, axes="z", preload=100.0)))
