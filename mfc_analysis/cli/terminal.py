"""Output of the command line: plain text, tables, a progress bar on a terminal, and errors as sentences with an exit code."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import TYPE_CHECKING, Any

from mfc_analysis.errors import MfcError, MfcWarning

if TYPE_CHECKING:
    from rich.console import Console

MET, NOT_MET, BAD_INPUT = 0, 1, 2  #: exit codes


def plain(text: object) -> str:
    """Printable text: characters that do not print, such as terminal escape sequences, are escaped. Line ends stay."""
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in str(text))


def console(stderr: bool = False) -> Console:
    """A console without markup; if it is not a terminal, 200 columns wide."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, markup=False, highlight=False, emoji=False, soft_wrap=True, width=None if stream.isatty() else 200)


def say(*lines: object) -> None:
    """Writes lines to standard output."""
    for line in lines:
        sys.stdout.write(plain(line) + "\n")


def complain(line: object) -> None:
    """Writes a line to standard error."""
    sys.stderr.write(plain(line) + "\n")


def table(columns: Sequence[str], rows: Sequence[Sequence[object]], title: str = "") -> None:
    """Writes a table to standard output, without empty columns; PASS, WATCH and FAIL are coloured on a terminal."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    colours = {"PASS": "green", "WATCH": "yellow", "FAIL": "bold red"}
    if title:
        say(title)
    out = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    shown = [i for i in range(len(columns)) if any(str(row[i]) for row in rows)]
    for i in shown:
        out.add_column(Text(columns[i]), overflow="fold")
    for row in rows:
        cells = [plain(row[i]) for i in shown]
        out.add_row(*(Text(cell, style=colours.get(cell, "")) for cell in cells))
    screen = console()
    with screen.capture() as drawn:
        screen.print(out, soft_wrap=False)
    sys.stdout.write("\n".join(line.rstrip() for line in drawn.get().splitlines()) + "\n")


def pairs(rows: Sequence[tuple[str, str]]) -> None:
    """Writes names and their descriptions, one pair per line."""
    wide = max(len(name) for name, _ in rows)
    say(*(f"{name:<{wide}}  {what}" for name, what in rows))


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, int, int], None]]:
    """A callback (what, done, of): a progress bar on standard error if it is a terminal, else nothing."""
    if not sys.stderr.isatty():
        yield lambda what, done, of: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f}"), TimeElapsedColumn())
    with Progress(*columns, console=console(stderr=True), transient=True) as bar:
        task = bar.add_task(plain(title), total=1)

        def advance(what: str, done: int, of: int) -> None:
            bar.update(task, description=plain(what), completed=done, total=max(of, 1))

        yield advance


def guarded(command: Callable[..., None]) -> Callable[..., None]:
    """A command that reports errors as a sentence on standard error with exit code 2, and each warning on one line."""

    @wraps(command)
    def run(*args: Any, **options: Any) -> None:
        from typer import Exit

        said: set[str] = set()

        def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
            if str(message) not in said:
                said.add(str(message))
                complain(f"warning: {message}")

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", MfcWarning)
            warnings.showwarning = show
            try:
                command(*args, **options)
            except MfcError as why:
                complain(f"error: {why}")
                raise Exit(BAD_INPUT) from None
            except BrokenPipeError:  # the reader closed the pipe
                sys.stdout = None  # nothing is left to flush into
                raise Exit(MET) from None
            except OSError as why:
                complain(f"error: {why.filename or 'file'}: {why.strerror or why}")
                raise Exit(BAD_INPUT) from None

    return run
