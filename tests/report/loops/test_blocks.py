"""Blocks of a page about one loop: the numbers in facts, tables and figures, found by hand."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import lambertw

import mfc_analysis as mfc
from mfc_analysis.report.document.document import Number, Paragraph
from mfc_analysis.report.loops import blocks
from mfc_analysis.report.loops.step_runs import step_run
from tests.report.loops.views import MGR, H, L, T, falling, links, mass, open_loop, triple, unstable, velocity, view


def values(found: blocks.KeyFacts) -> list[float]:
    return [fact.value.value for fact in found.facts]


def test_the_triple_pole_may_lose_eight_ninths_of_its_gain_and_has_python_controls_phase() -> None:
    down, up, phase, delay, peak = values(blocks.sensitivity(triple()))
    low, wanted, _, crossover = control.margin(control.tf([24.0, 192.0, 512.0], [1, 0, 0, 0]))
    assert (down, up) == (pytest.approx(20 * np.log10(9)), np.inf) and low == pytest.approx(1 / 9)
    assert (phase, delay) == (pytest.approx(wanted, rel=1e-6), pytest.approx(1e3 * np.radians(wanted) / crossover, rel=1e-6))
    assert peak == pytest.approx(1.0, rel=1e-9)


def test_three_numbers_of_an_integrator_and_of_loops_that_have_none() -> None:
    assert_allclose(values(blocks.three_numbers(velocity(4.0))), [-4.0, 90.0, 1e3 * np.pi / 8])
    root, *lost = values(blocks.three_numbers(unstable()))
    assert root > 0 and np.isnan(lost).all()
    nothing = blocks.three_numbers(open_loop())
    assert np.isnan(values(nothing)[0]) and (str(nothing.facts[0].value), nothing.facts[0].note) == ("every root is slow", "nothing holds the loop")
    assert {str(x.value) for x in nothing.facts[1:]} & {str(x.value) for x in blocks.three_numbers(unstable()).facts[1:]} == set()


def test_a_pair_of_poles_is_one_row_with_its_frequency_damping_and_time_constant() -> None:
    ((pole, frequency, damping, constant, kind),) = blocks.pole_rows(mass(25.0, 6.0)).rows
    assert (pole, kind) == (pytest.approx(-3 + 4j), "")
    assert_allclose([frequency.value, damping.value, constant.value], [5.0, 0.6, 1 / 3])
    assert [row[-1] for row in blocks.pole_rows(open_loop()).rows] == ["slow"]
    assert len(blocks.pole_rows(links(), most=1).rows) == 1


def test_with_dead_time_table_and_map_show_the_roots_that_the_verdict_counts_and_say_so() -> None:
    """k T = 1.7 > pi/2: unstable, though the pole without dead time is at -k. The roots of s + k exp(-s T) are Lambert's W(-k T)/T."""
    k, T = 17.0, 0.1
    late = velocity(k, H(delay=T))
    first = complex(lambertw(-k * T, 0)) / T
    table = blocks.pole_rows(late)
    assert "dead time included" in str(table.caption) and all("-17" not in str(row[0]) for row in table.rows)
    assert table.rows[0][0] == pytest.approx(complex(first.real, abs(first.imag))) and table.rows[0][-1] == "unstable"
    assert table.rows[0][3].value == pytest.approx(-1 / first.real) and first.real > 0
    drawing = blocks.pole_map(late)
    assert "dead time included" in str(drawing.caption) and "dead time" in drawing.draw.keywords["title"]
    assert np.abs(drawing.draw.args[0] - table.rows[0][0]).min() < 1e-9 and late.growth == pytest.approx(first.real)
    assert "dead time" not in str(blocks.pole_rows(velocity(k)).caption) + str(blocks.pole_map(velocity(k)).caption)


def test_every_point_where_a_loop_opens_has_its_row_of_margins() -> None:
    found = triple()
    rows = {row[0]: [x.value for x in row[1:]] for row in blocks.points_table(found).rows}
    assert tuple(rows) == found.lin.opened.points
    for point, row in rows.items():
        w = found.lin.margins(point).worst()
        assert_allclose([row[0], row[2], row[3]], [-20 * np.log10(w.gain_reduction[0]), w.phase_deg[0], 1e3 * w.delay[0]], rtol=1e-9)


def test_figures_are_drawn_from_the_loop_at_its_worst_place() -> None:
    found = triple()
    (row,) = blocks.frequency_figures(found)
    grid, L = row.figures[0].draw.args
    s = 1j * grid
    assert_allclose(L, (24 * s**2 + 192 * s + 512) / s**3, rtol=1e-9)
    assert_allclose(np.poly(blocks.pole_map(found).draw.args[0]), np.poly([-8.0] * 3), rtol=1e-9)
    (said,) = blocks.frequency_figures(open_loop())
    assert isinstance(said, Paragraph)


def test_a_path_has_a_history_and_a_scrubber_with_the_limits_asked() -> None:
    for single in (blocks.history(links()), blocks.scrubber(links())):
        assert single is None
    moving = links((0.0, 1.0, 2.0))
    assert blocks.history(moving).draw.args[1] == {"phase_deg": 45.0}
    made = blocks.scrubber(moving)
    phase = next(x for x in made.traces if x.unit == "°")
    assert phase.limit == 45.0 and len(made.traces) <= 3 and np.shape(made.poles) == (3, 4)
    s = 8j * np.sqrt(2 + np.sqrt(5))  # |L| = 1 of L = (16 s + 64) / s^2
    assert_allclose(phase.values, 180 + np.degrees(np.angle((16 * s + 64) / s**2)), rtol=1e-6)
    assert blocks.scrubber(replace(velocity(hardware=H(sample_time=8e-3)), times=np.array([0.0, 1.0]))) is None
    assert f"{int((~falling().evidence.judged).sum())} of 5" in blocks.history(falling()).alt


def test_the_stick_figure_has_the_tool_where_the_angles_put_it() -> None:
    origins = blocks.arm_figure(links()).draw.args[0]
    a, b = 0.3, 0.5  # of both links, 1 m each, against the horizontal
    assert_allclose(origins[0, -1], [np.cos(a) + np.cos(b), np.sin(a) + np.sin(b), 0.0], atol=1e-12)


@pytest.mark.parametrize(("unit", "velocity", "said"), [("rad", False, "Nm"), ("m", False, "N"), ("rad", True, "rad/s"), ("m", True, "m/s")])
def test_what_drives_a_joint_has_the_unit_of_the_joint(unit: str, velocity: bool, said: str) -> None:
    assert blocks.drive_unit(unit, velocity) == said


@pytest.mark.parametrize(("part", "drawn"), [(2.0, True), (100.0, False)])
def test_a_torque_limit_is_in_the_step_figure_and_drawn_where_the_torque_comes_near_it(part: float, drawn: bool) -> None:
    free = step_run(mass())
    assert free is not None
    figure = blocks.step_figure(mass(), free)
    assert figure.draw.keywords["torque_limit"] is None and "limit" not in str(figure.caption)
    limit = part * float(np.abs(free.drive).max())
    found = view(mfc.ClosedLoop(mfc.robots.slider(), L.JointPID(25.0, kd=6.0), T.Hold([0.0]), hardware=H(torque_limit=limit)))
    run = step_run(found)
    assert run is not None
    figure = blocks.step_figure(found, run)
    assert figure.draw.keywords["torque_limit"] == (limit if drawn else None)
    assert str(figure.caption).endswith(f"; limit {Number(limit, 'N', exact=True)}{' (dotted)' if drawn else ', not reached'}.")


def test_the_torque_of_a_step_is_drawn_whole_with_what_holds_the_arm() -> None:
    """The joint of eq. 9.6 at 1 rad under 9.10: before and long after a step to 1.05 rad the motor holds m g r cos(q)."""
    found = view(mfc.ClosedLoop(mfc.robots.single_joint(), L.ComputedTorque(100.0, kd=20.0), T.Hold([1.0])))
    run = step_run(found)
    assert run is not None and abs(run.drive[-1]) < 0.1
    drawn = blocks.step_figure(found, run).draw.keywords["torque"][1]
    assert drawn[-1] == pytest.approx(MGR * np.cos(1.05), rel=1e-2)
