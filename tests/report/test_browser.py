"""The page in a real browser: phone width, the scrubber, the math font. Skipped where there is no chromium."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess

import pytest

from mfc_analysis.report.render.write import rendered
from tests.report import samples

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None and not os.environ.get("MFC_BROWSER_REQUIRED"), reason="chromium is not installed")

QUIET = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
QUIET += ["--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--virtual-time-budget=4000", "--window-size=1300,1000"]


def asked(tmp_path, document, script, width=1250, *options):
    """Opens the page in a frame of the given width, runs a script that returns a value, and gives that value."""
    page = rendered(document, ("html",))["html"].decode()
    ending = page.rindex("</body>")
    probe = f"<script>addEventListener('load', async () => parent.postMessage(JSON.stringify(await (async () => {{ {script} }})()), '*'))</script>"
    (tmp_path / "page.html").write_text(page[:ending] + probe + page[ending:], encoding="utf-8")
    holder = f"""<!DOCTYPE html><body style="margin:0"><pre id="out"></pre>
<script>addEventListener('message', e => document.getElementById('out').textContent = e.data)</script>
<iframe src="page.html" style="width:{width}px;height:900px;border:0"></iframe></body>"""
    (tmp_path / "holder.html").write_text(holder, encoding="utf-8")
    command = [
        CHROMIUM,
        *QUIET,
        *options,
        f"--user-data-dir={tmp_path / 'profile'}",
        "--window-size=1300,1000",
        "--dump-dom",
        (tmp_path / "holder.html").as_uri(),
    ]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=60).stdout
    return json.loads(html.unescape(re.search(r'<pre id="out">(.*?)</pre>', dom, re.S)[1]))


@pytest.mark.parametrize("make", [samples.document, samples.chapter])
def test_a_phone_scrolls_only_downwards(tmp_path, make):
    width, inner, wide = asked(
        tmp_path,
        make(),
        """const all = [...document.querySelectorAll('main *')].filter(e => !e.closest('.scroll, pre, .formula, svg, .hush'));
        const wide = all.filter(e => e.getBoundingClientRect().right > innerWidth + 1);
        return [document.documentElement.scrollWidth, innerWidth, wide.map(e => e.outerHTML.slice(0, 80))]""",
        390,
    )
    assert inner == 390
    assert width <= 390 and wide == []


@pytest.mark.parametrize("make", [samples.document, samples.chapter])
def test_on_a_phone_the_result_stays_in_view_and_figures_can_be_read(tmp_path, make):
    results, captions, letters = asked(
        tmp_path,
        make(),
        """const results = [], captions = [];
        for (const box of document.querySelectorAll('.scroll')) for (const left of [0, 9999]) {
            box.scrollLeft = left;
            for (const cell of box.querySelectorAll('td.result')) { const r = cell.getBoundingClientRect(); results.push([r.left, r.right]) }
            const caption = box.querySelector('caption span').getBoundingClientRect(); captions.push([caption.left, caption.right])
        }
        const letters = [...document.querySelectorAll('figure svg')].flatMap(svg => {
            const zoom = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
            return [...svg.querySelectorAll('text')].map(t => zoom * parseFloat(getComputedStyle(t).fontSize)) });
        return [results, captions, letters]""",
        390,
    )
    assert results and all(0 <= left < right <= 391 for left, right in results)
    assert captions and all(-1 <= left < right <= 391 for left, right in captions)
    assert letters and min(letters) >= 8.5


def test_the_slider_moves_poles_and_says_the_margins(tmp_path):
    first, moved, back = asked(
        tmp_path,
        samples.document(),
        """const f = document.querySelector('[data-scrubber]'), s = f.querySelector('input');
        const state = () => [f.querySelector('output').textContent, f.querySelector('.pole').getAttribute('transform'), s.value];
        const a = state(); s.value = 0; s.oninput(); const b = state(); f.querySelector('button').click(); return [a, b, state()]""",
    )
    assert first == back and first[0].startswith("t = 1.05 s: PM 33.0°")
    assert moved[0].startswith("t = 0 s: PM") and moved[1] != first[1] and moved[2] == "0"


def test_printing_puts_the_scrubber_on_the_worst_case(tmp_path):
    said = asked(
        tmp_path,
        samples.document(),
        "const f = document.querySelector('[data-scrubber]'), s = f.querySelector('input'); s.value = 3; s.oninput();"
        "dispatchEvent(new Event('beforeprint')); return f.querySelector('output').textContent",
    )
    assert said.startswith("t = 1.05 s")


def test_equations_are_set_in_the_font_that_the_page_carries(tmp_path):
    names, height = asked(
        tmp_path,
        samples.document(),
        """await document.fonts.ready;
        return [[...document.fonts].map(f => f.family + ' ' + f.status),
            document.querySelector('.formula math').getBoundingClientRect().height]""",
    )
    assert names == ['"STIX Two Math subset" loaded'] or names == ["STIX Two Math subset loaded"]
    assert height > 20


def test_dark_pages_have_light_ink(tmp_path):
    script = "const c = getComputedStyle(document.body); return [c.color, c.backgroundColor]"
    colours = [asked(tmp_path, samples.chapter(), script, 1250, f"--blink-settings=preferredColorScheme={k}") for k in (0, 1)]
    dark, light = ([sum(map(int, re.findall(r"\d+", c))) for c in pair] for pair in colours)
    assert dark[0] > dark[1] and light[0] < light[1]
