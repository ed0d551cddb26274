"""The garbage collector runs rarely within, and as the user has set it before and after."""

from __future__ import annotations

import gc

import pytest

from mfc_analysis.maths.garbage import NEW, rare_collections


@pytest.fixture(autouse=True)
def _as_it_was():
    before = gc.get_threshold()
    yield
    gc.set_threshold(*before)


@pytest.mark.parametrize(("given", "within"), [(700, NEW), (0, 0), (2 * NEW, 2 * NEW)])
def test_collections_are_rare_within_and_as_the_user_has_them_outside(given: int, within: int) -> None:
    gc.set_threshold(given, 11, 12)
    with rare_collections():
        assert gc.get_threshold() == (within, 11, 12)
    assert gc.get_threshold() == (given, 11, 12)


def test_an_error_within_leaves_the_users_setting() -> None:
    gc.set_threshold(700, 10, 10)
    with pytest.raises(ZeroDivisionError), rare_collections():
        raise ZeroDivisionError
    assert gc.get_threshold() == (700, 10, 10)


def test_reports_of_two_threads_leave_the_users_setting_whichever_ends_first() -> None:
    gc.set_threshold(700, 10, 10)
    one, two = rare_collections(), rare_collections()
    one.__enter__()
    two.__enter__()
    one.__exit__(None, None, None)
    two.__exit__(None, None, None)
    assert gc.get_threshold() == (700, 10, 10)


def test_a_report_is_rendered_with_few_collections(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    from mfc_analysis.report.document.document import Document, Section
    from mfc_analysis.report.render import write

    seen = []
    monkeypatch.setattr(write, "rendered", lambda *given, **options: seen.append(gc.get_threshold()[0]) or {})
    gc.set_threshold(700, 10, 10)
    write.render(Document("A title", "", (Section("One"),), "name"), tmp_path)
    assert seen == [NEW]
    assert gc.get_threshold() == (700, 10, 10)
