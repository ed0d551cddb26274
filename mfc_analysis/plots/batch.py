"""Drawing many figures: two processes draw them if there are more than 20.

The second process runs Python with the module search path of the first, without the current folder, and ends with it: it reads its tasks
from a pipe, and leaves at once when the pipe closes.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from signal import SIGTERM
from subprocess import PIPE, Popen
from typing import Any, TypeVar

from mfc_analysis.maths.garbage import rare_collections
from mfc_analysis.maths.threads import THREADS

Made = TypeVar("Made")

MANY = 20  #: up to this number of figures one process is faster: starting others takes about a second
SHARE = 4  #: figures drawn between two calls of ``progress``

_shared: ContextVar[Popen[bytes] | None] = ContextVar("shared", default=None)  #: that of ``second_process``

_START = "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); from mfc_analysis.plots.batch import serve; serve()"


def drawn(recipes: Sequence[Any], *, progress: Callable[[int], None] | None = None) -> list[str]:
    """SVG of each of ``recipes`` (callables without arguments, or finished Axes), in order; the same bytes from any process.

    ``progress`` is called with the number of figures finished since the last call.
    """
    from mfc_analysis.plots import figure as sheet

    shares = [recipes[k : k + SHARE] for k in range(0, len(recipes), SHARE)]
    out: list[list[str]] = []

    def keep(found: Iterable[list[str]]) -> None:
        for some in found:
            out.append(some)
            if progress is not None:
                progress(len(some))

    tasks = [partial(sheet.svgs, some) for some in shares]
    keep(in_two_processes(tasks) if len(recipes) > MANY else (task() for task in tasks))
    return [text for some in out for text in some]


@contextmanager
def second_process() -> Iterator[None]:
    """One second process for all that is done ``in_two_processes`` within, started at once: it loads its modules while this one loads its own.

    Within another ``second_process`` it is the same.
    """
    if _shared.get() is not None:
        yield
        return
    process = _second()
    token = _shared.set(process)
    try:
        yield
    finally:
        _shared.reset(token)
        _end(process)


def in_two_processes(tasks: Iterable[Callable[[], Made]]) -> Iterator[Made]:
    """What each task returns, in order, as it comes; a second process does some of the tasks, where there is a core for it, and ends with them.

    A task that cannot be sent, or that fails there, is done here: its error is raised here.
    """
    given = list(tasks)
    waiting, done, news = deque(range(len(given))), dict[int, Callable[[], Made]](), threading.Condition()
    shared = _shared.get()
    second = shared if shared is not None and shared.poll() is None else _second() if len(given) > 1 else None

    def others() -> None:
        while second is not None and waiting:
            with suppress(IndexError):  # the first process took the last one
                k = waiting.popleft()
                answer = _asked(second, given[k]) or given[k]
                with news:
                    done[k] = answer
                    news.notify()

    thread = threading.Thread(target=others, daemon=True)
    thread.start()
    finished = False
    try:
        for k in range(len(given)):
            while k not in done:
                try:
                    here = waiting.popleft()
                except IndexError:
                    with news:
                        while k not in done:
                            news.wait()
                else:
                    done[here] = partial(_told, given[here](), ())
            yield done.pop(k)()
        finished = True
    finally:
        waiting.clear()
        if second is not None and (second is not shared or not finished):  # it may be busy with a task that nobody waits for
            second.kill()
        thread.join()
        if second is not shared:
            _end(second)


def _second() -> Popen[bytes] | None:
    """A second process; None where there is no core for it, or it cannot be started."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores < 2 or not sys.executable:
        return None
    try:
        environment = {**dict.fromkeys(THREADS, "1"), **os.environ}
        found = Popen([sys.executable, "-P", "-c", _START], stdin=PIPE, stdout=PIPE, env=environment, start_new_session=True)
        home = str(Path(__file__).resolve().parents[2])  # of this package, last: where it was found by the current folder
        _send(found, pickle.dumps([*(str(entry) for entry in sys.path if entry), home]))
    except OSError:
        return None
    return found


def _end(process: Popen[bytes] | None) -> None:
    if process is not None:
        process.kill()
        with suppress(OSError), process:  # closes its pipes
            pass


def _send(process: Popen[bytes], content: bytes) -> None:
    assert process.stdin is not None
    process.stdin.write(content)
    process.stdin.flush()


def _asked(process: Popen[bytes], task: Callable[[], Made]) -> Callable[[], Made] | None:
    """What the second process returns for a task, with its warnings; None where it does not."""
    assert process.stdout is not None
    try:
        _send(process, pickle.dumps(pickle.dumps(task)))
        answer = pickle.load(process.stdout)
        return partial(_told, *pickle.loads(answer)) if answer else None
    except (pickle.PickleError, AttributeError, TypeError, OSError, EOFError, RecursionError):
        return None


def _told(value: Made, said: Iterable[warnings.WarningMessage]) -> Made:
    for one in said:
        warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    return value


def serve() -> None:
    """The second process: does the tasks that arrive on standard input, and leaves when it closes. An empty answer: could not be done."""
    source, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a task prints is no answer
    arrived: SimpleQueue[bytes] = SimpleQueue()

    def listen() -> None:
        with suppress(EOFError, OSError, pickle.PickleError):
            while True:
                arrived.put(pickle.load(source))
        os.kill(os.getpid(), SIGTERM)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        task = arrived.get()
        try:
            with warnings.catch_warnings(record=True) as said, rare_collections():
                warnings.simplefilter("always")
                answer = pickle.dumps((pickle.loads(task)(), said))
        except Exception:  # any error of a task: the first process does the task again, and raises it
            answer = b""
        with suppress(OSError):
            pickle.dump(answer, answers)
            answers.flush()
