"""Many figures at once: over 20, a second process draws half of them."""
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mfc_analysis.plots import figure as sheet


def drawn(recipes: Sequence[Any]) -> list[str]:
    """SVG of each recipe, in order."""
    return sheet.svgs(recipes)
