"""For mkdocs: the equations of docstrings, written as reStructuredText, shown as they are written instead of as stray directives."""

from __future__ import annotations

import re
from typing import Any

import griffe


def shown(text: str) -> str:
    """``.. math:: X`` as a block of code, ``:math:`X``` and other roles as code, ``::`` at a paragraph's end as the start of a block."""
    text = re.sub(r"^\.\. math::[ ]*(.+(?:\n[ ]+\S.*)*)", _block, text, flags=re.MULTILINE)
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text)
    return re.sub(r"^::$", "", text, flags=re.MULTILINE)


def _block(found: re.Match[str]) -> str:
    return "\n" + "\n".join("    " + line.strip() for line in found[1].splitlines()) + "\n"


class MathInDocstrings(griffe.Extension):
    """Rewrites every docstring before it is parsed."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """griffe's event for each object it has loaded."""
        if obj.docstring is not None:
            obj.docstring.value = shown(obj.docstring.value)
