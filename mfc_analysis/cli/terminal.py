"""Output of the command line: plain text, tables, a progress bar on a terminal, and errors as sentences with an exit code."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from io import BufferedWriter, FileIO, TextIOWrapper
from pathlib import Path
from signal import SIGINT
from traceback import extract_tb
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


class _Output(FileIO):
    """A standard stream whose reader may leave: what is written afterwards is dropped. So is what standard error cannot take."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as why:
            if self.fileno() != 2 and why.errno not in (errno.EPIPE, errno.EINVAL, errno.EBADF):
                raise
            return len(data)


def open_streams() -> None:
    """Standard streams that take everything: a closed one is replaced by the null device, characters that the console lacks by "?"."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            with suppress(OSError):
                os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the number of the closed stream, which no file must have
            setattr(sys, name, open(os.devnull, "w" if number else "r", encoding="utf-8"))  # noqa: SIM115  open until the end
        elif number and isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
            if stream is getattr(sys, f"__{name}__") and not stream.isatty():
                output = BufferedWriter(_Output(number, "wb", closefd=False))
                setattr(sys, name, TextIOWrapper(output, stream.encoding, "replace", line_buffering=name == "stderr"))


def flushed() -> bool:
    """Writes out what was said. False, with a sentence, where it cannot be written, as on a full disk."""
    try:
        sys.stdout.flush()
    except OSError as why:
        complain(f"error: standard output: {why.strerror or why}")
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python flushes again when it ends
        return False
    return True


def fault(why: Exception) -> str:
    """An error of this package that no input should cause, as a sentence with its place."""
    here = [frame for frame in extract_tb(why.__traceback__) if "mfc_analysis" in frame.filename]
    place = f" ({Path(here[-1].filename).name}, line {here[-1].lineno})" if here else ""
    return f"internal error{place}: {type(why).__name__}: {' '.join(str(why).split())[:300]}; please report it with this command and its files"


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
        from typer import Abort, Exit

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
            except OSError as why:
                complain(f"error: {why.filename or 'standard output'}: {why.strerror or why}")
                raise Exit(BAD_INPUT) from None
            except MemoryError:
                complain("error: there is not enough memory for this input")
                raise Exit(BAD_INPUT) from None
            except Abort:  # no answer to a question
                raise Exit(BAD_INPUT) from None
            except KeyboardInterrupt:
                raise Exit(128 + SIGINT) from None

    return run
