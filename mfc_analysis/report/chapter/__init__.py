"""The report of the whole chapter, a file for each of its parts."""
