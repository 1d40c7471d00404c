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
    "float64": pa.float64(), "float32": pa.float32(), "string": pa.string(), "int64": pa.int64(),
    "int32": pa.int32(), "int16": pa.int16(), "binary": pa.binary(),
    "timestamp": pa.timestamp("ns", "UTC"),
}  # fmt: skip
_TEXTS = tomllib.loads(files("unbend.tables").joinpath("data/columns.toml").read_text("utf-8"))


def columns_of(table: str) -> Columns:
    """The columns of a table: a section of ``data/columns.toml``.

    >>> columns_of("profile")["h_m"]
    (DataType(double), 'm', 'height above mean sea level')
    """
    return {
        name: (_TYPES[kind], unit, meaning.format_map(_TEXTS["notes"]))
        for name, (kind, unit, meaning) in _TEXTS[table].items()
    }


OBSERVATION_COLUMNS = columns_of("observations")
STATION_COLUMNS, PROFILE_COLUMNS = columns_of("stations"), columns_of("profile")

_DISPLACED = {
    name: (new, (_TYPES[kind], unit, meaning))
    for name, (new, kind, unit, meaning) in _TEXTS["displaced"].items()
}
DISPLACED_COLUMNS: Columns = dict(
    _DISPLACED.get(name, (name, column)) for name, column in OBSERVATION_COLUMNS.items()
)
"""Those of observations that were displaced, of which some have other names and meanings."""

CONVENTIONS: Mapping[str, str] = _TEXTS["conventions"]


def schema_of(columns: Columns, extra: Mapping[str, str], users: Iterable[Any] = ()) -> pa.Schema:
    """An Arrow schema with units and meanings in the fields and conventions in the metadata.

    ``extra`` joins the metadata; ``users`` are the user's own columns, after ours.
    """
    fields = [
        pa.field(name, kind, metadata={"unit": unit, "meaning": meaning})
        for name, (kind, unit, meaning) in columns.items()
    ]
    conventions = json.dumps(dict(CONVENTIONS), sort_keys=True)
    ours = {"unbend.schema": SCHEMA_VERSION, "unbend.conventions": conventions}
    return pa.schema([*fields, *users], metadata=ours | dict(extra))
