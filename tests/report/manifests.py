"""Manifests of which a test states only what it is about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from unbend.tables.manifest.results import ResultsRecord
from unbend.tables.manifest.run import RunRecord
from unbend.tables.manifest.sections import MissionSections
from unbend.tables.manifest.whole import Manifest


def manifest_of(values: Mapping[str, Any]) -> Manifest:
    """A manifest with these values, and nothing (None, 0, an empty text) in all other fields."""
    whole = filled(RunRecord, values) | filled(ResultsRecord, values)
    config = filled(MissionSections, values.get("config", {}))
    return Manifest(whole | {"config": config}, "manifest.json")


def filled(kind: Any, value: Any) -> Any:
    """A value of a record's field, its own records filled up."""
    parts = get_args(kind)
    if is_dataclass(kind):
        whole = dict(value)
        for name, hint in get_type_hints(kind).items():
            whole[name] = filled(hint, value[name]) if name in value else empty(hint)
        return whole
    if get_origin(kind) is UnionType:
        records = [part for part in parts if is_dataclass(part)]
        return filled(*records, value) if len(records) == 1 and isinstance(value, dict) else value
    if get_origin(kind) is list:
        return [filled(parts[0], item) for item in value]
    if get_origin(kind) is Mapping:
        return {name: filled(parts[1], item) for name, item in value.items()}
    return value


def empty(kind: Any) -> Any:
    """Nothing of the type of a field."""
    if NoneType in get_args(kind):
        return None
    if is_dataclass(kind):
        return filled(kind, {})
    origin = get_origin(kind)
    return {} if origin is Mapping else (origin or kind)()
