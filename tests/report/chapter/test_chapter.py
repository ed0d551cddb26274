"""The chapter as a whole: verdicts that follow the gains, loops that are only shown, the overview of all loops."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.text import Text

from mfc_analysis.plots import figure as sheet
from mfc_analysis.report.chapter import chapter, joint_torque, velocity
from mfc_analysis.report.chapter.arms import Designs, arms
from mfc_analysis.report.document.document import Badge, Document
from mfc_analysis.report.document.tree import every_block, tree
from mfc_analysis.report.document.verdict import verdict
from mfc_analysis.report.render.write import rendered
from mfc_analysis.requirements.line import Status
from tests.plots.overlaps import texts_on_curves, texts_on_texts
from tests.plots.test_figure import texts
from tests.report.loops.test_record import assert_same_margins, rebuilt
from tests.report.render.test_pdf import words

LOOP = "9.8 independent PID, planar 2R"
ROOM = Path(chapter.__file__).parents[1]  #: of the reports


def made(designs: Designs) -> Document:
    """9.1 and 9.8 alone: a document with loops that are shown and loops that are judged."""
    parts = (lambda: (velocity.open_loop(designs),), partial(lambda d: (joint_torque.independent(d),), designs))
    return chapter.chapter_document(parts=parts, full=True)


@pytest.fixture(scope="module")
def good() -> Document:
    return made(Designs())


@pytest.fixture(scope="module")
def bad() -> Document:
    """The integral gains of 9.8 made so large that no arm stays stable."""
    return made(Designs(scale={"9.8": {"ki": 30.0}}))


def sections_of(data: dict, out: list | None = None) -> list[dict]:
    found = [] if out is None else out
    for section in data["sections"]:
        found.append(section)
        sections_of(section, found)
    return found


def test_loops_that_are_shown_to_fail_do_not_fail_the_chapter(good):
    found = verdict(good)
    assert found.status is Status.PASS
    assert "3 loops are shown for demonstration (DEMO)" in found.detail
    assert good.sections[0].badge is Badge.DEMO


def test_a_gain_that_makes_a_loop_unstable_changes_banner_matrix_section_and_json(good, bad):
    pages = rendered(bad, ("html", "json"))
    page, data = pages["html"].decode(), json.loads(pages["json"])
    before = json.loads(rendered(good, ("json",))["json"])
    assert (before["verdict"]["status"], data["verdict"]["status"]) == ("PASS", "FAIL")
    assert '<div class="banner fail"' in page
    assert "not met on 3 of 3 loops" in data["verdict"]["detail"]
    section = next(s for s in sections_of(data) if s["loop"] == LOOP)
    assert (section["status"] == "FAIL" and "Not stable" in section["finding"]) or "unstable" in section["finding"]
    check = next(c for c in section["checks"] if c["name"] == "stable")
    assert check["status"] == "FAIL" and check["found"] > 0
    assert max(complex(z["re"], z["im"]).real if isinstance(z, dict) else z for z in section["numbers"]["poles"]) > 0
    assert next(c for c in section["checks"] if c["name"] == "phase margin")["found"] == "unstable"
    assert f'<a class="cell fail" href="#{section["id"]}">' in page


def test_an_unstable_chapter_still_has_all_its_figures(bad):
    data = json.loads(rendered(bad, ("json",))["json"])
    assert all(f["alt"].strip() for f in data["figures"])
    assert any("unstable" in f["alt"] or "not stable" in f["alt"] for f in data["figures"])


def test_every_loop_stands_in_the_matrix_and_in_the_appendix_of_poles(good):
    data = json.loads(rendered(good, ("json",))["json"])
    loops = {s["loop"] for s in sections_of(data) if s["loop"]}
    poles = next(s for s in data["sections"] if s["id"] == "all-poles")
    assert {row[0] for row in poles["tables"][0]["rows"]} == loops and len(loops) == 6


def test_poles_that_are_alike_are_counted_and_pairs_are_told_once():
    assert chapter.poles_words([-2.0, -2.0, -1 + 3j, -1 - 3j]) == "−2.00 (×2),  −1.00 ± 3.00j"


def test_the_overview_of_validity_names_the_loop_that_stops_holding_first(good):
    data = json.loads(rendered(good, ("json",))["json"])
    found = {s["loop"]: s["numbers"]["validation"]["radius"] for s in sections_of(data) if "validation" in s["numbers"]}
    finite = {k: v for k, v in found.items() if not isinstance(v, str)}
    section = next(s for s in data["sections"] if s["id"] == "linear-against-nonlinear")
    assert min(finite, key=finite.get) in section["finding"]
    assert len(section["tables"][0]["rows"]) == len(found)


def test_progress_counts_every_part():
    told: list[tuple[int, int]] = []
    chapter.chapter_document(lambda done, of: told.append((done, of)), parts=(lambda: (), lambda: ()))
    assert told == [(1, 2), (2, 2)]


def test_the_parts_of_the_chapter_are_those_that_are_there():
    room = Path(chapter.__file__).parent
    with_sections = {path.stem for path in room.glob("*.py") if "\ndef sections(" in path.read_text()}
    assert set(chapter.PARTS) == with_sections and set(chapter.LONGEST_FIRST) <= with_sections


def test_no_figure_of_the_chapter_is_a_function_that_cannot_be_sent_to_another_process():
    """A part whose sections cannot be sent back is made again by the first process."""
    recipes = []
    for path in (ROOM / name for name in ("chapter", "loops")):
        for file in path.glob("*.py"):
            module = ast.parse(file.read_text(encoding="utf-8"))
            inner = {
                f.name
                for top in ast.walk(module)
                if isinstance(top, ast.FunctionDef)
                for f in ast.walk(top)
                if isinstance(f, ast.FunctionDef) and f is not top
            }
            for call in ast.walk(module):
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "Figure":
                    recipe = call.args[0].args[0] if isinstance(call.args[0], ast.Call) else call.args[0]
                    recipes.append(recipe)
                    assert not isinstance(recipe, ast.Lambda) and getattr(recipe, "id", "") not in inner, f"{file.name}:{call.lineno}"
    assert len(recipes) > 30


def test_the_same_chapter_twice_is_the_same_bytes(good):
    again = made(Designs())
    assert rendered(good, ("html", "json")) == rendered(again, ("html", "json"))


def test_designs_scale_the_gains_of_one_equation_only():
    scaled, plain = Designs(scale={"9.10": {"ki": 2.0}}), Designs()
    arm = arms()[0]
    assert np.isclose(scaled.law("9.10", arm).gains()["ki"].array, 2 * plain.law("9.10", arm).gains()["ki"].array)
    assert np.isclose(scaled.law("9.8", arm).gains()["ki"].array, plain.law("9.8", arm).gains()["ki"].array)


@pytest.mark.parametrize("which", ["good", "bad"])
def test_no_text_leaves_its_sheet_in_the_figures_of_the_chapter(which, request, monkeypatch):
    with matplotlib.rc_context(sheet.settings()):
        for drawing in tree(request.getfixturevalue(which)).figures.values():
            for said, box, whole in texts(sheet.figure_of(drawing.draw()), monkeypatch):
                inside = box.x0 > -0.5 and box.y0 > -0.5 and box.x1 < whole.width + 0.5 and box.y1 < whole.height + 0.5
                assert inside, f"{said!r} in {drawing.alt}"
            monkeypatch.undo()


# --- the report that `mfc-analysis report` writes -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole() -> Document:
    return chapter.chapter_document()


@pytest.fixture(scope="module")
def written(whole):
    pages = rendered(whole, ("pdf", "json"))
    return pages["pdf"], json.loads(pages["json"])


def test_every_loop_rebuilt_from_the_json_has_the_margins_of_the_report(written):
    loops = {s["loop"]: s["numbers"] for s in sections_of(written[1]) if s["loop"] and "loop" in s["numbers"]}
    named = {s["loop"] for s in sections_of(written[1]) if s["loop"]}
    assert set(loops) == named and len(loops) >= 22
    for found in loops.values():
        assert_same_margins(found, rebuilt(found["loop"]))


def test_the_gains_of_every_loop_stand_in_front_with_their_units_and_origin(written):
    gains = next(s for s in written[1]["sections"] if s["id"] == "gains")["tables"][0]["rows"]
    said = " ".join(row[0] for row in gains)
    for name in {s["loop"] for s in sections_of(written[1]) if s["loop"]}:
        assert name in said or (name.partition(", ")[0] in said and name.partition(", ")[2] in said), name
    nine = next(row for row in gains if row[0].startswith("9.10 computed torque"))
    assert nine[2] == "kp = 192 1/s²; ki = 512 1/s³; kd = 24 1/s" and "triple pole at −8 rad/s" in nine[3]


def test_the_headline_counts_requirements_only(whole, written):
    data = written[1]
    asked = [c for s in sections_of(data) if not s["shown"] for c in s["checks"]]
    met = sum(c["status"] == "PASS" for c in asked)
    assert data["verdict"]["sentence"].startswith(f"{met} of {len(asked)} requirements are met")
    assert all("deviation" not in c["name"] and "simulated" not in c["name"] for c in asked)
    assert {s["status"] for s in sections_of(data)} <= {"PASS", "WATCH", "FAIL", "DEMO", "CONFIRMED", "INFO"}
    demos = {s["id"] for s in data["sections"] if s["status"] == "DEMO"}
    assert {"eq-9-9", "free-space", "hybrid-damping", "floquet", "misprints", "misprints-tool"} <= demos


def test_the_report_has_at_most_28_pages_and_each_is_at_least_half_used(written, tmp_path):
    if shutil.which("pdftoppm") is None:
        pytest.skip("pdftoppm is not installed")
    (tmp_path / "chapter.pdf").write_bytes(written[0])
    subprocess.run(["pdftoppm", "-r", "20", "-gray", str(tmp_path / "chapter.pdf"), str(tmp_path / "p")], check=True, capture_output=True)
    used = [used_part(path.read_bytes()) for path in sorted(tmp_path.glob("p-*.pgm"))]
    assert len(used) <= 28
    assert not [(k + 1, round(x, 2)) for k, x in enumerate(used[:-1]) if x < 0.5]


def used_part(picture: bytes) -> float:
    """The part of the body of a page (PGM, 20 dots per inch) that lies within 8 mm of ink."""
    _, size, _, rest = picture.split(b"\n", 3)
    width, height = map(int, size.split())
    ink = (np.frombuffer(rest, np.uint8)[: width * height].reshape(height, width) < 200).any(axis=1)
    body = ink[int(0.06 * height) : int(0.94 * height)]
    near = np.convolve(body, np.ones(13), "same") > 0
    return float(near.mean())


def test_no_rounding_error_no_doubled_unit_and_no_infinite_distance_is_printed(written):
    said = words(written[0])
    for bad in (r"(?<!≤ )\b\d[\d.]*e−1\d", "rad or m", "minus infinit", r"wrong \[", "down to 0", "Join…", r"\bnan\b", "\\{"):
        assert not re.search(bad, said), (bad, re.search(f".*{bad}.*", said))
    lags = [c for s in sections_of(written[1]) for c in s["checks"] if c["name"].startswith("lag")]
    assert (
        lags and {c["unit"] for c in lags} == {"rad"} and not any(c["name"] == "error at rest" for s in sections_of(written[1]) for c in s["checks"])
    )
    assert said.count("Sources") == 1 and "payload unknown" in json.dumps(written[1])


def test_text_in_figures_has_8_points_in_print_and_lies_on_nothing(whole, monkeypatch):
    flat = tree(whole)
    widths = {}
    with matplotlib.rc_context(sheet.settings()):
        for key, drawing in flat.figures.items():
            figure = sheet.figure_of(drawing.draw())
            widths[key] = 72 * figure.get_figwidth()
            assert min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text().strip()) >= 8, drawing.alt
            assert not texts_on_texts(figure, monkeypatch) + texts_on_curves(figure, monkeypatch), drawing.alt
    for block in every_block(flat.root["sections"]):
        row = block["figures"] if block["k"] == "row" else [block] if block["k"] == "figure" else []
        assert sum(widths[f["id"]] for f in row) + 8 * (len(row) - 1) <= 17.2 * 72 / 2.54, row  # else it is made smaller
