"""The whole docs step: runs the blocks of README.md and of the guide, then builds the site in build/site with warnings as errors.

    python docs/build.py                 everything
    python docs/build.py docs/start.md   only the blocks of these pages

``docs/conftest.py`` says what runs and what is compared; ``docs/conf.py`` has the settings of the site.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main(pages: list[str]) -> int:
    """Runs the pages, then sphinx-build; returns the first exit code that is not 0."""
    run = [sys.executable, "-m"]
    code = subprocess.call([*run, "pytest", "-q", *(pages or [ROOT / "docs", ROOT / "README.md"]), "-n", "2", "--dist", "loadfile"])
    if code or pages:
        return code
    return subprocess.call([*run, "sphinx", "-q", "-W", "--keep-going", "-E", "-d", "build/doctrees", "docs", "build/site"], cwd=ROOT)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
