"""The provenance of a report: versions, platform, inputs with their SHA-256, command, settings. The clock is not read."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from mfc_analysis.report.document.document import Provenance

MACHINE = ("Python", "platform")  #: of the items
PACKAGES = ("mfc-analysis", "control", "numpy", "scipy", "pin", "slycot", "matplotlib", "typst")


def provenance(
    command: str = "", inputs: Mapping[str, bytes] | None = None, settings: Mapping[str, object] | None = None, date: str = ""
) -> Provenance:
    """The provenance of a report made on this machine.

    Args:
        command: the command that reproduces the report.
        inputs: content of each input file, by its name (never by its path).
        settings: seeds, tolerances and the like.
        date: given by the user; left out if empty.
    """
    items = [("date", date)] if date else []
    items += [(name, found) for name in PACKAGES if (found := _version(name))]
    items += list(zip(MACHINE, (platform.python_version(), f"{platform.system()} {platform.machine()}"), strict=True))
    items += [(f"SHA-256 of {name}", hashlib.sha256(content).hexdigest()) for name, content in (inputs or {}).items()]
    items += [(str(name), str(value)) for name, value in (settings or {}).items()]
    return Provenance(tuple(items), command)


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
