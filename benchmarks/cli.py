"""Start of the package and of the command line, in a process of its own."""

from __future__ import annotations

import subprocess
import sys

from benchmarks.table import ROOT, Found, Row, elapsed

IMPORT = "from time import perf_counter as now; start = now(); import mfc_analysis; print(now() - start)"


def imported() -> Found:
    """The import alone, without the start of Python: the fastest of some."""
    command = [sys.executable, "-c", IMPORT]
    return Found(min(float(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout) for _ in range(10)))


ROWS = (
    Row("import mfc_analysis (wall time)", "", imported, 0.03),
    Row("mfc-analysis --help (wall time)", "", lambda: elapsed(sys.executable, "-m", "mfc_analysis", "--help"), 0.2),
)
