"""Image measurements from CSV or Parquet, in batches, with the user's other columns intact."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.tables.schemas import OBSERVATION_COLUMNS, REFRACTION_KEY, REFRACTION_REMOVED

Array = NDArray[np.float64]

_CSV_BLOCK_BYTES = 4 << 20


@dataclass(frozen=True, eq=False)
class Batch:
    """A slice of the observations: ours as numpy, the user's as Arrow, in the order of the file."""

    image: pa.StringArray
    point: pa.StringArray
    x_px: Array
    y_px: Array
    ground: Array | None
    users: dict[str, pa.Array]

    def __len__(self) -> int:
        return len(self.image)


@dataclass(frozen=True, eq=False)
class Observations:
    """A table of observations, opened and checked, not yet read.

    ``user_fields`` are the columns that pass through, under the names they leave with.
    """

    path: Path
    columns: Mapping[str, str]
    ground_column: str | None
    rows: int
    images: tuple[str, ...]
    user_fields: tuple[pa.Field, ...]
    _sources: Mapping[str, str] = field(repr=False, default_factory=dict)
    _csv_types: Mapping[str, pa.DataType] = field(repr=False, default_factory=dict)

    def batches(self, batch_rows: int) -> Iterator[Batch]:
        """The observations in slices of ``batch_rows``, each row once and in its place."""
        for table in _slices(_record_batches(self.path, self._csv_types, batch_rows), batch_rows):
            yield self._batch(table)

    def _batch(self, table: pa.Table) -> Batch:
        def text(role: str) -> pa.StringArray:
            return _one(table[self.columns[role]]).cast(pa.string())

        def number(name: str) -> Array:
            return _as_float(_one(table[name]))

        return Batch(
            text("image"),
            text("point"),
            number(self.columns["x_px"]),
            number(self.columns["y_px"]),
            number(self.ground_column) if self.ground_column else None,
            {f.name: _one(table[self._sources[f.name]]) for f in self.user_fields},
        )


def open_observations(
    path: Path, columns: Mapping[str, str], ground_column: str | None, ledger: Ledger
) -> Observations:
    """Check a table of observations: its columns, its marks, its images.

    Parameters
    ----------
    path : ``.csv`` or ``.parquet``.
    columns : image, point, x_px, y_px -> the user's name of the column.
    ground_column : the column of ground heights, or None where they are constant.

    Refuses a table that is already free of refraction, lacks a column, or repeats a name.
    """
    numbers = {columns["x_px"], columns["y_px"], ground_column or ""}
    schema, csv_types = _schema(path, numbers, {columns["image"], columns["point"]})
    _refuse_corrected(path, schema)
    _refuse_one_for_two(path, columns)
    needed = dict(columns) | ({"ground height": ground_column} if ground_column else {})
    for role, name in needed.items():
        _require(path, schema, role, name)
    taken = set(columns.values())
    if ground_column == "h_g_m":
        taken.add("h_g_m")
    sources, fields = {}, []
    for item in schema:
        if item.name in taken:
            continue
        name = item.name
        while name in OBSERVATION_COLUMNS or name in sources:
            name += "_input"
        if name != item.name:
            ledger.note(
                "OBS-RENAMED", f"your column {item.name} leaves as {name}: the name is ours"
            )
        sources[name] = item.name
        fields.append(pa.field(name, item.type))
    rows, images = 0, set()
    for batch in _record_batches(path, csv_types, 1 << 20, [columns["image"]]):
        rows += batch.num_rows
        images.update(pc.unique(batch.column(0).cast(pa.string())).to_pylist())
    if rows == 0:
        raise InputError(
            "OBS-EMPTY", "the table has no rows", where=str(path), remedy="write observations to it"
        )
    names = tuple(sorted(name for name in images if name is not None))
    return Observations(
        path, columns, ground_column, rows, names, tuple(fields), sources, csv_types
    )


def _schema(
    path: Path, numbers: set[str], texts: set[str]
) -> tuple[pa.Schema, dict[str, pa.DataType]]:
    """The Arrow schema of the file; for CSV also types under which every row can be read."""
    if not path.is_file():
        raise InputError(
            "OBS-MISSING",
            "there is no such file",
            where=str(path),
            remedy="check observations.path",
        )
    suffix = path.suffix.lower()
    if suffix in (".parquet", ".pq"):
        try:
            schema = pq.read_schema(path)
            _refuse_repeated(path, schema)
            return schema, {}
        except (pa.ArrowInvalid, OSError) as error:
            raise InputError(
                "OBS-PARQUET", f"is no readable Parquet file: {error}", where=str(path),
                remedy="write it again",
            ) from None  # fmt: skip
    if suffix in (".csv", ".txt"):
        return _csv_schema(path, numbers, texts)
    raise InputError(
        "OBS-FORMAT",
        f"a table of observations is .csv or .parquet, not {suffix or 'a file without extension'}",
        where=str(path),
        remedy="convert or rename it",
    )


def _refuse_repeated(path: Path, schema: pa.Schema) -> None:
    twice = sorted({name for name in schema.names if schema.names.count(name) > 1})
    if twice:
        raise InputError(
            "OBS-REPEATED-COLUMN", f"the columns {', '.join(twice)} stand there twice",
            where=str(path), remedy="rename one of each",
        )  # fmt: skip


def _csv_schema(
    path: Path, numbers: set[str], texts: set[str]
) -> tuple[pa.Schema, dict[str, pa.DataType]]:
    """Types from the first block, given up for text where a later row contradicts them.

    Names are text whatever they look like: image 0012 is not image 12.
    """
    types: dict[str, pa.DataType] = {}
    try:
        with _open_csv(path, {}, None) as reader:
            schema = reader.schema
        _refuse_repeated(path, schema)
        if len(schema) == 1 and any(mark in schema.names[0] for mark in ";\t|"):
            raise pa.ArrowInvalid("its fields are not separated by commas")
        whole = [item.name for item in schema if pa.types.is_integer(item.type)]
        codes = _with_leading_zeros(path, [name for name in whole if name not in numbers | texts])
    except (pa.ArrowInvalid, OSError) as error:
        raise _csv_refusal(path, error) from None
    for item in schema:
        types[item.name] = pa.float64() if item.name in numbers else item.type
        if item.name in texts | codes or pa.types.is_null(types[item.name]):
            types[item.name] = pa.string()
    try:
        _read_through(path, types)
    except pa.ArrowInvalid:
        types = {name: _type_that_fits(path, name, kind) for name, kind in types.items()}
        try:
            _read_through(path, types)
        except pa.ArrowInvalid as error:
            raise _csv_refusal(path, error) from None
    return pa.schema([pa.field(name, kind) for name, kind in types.items()]), types


def _type_that_fits(path: Path, name: str, kind: pa.DataType) -> pa.DataType:
    """The type of a column under which all of it can be read, the plainest being text."""
    ladder = [kind, pa.float64()] if pa.types.is_integer(kind) else [kind]
    for candidate in ladder:
        try:
            _read_through(path, {name: candidate}, [name])
        except pa.ArrowInvalid as error:
            if "conversion error" not in str(error):
                raise _csv_refusal(path, error) from None
        else:
            return candidate
    return pa.string()


def _with_leading_zeros(path: Path, names: list[str]) -> set[str]:
    """Which columns of digits are codes rather than numbers: 007 must leave as it came."""
    if not names:
        return set()
    with _open_csv(path, dict.fromkeys(names, pa.string()), names) as reader:
        first = next(iter(reader), None)
    if first is None:
        return set()
    return {
        name
        for name in names
        if pc.any(pc.match_substring_regex(first[name], "^[-+]?0[0-9]")).as_py()
    }


def _read_options() -> pa_csv.ReadOptions:
    return pa_csv.ReadOptions(block_size=_CSV_BLOCK_BYTES)


def _read_through(
    path: Path, types: Mapping[str, pa.DataType], only: list[str] | None = None
) -> None:
    with _open_csv(path, types, only) as reader:
        for _ in reader:
            pass


def _open_csv(
    path: Path, types: Mapping[str, pa.DataType], only: list[str] | None
) -> pa_csv.CSVStreamingReader:
    # Only an empty field is null: NA is a country, and "nan" reads as a number where one is due.
    options = pa_csv.ConvertOptions(
        column_types=types,
        include_columns=only,
        null_values=[""],
        strings_can_be_null=True,
        quoted_strings_can_be_null=False,
    )
    parsing = pa_csv.ParseOptions(newlines_in_values=True)
    return pa_csv.open_csv(
        path, read_options=_read_options(), parse_options=parsing, convert_options=options
    )


def _csv_refusal(path: Path, error: BaseException) -> InputError:
    return InputError(
        "OBS-CSV",
        f"is no readable CSV: {error}",
        where=str(path),
        remedy="a table has a header line, commas, and as many fields in every row",
    )


def _record_batches(
    path: Path,
    csv_types: Mapping[str, pa.DataType],
    batch_rows: int,
    only: list[str] | None = None,
) -> Iterator[pa.RecordBatch]:
    try:
        if csv_types:
            with _open_csv(path, csv_types, only) as reader:
                yield from reader
        else:
            with pq.ParquetFile(path, memory_map=True) as file:
                yield from file.iter_batches(batch_size=batch_rows, columns=only)
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            "OBS-DAMAGED", f"reading failed: {error}", where=str(path), remedy="write it again"
        ) from None


def _slices(batches: Iterator[pa.RecordBatch], rows: int) -> Iterator[pa.Table]:
    """Cut a stream of record batches into tables of exactly ``rows`` rows, but for the last."""
    waiting: list[pa.RecordBatch] = []
    count = 0
    for batch in batches:
        while batch.num_rows:
            part = batch.slice(0, rows - count)
            waiting.append(part)
            count += part.num_rows
            batch = batch.slice(part.num_rows)
            if count == rows:
                yield pa.Table.from_batches(waiting)
                waiting, count = [], 0
    if waiting:
        yield pa.Table.from_batches(waiting)


def _one(column: pa.ChunkedArray) -> pa.Array:
    """One contiguous array, dictionaries decoded."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    combined = column.combine_chunks()
    if isinstance(combined, pa.ChunkedArray):
        return combined.chunk(0) if combined.num_chunks else pa.array([], combined.type)
    return combined


def _as_float(column: pa.Array) -> Array:
    """float64 with NaN for null and for text that is no number."""
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        values = pd.to_numeric(column.to_pandas(), errors="coerce")
        return np.asarray(values, dtype=np.float64)
    return np.asarray(
        column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64
    )


def _refuse_corrected(path: Path, schema: pa.Schema) -> None:
    marked = (schema.metadata or {}).get(REFRACTION_KEY) == REFRACTION_REMOVED
    if marked or "x_corrected_px" in schema.names:
        why = "carries the mark" if marked else "has a column x_corrected_px:"
        raise InputError(
            "OBS-ALREADY-CORRECTED",
            f'the table {why} "refraction removed"; correcting it again would count it twice',
            where=str(path),
            remedy="give the measurements as they came from the images",
        )


def _refuse_one_for_two(path: Path, columns: Mapping[str, str]) -> None:
    names = list(columns.values())
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            "OBS-COLUMN", f"the column {twice[0]!r} is named for two quantities", where=str(path),
            remedy="mend observations.columns",
        )  # fmt: skip


def _require(path: Path, schema: pa.Schema, role: str, name: str) -> None:
    if name in schema.names:
        kind = schema.field(name).type
        named = role in ("image", "point")
        if _is_text(kind) or _is_number(kind):
            return
        raise InputError(
            "OBS-TYPE", f"the column {name} holds {kind}, not {'names' if named else 'numbers'}",
            where=str(path), remedy=f"write it as {'text' if named else 'float64'}",
        )  # fmt: skip
    near = difflib.get_close_matches(name, schema.names, 1, 0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise InputError(
        "OBS-COLUMN",
        f"there is no column {name!r} for the {role}{hint}; there is {', '.join(schema.names)}",
        where=str(path),
        remedy=f"say what it is called: observations.columns.{role}"
        if role != "ground height"
        else "say what it is called: ground.height.column",
    )


def _is_text(kind: Any) -> bool:
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _is_number(kind: Any) -> bool:
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(
        pa.types.is_floating(kind)
        or pa.types.is_integer(kind)
        or pa.types.is_decimal(kind)
        or pa.types.is_null(kind)
    )
