"""``pytest docs README.md`` runs the code blocks of these pages. Each page is one namespace, in its own working folder.

- ``python``: executed. Warnings of the package are errors. ``# picture: NAME`` in a comment saves the current figure of pyplot as
  ``pictures/NAME`` beside the page. With a first line ``# file: NAME`` the block is written to the working folder and not executed.
- ``toml``: written to the working folder if its first line is ``# file: NAME``.
- ``console``: commands after ``$``. ``mfc-analysis`` and ``pytest`` are run. A comment ``exit code N`` gives the expected exit code (default 0).
- ``text`` directly after a python block, or the lines after a command: the expected output. Words must be equal, and numbers must agree to
  one unit of the last digit shown or to 1e-6; a line ``...`` matches any lines.

Every working folder has ``arm.urdf`` (a UR5), ``study.toml`` (written by ``mfc-analysis init`` for it) and the scripts of ``examples/``.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from importlib.metadata import entry_points
from itertools import zip_longest
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from sybil import Document, Example, Region, Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown.lexers import FencedCodeBlockLexer

ROOT = Path(__file__).resolve().parent.parent
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
ENVIRONMENT = {
    "MPLBACKEND": "Agg",
    "COLUMNS": "120",
    "NO_COLOR": "1",
    "TERM": "dumb",
    "PYTHONUTF8": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
NOT_RUN = ("python3", "pip", "git", "conda", "mfc-analysis report")  #: installation is not part of a page; the chapter's report has its own tests


# --- comparison of the printed and the shown output ------------------------------------------------------------------------------


def agree(shown: str, printed: str) -> bool:
    """True if the printed and the shown text agree: equal words, and numbers equal to one unit of the last digit shown."""
    want, got = ([line.rstrip() for line in text.strip("\n").splitlines()] for text in (shown, printed))
    return _lines_agree(want, got)


def _lines_agree(want: list[str], got: list[str]) -> bool:
    for k, line in enumerate(want):
        if line.strip() == "...":
            return any(_lines_agree(want[k + 1 :], got[j:]) for j in range(k, len(got) + 1))
        if k >= len(got) or not _line_agrees(line, got[k]):
            return False
    return len(want) == len(got)


def _line_agrees(want: str, got: str) -> bool:
    if NUMBER.split(want) != NUMBER.split(got):
        return " ".join(want.split()) == " ".join(got.split())
    return all(_same(a, b) for a, b in zip_longest(NUMBER.findall(want), NUMBER.findall(got), fillvalue=""))


def _same(want: str, got: str) -> bool:
    mantissa, _, exponent = want.lower().partition("e")
    places = len(mantissa.partition(".")[2])
    unit = 10.0 ** (int(exponent or 0) - places) if "." in mantissa else 0.0
    return abs(float(want) - float(got)) <= max(1.01 * unit, 1e-6 * abs(float(want)))


def _compared(shown: str, printed: str) -> str | None:
    return None if agree(shown, printed) else f"the page shows\n{shown}\nbut it prints\n{printed}"


# --- the blocks of a page ----------------------------------------------------------------------------------------------------------


def blocks(page: Document) -> Iterator[Region]:
    """The blocks of a page that are run or written, ``text`` joined to the python block before it. Gives the page its namespace."""
    module = ModuleType("page_" + Path(page.path).stem.replace(".", "_"))
    sys.modules[module.__name__] = module  # dataclasses look up their module here
    page.namespace = vars(module)
    fences = list(FencedCodeBlockLexer(r"\w+")(page))
    for fence, after in zip_longest(fences, fences[1:]):
        source, language = fence.lexemes["source"], fence.lexemes["language"]
        if not re.search(r"\n`{3,}$", page.text[fence.start : fence.end]):
            raise ValueError(f"{page.path}: {page.line_column(fence.start)}: a fence that never closes")
        if re.match(r"#\s*file:\s*(\S+)", source):
            yield Region(fence.start, fence.end, source, _write)
        elif language == "python":
            adjacent = after and after.lexemes["language"] == "text" and not page.text[fence.end : after.start].strip()
            yield Region(fence.start, fence.end, source, _run_python, {"shown": after.lexemes["source"] if adjacent else None})
        elif language == "console":
            yield Region(fence.start, fence.end, source, _run_console)


def _write(block: Example) -> None:
    Path(block.parsed.split()[2]).write_text(block.parsed, encoding="utf-8")


@contextlib.contextmanager
def _printed(*streams: Any) -> Iterator[io.StringIO]:
    """Collects what is printed; warnings of the package are errors."""
    from mfc_analysis.errors import MfcWarning

    out = io.StringIO()
    with warnings.catch_warnings(), contextlib.ExitStack() as stack:
        warnings.filterwarnings("error", module=r"mfc_analysis\b")
        warnings.simplefilter("error", MfcWarning)
        for stream in streams:
            stack.enter_context(stream(out))
        yield out


def _run_python(block: Example) -> str | None:
    with _printed(contextlib.redirect_stdout) as out:
        PythonEvaluator()(block)
    for picture in re.findall(r"#.*\bpicture: (\S+)", block.parsed):
        _save_picture(Path(block.path).parent / "pictures" / picture)
    shown = block.region.lexemes["shown"]
    return None if shown is None else _compared(shown, out.getvalue())


def _save_picture(path: Path) -> None:
    from matplotlib import pyplot

    path.parent.mkdir(exist_ok=True)
    pyplot.savefig(path, dpi=150, bbox_inches="tight")
    pyplot.close("all")


def _run_console(block: Example) -> str | None:
    for command, shown in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block.parsed, re.MULTILINE):
        if command.startswith(NOT_RUN) and " study.toml" not in command:
            continue
        program, *words = shlex.split(command, comments=True)
        if program not in ("mfc-analysis", "pytest"):
            return f"{command}: neither run nor known as one that isn't"
        code, said = _mfc_analysis(words) if program == "mfc-analysis" else _pytest(words)
        expected = re.search(r"#.*?exit code (\d)", command)
        if code != int(expected[1] if expected else 0):
            return f"{command}: exit code {code}\n{said}"
        if shown and (wrong := _compared(shown, said)):
            return f"{command}: {wrong}"
    return None


def _mfc_analysis(words: list[str]) -> tuple[Any, str]:
    from mfc_analysis.cli.app import app

    with _printed(contextlib.redirect_stdout, contextlib.redirect_stderr) as out, pytest.raises(SystemExit) as ended:
        app(words, prog_name="mfc-analysis")
    return ended.value.code or 0, out.getvalue()


def _pytest(words: list[str]) -> tuple[int, str]:
    registered = any(e.value == "mfc_analysis.pytest_plugin" for e in entry_points(group="pytest11"))
    command = [sys.executable, "-m", "pytest", *(() if registered else ("-p", "mfc_analysis.pytest_plugin")), *words]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, encoding="utf-8")
    return done.returncode, done.stdout + done.stderr


# --- the working folder of a page ------------------------------------------------------------------------------------------------


def enter(names: dict[str, Any]) -> None:
    """Makes the working folder of a page, and goes there."""
    from mfc_analysis.robots.catalogue import ur5_urdf
    from mfc_analysis.study.init import write

    names["__folder__"], names["__back__"] = tempfile.TemporaryDirectory(), os.getcwd()
    os.chdir(names["__folder__"].name)
    Path("arm.urdf").write_text(ur5_urdf(), encoding="utf-8")
    write("arm.urdf", Path("study.toml"))
    for script in (ROOT / "examples").glob("*.py"):
        shutil.copy(script, ".")


def leave(names: dict[str, Any]) -> None:
    """Goes back, and removes the folder."""
    os.chdir(names["__back__"])
    names["__folder__"].cleanup()


def pytest_configure(config: pytest.Config) -> None:
    """Collects Markdown wherever it is: a hook ``pytest_collect_file`` of this file would see ``docs/`` only."""
    os.environ |= {**ENVIRONMENT, "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))}
    pages = Sybil([blocks], path=str(ROOT), pattern="*.md", setup=enter, teardown=leave)
    plugin = ModuleType("pages")
    plugin.pytest_collect_file = pages.pytest()  # type: ignore[attr-defined]
    config.pluginmanager.register(plugin)
