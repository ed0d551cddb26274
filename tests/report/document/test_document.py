"""Values of the document model: numbers as words, statuses, what mathematics may hold."""

from __future__ import annotations

from functools import partial

import pytest

from mfc_analysis.errors import BadArgument
from mfc_analysis.report.document.document import Badge, Column, Equation, Figure, Math, Number, Section, Table, distance_of, written
from mfc_analysis.requirements.line import Line, Status, worst

INF, NAN = float("inf"), float("nan")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.0, "0"),
        (15.93, "15.9"),
        (-2.974, "−2.97"),
        (1621.04, "1621"),
        (0.000123456, "0.000123"),
        (1.2345e-5, "1.23e-5"),
        (1.2345e9, "1.23e9"),
        (INF, "no limit"),
        (-INF, "minus infinity"),
        (NAN, "not defined"),
        (99999.4, "99999"),
    ],
)
def test_numbers_are_written_with_three_digits_and_words(value, said):
    assert written(value).replace("−", "-") == said.replace("−", "-")


@pytest.mark.parametrize(("value", "said"), [(45.0, "45"), (0.002, "0.002"), (1.75, "1.75")])
def test_what_somebody_asked_is_written_as_it_was_asked(value, said):
    assert written(value, exact=True) == said


def test_an_infinite_number_loses_its_unit_and_keeps_its_word():
    assert str(Number(INF, "dB", infinite="no crossing")) == "no crossing"
    assert str(Number(66.0, "°")) == "66.0°"
    assert str(Number(45.0, "°", sign="≥", exact=True)) == "≥ 45°"


@pytest.mark.parametrize("source", ["#import", "$", "`x`", "a // b", "/* a */", "#eval(read(1))"])
def test_mathematics_cannot_leave_math_mode(source):
    with pytest.raises(BadArgument, match="source"):
        Math(source)
    with pytest.raises(BadArgument, match="source"):
        Equation(source, "alt")


def test_a_figure_without_a_description_is_refused():
    with pytest.raises(BadArgument, match="alt"):
        Figure(partial(int), "caption", "  ")


def test_a_row_of_a_table_has_a_cell_for_each_column():
    with pytest.raises(BadArgument, match="rows"):
        Table("caption", (Column("a"), Column("b")), ((1,),))


def check(status, distance, asked=10.0):
    return Line("x", asked, asked + distance, "dB", distance, status)


def test_the_worst_status_wins_and_none_is_info():
    assert worst([Status.PASS, Status.FAIL, Status.WATCH]) is Status.FAIL
    assert worst([]) is Status.INFO


def test_a_section_is_as_bad_as_the_worst_within_it():
    inner = Section("inner", checks=(check(Status.WATCH, 0.1),))
    outer = Section("outer", checks=(check(Status.PASS, 3.0),), sections=(inner,))
    assert outer.judged is outer.badge is Status.WATCH
    assert [c.status for _, c in outer.every_check()] == [Status.PASS, Status.WATCH]


def test_a_demonstration_is_a_demo_whatever_fails_and_theory_is_confirmed_unless_it_fails():
    demo = Section("open loop", checks=(check(Status.FAIL, -1.0),), shown="open loop")
    assert demo.badge is Badge.DEMO and demo.judged is Status.INFO and Section("law", sections=(demo,)).badge is Badge.DEMO
    good, bad = (Section("theory", proofs=(check(status, 1.0),)) for status in (Status.PASS, Status.FAIL))
    assert good.badge is Badge.CONFIRMED and good.judged is Status.INFO and bad.badge is Status.FAIL
    assert Section("both", checks=(check(Status.WATCH, 0.1),), sections=(demo, good)).badge is Status.WATCH and Section("text").badge is None
    assert [c for _, c in Section("top", sections=(good, demo)).every_proof()] == list(good.proofs)


@pytest.mark.parametrize(("found", "said"), [(INF, "–"), (-INF, "–"), (NAN, "–"), (12.5, "2.50 dB")])
def test_a_distance_is_a_number_or_a_dash_never_infinite(found, said):
    assert str(distance_of(Line("x", 10.0, found, "dB", found - 10.0, Status.PASS))) == said


@pytest.mark.parametrize(("value", "said"), [(6.66e-16, "0"), (-9.9e-10, "0"), (1.1e-9, "1.10e−9")])
def test_rounding_error_is_written_as_zero_unless_somebody_gave_it(value, said):
    assert written(value) == said and written(value, exact=True) != "0"


def test_severity_orders_unstable_before_missed_before_close():
    order = [check(Status.FAIL, d) for d in (NAN, -5.0, -1.0)] + [check(Status.WATCH, 1.0), check(Status.PASS, 0.1), check(Status.PASS, 9.0)]
    assert sorted(order, key=lambda c: c.severity, reverse=True) == order


def test_an_infinite_distance_is_the_least_severe_of_its_status():
    assert check(Status.PASS, INF).severity < check(Status.PASS, 1e9).severity


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("hat(g)", "g^"),
        ('(b + k_"damp")(1 + k_"fp") slash m', "(b + k_damp)(1 + k_fp) / m"),
        ("M_(j j)", "M_jj"),
        ("K_p dot(q) + dot.double(q)", "K_p q' + q''"),
        ("omega_n", "omega_n"),
    ],
)
def test_mathematics_in_a_text_without_markup_has_none(source: str, said: str) -> None:
    assert Math(source).words == said and Math(source, "spoken").words == "spoken"
