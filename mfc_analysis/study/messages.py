"""Validation errors of a study as key, sentence and allowed keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from mfc_analysis.errors import short
from mfc_analysis.study.schema import StudyTable
from mfc_analysis.study.tables import REFERENCES, Table, tables_of

_KINDS = {"model_type": "a table", "dict_type": "a table", "list_type": "a list", "string_type": "a text", "bool_type": "true or false"}


def explained(error: Any, raw: Mapping[str, Any]) -> tuple[str, str, tuple[str, ...]]:
    """Dotted key, sentence and allowed keys of one pydantic error."""
    key, table, got = _walk(error["loc"], raw)
    kind, ctx = error["type"], error.get("ctx") or {}
    if kind == "extra_forbidden":
        allowed = tuple(table.model_fields)
        near = get_close_matches(key.rpartition(".")[2], allowed, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return key, f"no such key; {hint}allowed: {', '.join(allowed)}", allowed
    if kind == "missing":
        return key, "is missing", ()
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        kinds = tuple(REFERENCES)
        word = got.get("kind") if isinstance(got, Mapping) else None
        near = get_close_matches(str(word), kinds, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        return f"{key}.kind", f"got {short(word, 80)}; takes one of {', '.join(map(repr, kinds))}{hint}" if word is not None else "is missing", kinds
    said = _KINDS.get(kind) or ctx.get("what") or error["msg"].removeprefix("Input should be ")
    if isinstance(got, Mapping) and kind == "takes":
        return key, f"takes {said}", ()
    return key, f"got {short(got, 80)}; takes {said}", ()


def _walk(loc: Sequence[str | int], raw: Any) -> tuple[str, type[Table], Any]:
    """The dotted key of an error, its table, and the value in the file. Names of validators in ``loc`` are dropped."""
    key, here, last = "", raw, len(loc) - 1
    table: type[Table] = StudyTable
    for i, part in enumerate(loc):
        if isinstance(part, int):
            if isinstance(here, list) and part < len(here):
                key, here = f"{key}[{part}]", here[part]
            continue
        known = isinstance(here, Mapping) and part in here
        if not known and (i != last or (part == "values" and isinstance(here, list))):
            continue
        if not known and part in REFERENCES:
            continue
        key = f"{key}.{part}" if key else part
        inner = tables_of(table.model_fields[part].annotation) if part in table.model_fields else []
        here = here[part] if isinstance(here, Mapping) and known else None
        if inner and (i != last or not known or isinstance(here, (Mapping, list))):
            kind = here.get("kind") if isinstance(here, Mapping) else None
            table = REFERENCES[kind] if part == "reference" and isinstance(kind, str) and kind in REFERENCES else inner[0]
    return key, table, here


def has(raw: Any, key: str) -> bool:
    """Whether the file has this dotted key."""
    for part in key.replace("]", "").replace("[", ".").split("."):
        if isinstance(raw, list) and part.isdigit() and int(part) < len(raw):
            raw = raw[int(part)]
        elif isinstance(raw, Mapping) and part in raw:
            raw = raw[part]
        else:
            return False
    return True
