"""Draws the pictures of README.md again: the margins of its loop along the path, and the first page of the loop's report.

    python docs/readme_pictures.py

The loop is that of the first Python block of README.md, which is executed here. The pictures go to docs/readme/.
"""

from __future__ import annotations

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "readme"
PAGE = '#set page(width: auto, height: auto, margin: 0pt)\n#image("report.pdf", page: {page}, width: 595pt)\n'
RESOLUTION = 85.0  #: [1/inch]


def names_of_readme() -> dict[str, Any]:
    """The names of README's first Python block after its execution: ``loop``, ``times``, ``requirements``."""
    found = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    names: dict[str, Any] = {}
    with redirect_stdout(StringIO()):
        exec(found[1], names)
    return names


def draw(names: dict[str, Any], folder: Path) -> list[Path]:
    """Draws both pictures in a folder, and returns their paths."""
    import typst
    from matplotlib.figure import Figure

    import mfc_analysis as mfc

    folder.mkdir(parents=True, exist_ok=True)
    margins, report = folder / "margins.png", folder / "report.png"
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    names["loop"].linearize(names["times"]).margins().plot("phase_deg", asked=names["requirements"].phase_deg, ax=figure.add_subplot())
    figure.savefig(margins, dpi=RESOLUTION, metadata={"Software": ""})
    with TemporaryDirectory() as place:
        written = mfc.report.write(names["loop"], place, names["times"], ("pdf",), names["requirements"], title="UR5 with an unknown payload of 2 kg")
        Path(place, "report.pdf").write_bytes(written["pdf"].read_bytes())
        Path(place, "page.typ").write_text(PAGE.format(page=1), encoding="utf-8")
        typst.compile(str(Path(place, "page.typ")), output=str(report), format="png", ppi=RESOLUTION)
    return [margins, report]


if __name__ == "__main__":
    for path in draw(names_of_readme(), FOLDER):
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size // 1024} KB")
