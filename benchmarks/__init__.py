"""Run times and memory, as ratios to a lower bound or an alternative measured in the same run: ``python -m benchmarks``."""
