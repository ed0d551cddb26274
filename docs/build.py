"""Run every code block of README.md and docs/*.md, then build the site in build/site with warnings as errors.

    python docs/build.py                 everything
    python docs/build.py docs/start.md   only the blocks of these pages

Types of blocks:

- ``python``: executed. The blocks of a page share one namespace, and each page has its own process and working folder. Warnings of the
  package are errors. With a first line ``# file: NAME`` the block is written to the working folder and not executed.
- ``toml``: written to the working folder if its first line is ``# file: NAME``.
- ``console``: commands after ``$``. ``mfc-analysis`` and ``pytest`` are run. A comment ``exit code N`` gives the expected exit code (default 0).
  ``picture: NAME`` in a comment of a block saves the current figure of pyplot in ``build/pictures``, where the page finds it as ``pictures/NAME``.
- ``text`` directly after a python block, or the lines after a command: the expected output. Words must be equal, and numbers must agree to
  one unit of the last digit shown or to 1e-6; a line ``...`` matches any lines.

Every working folder has ``arm.urdf`` (a UR5) and ``study.toml`` (written by ``mfc-analysis init`` for it). mkdocs also loads this file as a
hook, which replaces ``<!-- include: FILE -->`` by the text of the file.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import linecache
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import entry_points
from importlib.util import find_spec
from itertools import zip_longest
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SITE = ROOT / "build" / "site"
PICTURES = ROOT / "build" / "pictures"
LONGEST = 300  #: [s] time limit for the blocks of a page
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
NOT_RUN = ("python3", "pip", "git", "mfc-analysis report")  #: installation is not part of a page, and the chapter's report has its own tests


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    kind: str  #: python, console, text, toml...
    line: int  #: of its first line, from 1
    text: str
    shown: str | None = None  #: the output shown on the page

    @property
    def file(self) -> str | None:
        """The name of the file to write, if the first line gives one."""
        found = re.match(r"#\s*file:\s*(\S+)", self.text)
        return found[1] if found else None


class Wrong(Exception):
    """A block whose behaviour differs from its page."""


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, ``text`` joined to the python block before it."""
    out: list[Block] = []
    lines = page.read_text(encoding="utf-8").splitlines()
    i, adjacent = 0, False
    while i < len(lines):
        fence = re.match(r"```(\w*)\s*$", lines[i])
        if not fence:
            adjacent = adjacent and not lines[i].strip()
            i += 1
            continue
        end = next((k for k in range(i + 1, len(lines)) if lines[k].rstrip() == "```"), None)
        if end is None:
            raise Wrong(f"{page.name}:{i + 1}: a fence that never closes")
        block = Block(fence[1], i + 2, "\n".join(lines[i + 1 : end]) + "\n")
        if block.kind == "text" and adjacent and out[-1].kind == "python":
            last = out[-1]
            out[-1] = Block(last.kind, last.line, last.text, block.text)
        else:
            out.append(block)
        i, adjacent = end + 1, True
    return out


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


# --- running a page (in its own process) ----------------------------------------------------------------------------


def run_page(page: Path) -> int:
    """Runs the blocks of a page in the current folder; returns their number. Raises Wrong."""
    warnings.filterwarnings("error", module=r"mfc_analysis\b")
    module = ModuleType(page.stem)
    sys.modules[page.stem] = module  # dataclasses look up their module here
    names = vars(module)
    count = 0
    for block in blocks(page):
        if block.file is not None:
            Path(block.file).write_text(block.text, encoding="utf-8")
        elif block.kind == "python":
            _run_python(page, block, names)
        elif block.kind == "console":
            _run_console(page, block)
        else:
            continue
        count += 1
    return count


def _run_python(page: Path, block: Block, names: dict[str, Any]) -> None:
    from mfc_analysis.errors import MfcWarning

    name = f"{page.name}"
    text = "\n" * (block.line - 1) + block.text
    linecache.cache[name] = (len(text), None, page.read_text(encoding="utf-8").splitlines(True), name)
    printed = io.StringIO()
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(printed):
            warnings.simplefilter("error", MfcWarning)
            exec(compile(text, name, "exec", dont_inherit=True), names)
    except BaseException as why:  # any exception means that the page is wrong
        raise Wrong(f"{name}:{block.line}: {''.join(traceback.format_exception(why)[-4:])}") from why
    for picture in re.findall(r"#.*\bpicture: (\S+)", block.text):
        _save_picture(picture)
    if block.shown is not None and not agree(block.shown, printed.getvalue()):
        raise Wrong(f"{name}:{block.line}: the page shows\n{block.shown}but the block prints\n{printed.getvalue()}")


def _save_picture(name: str) -> None:
    from matplotlib import pyplot

    PICTURES.mkdir(parents=True, exist_ok=True)
    pyplot.savefig(PICTURES / name, dpi=150, bbox_inches="tight")
    pyplot.close("all")


def _run_console(page: Path, block: Block) -> None:
    commands: list[tuple[int, str, list[str]]] = []
    for k, line in enumerate(block.text.splitlines()):
        if line.startswith("$ "):
            commands.append((block.line + k, line[2:], []))
        elif commands:
            commands[-1][2].append(line)
    for line, command, shown in commands:
        words = shlex.split(command, comments=True)
        if command.startswith(NOT_RUN) and " study.toml" not in command:
            continue
        if words[0] not in ("mfc-analysis", "pytest"):
            raise Wrong(f"{page.name}:{line}: {command}: neither run nor known as one that isn't")
        if words[0] == "pytest" and find_spec("pytest") is None:
            print(f"{page.name}:{line}: not run: pytest is not installed")
            continue
        code = re.search(r"#.*?exit code (\d)", command)
        done = subprocess.run([*_program(words[0]), *words[1:]], stdin=subprocess.DEVNULL, capture_output=True, text=True, encoding="utf-8")
        said = done.stdout + done.stderr
        if done.returncode != int(code[1] if code else 0):
            raise Wrong(f"{page.name}:{line}: {command}: exit code {done.returncode}\n{said}")
        if shown and not agree("\n".join(shown), said):
            raise Wrong(f"{page.name}:{line}: {command}: the page shows\n" + "\n".join(shown) + f"\nbut it prints\n{said}")


def _program(name: str) -> list[str]:
    """How to start a command with this interpreter, whatever is on the path."""
    if name == "mfc-analysis":
        return [sys.executable, "-m", "mfc_analysis"]
    registered = any(e.value == "mfc_analysis.pytest_plugin" for e in entry_points(group="pytest11"))
    return [sys.executable, "-m", "pytest", *(() if registered else ("-p", "mfc_analysis.pytest_plugin"))]


def checked(page: Path) -> str | None:
    """Runs a page in its own process and folder; returns an error message, or None if the page is correct."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("arm.urdf", "study.toml"):
            (Path(folder) / name).write_bytes((_prepared() / name).read_bytes())
        try:
            done = subprocess.run(
                [sys.executable, str(Path(__file__).resolve()), "--here", str(page.resolve())],
                cwd=folder, env=_environment(), capture_output=True, text=True, encoding="utf-8", timeout=LONGEST,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"{page.name}: its blocks take more than {LONGEST} s"
    return None if done.returncode == 0 else f"{done.stdout}{done.stderr}"


def _timed(page: Path) -> tuple[str | None, float]:
    start = time.perf_counter()
    return checked(page), time.perf_counter() - start


_made: list[tempfile.TemporaryDirectory[str]] = []


def _prepared() -> Path:
    """The folder with the initial files of every working folder."""
    if not _made:
        from mfc_analysis.robots.catalogue import ur5_urdf
        from mfc_analysis.study.init import write

        _made.append(tempfile.TemporaryDirectory())
        folder = Path(_made[0].name)
        (folder / "arm.urdf").write_text(ur5_urdf(), encoding="utf-8")
        write(str(folder / "arm.urdf"), folder / "study.toml")
    return Path(_made[0].name)


def _environment() -> dict[str, str]:
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    set_ = {"PYTHONPATH": paths, "PYTHONUTF8": "1", "MPLBACKEND": "Agg", "COLUMNS": "120", "NO_COLOR": "1", "TERM": "dumb"}
    return {**os.environ, **set_, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


# --- the site --------------------------------------------------------------------------------------------------------------


def on_page_markdown(markdown: str, **_: Any) -> str:
    """mkdocs hook: replaces ``<!-- include: FILE -->`` by the text of the file, or by a note if the file does not exist."""

    def included(found: re.Match[str]) -> str:
        path = ROOT / found[1]
        return path.read_text(encoding="utf-8") if path.exists() else f"*{found[1]} has not been written yet.*"

    return re.sub(r"<!-- include: (\S+) -->", included, markdown)


def on_files(files: Any, config: Any) -> Any:
    """mkdocs hook: adds the pictures that the pages have drawn."""
    from mkdocs.structure.files import File

    for path in sorted(PICTURES.glob("*")):
        files.append(File.generated(config, f"pictures/{path.name}", abs_src_path=str(path)))
    return files


def build_site() -> int:
    """Runs mkdocs with warnings as errors; prints its output on failure and returns its exit code."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "-f", str(ROOT / "mkdocs.yml"), "-d", str(SITE)]
    done = subprocess.run(command, cwd=ROOT, env=_environment(), capture_output=True, text=True, encoding="utf-8")
    if done.returncode:
        print(done.stdout + done.stderr)
    return done.returncode


def main() -> int:
    """Checks the pages, then builds the site; returns the exit code."""
    takes = argparse.ArgumentParser(description="Runs the code blocks of the documentation and builds the site.")
    takes.add_argument("pages", nargs="*", type=Path, help="pages to check (default: README.md, docs/*.md and the site)")
    takes.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    asked = takes.parse_args()
    if asked.here:
        try:
            run_page(asked.pages[0])
        except Wrong as why:
            print(why)
            return 1
        return 0
    wrong = 0
    pages = asked.pages or [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    _prepared()
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        for page, (said, took) in zip(pages, pool.map(_timed, pages), strict=True):
            verdict = "ok   " if said is None else "WRONG"
            print(f"{verdict} {page.name:<18} {len(blocks(page)):3d} blocks  {took:5.1f} s", flush=True)
            if said is not None:
                wrong += 1
                print(said, flush=True)
    if asked.pages:
        return 1 if wrong else 0
    site = build_site()
    print("site: build/site" if site == 0 else f"site: mkdocs ended with {site}")
    return 1 if wrong or site else 0


if __name__ == "__main__":
    raise SystemExit(main())
