"""For mkdocs: what the package's docstrings say, in the form that the API page understands.

Equations in reStructuredText are shown as they are written instead of as stray directives, and the ``#:`` beside a field, which says its
shape and unit, becomes that field's docstring.
"""

from __future__ import annotations

import re
from typing import Any

import griffe


def shown(text: str) -> str:
    """``.. math:: X`` as a block of code, ``:math:`X``` and other roles as code, a lone ``::`` as nothing."""
    text = re.sub(r"^\.\. math::[ ]*(.+(?:\n[ ]+\S.*)*)", _block, text, flags=re.MULTILINE)
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text)
    return re.sub(r"^::$", "", text, flags=re.MULTILINE)


def _block(found: re.Match[str]) -> str:
    return "\n" + "\n".join("    " + line.strip() for line in found[1].splitlines()) + "\n"


def beside(lines: list[str], line: int) -> str | None:
    """What the ``#:`` comment at the end of a line (from 1) says, or those alone on the lines before it."""
    at_end = re.search(r"#:\s*(.+)$", lines[line - 1])
    if at_end:
        return at_end[1].strip()
    before = []
    for text in reversed(lines[: line - 1]):
        alone = re.match(r"\s*#:\s*(.+)$", text)
        if not alone:
            break
        before.insert(0, alone[1].strip())
    return " ".join(before) or None


class Docstrings(griffe.Extension):
    """Rewrites every docstring before it is parsed, and finds those of fields."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """griffe's event for each object it has loaded."""
        if obj.docstring is None and obj.is_attribute and obj.lineno is not None:
            text = beside(obj.lines_collection[obj.filepath], obj.lineno)
            if text:
                obj.docstring = griffe.Docstring(text, parent=obj, lineno=obj.lineno)
        if obj.docstring is not None:
            obj.docstring.value = shown(obj.docstring.value)
