"""One self-contained HTML file of a document: Jinja2 with autoescape on; only generated SVG and MathML are marked safe."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any
from xml.etree import ElementTree

from mfc_analysis.report.document.scrubber import Moving
from mfc_analysis.report.document.tree import Tree

_SVG = "http://www.w3.org/2000/svg"
_XLINK = "http://www.w3.org/1999/xlink"
_DROPPED = frozenset(("metadata", "title", "desc", "script", "foreignObject"))

#: colours of the figures -> custom properties of the style sheet, which has a second value of each for dark pages
COLOURS = {
    "#000000": "currentColor",
    "#ffffff": "var(--page)",
    "#0072b2": "var(--j0)",
    "#c44e00": "var(--j1)",
    "#00795a": "var(--j2)",
    "#9b3f84": "var(--j3)",
    "#7a6200": "var(--j4)",
    "#5a4fcf": "var(--j5)",
    "#8a5a44": "var(--j6)",
    "#3b6470": "var(--j7)",
    "#3d444d": "var(--limit)",
    "#b3261e": "var(--bad)",
    "#6b7280": "var(--grey)",
    "#7a4b00": "var(--watch)",
    "#6a3d9a": "var(--demo)",
    "#d5d9de": "var(--grid)",
    "#fbeee4": "var(--shade)",
    "#cfe8dc": "var(--fill-good)",
    "#f6d5d1": "var(--fill-bad)",
}


def asset(name: str) -> bytes:
    """A file of ``report/assets``."""
    return files("mfc_analysis.report").joinpath("assets", name).read_bytes()


def html(tree: Tree, drawings: Mapping[str, str], formulas: Mapping[str, str], scrubbers: Mapping[str, Moving], version: str) -> str:
    """The page. ``drawings``: SVG text by figure id; ``formulas``: MathML by id; ``scrubbers`` by figure id."""
    figures = {}
    for key, text in drawings.items():
        figures[key] = inline_svg(text, key, tree.figures[key].alt)
    moving = {}
    for key, made in scrubbers.items():
        alt = tree.scrubbers[key].alt
        moving[key] = {
            "poles": inline_svg(made.poles, f"{key}-poles", f"{tree.scrubbers[key].heading}. {alt}"),
            "traces": inline_svg(made.traces, f"{key}-traces", "Margins. " + alt),
            "data": script_json(made.data),
        }
    font = base64.b64encode(asset("stix-two-math-subset.woff2")).decode("ascii") if formulas else ""
    page: str = _template().render(
        root=tree.root,
        figures=figures,
        formulas=formulas,
        scrubbers=moving,
        font=font,
        css=asset("report.css").decode("utf-8"),
        js=asset("scrubber.js").decode("utf-8"),
        version=version,
    )
    return page


@cache
def _template() -> Any:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(asset("report.html.j2").decode("utf-8"))


def script_json(data: Any) -> str:
    """JSON that is safe inside a script element: without ``<``, ``>``, ``&`` and line separators."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), sort_keys=True)
    for bad in "<>&\u2028\u2029":
        text = text.replace(bad, f"\\u{ord(bad):04x}")
    return text


def inline_svg(text: str, key: str, alt: str) -> dict[str, Any]:
    """A matplotlib SVG prepared for the page: ids prefixed, prolog and metadata removed, colours as properties, named by ``alt``.

    Returns the markup, and its width and height [pt].
    """
    root = ElementTree.fromstring(text)
    width, height = (float(root.get(side, "0pt").removesuffix("pt")) for side in ("width", "height"))
    _clean(root, f"{key}-")
    for side in ("width", "height", "version"):
        root.attrib.pop(side, None)
    root.set("role", "img")
    root.set("aria-labelledby", f"{key}-alt")
    title = ElementTree.Element("title", {"id": f"{key}-alt"})
    title.text = alt
    root.insert(0, title)
    out = ElementTree.tostring(root, encoding="unicode", short_empty_elements=True)
    return {"svg": out.replace("\n", ""), "width": width, "height": height}


def _clean(node: ElementTree.Element, prefix: str) -> None:
    node.tag = node.tag.removeprefix(f"{{{_SVG}}}")
    for child in list(node):
        if child.tag.removeprefix(f"{{{_SVG}}}") in _DROPPED:
            node.remove(child)
        else:
            _clean(child, prefix)
    for name, value in list(node.attrib.items()):
        kept = _attribute(name, value, prefix)
        if name == f"{{{_XLINK}}}href":
            del node.attrib[name]
            node.set("href", kept)
        elif kept != value:
            node.set(name, kept)


def _attribute(name: str, value: str, prefix: str) -> str:
    if name == "id":
        return prefix + value
    if name.endswith("href") and value.startswith("#"):
        return "#" + prefix + value[1:]
    if "url(#" in value:
        value = value.replace("url(#", f"url(#{prefix}")
    if "#" in value and name in ("style", "fill", "stroke"):
        for colour, name_of in COLOURS.items():
            value = value.replace(colour, name_of)
    return value


ElementTree.register_namespace("", _SVG)
