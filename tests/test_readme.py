"""The pictures of README: they are there, small, and its script draws them."""

from __future__ import annotations

import importlib.util
import re
import struct
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def size(path: Path) -> tuple[int, int]:
    """Width and height of a PNG [pixels]."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", head[16:])
    return width, height


def shown() -> dict[str, str]:
    """Alt text by path, of Markdown's pictures and of HTML's."""
    markdown = {path: alt for alt, path in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", README)}
    return markdown | dict(re.findall(r'<img src="([^"]+)"[^>]* alt="([^"]+)"', README))


def test_the_pictures_of_readme_are_there_and_small_and_described() -> None:
    assert set(shown()) == {"docs/readme/margins.png", "docs/readme/report.png"}
    for name, alt in shown().items():
        assert (ROOT / name).stat().st_size < 150_000 and len(alt) > 60


def test_the_script_draws_the_pictures_of_readme(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("readme_pictures", ROOT / "docs" / "readme_pictures.py")
    assert spec is not None and spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    drawn = script.draw(script.names_of_readme(), tmp_path)
    assert {f"docs/readme/{path.name}" for path in drawn} == set(shown())
    for path in drawn:
        assert size(path) == size(ROOT / "docs" / "readme" / path.name)
