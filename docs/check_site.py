"""The built guide: ``pytest docs/check_site.py`` after ``python docs/build.py``, which calls it. Links, search and axe-core, without network."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

SITE = Path(__file__).resolve().parent.parent / "build" / "site"
PAGES = sorted(path for path in SITE.rglob("*.html") if ".probe." not in path.name)
#: one page of each kind: words and tables, equations, code and pictures, a notebook, the reference, the search
KINDS = ("index", "joint_torque", "gallery", "notebooks/which_gains", "reference/index", "reference/laws.ComputedTorque", "built", "search")
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
looked_at = pytest.mark.skipif(BROWSER is None and not os.environ.get("MFC_BROWSER_REQUIRED"), reason="chromium is not installed")


@cache
def targets(path: Path) -> frozenset[str]:
    """The anchors of a page."""
    return frozenset(html.unescape(name) for name in re.findall(r'\bid="([^"]+)"', path.read_text(encoding="utf-8")))


def test_every_link_within_the_guide_leads_to_a_file_and_to_an_anchor_that_are_there() -> None:
    lost = set()
    for page in PAGES:
        for link in set(re.findall(r'\b(?:href|src)="([^"]*)"', page.read_text(encoding="utf-8"))):
            to = urlsplit(html.unescape(link))
            if to.scheme or to.netloc:
                continue
            path = (page.parent / unquote(to.path)).resolve() if to.path else page
            missing = not path.is_file() or (path.suffix == ".html" and to.fragment and unquote(to.fragment) not in targets(path))
            lost |= {(str(page.relative_to(SITE)), link)} if missing else set()
    assert len(PAGES) > 20 and sorted(lost) == []


@pytest.mark.parametrize("page", sorted((SITE / "notebooks").glob("*.html")), ids=lambda path: path.stem)
def test_a_notebook_shows_its_pictures_and_its_results(page: Path) -> None:
    shown = page.read_text(encoding="utf-8").split("<article", 1)[1]
    assert len(re.findall(r'<img[^>]* src="\.\./_images/', shown)) >= 2 and 'class="output' in shown and "Traceback" not in shown


def test_no_page_loads_anything_from_the_network() -> None:
    loads = re.compile(
        r'<(?:script|img|iframe|source)\b[^>]*\bsrc="(?:https?:)?//|<link\b[^>]*\brel="(?:stylesheet|preload|icon)"[^>]*href="(?:https?:)?//'
    )
    assert [page.name for page in PAGES if loads.search(page.read_text(encoding="utf-8"))] == []


def asked(tmp_path: Path, page: str, script: str, query: str = "", dark: bool = False) -> object:
    """Opens a page as a file, runs a script that returns a value, and gives that value."""
    text = (SITE / f"{page}.html").read_text(encoding="utf-8")
    probe = SITE / f"{page}.{'dark' if dark else 'light'}.probe.html"
    ending = text.rindex("</body>")
    say = "const pre = document.createElement('pre'); pre.id = 'said'; pre.textContent = JSON.stringify(out); document.body.append(pre)"
    run = f"<script>addEventListener('load', async () => {{ const out = await (async () => {{ {script} }})(); {say} }})</script>"
    probe.write_text(text[:ending] + run + text[ending:], encoding="utf-8")
    quiet = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-sync"]
    quiet += [
        "--disable-component-update",
        "--disable-dev-shm-usage",
        "--virtual-time-budget=30000",
        f"--user-data-dir={tmp_path}",
        "--window-size=1280,1000",
    ]
    try:
        command = [str(BROWSER), *quiet, f"--blink-settings=preferredColorScheme={0 if dark else 1}", "--dump-dom", probe.as_uri() + query]
        dom = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", timeout=120).stdout
    finally:
        probe.unlink()
    said = re.search(r'<pre id="said">(.*?)</pre>', dom, re.DOTALL)
    assert said, "the page did not answer"
    return json.loads(html.unescape(said[1]))


@looked_at
def test_the_search_finds_a_page_without_a_server(tmp_path: Path) -> None:
    found = asked(
        tmp_path,
        "search",
        "await new Promise(r => setTimeout(r, 3000)); return [...document.querySelectorAll('#search-results a')].map(a => a.getAttribute('href'))",
        "?q=margins",
    )
    assert any("margins.html" in str(link) for link in found)  # type: ignore[attr-defined]


@looked_at
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("page", KINDS)
def test_axe_finds_nothing_wrong_with_a_page(tmp_path: Path, page: str, dark: bool) -> None:
    spec = find_spec("axe_core_python")
    assert spec is not None and spec.submodule_search_locations
    axe = Path(spec.submodule_search_locations[0], "axe.min.js").as_uri()
    script = f"""await new Promise(r => {{ const s = document.createElement('script'); s.src = '{axe}'; s.onload = r; document.head.append(s) }});
    const found = await axe.run(document);
    return found.violations.flatMap(v => v.nodes.map(n => [v.id, v.help, n.html.slice(0, 200), n.any.map(a => a.message).join()]))"""
    assert asked(tmp_path, page, script, dark=dark) == []
