"""pytest plugin: ``pytest --mfc-report=DIR`` collects every loop that the tests assert on into one verification report.

It holds only hooks: assertions are in ``testing``, the report in ``verification``; both load only with the option. Under xdist
each worker passes its records on when it ends, and the controller writes the report.
"""

from __future__ import annotations

import pickle
from collections.abc import Generator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mfc_analysis.errors import MissingExtra, require

if TYPE_CHECKING:
    from mfc_analysis.report.verification import Record
    from mfc_analysis.testing import Asserted

KEY = "mfc_records"  #: key in xdist's ``workeroutput``
FORMATS = "html,pdf,json"
MARK = "mfc_requirement"  #: marker of a test: the id of its requirement, and why it is required
ORIGIN = ("author", "revision", "date")  #: options that say who made a report, of what and when
MOST_RELIEFS = 20  #: failures for which is searched what would make them pass


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options ``--mfc-report`` and ``--mfc-report-formats``."""
    group = parser.getgroup("mfc-analysis")
    group.addoption("--mfc-report", metavar="DIR", default=None, help="write a verification report of every loop asserted in this run into DIR")
    group.addoption("--mfc-report-formats", metavar="LIST", default=FORMATS, help=f"some of {FORMATS} (default: all)")
    for name in ORIGIN:
        group.addoption(f"--mfc-report-{name}", metavar="TEXT", default="", help=f"{name} that the verification report names")


def pytest_configure(config: pytest.Config) -> None:
    """Registers the marker, and the collector if a report is requested. A wrong folder or format stops pytest before the tests."""
    config.addinivalue_line("markers", f"{MARK}(id, rationale=''): the requirement that a test verifies, for the verification report")
    folder = config.getoption("--mfc-report")
    if folder is None:
        return
    formats = tuple(str(config.getoption("--mfc-report-formats")).replace(" ", "").split(","))
    if not folder or Path(folder).is_file():
        raise pytest.UsageError(f"--mfc-report={folder!r}: takes an output folder")
    unknown = [f for f in formats if f not in FORMATS.split(",")]
    if unknown:
        raise pytest.UsageError(f"--mfc-report-formats: got {unknown[0]!r}; takes some of {FORMATS}")
    try:
        require("report")
    except MissingExtra as why:
        raise pytest.UsageError(f"--mfc-report: {why}") from why
    config.pluginmanager.register(Collector(config, Path(folder), formats), "mfc-analysis-collector")


class Collector:
    """State of the plugin during a run."""

    def __init__(self, config: pytest.Config, folder: Path, formats: tuple[str, ...]) -> None:
        self.config, self.formats = config, formats
        self.folder = config.invocation_params.dir / folder
        self.worker = hasattr(config, "workerinput")
        self.records: list[Record] = []
        self.outcomes: dict[str, str] = {}
        self.lost: list[str] = []
        self.written: dict[str, Path] = {}
        self.test = ""
        self.marked = ("", "")  #: id and rationale of the requirement of the running test
        self.failed: dict[tuple[str, int], Asserted] = {}
        self.stack = ExitStack()

    # --- while tests run -----------------------------------------------------------------------------------------

    def pytest_sessionstart(self) -> None:
        """Starts to collect assertions."""
        from mfc_analysis.testing import observed

        self.stack.enter_context(observed(self.add))

    def add(self, asserted: Asserted) -> None:
        """Records one assertion."""
        from mfc_analysis.report.verification import record

        number = sum(r.test == self.test for r in self.records)
        made = record(asserted, self.test, number)
        self.records.append(replace(made, requirement=self.marked[0], rationale=self.marked[1]))
        if not asserted.passed:
            self.failed[self.test, number] = asserted

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Keeps the name of the running test; a repeated test replaces its earlier records."""
        self.test = item.nodeid
        mark = item.get_closest_marker(MARK)
        self.marked = ("", "") if mark is None else (str(next(iter(mark.args), "")), str(mark.kwargs.get("rationale", "")))
        self.records = [r for r in self.records if r.test != self.test]
        self.failed = {key: x for key, x in self.failed.items() if key[0] != self.test}
        try:
            return (yield)
        finally:
            self.test, self.marked = "", ("", "")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Records the outcome of each test; a failure of any phase counts. On xdist's controller outcomes come from the workers."""
        if report.when == "call" or report.outcome != "passed":
            expected = report.outcome == "skipped" and hasattr(report, "wasxfail")
            self.outcomes[report.nodeid] = "passed" if expected else report.outcome

    # --- at the end ----------------------------------------------------------------------------------------------

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any, error: object) -> None:
        """xdist: takes over the records of a worker; those of a crashed worker are lost."""
        content = getattr(node, "workeroutput", {}).get(KEY)
        if content is None:
            self.lost.append(f"worker {node.gateway.id}")
        else:
            self.records += pickle.loads(content)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self) -> None:
        """A worker passes its records on; any other process writes the report."""
        self.stack.close()
        self.relieve()
        if self.worker:
            self.config.workeroutput[KEY] = pickle.dumps(self.records)  # type: ignore[attr-defined]  # an attribute of xdist
        elif self.records or self.lost:
            from mfc_analysis.report import render
            from mfc_analysis.report.verification import Origin, verification_document, with_outcomes

            origin = Origin(*(str(self.config.getoption(f"--mfc-report-{name}")) for name in ORIGIN))
            document = verification_document(with_outcomes(self.records, self.outcomes), self.lost, "pytest --mfc-report=DIR", origin)
            self.written = render(document, self.folder, self.formats)

    def relieve(self) -> None:
        """Searches what would make the failures pass that no test expected, in the process that has their loops."""
        if not self.failed:
            return
        from mfc_analysis.report.verification import relief

        wanted = [key for key in self.failed if self.outcomes.get(key[0]) == "failed"][:MOST_RELIEFS]
        found = {key: relief(self.failed[key]) for key in wanted}
        self.records = [replace(r, relief=found[r.test, r.number]) if (r.test, r.number) in found else r for r in self.records]

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Lists the files written."""
        if self.worker:
            return
        terminalreporter.section("mfc-analysis")
        for name in self.lost:
            terminalreporter.write_line(f"{name} ended without passing on its assertions: the report is not complete")
        if not self.written:
            terminalreporter.write_line("no assertion of mfc_analysis.testing was made: no report was written")
            return
        failed = sum(not r.passed for r in self.records)
        terminalreporter.write_line(f"verification report of {len(self.records)} assertions, {failed} failed:")
        for path in self.written.values():
            terminalreporter.write_line(f"  {path}")
