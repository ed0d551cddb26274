"""Over frequency: responses, crossings, peaks."""
