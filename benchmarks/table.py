"""A row of the table: a task, what it is compared with, its target, and how both are measured."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LEAST, MOST, ENOUGH = 3, 15, 1.5  #: pairs of a comparison, at least and at most, and the time after which no further one starts [s]
HEADS = ("task", "value", "reference", "value", "ratio", "target", "met")
INFORMATION = "for information"

Program = Callable[[], object]
Clock = Callable[[], float]


@dataclass(frozen=True)
class Found:
    """What a row measures: its value and that of the reference, in SI units, and their ratio (the median of all pairs)."""

    ours: float
    reference: float | None = None
    ratio: float | None = None


@dataclass(frozen=True)
class Row:
    """A row of the table; without a library that it needs it is not measured."""

    task: str
    reference: str
    measure: Callable[[], Found]
    most: float | None = None  #: target: of the ratio, or of the value where there is no reference
    unit: str = "s"  #: "s", "bytes" or "bytes/point"
    aim: float | None = None
    slow: bool = False  #: True: measured with ``--all`` only
    needs: tuple[str, ...] = ()  #: optional distributions

    @property
    def target(self) -> str:
        """The target in words."""
        if self.most is None:
            return INFORMATION
        compared = bool(self.reference)
        limit = (f"1/{1 / self.most:g}" if self.most < 1 else f"{self.most:g}") if compared else shown(self.most, self.unit)
        return f"<= {limit}" + ("" if self.aim is None else f", aim {self.aim:g}")

    def met(self, found: Found) -> bool | None:
        """Whether the target is met; None without one."""
        measured = found.ratio if self.reference else found.ours
        return None if self.most is None or measured is None else measured <= self.most

    def cells(self, found: Found | str) -> tuple[str, ...]:
        """The row of the table; ``found`` may say why there is no measurement."""
        if isinstance(found, str):
            return (self.task, found, self.reference, "", "", self.target, "")
        other = "" if found.reference is None else shown(found.reference, self.unit)
        ratio = "" if found.ratio is None else f"{found.ratio:.3g}"
        verdict = {None: "", True: "yes", False: "no"}[self.met(found)]
        return (self.task, shown(found.ours, self.unit), self.reference, other, ratio, self.target, verdict)


def shown(value: float, unit: str) -> str:
    """A time or an amount of memory with a prefix: 26.7 us, 1.2 s, 812 MiB."""
    if unit == "s":
        scale, name = next((pair for pair in ((1.0, "s"), (1e-3, "ms")) if value >= pair[0]), (1e-6, "us"))
        return f"{value / scale:.3g} {name}" if value < 1000 * scale else f"{value / scale:.0f} {name}"
    scale, name = next((pair for pair in ((2.0**30, "GiB"), (2.0**20, "MiB")) if value >= pair[0]), (2.0**10, "KiB"))
    return f"{value / scale:.3g} {name}{unit.removeprefix('bytes')}"


def paired(ours: Program, reference: Program, per: int = 1, reference_per: int | None = None, clock: Clock = time.process_time) -> Found:
    """Both programs in turns: median times for one of ``per`` (``reference_per``) points, and the median ratio of all pairs.

    Processor time, which other programs on the machine disturb least; where several processes share the work, pass ``time.perf_counter``.
    """
    ours(), reference()
    a, b = [], []
    start = time.perf_counter()
    while len(a) < LEAST or (len(a) < MOST and time.perf_counter() - start < ENOUGH):
        t0 = clock()
        ours()
        t1 = clock()
        reference()
        t2 = clock()
        a.append(t1 - t0)
        b.append(t2 - t1)
    other = reference_per or per
    ratio = statistics.median(x / y for x, y in zip(a, b, strict=True))
    return Found(statistics.median(a) / per, statistics.median(b) / other, ratio * other / per)


def alone(program: Program, per: int = 1, repeats: int = 5) -> Found:
    """The median processor time of a program for one of ``per`` points."""
    program()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        program()
        times.append(time.process_time() - start)
    return Found(statistics.median(times) / per)


PEAK = """
import json, os, resource, sys

def most():
    if os.path.exists("/proc/self/status"):  # on Linux ru_maxrss is at least that of the process that started this one
        with open("/proc/self/status") as lines:
            return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

marks = []
begin = lambda: marks.append(most())
"""


def peak(code: str) -> tuple[int, int]:
    """[bytes] resident memory of a program in a process of its own: the largest until it calls ``begin()``, and until its end."""
    text = f"{PEAK}\n{code}\nprint(json.dumps([marks[0], most()]))\n"
    done = subprocess.run([sys.executable, "-c", text], cwd=ROOT, capture_output=True, text=True, check=True)
    before, most = json.loads(done.stdout.splitlines()[-1])
    return int(before), int(most)


def elapsed(*command: str, repeats: int = 7) -> Found:
    """The wall time of a command in a process of its own: the fastest of some, which other programs on the machine disturb least."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
        times.append(time.perf_counter() - start)
    return Found(min(times))


def markdown(rows: list[tuple[str, ...]]) -> str:
    """The table."""
    lines = [f"| {' | '.join(HEADS)} |", "|---|---:|---|---:|---:|---|---|", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines) + "\n"
