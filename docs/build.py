"""The whole docs step: runs the blocks of README.md and of the guide, builds the site in build/site with warnings as errors, and checks it.

    python docs/build.py                 everything
    python docs/build.py docs/start.md   only the blocks of these pages

``docs/conftest.py`` says what runs and what is compared, ``docs/conf.py`` has the settings of the site, ``docs/check_site.py`` looks at it.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main(pages: list[str]) -> int:
    """Runs the steps until one fails; returns its exit code."""
    run = [sys.executable, "-m"]
    steps = [[*run, "pytest", "-q", "-n", "2", "--dist", "loadfile", *(pages or [ROOT / "docs", ROOT / "README.md"])]]
    if not pages:
        shutil.rmtree(ROOT / "build" / "site", ignore_errors=True)
        sphinx = [*run, "sphinx", "-q", "-W", "--keep-going", "-E", "-j", "2", "-d", ROOT / "build" / "doctrees"]
        checks = [ROOT / name for name in ("docs/check_site.py", "tests/test_docs.py", "tests/test_reference.py")]  # those of tests need Sphinx
        steps += [[*sphinx, ROOT / "docs", ROOT / "build" / "site"], [*run, "pytest", "-q", "-n", "2", *checks]]
    return next((code for step in steps if (code := subprocess.call(step))), 0)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
