"""The command line computes with one thread of linear algebra, unless the user wants more."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mfc_analysis.maths.threads import THREADS

CODE = f"""
import sys
from mfc_analysis.cli import main
sys.argv = ["mfc-analysis", "laws"]
try:
    main()
except SystemExit:
    import os
    sys.stderr.write(" ".join(os.environ[name] for name in {THREADS!r}))
"""


@pytest.mark.parametrize(("given", "used"), [({}, "1 1 1"), ({"OPENBLAS_NUM_THREADS": "2"}, "1 2 1")])
def test_the_command_line_sets_one_thread_where_none_is_set(given: dict[str, str], used: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in THREADS} | given
    done = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, timeout=60)
    assert done.stderr.endswith(used)
