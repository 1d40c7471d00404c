"""Image measurements from a table or a block, in batches, with the user's other columns intact."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from unbend.messages import Ledger
from unbend.tables import messages
from unbend.tables.delimited import scan_csv
from unbend.tables.geodata.object_points import ObjectPoints
from unbend.tables.imports.blocks import BLOCKS
from unbend.tables.imports.blocks.image_points import of_points
from unbend.tables.measured_columns import at_least_zero, measured_floats
from unbend.tables.observation_files import OpenedTable, Records, csv_records, in_memory, open_file
from unbend.tables.pixels import COLMAP, ImageFrame, PixelSystem
from unbend.tables.refraction_mark import Direction, refuse_done
from unbend.tables.schemas import DISPLACED_COLUMNS, OBSERVATION_COLUMNS
from unbend.tables.text_columns import (
    hashes_of,
    refuse_other_pixels,
    require_columns,
)
from unbend.units import Array

_SCANNED_ROWS = 1 << 20  # read at a time for the names of images

# A user's column with one of these names would be taken for a result, in either direction.
_OURS = OBSERVATION_COLUMNS.keys() | DISPLACED_COLUMNS.keys()


@dataclass(frozen=True, eq=False)
class Batch:
    """A slice of the observations: ours as numpy, the user's as Arrow, in the order of the file.

    ``x_px``, ``y_px`` are COLMAP's; ``x_given_px``, ``y_given_px`` the pixels of the table.
    ``distance_m`` are slant ranges, NaN where there is none; ``no_distance`` counts those that are
    none: zero, negative, infinite or no number. ``ground_sigma`` and ``no_sigma`` likewise for
    standard deviations of ground heights, of which zero is one. ``first_row`` is the place of its
    first row in the table; ``no_point`` counts points that a table of object points has not.
    Of a sample, ``numbers`` are the places of its rows, and ``weight`` the rows each stands for.
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
    no_point: int = 0
    first_row: int = 0
    numbers: NDArray[np.int64] | None = None
    weight: Array | None = None

    @property
    def rows(self) -> slice | NDArray[np.int64]:
        """Places of its rows in the table."""
        if self.numbers is not None:
            return self.numbers
        return slice(self.first_row, self.first_row + len(self))

    def __len__(self) -> int:
        return len(self.image)

    def taken(self, rows: NDArray[np.int64]) -> "Batch":
        """Some of its rows, without the user's columns."""
        place = np.arange(len(self)) + self.first_row
        numbers = place if self.numbers is None else self.numbers
        of_rows = {
            name: None if values is None else values[rows]
            for name, values in vars(self).items()
            if values is None or isinstance(values, np.ndarray)
        }
        names = {"image": self.image.take(rows), "point": self.point.take(rows)}
        return replace(self, **(of_rows | names | {"users": {}, "numbers": numbers[rows]}))


@dataclass
class RowSample:
    """At most ``most`` rows of a table, spread over its images, drawn in one pass over their names.

    An image has as many as any other, or all of its own where these are fewer. The same table
    gives the same rows. ``counts`` are the rows of each image, ``of_each`` the most drawn of one.

    >>> sample = RowSample(4)
    >>> sample.add(pa.array(["a"] * 7 + ["b", None]))
    >>> sample.number.tolist(), sample.weights.tolist()
    ([0, 5, 7, 8], [3.5, 3.5, 1.0, 1.0])
    """

    most: int
    of_each: int = 1 << 62
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    number: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    image: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    _codes: dict[str | None, int] = field(default_factory=dict)

    def add(self, names: pa.StringArray | pa.DictionaryArray) -> None:
        """The images of the next rows of the table."""
        encoded = names.dictionary_encode()
        known = [*encoded.dictionary.to_pylist(), *[None] * (encoded.null_count > 0)]
        coded = np.array([self._codes.setdefault(n, len(self._codes)) for n in known], np.int64)
        image = coded[encoded.indices.fill_null(len(known) - 1).to_numpy(zero_copy_only=False)]
        number = np.arange(image.size) + self.counts.sum()
        self.counts = np.pad(self.counts, (0, len(self._codes) - self.counts.size))
        rows = np.bincount(image, minlength=self.counts.size)
        self.counts += rows
        # Images with more than 0, 1, 2 ... rows: so many rows of each image fit together.
        more = np.bincount(np.minimum(self.counts, self.most), minlength=self.most + 1)
        more = more[:0:-1].cumsum()[::-1].cumsum()
        self.of_each = min(self.of_each, int(np.searchsorted(more, self.most, "right")))
        # Of an image three times the rows that can be drawn are sorted, where these have them all.
        drawn = np.minimum(rows, max(self.of_each, 1))
        share = np.minimum(3.0 * drawn / np.maximum(rows, 1), 1.0) * (1 << 40)
        scattered = _scattered(number)
        low = np.flatnonzero(scattered <= np.uint64(share.max(initial=0.0)))
        low = low[scattered[low] <= share.astype(np.uint64)[image[low]]]
        few = np.bincount(image[low], minlength=rows.size) < drawn
        low = np.union1d(low, np.flatnonzero(few[image])) if few.any() else low
        image, number = np.append(self.image, image[low]), np.append(self.number, number[low])
        order = np.argsort(image.astype(np.uint64) << np.uint64(40) | _scattered(number))
        begin = np.searchsorted(image[order], np.arange(self.counts.size))
        rank = np.arange(order.size) - begin[image[order]]
        kept = order[rank < max(self.of_each, 1)]
        if self.of_each == 0:  # more images than rows: of some of them one
            kept = kept[np.argsort(_scattered(image[kept]), kind="stable")[: self.most]]
        kept = np.sort(kept)
        self.number, self.image = number[kept], image[kept]

    @property
    def weights(self) -> Array:
        """(m,) rows of the table that each row drawn stands for."""
        drawn = np.bincount(self.image, minlength=self.counts.size)
        weights = self.counts[self.image] / drawn[self.image]
        return np.asarray(weights * (self.counts.sum() / weights.sum()))


def _scattered(number: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Multiples of the golden ratio: of consecutive numbers the lowest lie evenly among them."""
    scattered = number.astype(np.uint64)
    scattered *= np.uint64(0x9E3779B97F4A7C15)
    scattered >>= np.uint64(24)
    return scattered


@dataclass(frozen=True, eq=False)
class Observations:
    """A table of observations, opened and checked, not yet read.

    ``user_fields`` are the columns that pass through, under the names they leave with; ``pixels``
    the system of the table's pixels, ``points`` give the heights where they do. A database of
    keypoints has no points (``has_points``). Coordinates in millimetres have a ``frame``.
    """

    path: Path
    columns: Mapping[str, str]
    ground_column: str | None
    rows: int
    images: tuple[str, ...]
    user_fields: tuple[pa.Field, ...]
    sigma_column: str | None = None
    pixels: PixelSystem = COLMAP
    frame: ImageFrame | None = None
    points: ObjectPoints | None = None
    is_block: bool = False
    has_points: bool = True
    sample: RowSample | None = field(repr=False, default=None)
    _drawn: list[Batch] = field(init=False, repr=False, default_factory=list)
    _sources: Mapping[str, str] = field(repr=False, default_factory=dict)
    _records: Records = field(repr=False, default=lambda rows, only, first: iter(()))

    def sampled(self, *, points: bool = False) -> Batch:
        """The rows that were drawn when the table was opened, without the user's columns.

        Their ``points`` are read where they are asked for, or have the heights; then all is kept.
        """
        if self._drawn:
            return self._drawn[0]
        drawn = self.sample or RowSample(0)
        unread = () if points or self.points is not None else (self.columns["point"],)

        def of_sample(records: pa.RecordBatch, first: int) -> NDArray[np.int64]:
            begin, end = np.searchsorted(drawn.number, (first, first + len(records)))
            return drawn.number[begin:end] - first

        batch = replace(self.selected(of_sample, unread=unread), weight=drawn.weights)
        self._drawn.extend([batch] if points else [])
        return batch

    def of_points(
        self, chosen: Callable[[NDArray[np.uint64]], NDArray[np.int64]], most_rows: int = 1 << 62
    ) -> Batch:
        """The rows whose points' hashes are chosen, of the first ``most_rows``; else as `sampled`.

        ``chosen`` gives the rows (k,) to take of the hashes (n,) of a part of the table. Image
        points of a block that belong to no point are left out: they tie nothing.
        """

        def of_hashes(records: pa.RecordBatch, first: int) -> NDArray[np.int64]:
            point = self.columns["point"]
            if not self.is_block:
                return chosen(hashes_of(records[point].cast(pa.string())))
            tied = of_points(records, self.columns["image"], point)
            return tied[chosen(hashes_of(records[point].take(tied)))] if tied.size else tied

        return self.selected(of_hashes, most_rows=most_rows if self.has_points else 0)

    def selected(
        self,
        chosen: Callable[[pa.RecordBatch, int], NDArray[np.int64]],
        *,
        unread: tuple[str, ...] = (),
        most_rows: int = 1 << 62,
    ) -> Batch:
        """Rows (k,) that are chosen of each part of the table, which begins at a row."""
        image, first, parts, numbers = self.columns["image"], 0, [], []
        wanted = {*self.columns.values(), self.ground_column, self.sigma_column}
        wanted -= {None, image, *unread}
        for records in self._records(1 << 18, [image, *sorted(filter(None, wanted))], 0):
            rows = chosen(records, first)
            parts.append(records.take(pa.array(rows)))
            numbers.append(rows + first)
            first += len(records)
            if first >= most_rows:
                break
        batch = self._batch(pa.Table.from_batches(parts), {})
        return replace(batch, numbers=np.concatenate(numbers))

    def rows_of_part(self, batch_rows: int) -> int:
        """Rows of a part of the results, but for the last; ``batch_rows`` or fewer."""
        # Keypoints are many more than tie points: their memory stays under 100 MB.
        return min(batch_rows, 1 << 15) if self.is_block else batch_rows

    def batches(
        self, batch_rows: int, first_part: int = 0, stop: int | None = None
    ) -> Iterator[Batch]:
        """The observations in slices of `rows_of_part`, each row once and in its place.

        Those of the parts from the first up to ``stop``; what comes before is not decoded where a
        file lets skip it.
        """
        batch_rows = self.rows_of_part(batch_rows)
        first_row = first_part * batch_rows
        slices = _slices(self._records(batch_rows, None, first_row), batch_rows)
        for table in islice(slices, None if stop is None else stop - first_part):
            users = {f.name: self._sources[f.name] for f in self.user_fields}
            yield replace(self._batch(table, users), first_row=first_row)
            first_row += table.num_rows

    def _batch(self, table: pa.Table, users: Mapping[str, str]) -> Batch:
        """A slice of the table; ``users`` names the user's columns of it."""
        arrays = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            if pa.types.is_dictionary(column.type):
                column = column.cast(column.type.value_type)
            arrays[name] = column.combine_chunks()
        x = measured_floats(arrays[self.columns["x_px"]])
        y = measured_floats(arrays[self.columns["y_px"]])
        unread = pa.nulls(table.num_rows)
        names = (arrays.get(self.columns[n], unread) for n in ("image", "point"))
        image, point = (column.cast(pa.string()) for column in names)
        optional: dict[str, Any] = {}
        ground = None if self.ground_column is None else measured_floats(arrays[self.ground_column])
        if self.points is not None:
            ground, row = self.points.heights(point, image)
            optional["no_point"] = int(((row < 0) & np.isnan(ground)).sum())
        if "distance_m" in self.columns:
            found = at_least_zero(arrays[self.columns["distance_m"]], above=True)
            optional["distance_m"], optional["no_distance"] = found
        if self.sigma_column is not None:
            found = at_least_zero(arrays[self.sigma_column])
            optional["ground_sigma"], optional["no_sigma"] = found
        own = {name: arrays[source] for name, source in users.items()}
        x_px, y_px = self.pixels.to_colmap(x), self.pixels.to_colmap(y)
        if self.frame is not None:
            x_px, y_px = self.frame.to_colmap(x, y)
            x = self.pixels.from_colmap(x_px)
            y = self.pixels.from_colmap(y_px)
        return Batch(image, point, x_px, y_px, x, y, ground=ground, users=own, **optional)


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
    frame: ImageFrame | None = None,
    most_rows: int | None = None,
    file_format: str | None = None,
    table: pa.Table | None = None,
) -> Observations:
    """Check a table of observations: its columns, its marks, its images.

    Parameters
    ----------
    path : ``.csv`` or ``.parquet``, or what ``file_format`` says; of a ``table`` its name.
    columns : image, point, x_px, y_px -> the user's name of the column; distance_m too, where
        there is one: it passes through as the user's own.
    ground_column : the column of ground heights, or None where none has them.
    ground_is_msl : whether these heights are above mean sea level, as our ``h_g_m`` is; any other
        column of that name is the user's own and leaves as ``h_g_m_input``.
    sigma_column : the column of standard deviations of the ground heights, which passes through.
    direction : whether refraction will be removed from these observations or applied to them.
    pixels : where the table counts its pixels from, and the results do.
    frame : that of coordinates that are no pixels; they pass through as the user's own.
    most_rows : draw that many rows, spread over the images, for `Observations.sampled`.
    file_format : csv, parquet, or one of `BLOCKS`; by default the ending says it.
    table : the table itself, where it is in memory and no file.

    Refuses a table to which that was done already, one that lacks a column, or repeats a name. A
    point that stands twice in one image of a block is a loss.
    """
    opened = open_file(path, file_format) if table is None else in_memory(table)
    schema = opened.schema
    named = {role: name for role, name in columns.items() if name is not None}
    wanted = [(role, name, f"observations.columns.{role}") for role, name in named.items()]
    if ground_column:
        wanted.append(("ground height", ground_column, "ground.height.column"))
    if sigma_column:
        wanted.append(("sigma of the ground", sigma_column, "ground.sigma_column"))
    refuse_done(path, schema, direction, is_file=table is None)
    refuse_other_pixels(path, schema, direction, named)
    require_columns(path, schema, wanted)

    # The images of all rows, and of a CSV the types of its columns.
    sample = None if most_rows is None else RowSample(most_rows)
    if opened.kind == "csv":
        numbers = {named["x_px"], named["y_px"], ground_column or ""} & set(schema.names)
        scan = _scan_of_csv(path, schema.names, named, numbers, sample, ledger)
        require_columns(path, scan.schema, wanted)  # now with the types that the values have
    else:
        scan = _scan_of_names(path, opened, named, sample, ledger)
    if scan.rows == 0:
        raise messages.observations_empty(where=path)

    # The user's other columns, beside those that the results replace.
    replaced = set(named.values()) - {named.get("distance_m")}
    replaced -= set() if frame is None else {named["x_px"], named["y_px"]}
    if ground_column == "h_g_m" and ground_is_msl:
        replaced.add("h_g_m")
    own_names = [name for name in scan.schema.names if name not in replaced]
    sources = _written_names(own_names, ledger)
    user_fields = []
    for written, original in sources.items():
        user_fields.append(pa.field(written, scan.schema.field(original).type))
    return Observations(
        path=path,
        columns=named,
        ground_column=ground_column,
        rows=scan.rows,
        images=tuple(sorted(name for name in scan.images if name is not None)),
        user_fields=tuple(user_fields),
        sigma_column=sigma_column,
        pixels=pixels,
        frame=frame,
        is_block=opened.kind in BLOCKS,
        has_points=scan.has_points,
        sample=sample,
        _sources=sources,
        _records=scan.records,
    )


@dataclass(frozen=True)
class _Scan:
    """What all rows of a table were read for once."""

    rows: int
    images: Collection[str | None]
    schema: pa.Schema
    records: Records
    has_points: bool


def _scan_of_csv(
    path: Path,
    names: list[str],
    named: Mapping[str, str],
    numbers: set[str],
    sample: RowSample | None,
    ledger: Ledger,
) -> _Scan:
    """Read a CSV once, which says the types of its columns."""
    add = None if sample is None else sample.add
    scan = scan_csv(path, names, (named["image"], named["point"]), numbers, add)
    for name in scan.codes:
        ledger.add(messages.column_as_text(column=name))
    return _Scan(
        rows=scan.rows,
        images=scan.images,
        schema=pa.schema(list(scan.types.items())),
        records=partial(csv_records, path, scan.types),
        has_points=True,
    )


def _scan_of_names(
    path: Path,
    opened: OpenedTable,
    named: Mapping[str, str],
    sample: RowSample | None,
    ledger: Ledger,
) -> _Scan:
    """Read the images of all rows, and the points of a block, which may stand twice in an image."""
    is_block = opened.kind in BLOCKS
    only = [named["image"], named["point"]] if is_block else [named["image"]]
    rows = 0
    images: set[str | None] = set()
    repeated: list[str] = []
    has_points = not is_block
    for batch in opened.records(_SCANNED_ROWS, only, 0):
        rows += batch.num_rows
        if is_block and (tied := of_points(batch, *batch.schema.names)).size:
            point = batch.column(1).take(tied).to_pandas()
            has_points = True
            repeated += [f"{p} in {batch.column(0)[0]}" for p in point[point.duplicated()]]
        names = batch.column(0)
        if not pa.types.is_dictionary(names.type):
            names = names.cast(pa.string())
        images.update(pc.unique(names).to_pylist())
        if sample is not None:
            sample.add(names)
    if repeated:
        count = len(repeated)
        ledger.add(messages.points_repeated(where=path.name, count=count, first=repeated[0]))
    return _Scan(
        rows=rows,
        images=images,
        schema=opened.schema,
        records=opened.records,
        has_points=has_points,
    )


def _written_names(users: list[str], ledger: Ledger) -> dict[str, str]:
    """Names that the user's columns are written with, no result among them -> the own names."""
    sources: dict[str, str] = {}
    for own in users:
        name = own
        while name in _OURS or name in sources:
            name += "_input"
        if name != own:
            ledger.add(messages.column_renamed(column=own, written=name))
        sources[name] = own
    return sources


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
