"""The guide as a site: Markdown by MyST, the reference by autodoc. ``docs/build.py`` runs the pages first, which draws their pictures."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path[:0] = [str(ROOT), str(DOCS)]

from names import ALIASES  # noqa: E402

from mfc_analysis import __version__  # noqa: E402

#: heading in the navigation -> its pages
NAVIGATION = {
    "Start": ["install", "start", "faq", "cheat_sheet"],
    "The chapter": ["velocity", "joint_torque", "task", "force", "hybrid", "impedance", "misprints"],
    "Reading the numbers": ["conventions", "margins", "hardware", "armature", "passivity", "plain", "from_control", "pictures", "measured"],
    "Working with it": ["testing", "studies", "controllers", "reports", "adding", "performance"],
    "Reference": ["api", "reference/index"],
    "The project": ["built", "changelog", "cite"],
}

project = "mfc_analysis"
version = release = __version__
author = "mfc_analysis maintainers"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton", "names", "mathematics"]
exclude_patterns = []
nitpicky = True

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
nb_execution_mode = "off"

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "description"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ALIASES}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100

copybutton_prompt_text = "$ "
html_theme = "furo"
html_title = "mfc_analysis"
html_math_renderer = "mathml"
html_static_path = ["style.css"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_copyright = False


def read(app: Any, page: str, source: list[str]) -> None:
    """``<!-- include: FILE -->`` becomes the text of the file; the first page gets the navigation, so that it stays plain Markdown."""
    source[0] = re.sub(r"<!-- include: (\S+) -->", lambda found: (ROOT / found[1]).read_text(encoding="utf-8"), source[0])
    if page == "index":
        for heading, pages in NAVIGATION.items():
            there = [name for name in pages if (DOCS / f"{name}.md").exists()]
            source[0] += f"\n\n```{{toctree}}\n:hidden:\n:caption: {heading}\n\n" + "\n".join(there) + "\n```\n"


def setup(app: Any) -> None:
    app.connect("source-read", read)
