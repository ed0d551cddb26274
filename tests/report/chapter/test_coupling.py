"""The decentralised design beside the coupled arm, on arms whose inertia is known."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.report.chapter.coupling import coupling_figures, coupling_numbers, coupling_table, coupling_words, price
from mfc_analysis.report.document.document import written
from mfc_analysis.report.loops.view import View
from tests.report.loops.views import planar, view

Q = (0.2, 0.5)
KP, KI, KD = np.array([12000.0, 3000.0]), np.array([18000.0, 4000.0]), np.array([2400.0, 500.0])


def independent(ki: float = 1.0) -> View:
    """9.8 on the planar arm at rest, its integral gains times ``ki``."""
    return view(mfc.ClosedLoop(planar(), mfc.laws.JointPID(KP, ki * KI, KD), mfc.trajectories.Hold(Q)))


def test_each_joint_alone_has_python_controls_margin_on_the_diagonal_of_the_inertia() -> None:
    q, h = np.array(Q), 1e-6
    M = planar().mass(q)
    slope = [(planar().gravity(q + h * e)[j] - planar().gravity(q - h * e)[j]) / (2 * h) for j, e in enumerate(np.eye(2))]
    found = coupling_numbers(independent())
    alone = [control.margin(control.tf([KD[j], KP[j], KI[j]], [M[j, j], planar().viscous[j], slope[j], 0]))[1] for j in range(2)]
    assert_allclose(found["decentralised_phase_deg"], alone, rtol=1e-6)
    assert_allclose(found["coupled_phase_deg"], independent().margins.phase_deg[0])
    rows = coupling_table(independent()).rows
    assert_allclose([[row[1].value, row[2].value] for row in rows], np.stack([alone, found["coupled_phase_deg"]], axis=1), rtol=1e-6)


def test_the_sentence_is_made_of_the_smallest_margins_and_the_slowest_roots() -> None:
    made = independent()
    found = coupling_numbers(made)
    alone, true = float(found["decentralised_phase_deg"].min()), float(found["coupled_phase_deg"].min())
    designed, real = float(found["decentralised_poles"].real.max()), float(made.poles.real.max())
    numbers = [written(x) for x in (alone, true, abs(alone - true), real, designed)]
    assert all(x in coupling_words(made) for x in numbers)
    change = found["coupled_phase_deg"] - found["decentralised_phase_deg"]
    assert all(x in price(made) for x in (written(designed), written(real), written(abs(float(change.min())))))


def test_a_coupled_arm_may_be_unstable_where_each_joint_alone_is_stable() -> None:
    made = independent(2.85)
    alone = made.lin.decentralised()
    assert alone.stable.all() and not made.stable
    said = coupling_words(made)
    assert written(float(alone.poles().real.max())) in said and written(float(made.poles.real.max())) in said
    assert {row[2].value for row in coupling_table(made).rows} != {row[1].value for row in coupling_table(made).rows}
    assert not any("°" in x for x in (said, price(made)))  # no margin to speak of


def test_a_diagonal_inertia_has_a_relative_gain_of_one_and_a_coupled_one_the_ratio_of_determinants() -> None:
    law = mfc.laws.JointPID(100.0, kd=20.0)
    rp = view(mfc.ClosedLoop(mfc.robots.rp(), law, mfc.trajectories.Hold([0.4, 0.7])))
    assert_allclose(coupling_numbers(rp)["relative_gain"], 1.0, rtol=1e-12)
    M = planar().mass(np.array(Q))
    gain = M[0, 0] * M[1, 1] / np.linalg.det(M)
    assert_allclose(coupling_numbers(independent())["relative_gain"], gain, rtol=1e-12)
    (figure,) = coupling_figures(independent())
    assert figure.draw.args[1][0].values.max() == pytest.approx(gain) and len(figure.draw.args[1]) == 2


def test_a_page_takes_the_margins_of_the_joints_alone_once(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = independent(), independent(2.0)
    kind, asked = type(one.lin.decentralised()), []
    true = kind.margins
    monkeypatch.setattr(kind, "margins", lambda self: asked.append(self) or true(self))
    said = price(one), coupling_words(one), coupling_numbers(one), coupling_table(one), coupling_figures(one)
    assert len(asked) == 1
    assert coupling_words(other) != said[1]  # another loop has its own
