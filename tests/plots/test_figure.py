"""What holds for every kind of figure: no text leaves its sheet, same bytes twice, colours."""

from __future__ import annotations

import subprocess
import sys

import matplotlib.figure
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from mfc_analysis import plots
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.plots import figure as sheet
from tests.plots import kinds
from tests.plots.overlaps import texts_on_curves, texts_on_texts

KINDS = kinds.every_kind()


def texts(figure, monkeypatch):
    """Every text that is really drawn with its box and the sheet's, in pixels."""
    seen, plain = [], Text.draw

    def draw(self, renderer):
        seen.append(self)
        plain(self, renderer)

    monkeypatch.setattr(Text, "draw", draw)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    for text in seen:
        if text.get_visible() and text.get_text().strip():
            yield text.get_text(), Text.get_window_extent(text, canvas.get_renderer()), figure.bbox


@pytest.mark.parametrize("kind", KINDS)
def test_no_text_leaves_the_sheet(kind, monkeypatch):
    with matplotlib.rc_context(sheet.settings()):
        figure = sheet.figure_of(KINDS[kind]())
        outside = [
            f"{said!r} at {box.x0:.0f}..{box.x1:.0f}, {box.y0:.0f}..{box.y1:.0f} of {whole.width:.0f} x {whole.height:.0f}"
            for said, box, whole in texts(figure, monkeypatch)
            if box.x0 < -0.5 or box.y0 < -0.5 or box.x1 > whole.width + 0.5 or box.y1 > whole.height + 0.5
        ]
    assert not outside


@pytest.mark.parametrize("kind", KINDS)
def test_no_text_lies_on_another_or_on_a_curve(kind, monkeypatch):
    with matplotlib.rc_context(sheet.settings()):
        figure = sheet.figure_of(KINDS[kind]())
        assert not texts_on_texts(figure, monkeypatch)
        assert not texts_on_curves(figure, monkeypatch)


def test_the_test_of_overlaps_sees_a_label_on_a_label_and_on_a_curve(monkeypatch):
    ax = sheet.axes_for("map")
    ax.plot(np.linspace(0, 1, 50), np.linspace(0, 1, 50))
    sheet.note(ax, "on the curve", (0.5, 0.5), ha="center")
    sheet.note(ax, "on the label", (0.55, 0.52), ha="center", plate=True)
    assert texts_on_curves(ax.figure, monkeypatch) == ["'on the curve' on a curve"]
    assert texts_on_texts(ax.figure, monkeypatch) == ["'on the curve' on 'on the label'"]


def test_a_free_note_goes_where_no_curve_is_and_takes_a_plate_where_there_is_no_such_place(monkeypatch):
    ax = sheet.axes_for("map")
    ax.set(xlim=(0, 1), ylim=(0, 1))
    ax.plot(np.linspace(0, 1, 50), np.linspace(0.2, 0.95, 50))
    sheet.free_note(ax, "PM 45°", (0.5, 0.575))
    assert not texts_on_curves(ax.figure, monkeypatch) and ax.texts[0].get_bbox_patch() is None
    for k in range(60):
        ax.plot([0, 0.5, 1], [k / 60] * 3)
    sheet.free_note(ax, "GM 6 dB", (0.5, 0.5))
    assert ax.texts[1].get_bbox_patch() is not None


@pytest.mark.parametrize("kind", KINDS)
def test_a_figure_is_the_same_bytes_twice(kind):
    assert sheet.svg(KINDS[kind]) == sheet.svg(KINDS[kind])


def test_a_users_settings_change_nothing():
    before = sheet.svg(KINDS["bode"])
    with matplotlib.rc_context({"font.size": 30, "axes.grid": False, "svg.fonttype": "path", "lines.linewidth": 9, "font.family": "serif"}):
        assert sheet.svg(KINDS["bode"]) == before


def test_figures_carry_no_date_and_keep_their_text_as_text():
    text = sheet.svg(KINDS["bode"])
    assert "<dc:date>" not in text
    assert ">ω [rad/s]<" in text.replace("\n", "")


def test_a_title_has_a_fixed_place():
    def recipe():
        ax = sheet.axes_for("map")
        sheet.label(ax, title="above")
        ax.xaxis.tick_top()
        made.append(ax)
        return ax

    made = []
    sheet.svg(recipe)
    assert [text.get_position() for text in made[0].findobj(Text) if text.get_text() == "above"] == [(0.0, 1.0)]


def test_a_joint_keeps_its_colour_in_every_kind_of_figure():
    found = kinds.history()
    lines = [ax.get_lines()[2].get_color() for ax in (plots.margins(found), plots.margin_history(found)[0])]
    run = plots.traces(np.arange(3.0), (plots.Panel("q [rad]", np.zeros((3, 6))),))[0]
    w = np.geomspace(0.1, 100, 50)
    bode = plots.bode(w, 1 / (1j * w), index=2)[0]
    assert {*lines, run.get_lines()[2].get_color(), bode.get_lines()[0].get_color()} == {sheet.colour(2)}


def test_an_unknown_kind_of_sheet_lists_those_there_are():
    with pytest.raises(UnknownName) as caught:
        sheet.panels_for("bodes")
    assert "bode" in caught.value.known


def test_drawing_imports_neither_control_nor_pinocchio():
    code = """import sys, mfc_analysis.plots as p; p.svg(p.axes_for('map'))
print([m for m in ('control', 'pinocchio', 'scipy', 'matplotlib.pyplot') if m in sys.modules])"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_importing_plots_does_not_load_matplotlib():
    run = subprocess.run(
        [sys.executable, "-c", "import sys, mfc_analysis.plots; print('matplotlib' in sys.modules)"], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "False"


def test_the_test_of_texts_sees_a_label_that_leaves_the_sheet(monkeypatch):
    ax = sheet.axes_for("pole map")
    ax.set_ylabel("a label much too long for the height of such a small sheet of paper, and longer")
    assert any(box.y0 < 0 for _, box, _ in texts(ax.figure, monkeypatch))


@pytest.mark.parametrize("count", [1, 6, 8])
def test_a_legend_is_shortened_until_it_fits(count):
    names = [f"a_rather_long_name_of_{i}_joint" for i in range(count)]
    assert sum(map(len, sheet.fitting(names, 6.2))) * 0.065 + 0.32 * count <= 6.2
    assert sheet.fitting(("q1", "q2"), 6.2) == ["q1", "q2"]


def test_what_is_common_to_all_names_goes_first():
    assert sheet.fitting([f"panda_joint{k}" for k in range(1, 8)], 5.7) == [f"joint{k}" for k in range(1, 8)]


@pytest.mark.parametrize(("names", "found"), [
    (("panda_joint1", "panda_joint2"), ["joint1", "joint2"]), (("left_joint_1", "left_joint_2"), ["joint_1", "joint_2"]),
    (("arm_shoulder_pan", "arm_shoulder_lift"), ["pan", "lift"]), (("q_elbow", "q_wrist"), ["q_elbow", "q_wrist"]),
    (("X_e_vx", "X_e_vy"), ["X_e_vx", "X_e_vy"]), (("elbow_1", "elbow_2"), ["elbow_1", "elbow_2"]), (("arm_elbow",), ["arm_elbow"]),
    (("arm_", "arm_x"), ["arm_", "arm_x"]), (("shoulder", "elbow"), ["shoulder", "elbow"]), ((), []),
])  # fmt: skip
def test_what_all_joints_begin_with_is_left_out_of_a_picture(names, found):
    assert sheet.without_prefix(names) == found


def test_a_shortened_legend_tells_its_joints_apart():
    names = [f"L{part}{axis}" for part in ("Shoulder", "Elbow", "Wrist") for axis in ("Roll", "Pitch", "Yaw")]
    found = sheet.fitting(names, 6.2)
    assert len(set(found)) == 9 and all(len(x) < len(name) for x, name in zip(found, names, strict=True))
    assert sheet.fitting(("an_arm_link", "the_other_arm_link"), 1.6) == ["an_arm…", "the_ot…"]


@pytest.mark.parametrize(("value", "said"), [(0.0, "0"), (-1e5, "−1e5"), (1e-6, "1e-6"), (0.25, "0.25"), (12000.0, "12000")])
def test_tick_labels_have_no_offset(value, said):
    assert sheet.tick(value).replace("−", "-") == said.replace("−", "-")


@pytest.mark.parametrize(("value", "said"), [(0.0, "0"), (-250.0, "−250"), (1e4, "10⁴"), (-1e5, "−10⁵"), (1e-6, "10⁻⁶"), (1e13, "10¹³")])
def test_labels_of_a_logarithmic_axis_are_text_of_the_font(value, said):
    from matplotlib.font_manager import fontManager
    from matplotlib.ft2font import FT2Font

    assert sheet.decade(value) == said
    font = FT2Font(fontManager.findfont("DejaVu Sans"))
    assert all(font.get_char_index(ord(c)) for c in said)


def test_labels_of_logarithmic_axes_are_no_formulas():
    ax = sheet.axes_for("map")
    ax.plot([1e-4, 1e5], [0.02, 300.0])
    sheet.logarithmic(ax, "xy")
    ax.set(xlim=(1e-4, 1e5), ylim=(0.02, 300.0))
    svg = sheet.svg(ax)
    assert all(f">{label}</text>" in svg for label in ("10⁻⁴", "0.01", "1", "100", "10⁴", "0.1", "10"))
    assert "tspan" not in svg
    assert not ax.get_xticks(minor=True).size and not ax.get_yticks(minor=True).size


@pytest.mark.parametrize(
    ("low", "high", "said"), [(1.0, 1e3, ["1", "10", "100", "1000"]), (3.0, 60.0, ["5", "10", "20", "50"]), (3e4, 8e4, ["5×10⁴"])]
)
def test_a_logarithmic_axis_with_one_decade_has_labels_between_the_decades(low, high, said):
    ax = sheet.axes_for("map")
    sheet.logarithmic(ax, "x")
    ax.set_xlim(low, high)
    ax.figure.canvas.draw()
    found = [text.get_text() for tick, text in zip(ax.get_xticks(), ax.get_xticklabels(), strict=True) if low <= tick <= high]
    assert set(said) <= set(found) and len(found) >= 2


@pytest.mark.parametrize("ax", [3, "ax", plots, [], np.empty(1, object)], ids=["number", "string", "module", "empty", "nothing"])
@pytest.mark.parametrize("kind", ["map", "three histories"])
def test_what_is_not_axes_is_refused_by_name(kind, ax):
    with pytest.raises(BadArgument, match=r"^ax: got .*axes of matplotlib"):
        sheet.shown(kind, ax)
    with pytest.raises(BadArgument, match=r"^ax: got .*axes of matplotlib"):
        plots.two_axes(ax)


def test_axes_come_in_any_sequence_and_in_the_right_number():
    """As ``plt.subplots`` gives them: an array, whose truth value is not defined."""
    three = matplotlib.figure.Figure().subplots(3, 1)
    assert sheet.shown("three histories", three) == tuple(three) == sheet.shown("three histories", list(three))
    assert plots.two_axes(three[:2]) == tuple(three[:2])
    assert sheet.shown("map", three[:1]) == (three[0],)
    for few in (three[0], three[:2]):
        with pytest.raises(BadArgument, match=r"^ax: got .*; takes a sequence of 3 axes of matplotlib"):
            sheet.shown("three histories", few)
    with pytest.raises(BadArgument, match=r"^ax: got shape \(3,\); takes axes of matplotlib"):
        sheet.shown("map", three)
