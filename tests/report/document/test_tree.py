"""A document as plain data: keys, numbers of tables and figures, links, the order of what is made for the pages."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest

from mfc_analysis.report.document import document as s
from mfc_analysis.report.document.tree import cited_once, clean, complex_written, every_block, slug, tree
from mfc_analysis.requirements.line import Line, Status
from tests.report import samples

MINUS = "\N{MINUS SIGN}"


def ids(sections: list[dict]) -> list[str]:
    return [x for one in sections for x in (one["id"], *ids(one["sections"]))]


def figure(name: str) -> s.Figure:
    return s.Figure(partial(int), name, f"{name} 1")


def test_front_and_back_stand_around_the_documents_own_sections() -> None:
    made = samples.document()
    found = [x["id"] for x in tree(replace(made, appendices=(s.Section("More"),))).root["sections"]]
    own = [slug(f"{x.loop} {x.title}" if x.loop else x.title) for x in made.sections]
    assert found == ["worst-case", "scope", *own, "provenance", "more", "symbols"]  # of one loop there is no matrix
    many = replace(samples.chapter(), front=(s.Section("Given"),))
    assert [x["id"] for x in tree(many).root["sections"]][:3] == ["worst-case", "given", "matrix"]
    assert tree(many).root["sections"][-1]["id"] == "sources"
    assert "matrix" not in ids(tree(replace(samples.chapter(), matrix=False)).root["sections"])


def test_sections_of_one_title_have_keys_of_their_own_and_levels_go_down() -> None:
    inner = s.Section("Poles")
    root = tree(s.Document("t", "u", (s.Section("Poles", sections=(inner,)), s.Section("Poles"), s.Section("Top")))).root
    assert ids(root["sections"]) == ["poles", "poles-2", "poles-3", "top-2"]  # "top" is the page's own
    assert [root["sections"][0]["level"], root["sections"][0]["sections"][0]["level"]] == [1, 2]


def test_tables_and_figures_are_counted_through_rows_and_comparisons_in_the_order_of_the_page() -> None:
    table = s.Table("c", (s.Column("a"),), ((1,),))
    sides = s.Compare(s.Side("l", s.Badge.DEMO, (figure("f2"), table)), s.Side("r", None, (figure("f3"),)), "cost")
    made = tree(
        s.Document("t", "u", (s.Section("one", body=(table, s.Row((figure("f0"), figure("f1"))), sides)), s.Section("two", body=(figure("f4"),))))
    )
    blocks = list(every_block(made.root["sections"]))
    figures = [b for b in blocks if b["k"] == "figure"]
    assert [(b["number"], b["id"], b["alt"]) for b in figures] == [(i + 1, f"f{i + 1}", f"f{i} 1") for i in range(5)]
    assert [b["number"] for b in blocks if b["k"] == "table"] == [1, 2]
    assert {key: x.caption for key, x in made.figures.items()} == {f"f{i + 1}": f"f{i}" for i in range(5)}


def test_one_equation_in_two_places_is_compiled_once_and_a_display_apart_from_a_line() -> None:
    text = (s.Math("K_p"), " and ", s.Math("K_p"))
    made = tree(s.Document("t", "u", (s.Section("one", text, (s.Equation("K_p", "gain"), s.Equation("K_i", "gain"))),)))
    assert sorted(made.equations.values()) == [("K_i", True), ("K_p", False), ("K_p", True)]
    a, _, b = made.root["sections"][0]["finding"]
    assert a["id"] == b["id"] and made.equations[a["id"]] == ("K_p", False)


def test_a_link_leads_only_to_a_section_that_is_there_and_the_verdict_to_the_worst_check() -> None:
    bad = Line("x", 1.0, 0.0, "", -1.0, Status.FAIL)
    spans = (s.Link("there", "b-two"), s.Link("nowhere", "c"))
    root = tree(s.Document("t", "u", (s.Section("a one", spans), s.Section("b two", checks=(bad,))))).root
    own = {x["id"]: x for x in root["sections"]}
    assert [x["to"] for x in own["a-one"]["finding"]] == ["b-two", ""]
    assert root["verdict"]["to"] == "b-two" and own["worst-case"]["blocks"][0]["facts"][0]["value"] == "x"
    assert own["b-two"]["blocks"][0]["k"] == "table"  # what was asked stands first


def test_loops_that_share_a_page_have_one_table_and_their_links_lead_there() -> None:
    def loop(name: str, found: float, shown: str = "") -> s.Section:
        status = Status.PASS if found >= 1 else Status.FAIL
        checks = (Line("y", 2.0, 3.0, "", 1.0, Status.PASS, "elbow", 0.5), Line("x", 1.0, found, "", found - 1, status))
        return s.Section(name, checks=checks, loop=f"law, {name}", shown=shown, body=(s.Paragraph("not here"),))

    shared = s.Section("law", "all of them", sections=(loop("a", 5.0), loop("b", 0.5), loop("c", 0.0, "open")), folded=True)
    root = tree(s.Document("t", "u", (shared,))).root
    own = {x["id"]: x for x in root["sections"]}
    assert own["law"]["sections"] == [] and [b["k"] for b in own["law"]["blocks"]] == ["table"]
    (table,) = own["law"]["blocks"]
    assert [[c["spans"][0]["t"] if c["spans"] else "" for c in row] for row in table["rows"]] == [
        ["a", "PASS", "3.00 elbow, t = 0.5 s", "5.00"], ["b", "FAIL", "3.00 elbow, t = 0.5 s", "0.500"], ["c", "DEMO", "", ""],
    ]  # fmt: skip
    assert [row["to"] for row in own["matrix"]["blocks"][0]["rows"]] == ["law"] * 3 and root["verdict"]["to"] == "law"


def test_each_work_is_cited_once_with_all_its_chapters() -> None:
    given = ("A, B, ch. 11", "chapter, eq. 9.1", "A, B, ch. 11.5", "chapter, eq. 9.2", "A, B, ch. 11", "C (2020)")
    assert cited_once(given) == ("A, B, ch. 11, 11.5", "chapter, eq. 9.1, 9.2", "C (2020)")


@pytest.mark.parametrize(("z", "said"), [
    (-3 + 4j, f"{MINUS}3.00 ± 4.00j"), (-3 - 4j, f"{MINUS}3.00 ∓ 4.00j"), (-3 + 1e-12j, f"{MINUS}3.00"), (2j, "0 ± 2.00j"), (0j, "0"),
])  # fmt: skip
def test_a_pole_is_written_as_a_pair_where_it_has_an_imaginary_part(z: complex, said: str) -> None:
    assert complex_written(z) == said
    table = s.Table("c", (s.Column("p"),), ((z,),))
    (block,) = tree(s.Document("t", "u", (s.Section("a", body=(table,)),))).root["sections"][0]["blocks"]
    assert block["rows"][0][0]["spans"] == [{"k": "text", "t": said}]


def test_keys_are_plain_words_and_texts_lose_what_no_page_can_hold() -> None:
    assert [slug(x) for x in ("9.8 Unabhängig: PID", "☃", "../../etc", "a" * 80)] == ["9-8-unabhangig-pid", "section", "etc", "a" * 60]
    assert clean("a\x00b\nc\x7f\ud800") == "a b c \N{REPLACEMENT CHARACTER}"
    assert clean("a\nb\tc", newlines=True) == "a\nb c"


def test_long_names_are_short_on_the_pages_and_stay_in_code_and_in_longer_words() -> None:
    line = Line("phase_deg", 45.0, 50.0, "°", 5.0, Status.PASS, "panda_joint1", 0.5, label="phase margin")
    body = (
        s.Paragraph(("at panda_joint1, ", s.Strong("panda_joint2"), s.Mono("panda_joint1"), " and q_panda_joint1")),
        s.Code("panda_joint1"),
        s.Table("of panda_joint2", (s.Column("Where"),), (("panda_joint1 and panda_joint10",),)),
        s.KeyFacts((s.Fact("Where", "panda_joint2", "panda_joint1"),)),
    )
    short = {f"panda_joint{i}": f"joint{i}" for i in (1, 2)}
    made = tree(s.Document("t", "u", (s.Section("one", "panda_joint1", body, (line,), loop="one"),), names=short))
    page = next(x for x in made.root["sections"] if x["title"] == "one")
    asked, words, code, table, facts = page["blocks"]
    assert made.root["verdict"]["detail"].endswith("(joint1, t = 0.5 s).") and page["finding"][0]["t"] == "joint1"
    assert asked["rows"][0][-1]["spans"][0]["t"] == "joint1, t = 0.5 s"
    assert [x["t"] for x in words["spans"]] == ["at joint1, ", "joint2", "panda_joint1", " and q_panda_joint1"]
    assert code["text"] == "panda_joint1"
    assert table["caption"][0]["t"] == "of joint2" and table["rows"][0][0]["spans"][0]["t"] == "joint1 and panda_joint10"
    assert facts["facts"][0]["value"] == "joint2" and facts["facts"][0]["note"][0]["t"] == "joint1"
