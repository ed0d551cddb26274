"""The guide as a site: Markdown by MyST, the reference by autodoc. ``docs/build.py`` runs the pages first, which draws their pictures."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path[:0] = [str(ROOT), str(DOCS)]

import house  # noqa: E402
from names import ALIASES  # noqa: E402

from mfc_analysis import __version__  # noqa: E402

#: heading in the navigation -> its pages
NAVIGATION = {
    "Start": ["install", "start", "faq", "cheat_sheet"],
    "The chapter": [
        "Velocity inputs, 9.1-9.5 <velocity>",
        "Joint torques, 9.6-9.13 <joint_torque>",
        "Tool space, 9.14-9.16 <task>",
        "Force, 9.17-9.23 <force>",
        "Hybrid, 9.24 <hybrid>",
        "impedance",
        "misprints",
    ],
    "Reading the numbers": [
        "conventions",
        "Margins <margins>",
        "Hardware <hardware>",
        "armature",
        "Passivity and impact <passivity>",
        "plain",
        "from_control",
        "pictures",
        "measured",
    ],
    "Working with it": ["testing", "studies", "controllers", "reports", "Laws and robots of your own <adding>", "performance"],
    "Examples": [
        "Scripts <gallery>",
        "An arm with dead time <notebooks/arm_with_dead_time>",
        "notebooks/which_gains",
        "notebooks/why_it_bounces_on_steel",
    ],
    "Reference": ["reference/index"],
    "The project": ["built", "changelog", "cite"],
}

project = "mfc_analysis"
version = release = __version__
author = "mfc_analysis maintainers"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton", "names", "mathematics"]
exclude_patterns = []
nitpicky = True
smartquotes_action = "De"  # dashes and dots; the quote of q' is a derivative

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
os.environ |= {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # of the kernels

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "both"
autodoc_typehints_description_target = "documented"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ALIASES}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100

copybutton_prompt_text = "$ "
html_theme = "furo"
html_title = "mfc_analysis"
pygments_dark_style = "a11y-high-contrast-dark"
html_math_renderer = "mathml"
html_static_path = ["style.css", "../mfc_analysis/report/assets/stix-two-math-subset.woff2"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_copyright = False


def gather(app: Any) -> None:
    """Puts what is drawn or kept elsewhere beside the pages: the picture of the house, the notebooks of ``examples/``."""
    for folder in ("pictures", "notebooks"):
        (DOCS / folder).mkdir(exist_ok=True)
    (DOCS / "pictures" / "house.svg").write_text(house.svg(), encoding="utf-8")
    for book in (ROOT / "examples").glob("*.ipynb"):
        cells = json.loads(book.read_text(encoding="utf-8"))
        cells["cells"][0]["source"] += ["\n\n", f"{{download}}`Download this notebook <../../examples/{book.name}>`"]
        (DOCS / "notebooks" / book.name).write_text(json.dumps(cells), encoding="utf-8")


def _without_title(page: Path) -> str:
    return re.sub(r"\A# .*\n", "", page.read_text(encoding="utf-8"))


def read(app: Any, page: str, source: list[str]) -> None:
    """What pages that stay plain Markdown need: ``<!-- include: FILE -->``, notebooks as pages, and on the first page the navigation."""
    source[0] = re.sub(r"\]\(\.\./examples/(\w+\.ipynb)\)", r"](notebooks/\1)", source[0])
    source[0] = re.sub(r"<!-- include: (\S+) -->", lambda found: _without_title(ROOT / found[1]), source[0])
    if page.startswith("reference/") and page != "reference/index":  # two hundred entries in the navigation of every page would take minutes
        source[0] = f"---\norphan: true\n---\n{source[0]}\n\n[All names by topic](index.md)\n"
    if page == "index":
        for heading, pages in NAVIGATION.items():
            there = [page for page in pages if list(DOCS.glob(re.sub(r".*<(.*)>", r"\1", page) + ".*"))]
            source[0] += f"\n\n```{{toctree}}\n:hidden:\n:caption: {heading}\n\n" + "\n".join(there) + "\n```\n"


#: what the theme leaves out for readers of the screen and of the keyboard
MENDED = {
    'role="heading">': 'role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="Pages">',
    '<aside class="toc-drawer': '<aside aria-label="On this page" class="toc-drawer',
    "<pre>": '<pre tabindex="0">',
    '<div id="search-results"></div>': '<h1>Search</h1><div id="search-results"></div>',
}
#: printed text without columns, which may be wrapped
SENTENCES = r'(<div class="highlight-text notranslate)(?="><div class="highlight"><pre[^>]*>(?:(?!</pre>|\S {3,}\S)(?s:.))*</pre>)'


def _breaking(found: re.Match[str]) -> str:
    tag, name = found[0].rsplit(">", 1)
    return tag + ">" + re.sub(r"([._])|(?<=[a-z])(?=[A-Z])", r"\1<wbr>", name)


def mend(app: Any, failure: Exception | None) -> None:
    """Mends the pages, and makes a list of a signature of several lines, which is no list of definitions."""
    for path in Path(app.outdir).rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        for was, now in MENDED.items():
            text = text.replace(was, now)
        text = re.sub(SENTENCES, r"\1 sentences", text)
        if path.parent.name == "reference":  # on a phone long names break between their words: in headings, tables and signatures
            text = re.sub(r'(?:<h1>|(?<=<td><p>)<a [^>]*><span [^>]*><code [^>]*><span class="pre">)mfc\.[\w.]+', _breaking, text)
            text = text.replace('<span class="sig-paren">(</span>', '<span class="sig-paren">(</span><wbr>')
            text = text.replace('<span class="sig-name', '<wbr><span class="sig-name')
        text = re.sub(r"<p>alias of .*?</p>", "", text, flags=re.DOTALL)  # a type, which the text above says in words
        text = re.sub(r'<dl>\n((?:<dd><em class="sig-param">.*</dd>\n)+)</dl>', r'<ul class="sig-parameters">\n\1</ul>', text)
        path.write_text(re.sub(r'<dd>(<em class="sig-param">.*)</dd>', r"<li>\1</li>", text), encoding="utf-8")


def setup(app: Any) -> None:
    app.connect("builder-inited", gather, priority=1)
    app.connect("source-read", read)
    app.connect("build-finished", mend)
