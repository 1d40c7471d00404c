"""Image measurements from CSV or Parquet, in batches, with the user's other columns intact."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.tables.delimited import csv_names, open_csv, scan_csv
from pipeline.tables.marks import Direction, refuse_done, refuse_other_pixels
from pipeline.tables.naming import no_such_column
from pipeline.tables.pixels import COLMAP, PixelSystem
from pipeline.tables.schemas import DISPLACED_COLUMNS, OBSERVATION_COLUMNS

Array = NDArray[np.float64]

# A user's column of one of these names would be taken for ours in the results of either direction.
_OURS = OBSERVATION_COLUMNS.keys() | DISPLACED_COLUMNS.keys()


@dataclass(frozen=True, eq=False)
class Batch:
    """A slice of the observations: ours as numpy, the user's as Arrow, in the order of the file.

    ``x_px``, ``y_px`` are COLMAP's; ``x_given_px``, ``y_given_px`` the numbers of the table.
    ``distance_m`` are slant ranges, NaN where there is none; ``no_distance`` counts those that are
    none: zero, negative, infinite or no number. ``ground_sigma`` and ``no_sigma`` likewise for
    standard deviations of ground heights, of which zero is one.
    """

    image: pa.StringArray
    point: pa.StringArray
    x_px: Array
    y_px: Array
    x_given_px: Array
    y_given_px: Array
    ground: Array | None
    users: dict[str, pa.Array]
    distance_m: Array | None = None
    no_distance: int = 0
    ground_sigma: Array | None = None
    no_sigma: int = 0

    def __len__(self) -> int:
        return len(self.image)


@dataclass(frozen=True, eq=False)
class Observations:
    """A table of observations, opened and checked, not yet read.

    ``user_fields`` are the columns that pass through, under the names they leave with; ``pixels``
    the system of the table's pixels.
    """

    path: Path
    columns: Mapping[str, str]
    ground_column: str | None
    distance_column: str | None
    rows: int
    images: tuple[str, ...]
    user_fields: tuple[pa.Field, ...]
    sigma_column: str | None = None
    pixels: PixelSystem = COLMAP
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

        distance, no_distance, sigma, no_sigma = None, 0, None, 0
        if self.distance_column is not None:
            distance, no_distance = _known(_one(table[self.distance_column]), _is_distance)
        if self.sigma_column is not None:
            sigma, no_sigma = _known(_one(table[self.sigma_column]), _is_sigma)
        x, y = number(self.columns["x_px"]), number(self.columns["y_px"])
        return Batch(
            text("image"),
            text("point"),
            self.pixels.to_colmap(x),
            self.pixels.to_colmap(y),
            x,
            y,
            number(self.ground_column) if self.ground_column else None,
            {f.name: _one(table[self._sources[f.name]]) for f in self.user_fields},
            distance,
            no_distance,
            sigma,
            no_sigma,
        )


def open_observations(
    path: Path,
    columns: Mapping[str, str | None],
    ground_column: str | None,
    ledger: Ledger,
    *,
    ground_is_msl: bool = True,
    sigma_column: str | None = None,
    direction: Direction = "remove",
    pixels: PixelSystem = COLMAP,
) -> Observations:
    """Check a table of observations: its columns, its marks, its images.

    Parameters
    ----------
    path : ``.csv`` or ``.parquet``.
    columns : image, point, x_px, y_px -> the user's name of the column; distance_m too, where
        there is one: it passes through as the user's own.
    ground_column : the column of ground heights, or None where none has them.
    ground_is_msl : whether these heights are above mean sea level, as our ``h_g_m`` is; any other
        column of that name is the user's own and leaves as ``h_g_m_input``.
    sigma_column : the column of standard deviations of the ground heights, which passes through.
    direction : whether refraction will be removed from these observations or applied to them.
    pixels : where the table counts its pixels from.

    Refuses a table to which that was done already, one that lacks a column, or repeats a name.
    """
    schema = _schema(path)
    _refuse_repeated(path, schema)
    named = {role: name for role, name in columns.items() if name is not None}
    distance_column = named.get("distance_m")
    heights = [ground_column] if ground_column and ground_column == distance_column else []
    sigmas = [sigma_column] if sigma_column else []
    _refuse_one_for_two(path, [*named.values(), *heights, *sigmas])
    refuse_done(path, schema, direction)
    refuse_other_pixels(path, schema, direction, named)
    for role, name in named.items():
        _require(path, schema, role, name, f"observations.columns.{role}")
    if ground_column:
        _require(path, schema, "ground height", ground_column, "ground.height.column")
    if sigma_column:
        _require(path, schema, "sigma of the ground", sigma_column, "ground.sigma_column")
    csv_types: Mapping[str, pa.DataType] = {}
    if _is_csv(path):
        numbers = {named["x_px"], named["y_px"], ground_column or ""} & set(schema.names)
        scan = scan_csv(path, schema.names, named["image"], named["point"], numbers)
        rows, images, csv_types = scan.rows, scan.images, scan.types
        schema = pa.schema(list(csv_types.items()))
        _note_codes(scan.codes, ledger)
        if distance_column:  # which keeps the type of a column of the user's
            _require(path, schema, "distance_m", distance_column, "observations.columns.distance_m")
        if sigma_column:
            _require(path, schema, "sigma of the ground", sigma_column, "ground.sigma_column")
    else:
        rows, images = _count(path, named["image"])
    if rows == 0:
        raise InputError(
            "OBS-EMPTY", "the table has no rows", where=str(path), remedy="write observations to it"
        )
    taken = set(named.values()) - {distance_column}
    if ground_column == "h_g_m" and ground_is_msl:
        taken.add("h_g_m")
    leaving = _leaving([item for item in schema if item.name not in taken], ledger)
    return Observations(
        path,
        named,
        ground_column,
        distance_column,
        rows,
        tuple(sorted(images)),
        tuple(pa.field(name, item.type) for name, item in leaving.items()),
        sigma_column,
        pixels,
        {name: item.name for name, item in leaving.items()},
        csv_types,
    )


def _leaving(users: list[pa.Field], ledger: Ledger) -> dict[str, pa.Field]:
    """The user's columns under the names they leave with, none of them one of ours."""
    leaving: dict[str, pa.Field] = {}
    for item in users:
        name = item.name
        while name in _OURS or name in leaving:
            name += "_input"
        if name != item.name:
            ledger.note(
                "OBS-RENAMED",
                f"column {item.name} is written as {name}: a column of the results has its name",
            )
        leaving[name] = item
    return leaving


def _note_codes(names: Iterable[str], ledger: Ledger) -> None:
    for name in names:
        ledger.note(
            "OBS-CODES",
            f"column {name} is written as text: some of its digits are no plain number",
        )


def _count(path: Path, image: str) -> tuple[int, set[str]]:
    """The rows of a Parquet file, and the images they speak of."""
    rows, images = 0, set()
    for batch in _record_batches(path, {}, 1 << 20, [image]):
        rows += batch.num_rows
        images.update(pc.unique(batch.column(0).cast(pa.string())).to_pylist())
    return rows, images - {None}


def _is_csv(path: Path) -> bool:
    return path.suffix.lower() in (".csv", ".txt")


def _schema(path: Path) -> pa.Schema:
    """The Arrow schema of the file; that of a CSV is all text until it is surveyed."""
    if not path.is_file():
        raise InputError(
            "OBS-MISSING",
            "there is no such file",
            where=str(path),
            remedy="check observations.path",
        )
    if _is_csv(path):
        return pa.schema([(name, pa.string()) for name in csv_names(path)])
    suffix = path.suffix.lower()
    if suffix in (".parquet", ".pq"):
        try:
            return pq.read_schema(path)
        except (pa.ArrowInvalid, OSError) as error:
            raise InputError(
                "OBS-PARQUET", f"is no readable Parquet file: {error}", where=str(path),
                remedy="write it again",
            ) from None  # fmt: skip
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


def _record_batches(
    path: Path,
    csv_types: Mapping[str, pa.DataType],
    batch_rows: int,
    only: list[str] | None = None,
) -> Iterator[pa.RecordBatch]:
    try:
        if csv_types:
            with open_csv(path, csv_types, only) as reader:
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


def _is_distance(values: Array) -> NDArray[np.bool_]:
    return np.isfinite(values) & (values > 0.0)


def _is_sigma(values: Array) -> NDArray[np.bool_]:
    return np.isfinite(values) & (values >= 0.0)


def _known(column: pa.Array, is_one: Callable[[Array], NDArray[np.bool_]]) -> tuple[Array, int]:
    """Values with NaN for null and for what is none, and how many those are."""
    values = _as_float(column)
    with np.errstate(invalid="ignore"):
        sound = is_one(values)
    absent = column.is_null().to_numpy(zero_copy_only=False)
    if not _is_text(column.type):
        absent = absent | np.isnan(values)
    return np.where(sound, values, np.nan), int(np.count_nonzero(~sound & ~absent))


def _refuse_one_for_two(path: Path, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            "OBS-COLUMN", f"the column {twice[0]!r} is named for two quantities", where=str(path),
            remedy="mend observations.columns",
        )  # fmt: skip


def _require(path: Path, schema: pa.Schema, role: str, name: str, key: str) -> None:
    if name not in schema.names:
        raise no_such_column("OBS-COLUMN", path, name, schema.names, key, role)
    kind = schema.field(name).type
    if not (_is_text(kind) or _is_number(kind)):
        named = role in ("image", "point")
        raise InputError(
            "OBS-TYPE", f"the column {name} holds {kind}, not {'names' if named else 'numbers'}",
            where=str(path), remedy=f"write it as {'text' if named else 'float64'}",
        )  # fmt: skip


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
