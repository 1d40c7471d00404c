"""The columns of all tables that the package writes: types, units, conventions."""

import json
import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any

import pyarrow as pa

SCHEMA_VERSION = "1"

Columns = Mapping[str, tuple[pa.DataType, str, str]]
"""Name of a column -> its type, unit and meaning, in the order of the table."""

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
    """The columns of a table, which is a section of ``data/columns.toml``.

    >>> columns_of("profile")["h_m"]
    (DataType(double), 'm', 'height above mean sea level')
    """
    columns = {}
    for name, (kind, unit, meaning) in _TEXTS[table].items():
        text = meaning.format_map(_TEXTS["notes"])
        columns[name] = (_TYPES[kind], unit, text)
    return columns


def _displaced_columns() -> Columns:
    """The columns of observations, with other names and meanings where the file has these."""
    columns = dict[str, tuple[pa.DataType, str, str]]()
    for name, column in OBSERVATION_COLUMNS.items():
        if name in _TEXTS["displaced"]:
            displaced_name, kind, *texts = _TEXTS["displaced"][name]
            unit, meaning = texts
            columns[displaced_name] = (_TYPES[kind], unit, meaning)
        else:
            columns[name] = column
    return columns


OBSERVATION_COLUMNS = columns_of("observations")
STATION_COLUMNS = columns_of("stations")
PROFILE_COLUMNS = columns_of("profile")
DISPLACED_COLUMNS = _displaced_columns()
"""The columns of observations to which refraction was applied, with pixels called displaced."""

CONVENTIONS: Mapping[str, str] = _TEXTS["conventions"]


def schema_of(columns: Columns, extra: Mapping[str, str], users: Iterable[Any] = ()) -> pa.Schema:
    """An Arrow schema with units and meanings in the fields, and conventions in the metadata.

    ``extra`` is added to the metadata; ``users`` are the fields of the user's columns, after ours.
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
