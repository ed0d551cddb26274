"""The JSON schema of a study file."""

from __future__ import annotations

from typing import Any

from mfc_analysis.study.schema import LoopTable, StudyTable


def json_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a study file, for editors that complete and check TOML by one.

    No key is required by it: any may stand in the ``[[loop]]`` tables.
    """
    whole = StudyTable.model_json_schema()
    keys = {key: of for key, of in whole["properties"].items() if key in LoopTable.model_fields}
    whole["properties"]["loop"]["items"] = {"type": "object", "properties": keys, "additionalProperties": False}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_optional(whole), "title": "a study of mfc-analysis"}


def _optional(schema: Any) -> Any:
    """The schema without its required keys."""
    if isinstance(schema, list):
        return [_optional(x) for x in schema]
    if not isinstance(schema, dict):
        return schema
    return {"anyOf" if key == "oneOf" else key: _optional(x) for key, x in schema.items() if not (key == "required" and isinstance(x, list))}
