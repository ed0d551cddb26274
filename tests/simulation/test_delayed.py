"""Runs with dead time against the closed forms of delay equations, and the record of signals on their way."""

from __future__ import annotations

from math import factorial
from typing import Any

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.simulation import delayed
from mfc_analysis.simulation.delayed import INTEGRALS, NODES, History, echoes, edges, segments
from mfc_analysis.trajectories import Hold, Sinusoid

JOINT = robots.single_joint()


@pytest.mark.parametrize("d", [0.02, 0.11, 0.25])
def test_an_integrator_with_dead_time_follows_its_series(d: float) -> None:
    """e' = -k e(t - d), e = 1 before: e(t) = 1 + sum over j of (-k)^j (t - (j - 1) d)^j / j! while t > (j - 1) d."""
    k, t = 5.0, np.linspace(0, 1.3, 27)
    sim = ClosedLoop(JOINT, L.VelocityP(k), Hold([0.3]), hardware=Hardware(delay=d)).simulate(t, 1.0, rtol=1e-9, atol=1e-11)
    want = np.ones_like(t)
    for j in range(1, 80):
        since = np.maximum(t - (j - 1) * d, 0.0)
        want += np.where(since > 0, (-k) ** j * (since / 1.0) ** j / factorial(j), 0.0)
    assert_allclose(sim.error[:, 0], want, atol=2e-7)
    late = np.maximum(t - d, 0)
    assert_allclose(sim.tau[:, 0], k * np.interp(late, t, want), atol=0.02 * k)  # what arrives was sent d ago
    assert np.abs(sim.command - sim.tau).max() > 0.01


def test_dead_time_of_the_force_sensor_delays_what_the_law_sees() -> None:
    """Massless limit by damping: kdamp q' = kfp (F_d - k q(t - d)) + F_d - k q: compared with its own Euler steps of a microsecond."""
    k, kfp, kdamp, d, F_d, m = 200.0, 1.5, 60.0, 0.05, 10.0, 0.5
    law = L.DampedForcePI([0, 0, F_d, 0, 0, 0], kfp, None, kdamp)
    loop = ClosedLoop(robots.slider(m), law, Hold([0.0]), environment=Environment(k), hardware=Hardware(force_delay=d))
    sim = loop.simulate(np.linspace(0, 0.5, 26), rtol=1e-8, atol=1e-11)
    h = 2e-5
    lag, steps = round(d / h), round(0.5 / h)
    q, v = np.zeros(steps + 1), np.zeros(steps + 1)
    for i in range(steps):  # semi-implicit steps, error of order h
        seen = k * q[i - lag] if i >= lag else 0.0
        a = (F_d + kfp * (F_d - seen) - kdamp * v[i] - k * q[i]) / m
        v[i + 1] = v[i] + h * a
        q[i + 1] = q[i] + 0.5 * h * (v[i] + v[i + 1])
    assert_allclose(sim.q[:, 0], q[:: round(0.02 / h)], atol=2e-5)


@pytest.mark.parametrize(("factor", "grows"), [(0.95, False), (1.05, True)])
def test_both_sides_of_the_delay_margin_in_simulation(factor: float, grows: bool) -> None:
    law = L.JointPID(20.0, kd=2.0)
    margin = ClosedLoop(JOINT, law, Hold([0.4])).linearize([0.0], about="equilibrium").margins().delay[0, 0]
    loop = ClosedLoop(JOINT, law, Hold([0.4]), hardware=Hardware(delay=factor * margin))
    rest = ClosedLoop(JOINT, law, Hold([0.4])).equilibrium().q
    sim = loop.simulate(np.linspace(0, 12, 1201), q=rest + 1e-3)
    off = np.abs(sim.q[:, 0] - rest[0])
    assert (off[-200:].max() > off[200:400].max()) == grows


def test_a_recorded_signal_that_jumps_is_read_on_the_side_of_the_segment_that_asks() -> None:
    history = History(0.0, np.array([0.0]))
    for start, height in ((0.0, 1.0), (0.5, 2.0)):
        history.add(start, 0.5, np.full((NODES.size, 1), height))
    assert [history.at(0.5, towards)[0] for towards in (-0.1, 0.0, 0.1)] == [1.0, 2.0, 2.0]
    assert [history.at(0.0, towards)[0] for towards in (-0.1, 0.1)] == [0.0, 1.0]


def test_edges_lie_apart() -> None:
    assert edges(1.0, 2.0, [1.5, 1.2, 1.5 + 1e-13, 2.0 - 1e-12, 1.0, 0.5, 3.0], 0.1) == [1.0, 1.2, 1.5, 2.0]
    assert edges(0.0, 1e3, [1e-6, 2e-6], 1e-6) == [0.0, 1e-6, 2e-6, 1e3]
    assert_allclose(echoes([1.0, 10.0])[:6], [1, 2, 3, 4, 5, 10])


def test_a_recorded_signal_is_read_back_by_interpolation_and_is_constant_before() -> None:
    history = History(0.0, np.array([2.0]))
    for start in (0.0, 0.5):
        history.add(start, 0.5, np.sin(start + 0.5 * NODES)[:, None])
    assert history.at(-1.0)[0] == 2.0
    t = np.array([0.0, 0.1, 0.3777, 0.5, 0.73, 0.999])
    assert_allclose([history.at(x)[0] for x in t], np.sin(t), atol=1e-9)


def test_the_record_is_exact_for_polynomials_of_the_degree_of_its_nodes_and_no_further() -> None:
    t = np.linspace(0.3, 0.9, 13)
    for degree, exact in ((8, True), (9, False)):
        history = History(0.3, np.zeros(1))
        history.add(0.3, 0.6, (0.3 + 0.6 * NODES)[:, None] ** degree)
        gap = np.abs(np.array([history.at(x)[0] for x in t]) - t**degree).max()
        assert (gap < 1e-13) == exact


def test_at_the_start_of_a_segment_the_later_one_is_read() -> None:
    history = History(0.0, np.array([5.0]))
    assert history.at(0.7).tolist() == [5.0]  # nothing recorded yet
    history.add(0.0, 1.0, np.full((9, 1), 1.0))
    history.add(1.0, 1.0, np.full((9, 1), 2.0))
    assert [history.at(x)[0] for x in (-0.1, 0.0, 0.999, 1.0, 2.0)] == [5.0, 1.0, 1.0, 2.0, 2.0]


def test_what_arrives_is_what_was_commanded_a_dead_time_ago() -> None:
    d = 0.08
    loop = ClosedLoop(JOINT, L.JointPID(30.0, kd=5.0), Sinusoid([0.1], 0.4, 2.0), hardware=Hardware(delay=d))
    t = np.arange(0, 0.9, 0.02)
    sim = loop.simulate(t, 0.2, rtol=1e-9, atol=1e-12)
    assert_allclose(sim.tau[4:], sim.command[:-4], atol=1e-7)
    assert_allclose(sim.tau[:4], np.broadcast_to(sim.command[0], (4, 1)), atol=1e-9)  # before the start: what was commanded at it


def test_a_dead_time_that_vanishes_leaves_the_run_without_it() -> None:
    law, t = L.JointPID(30.0, kd=5.0), np.linspace(0, 0.4, 9)
    without = ClosedLoop(JOINT, law, Hold([0.3])).simulate(t, 0.2, rtol=1e-9, atol=1e-12).q
    gaps = [
        np.abs(ClosedLoop(JOINT, law, Hold([0.3]), hardware=Hardware(delay=d)).simulate(t, 0.2, rtol=1e-9, atol=1e-12).q - without).max()
        for d in (4e-3, 2e-3)
    ]
    assert abs(np.log2(gaps[0] / gaps[1]) - 1.0) < 0.05  # of first order in the dead time


def test_the_kinks_of_two_dead_times_and_of_their_sums_are_ends_of_segments() -> None:
    found = list(segments(2.0, 3.0, [0.11, 0.3]))
    edges = np.array([found[0][0], *(stop for _, stop in found)])
    assert [begin for begin, _ in found[1:]] == edges[1:-1].tolist()
    assert edges[0] == 2.0 and edges[-1] == 3.0 and np.diff(edges).max() <= 0.11 + 1e-12 and np.diff(edges).min() > 1e-9
    for kink in (0.11, 0.22, 0.3, 0.41, 0.6, 0.71):
        assert np.abs(edges - 2.0 - kink).min() < 1e-12


@pytest.mark.parametrize("delay", [5.0, 1e9])
def test_a_dead_time_longer_than_the_run_leaves_the_command_of_the_start(delay: float) -> None:
    k = 4.0
    sim = ClosedLoop(JOINT, L.VelocityP(k), Hold([0.3]), hardware=Hardware(delay=delay)).simulate(np.linspace(0, 1, 5), 0.1)
    assert_allclose(sim.error[:, 0], 0.1 * (1 - k * sim.t), atol=1e-9)


@pytest.mark.parametrize("hardware", [{"delay": 1e-9}, {"sample_time": 1e-9}], ids=str)
def test_a_dead_time_that_the_times_of_the_run_cannot_tell_apart_is_refused(hardware: dict) -> None:
    loop = ClosedLoop(JOINT, L.VelocityP(4.0), Hold([0.3]), hardware=Hardware(**hardware))
    with pytest.raises(Unsupported) as why:
        loop.simulate(np.array([1e9, 1e9 + 1.0]))
    assert why.value.argument == f"hardware.{next(iter(hardware))}"


# --- dead time and one-sided contact -------------------------------------------------------------------------------------------


def pressed_late(d: float, fd: float, times: np.ndarray) -> np.ndarray:
    """(position, speed) of a slider of 1 kg under 9.23 with dead times d and fd, against a Kelvin-Voigt wall 2 mm away, by steps of its own.

    Each piece ends at a touch, a lift, or a sum of dead times after one of these or after the start; every lookup is in one earlier piece.
    """
    k, c, gap, F_d, kfp, kdamp = 1e4, 60.0, 2e-3, 10.0, 1.0, 40.0
    pieces: list[tuple[float, float, Any, bool]] = []

    def state(t: float, side: float) -> tuple[np.ndarray, bool]:
        if t + side < 0 or not pieces:
            return np.array([0.0, 0.2]), False
        begin, _, sol, touched = next(p for p in reversed(pieces) if p[0] <= t + side)
        return sol(max(t, begin)), touched

    def force(y: np.ndarray, touched: bool) -> float:
        return max(0.0, k * (y[0] - gap) + c * y[1]) if touched else 0.0

    def command(y: np.ndarray, touched: bool, t: float, side: float) -> float:
        late = force(*state(t - fd, side)) if fd else force(y, touched)
        return F_d + kfp * (F_d - late) - kdamp * y[1]

    late = sorted({i * d + j * fd for i in range(7) for j in range(7) if i * d + j * fd > 0})
    marks, t, y, touched, end = set(late), 0.0, np.array([0.0, 0.2]), False, float(times[-1])
    while t < end - 1e-12:
        stop = min([m for m in marks if m > t + 1e-10] + [end, t + min(x for x in (d, fd) if x)])
        middle = 0.5 * (t + stop)

        def rates(s: float, y: np.ndarray, touched: bool = touched, middle: float = middle) -> list[float]:
            side = 1e-7 * np.sign(middle - s)
            before = state(s - d, side)
            u = command(*before, s - d, side) if d else command(y, touched, s, side)
            return [y[1], u - force(y, touched)]

        def penetration(s: float, y: np.ndarray) -> float:
            return y[0] - gap

        penetration.terminal, penetration.direction = True, -1 if touched else 1  # type: ignore[attr-defined]
        found = solve_ivp(rates, (t, stop), y, method="DOP853", rtol=1e-11, atol=1e-13, events=penetration, dense_output=True)
        pieces.append((t, float(found.t[-1]), found.sol, touched))
        t, y = float(found.t[-1]), found.y[:, -1]
        if found.status == 1:
            touched = not touched
            marks |= {t + x for x in late}
    return np.stack([state(float(s), 0.0)[0] for s in times])


@pytest.mark.parametrize(("delay", "force_delay"), [(0.0, 5e-3), (5e-3, 0.0), (3e-3, 5e-3)])
def test_the_jump_of_a_force_at_the_touch_comes_back_through_every_dead_time(delay: float, force_delay: float) -> None:
    X = np.array(robots.slider(1.0).pose([0.0]))
    X[2, 3] += 2e-3
    wall = Environment(1e4, 60.0, pose=X, one_sided=True)
    law = L.DampedForcePI([0, 0, 10.0, 0, 0, 0], 1.0, 0.0, 40.0)
    loop = ClosedLoop(robots.slider(1.0), law, Hold([0.0]), environment=wall, hardware=Hardware(delay=delay or None, force_delay=force_delay or None))
    sim = loop.simulate(np.linspace(0, 0.08, 81), v=[0.2], rtol=1e-10, atol=1e-12)
    right = pressed_late(delay, force_delay, sim.t)
    assert any(event.kind == "touch" for event in sim.events)
    close = 1e-7 if delay and force_delay else 1e-10  # five dead times are two round trips: kinks of the third order lie within segments
    assert_allclose(sim.q[:, 0], right[:, 0], rtol=0, atol=close)
    assert_allclose(sim.v[:, 0], right[:, 1], rtol=0, atol=100 * close)


def test_integrals_from_samples_at_the_nodes_are_exact_for_their_polynomials() -> None:
    for power in range(9):
        assert_allclose(INTEGRALS @ NODES**power, NODES ** (power + 1) / (power + 1), atol=1e-15)


@pytest.mark.parametrize("leak", [0.0, 2.0, 1e3])
def test_the_own_states_of_a_law_are_the_same_found_within_the_solver_or_after_it(leak: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A leaky integral, z' = e - leak z, as an LTI outer loop: its own states act on each other (1e3: too fast to be found after the plant)."""
    outer = control.ss([[-leak]], [[1.0]], [[60.0]], [[100.0]])
    loop = ClosedLoop(robots.single_joint(), L.InverseDynamics(outer), Hold([0.3]), hardware=Hardware(delay=4e-3))
    found = loop.simulate(np.linspace(0, 0.2, 41), initial_error=0.2, rtol=1e-9, atol=1e-12)
    monkeypatch.setattr(delayed, "COUPLED", -1.0)
    within = loop.simulate(found.t, initial_error=0.2, rtol=1e-9, atol=1e-12)
    assert_allclose(found.x, within.x, atol=1e-9)
    assert np.ptp(found.x[:, 2]) > 1e-4
    assert (found.evaluations < within.evaluations) == (leak < 1e3)
    assert_allclose(found.command, within.command, atol=1e-6)
