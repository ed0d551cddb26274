"""An mkdocs extension that converts the docstrings of the package for the API page.

Equations in reStructuredText become code blocks. The ``#:`` comment of a field, with its shape and unit, becomes the docstring of the field.
"""

from __future__ import annotations

import re
from typing import Any

import griffe


def shown(text: str) -> str:
    """The text with ``.. math:: X`` as a code block, ``:math:`X``` and other roles as code, and without a ``::`` alone on a line."""
    text = re.sub(r"^\.\. math::[ ]*(.+(?:\n[ ]+\S.*)*)", _block, text, flags=re.MULTILINE)
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text)
    return re.sub(r"^::$", "", text, flags=re.MULTILINE)


def _block(found: re.Match[str]) -> str:
    return "\n" + "\n".join("    " + line.strip() for line in found[1].splitlines()) + "\n"


def beside(lines: list[str], line: int) -> str | None:
    """The text of the ``#:`` comment at the end of a line (from 1), or of those on the lines directly before it."""
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
    """Rewrites every docstring before it is parsed, and adds those of the fields."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called by griffe for each object that it has loaded."""
        if obj.docstring is None and obj.is_attribute and obj.lineno is not None:
            text = beside(obj.lines_collection[obj.filepath], obj.lineno)
            if text:
                obj.docstring = griffe.Docstring(text, parent=obj, lineno=obj.lineno)
        if obj.docstring is not None:
            obj.docstring.value = shown(obj.docstring.value)
