"""Equations: Typst mathematics as MathML, all of a document in one compilation, with corrections for browsers.

Browsers set a combining accent over a letter at the wrong height, and stretch parentheses around flat content. Both are corrected in the
XML: accents become spacing characters, and fences around flat content get ``stretchy="false"``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

Element = ElementTree.Element

_ACCENTS = {"\u0307": "\u02d9", "\u0308": "\u00a8", "\u0302": "\u02c6", "\u0303": "\u02dc", "\u0304": "\u00af", "\u0305": "\u00af"}
_FENCES = frozenset("()[]{}|‖")
_LARGE = frozenset("∫∑∏")
_TALL = frozenset(("mfrac", "mtable", "munder", "mover", "munderover", "msqrt", "mroot"))


def mathml(equations: Mapping[str, tuple[str, bool]]) -> dict[str, str]:
    """MathML of each equation: id -> (Typst source, display?) becomes id -> markup. The sources are trusted (``section.Math`` checks them)."""
    if not equations:
        return {}
    import typst

    keys = list(equations)
    lines = [f'#html.elem("div")[{_dollars(*equations[key])}]' for key in keys]
    with TemporaryDirectory() as folder:
        source = Path(folder) / "equations.typ"
        source.write_text("\n".join(lines), encoding="utf-8")
        page: bytes = typst.compile(str(source), format="html", ignore_system_fonts=True)
    body = ElementTree.fromstring(_body(page.decode("utf-8")))
    found = list(body.iter("math"))
    assert len(found) == len(keys), "one formula per element"
    return {key: _mended(node, equations[key][1]) for key, node in zip(keys, found, strict=True)}


def _dollars(source: str, display: bool) -> str:
    return f"$ {source} $" if display else f"${source}$"


def _body(page: str) -> str:
    start, stop = page.index("<body"), page.index("</body>") + len("</body>")
    return page[start:stop]


def _mended(node: Element, display: bool) -> str:
    if display:
        node.set("display", "block")
    _walk(node)
    node.tail = None
    return ElementTree.tostring(node, encoding="unicode")


def _walk(node: Element) -> None:
    for child in node:
        _walk(child)
    if node.tag == "mover" and len(node) == 2 and node[1].text in _ACCENTS:
        node[1].text = _ACCENTS[node[1].text or ""]
        node[1].set("stretchy", "false")
    children = list(node)
    fenced = [i for i, c in enumerate(children) if c.tag == "mo" and c.text in _FENCES]
    if fenced and not any(_tall(c) for c in children):
        for i in fenced:
            children[i].set("stretchy", "false")


def _tall(node: Element) -> bool:
    if node.tag == "mover" and node.get("accent") == "true":
        return any(_tall(c) for c in node)
    return node.tag in _TALL or (node.tag == "mo" and node.text in _LARGE) or any(_tall(c) for c in node)
