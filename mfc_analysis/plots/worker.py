"""The second process of ``plots/batch.py``: pickled recipes in, SVG texts out. Figures that fail here are left to the first process."""

from __future__ import annotations

import pickle
import sys

from mfc_analysis.plots import figure as sheet


def main() -> None:
    """Reads {index: pickled recipe} from standard input, writes {index: SVG} to standard output."""
    parcels: dict[int, bytes] = pickle.load(sys.stdin.buffer)
    out: dict[int, str] = {}
    for index, parcel in parcels.items():
        try:
            recipe = pickle.loads(parcel)
        except (ImportError, AttributeError, pickle.UnpicklingError):
            continue
        out[index] = sheet.svg(recipe)
    pickle.dump(out, sys.stdout.buffer)


if __name__ == "__main__":
    main()
