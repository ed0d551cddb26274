"""``mfc-analysis export``: gains to the parameter file of a controller, and from it into a study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths import files
from mfc_analysis.study.shipped import found

if TYPE_CHECKING:
    from mfc_analysis.study.ros2_control import Export

LARGEST = 4_000_000  #: bytes of a parameter file
TARGETS = ("ros2_control",)


def to_controller(study: Path, target: str, controller: str, name: str, out: Path | None) -> Export:
    """The parameter file with the gains of the first loop of a study; written to ``out``, whose other lines stay, if it is given."""
    from mfc_analysis.study.read import read
    from mfc_analysis.study.ros2_control import exported

    if target not in TARGETS:
        raise UnknownName("--to", target, TARGETS)
    made = exported(read(found(study)).loops[0], _text(out) if out is not None and out.exists() else "", controller, name)
    if out is not None:
        files.write(out, made.text.encode("utf-8"))
    return made


def from_controller(study: Path, source: Path, name: str, out: Path | None) -> tuple[str, tuple[str, ...]]:
    """The study (TOML) with the law that a controller of a parameter file has, and notes; written to ``out`` if it is given, a new file."""
    from mfc_analysis.study.read import read
    from mfc_analysis.study.ros2_control import law_table, with_law

    path = found(study)
    joints = read(path).loops[0].loop.robot.joint_names
    law, notes = law_table(_text(source), joints, name)
    text = with_law(_text(path), law)
    if out is not None:
        if out.exists():
            raise BadArgument("--out", str(out), "a new file")
        files.write(out, text.encode("utf-8"))
    return text, notes


def _text(path: Path) -> str:
    try:
        return files.read(path, LARGEST).decode("utf-8-sig")
    except UnicodeError as why:
        raise BadArgument("file", str(path), "a text file (UTF-8)") from why
