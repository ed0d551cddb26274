"""The error of a study file."""

from __future__ import annotations

from collections.abc import Sequence

from mfc_analysis.errors import MfcError


class StudyError(MfcError, ValueError):
    """An invalid study file: names the ``file``, the ``key``, the ``problem`` and what is ``allowed``."""

    def __init__(self, file: str, key: str, problem: str, allowed: Sequence[str] = ()) -> None:
        self.file, self.key, self.problem, self.allowed = file, key, problem, tuple(allowed)
        super().__init__(f"{file}: {key}: {problem}" if key else f"{file}: {problem}")
