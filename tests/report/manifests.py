"""Manifests of which a test states only what it is about."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from types import NoneType, UnionType
from typing import get_args, get_origin, get_type_hints

from unbend.tables.manifest.results import ResultsRecord
from unbend.tables.manifest.run import RunRecord
from unbend.tables.manifest.sections import MissionSections
from unbend.tables.manifest.whole import Manifest


def manifest_of(values) -> Manifest:
    """A manifest with these values, and nothing (None, 0, an empty text) in all other fields."""
    whole = filled_record(RunRecord, values) | filled_record(ResultsRecord, values)
    whole["config"] = filled_record(MissionSections, values.get("config", {}))
    return Manifest(whole, "manifest.json")


def filled(kind, value):
    """A value of a record's field, its own records filled up."""
    origin = get_origin(kind)
    parts = get_args(kind)
    if is_dataclass(kind):
        return filled_record(kind, value)
    if origin is UnionType and isinstance(value, dict):
        records = [part for part in parts if is_dataclass(part)]
        if len(records) == 1:
            return filled_record(records[0], value)
    if origin is list:
        return [filled(parts[0], item) for item in value]
    if origin is Mapping:
        return {name: filled(parts[1], item) for name, item in value.items()}
    return value


def filled_record(kind, values):
    whole = dict(values)
    for name, hint in get_type_hints(kind).items():
        if name in values:
            whole[name] = filled(hint, values[name])
        else:
            whole[name] = empty(hint)
    return whole


def empty(kind):
    """Nothing of the type of a field."""
    if NoneType in get_args(kind):
        return None
    if is_dataclass(kind):
        return filled_record(kind, {})
    origin = get_origin(kind) or kind
    if origin is Mapping:
        return {}
    return origin()
