"""Threads of linear algebra: more than one only costs time for matrices of a few dozen rows. Imports no other file of the package."""

from __future__ import annotations

import os

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  #: what BLAS reads when numpy is imported


def one_thread() -> None:
    """One thread for linear algebra in this process and those that it starts, unless the user has set another number; before numpy is imported."""
    for name in THREADS:
        os.environ.setdefault(name, "1")
