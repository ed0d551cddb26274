"""Dead time, exact."""
