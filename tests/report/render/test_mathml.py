"""Equations as MathML: one batch, accents and fences mended."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from mfc_analysis.report.render.html import asset
from mfc_analysis.report.render.mathml import mathml


def one(source, display=True):
    return ElementTree.fromstring(mathml({"m": (source, display)})["m"])


def test_a_batch_keeps_each_equation_under_its_own_key():
    found = mathml({f"m{k}": (f"x_{k}", k % 2 == 0) for k in range(30)})
    for k in range(30):
        node = ElementTree.fromstring(found[f"m{k}"])
        assert "".join(node.itertext()).endswith(str(k))
        assert (node.get("display") == "block") == (k % 2 == 0)


@pytest.mark.parametrize(("source", "accent"), [("dot(q)", "˙"), ("dot.double(q)", "¨"), ("hat(M)", "ˆ")])
def test_combining_accents_become_spacing_ones(source, accent):
    found = mathml({"m": (source, True)})["m"]
    assert accent in found
    assert not any(0x300 <= ord(c) < 0x370 for c in found)


def test_parentheses_stretch_around_fractions_and_integrals_only():
    def fences(source):
        return [mo.get("stretchy") for mo in one(source).iter("mo") if mo.text in ("(", ")")]

    assert fences("L(s)") == ["false", "false"]
    assert fences("(dot(q) + hat(h))") == ["false", "false"]
    assert fences("(a / b)") == [None, None]
    assert fences("(K integral e)") == [None, None]
    assert fences("((a/b) + f(x))").count("false") == 2


def test_no_equation_no_compile():
    assert mathml({}) == {}


def test_the_font_of_the_equations_has_its_math_table_and_license():
    TTFont = pytest.importorskip("fontTools.ttLib").TTFont
    pytest.importorskip("brotli")
    from io import BytesIO

    font = TTFont(BytesIO(asset("stix-two-math-subset.woff2")))
    assert "MATH" in font
    assert {ord(c) for c in "(){}[]|∫∑−+=˙¨ˆ𝑞𝑴𝒒𝜏Λ⊤≤≥ω"} - {ord("ω")} <= set(font.getBestCmap())
    text = asset("OFL.txt").decode()
    assert "SIL OPEN FONT LICENSE Version 1.1" in text and "Copyright 2001-2020 The STIX Fonts Project Authors" in text
