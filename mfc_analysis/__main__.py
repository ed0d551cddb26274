"""``python -m mfc_analysis``: the command line."""

from mfc_analysis.cli import main

main()
