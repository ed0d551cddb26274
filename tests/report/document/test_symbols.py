"""The appendix of letters: which of them stand where."""

from __future__ import annotations

from itertools import product

import pytest

from mfc_analysis.report.document.symbols import symbols


def letters(**asked: bool) -> list[str]:
    return [x.letter.source for x in symbols(**asked)]


def test_letters_of_the_tool_and_of_forces_come_only_when_asked_for_and_change_no_others() -> None:
    joint, tool, force = letters(), letters(tool=True), letters(force=True)
    assert tool[: len(joint)] == joint == force[: len(joint)]
    assert {"X_e", "Lambda, eta"} & set(joint) == set() and "X_e" in " ".join(tool) and "X_e" not in " ".join(force)
    assert {'K_"damp"', "P"} <= set(force) and not {'K_"damp"', "P"} & set(tool)
    assert letters(tool=True, force=True) == tool + force[len(joint) :]


@pytest.mark.parametrize(("tool", "force"), list(product((False, True), repeat=2)))
def test_no_letter_stands_twice_and_each_has_a_meaning(tool: bool, force: bool) -> None:
    found = symbols(tool=tool, force=force)
    single = [word for x in found for word in x.letter.source.split(", ")]
    assert len(set(single)) == len(single)
    assert all(x.meaning.strip() for x in found)


@pytest.mark.parametrize(("letter", "unit"), [
    ("q, q_d", "rad (sliding: m)"), ("tau", "Nm (sliding: N)"), ("a_q", "rad/s²"), ('"PM"', "°"), ("M_s", ""), ("omega_n, zeta", "rad/s, –"),
    ('F_"tip", F_d', "N, Nm"), ('K_"fp", K_"fi"', "–, 1/s"), ('K_"damp"', "Ns/m"), ('k_"env"', "N/m"), ("V_b", "m/s, rad/s"),
])  # fmt: skip
def test_units_are_those_of_the_chapter(letter: str, unit: str) -> None:
    assert {x.letter.source: x.unit for x in symbols(tool=True, force=True)}[letter] == unit
