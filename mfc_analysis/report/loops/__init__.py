"""The report of one loop or several."""
