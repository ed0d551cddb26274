"""What a design helper returns: a mapping with its reason, and a damping matrix that behaves as one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import gains, laws
from mfc_analysis.gains.result import Achieved, DampingMatrix, Gains
from mfc_analysis.robots import ur5
from mfc_analysis.units import hertz

NAMES = ("kp", "ki", "kd", "kfp", "kfi", "kdamp")
Q = np.array([0.1, -1.2, 1.4, -0.8, 1.3, 0.2])


def made(**more: object) -> Gains:
    given = {
        "gains": {"kp": 2.0, "kd": 3.0},
        "units": {"kp": "N/m", "kd": "N s/m"},
        "formula": "kp = 2",
        "definition": "asked",
        "loop": "L",
        "achieved": None,
    }
    return Gains(**{**given, **more})


def test_gains_unpack_into_a_law_and_print_their_reason() -> None:
    g = gains.pid(bandwidth=hertz(4), damping=1.0)
    assert dict(**g) == {"kp": g.kp, "ki": g.ki, "kd": g.kd}
    assert len(g) == 3
    text = str(g)
    for part in ("kp = 124.65", "1/s^2", "ki = w^3", "-3 dB", "bandwidth 25.13 rad/s (4 Hz)", "phase margin", "(kd s^2 + kp s + ki)/(I s^3)"):
        assert part in text
    assert "N m/rad" in str(gains.pd(crossover=3, inertia=2.0))
    assert g.kfp is None
    assert hash(g) == hash(g)


def test_cartesian_damping_behaves_as_its_matrix() -> None:
    D = gains.cartesian_damping(ur5(), np.array([0.1, -1.2, 1.4, -0.8, 1.3, 0.2]), 500.0, [0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    x = np.arange(6.0)
    assert np.asarray(D).shape == D.shape == (6, 6)
    assert_allclose(D @ x, D.kd @ x)
    assert_allclose(2.0 * D + np.eye(6), 2 * D.kd + np.eye(6))
    assert set(D) == {"kp", "kd"}
    assert "Q diag(w^2) Q^T" in str(D)


def test_gains_are_a_mapping_of_those_they_have_and_none_where_they_have_none():
    g = made()
    assert dict(g) == {"kp": 2.0, "kd": 3.0} and list(g) == ["kp", "kd"] and "ki" not in g
    assert [getattr(g, name) for name in NAMES] == [2.0, None, 3.0, None, None, None]
    with pytest.raises(KeyError):
        g["ki"]
    whole = made(gains={name: float(i) for i, name in enumerate(NAMES)}, units=dict.fromkeys(NAMES, "-"))
    assert [getattr(whole, name) for name in NAMES] == [whole[name] for name in NAMES] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_gains_go_into_a_law_as_they_are():
    g = gains.pid(natural_frequency=2.0)
    law = laws.ComputedTorque(**g)
    assert_allclose([law.kp.array, law.ki.array, law.kd.array], [12.0, 8.0, 6.0])


def test_what_is_printed_has_a_line_for_each_gain_and_note_with_units():
    lines = str(made(notes=("one.", "two."))).splitlines()
    assert lines == ["kp = 2 [N/m]", "kd = 3 [N s/m]", "formula:  kp = 2", "asked:    asked", "loop:     L", "note:     one.", "note:     two."]
    assert repr(made()) == str(made())
    assert made(formula="a < b & c")._repr_html_().count("a &lt; b &amp; c") == 1


def test_figures_of_several_joints_are_printed_as_a_range_and_equal_ones_as_one_number():
    several = np.array([10.0, 20.0])
    said = str(Achieved(2 * np.pi * several, several, np.array([0.5, 0.5 * (1 + 1e-9)]), 0.36, 3.0, 0.7, 60.0))
    assert "bandwidth 62.83 .. 125.7 rad/s (10 .. 20 Hz)" in said and "crossover 10 .. 20 rad/s" in said
    assert "settling 0.5 s (step of the reference), 0.36 s (step of the loop, T)" in said and "damping 0.7" in said and "phase margin 60 deg" in said


def test_a_damping_matrix_takes_part_in_numpy_as_its_matrix():
    kd = np.diag([1.0, 2, 3, 4, 5, 6]) + 0.1
    D = DampingMatrix({"kp": np.eye(6), "kd": kd}, {"kp": "N/m", "kd": "N s/m"}, "f", "d", "l", None)
    assert D.shape == (6, 6)
    assert_allclose(np.linalg.solve(D, np.ones(6)), np.linalg.solve(kd, np.ones(6)))
    for ours, theirs in ((D + D, 2 * kd), (-D, -kd), (np.sqrt(D), np.sqrt(kd)), (kd @ D, kd @ kd), (D > 1, kd > 1), (D / 2, kd / 2)):
        assert np.array_equal(ours, theirs)
    copy = np.array(D)
    copy[0, 0] = -1
    assert D.kd[0, 0] == 1.1 and np.array(D, dtype=np.float32).dtype == np.float32
    assert hash(D) == hash(D)
