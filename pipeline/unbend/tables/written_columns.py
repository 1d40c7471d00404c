"""The columns of every table that leaves the package: types, units, conventions."""

import json
import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any

import pyarrow as pa

SCHEMA_VERSION = "1"

Columns = Mapping[str, tuple[pa.DataType, str, str]]
"""Type, unit and meaning of columns by their names, in their order."""

_TYPES = {
    "float64": pa.float64(),
    "float32": pa.float32(),
    "string": pa.string(),
    "int64": pa.int64(),
    "int32": pa.int32(),
    "int16": pa.int16(),
    "binary": pa.binary(),
    "timestamp": pa.timestamp("ns", "UTC"),
}
_TEXTS = tomllib.loads(files("unbend.tables").joinpath("data/columns.toml").read_text("utf-8"))


def columns_of(table: str) -> Columns:
    """The columns of a table: a section of ``data/columns.toml``.

    >>> columns_of("profile")["h_m"]
    (DataType(double), 'm', 'height above mean sea level')
    """
    columns = {}
    for name, (kind, unit, meaning) in _TEXTS[table].items():
        text = meaning.format_map(_TEXTS["notes"])
        columns[name] = (_TYPES[kind], unit, text)
    return columns


def _displaced_columns() -> Columns:
    columns = dict[str, tuple[pa.DataType, str, str]]()
    for name, column in OBSERVATION_COLUMNS.items():
        if name in _TEXTS["displaced"]:
            new_name, kind, *texts = _TEXTS["displaced"][name]
            unit, meaning = texts
            columns[new_name] = (_TYPES[kind], unit, meaning)
        else:
            columns[name] = column
    return columns


OBSERVATION_COLUMNS = columns_of("observations")
STATION_COLUMNS = columns_of("stations")
PROFILE_COLUMNS = columns_of("profile")
DISPLACED_COLUMNS = _displaced_columns()
"""Those of observations that were displaced, of which some have other names and meanings."""

CONVENTIONS: Mapping[str, str] = _TEXTS["conventions"]


def schema_of(columns: Columns, extra: Mapping[str, str], users: Iterable[Any] = ()) -> pa.Schema:
    """An Arrow schema with units and meanings in the fields and conventions in the metadata.

    ``extra`` joins the metadata; ``users`` are the user's own columns, after ours.
    """
    fields = []
    for name, (kind, unit, meaning) in columns.items():
        texts = {"unit": unit, "meaning": meaning}
        fields.append(pa.field(name, kind, metadata=texts))
    metadata = {
        "unbend.schema": SCHEMA_VERSION,
        "unbend.conventions": json.dumps(dict(CONVENTIONS), sort_keys=True),
        **extra,
    }
    return pa.schema([*fields, *users], metadata=metadata)
