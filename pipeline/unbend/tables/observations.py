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
from unbend.tables.imports.blocks.image_points import rows_with_point
from unbend.tables.measured_columns import at_least_zero, measured_floats
from unbend.tables.name_hashes import hashes_of
from unbend.tables.observation_files import OpenedTable, Records, csv_records, in_memory, open_file
from unbend.tables.pixels import COLMAP, ImageFrame, PixelSystem
from unbend.tables.refraction_mark import Direction, refuse_done
from unbend.tables.row_sample import RowSample
from unbend.tables.text_columns import refuse_other_pixels, require_columns
from unbend.tables.written_columns import DISPLACED_COLUMNS, OBSERVATION_COLUMNS
from unbend.units import Array, Mask

_SCANNED_ROWS = 1 << 20  # read at a time for the names of images
_SELECTED_ROWS = 1 << 18  # read at a time where some of them are selected

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

    def number_of(self, row: int) -> int:
        """The place in the table of a row of the batch."""
        if self.numbers is not None:
            return int(self.numbers[row])
        return self.first_row + row

    def without_image(self, rows: NDArray[np.int64]) -> Mask:
        """(k,) Which of some rows (k,) have no name of an image: an empty or a blank cell."""
        names = pc.fill_null(self.image.take(pa.array(rows)), "")
        is_blank = pc.equal(pc.utf8_trim_whitespace(names), "")
        return np.asarray(is_blank.to_numpy(zero_copy_only=False), np.bool_)

    def taken(self, rows: NDArray[np.int64]) -> "Batch":
        """Some of its rows, without the user's columns."""
        numbers = self.numbers
        if numbers is None:
            numbers = np.arange(len(self)) + self.first_row
        columns: dict[str, Any] = {}
        for name, values in vars(self).items():
            if isinstance(values, np.ndarray):
                columns[name] = values[rows]
        columns["image"] = self.image.take(rows)
        columns["point"] = self.point.take(rows)
        columns["users"] = {}
        columns["numbers"] = numbers[rows]
        return replace(self, **columns)


@dataclass(frozen=True, eq=False)
class Observations:
    """A table of observations, opened and checked, not yet read.

    ``user_fields`` are the columns that pass through, under the names they leave with; ``pixels``
    the system of the table's pixels, ``points`` give the heights where they do. A database of
    keypoints has no points (``has_points``). Coordinates in millimetres have a ``frame``. An empty
    or blank cell is not among the ``images``.
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
    _records: Records = field(
        repr=False,
        default=lambda rows, only, first: iter(()),
    )

    def sampled(self, *, points: bool = False) -> Batch:
        """The rows that were drawn when the table was opened, without the user's columns.

        Their ``points`` are read where they are asked for, or have the heights; then all is kept.
        """
        if self._drawn:
            return self._drawn[0]
        drawn = self.sample or RowSample(0)
        unread: tuple[str, ...] = ()
        if not points and self.points is None:
            unread = (self.columns["point"],)

        def of_sample(records: pa.RecordBatch, first: int) -> NDArray[np.int64]:
            begin, end = np.searchsorted(drawn.number, (first, first + len(records)))
            return drawn.number[begin:end] - first

        batch = replace(self.selected(of_sample, unread=unread), weight=drawn.weights)
        if points:
            self._drawn.append(batch)
        return batch

    def of_points(
        self,
        chosen: Callable[[NDArray[np.uint64]], NDArray[np.int64]],
        most_rows: int = 1 << 62,
    ) -> Batch:
        """The rows whose points' hashes are chosen, of the first ``most_rows``; else as `sampled`.

        ``chosen`` gives the rows (k,) to take of the hashes (n,) of a part of the table. Image
        points of a block that belong to no point are left out: they tie nothing.
        """

        def of_hashes(records: pa.RecordBatch, first: int) -> NDArray[np.int64]:
            point = self.columns["point"]
            if not self.is_block:
                return chosen(hashes_of(records[point].cast(pa.string())))
            tied = rows_with_point(records, self.columns["image"], point)
            if tied.size == 0:
                return tied
            return tied[chosen(hashes_of(records[point].take(tied)))]

        return self.selected(of_hashes, most_rows=most_rows if self.has_points else 0)

    def selected(
        self,
        chosen: Callable[[pa.RecordBatch, int], NDArray[np.int64]],
        *,
        unread: tuple[str, ...] = (),
        most_rows: int = 1 << 62,
    ) -> Batch:
        """Rows (k,) that are chosen of each part of the table, which begins at a row."""
        image = self.columns["image"]
        wanted = {*self.columns.values(), self.ground_column, self.sigma_column}
        wanted -= {None, image, *unread}
        names = [image, *sorted(name for name in wanted if name)]
        first = 0
        parts = []
        numbers = []
        for records in self._records(_SELECTED_ROWS, names, 0):
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
            users = {field.name: self._sources[field.name] for field in self.user_fields}
            yield replace(self._batch(table, users), first_row=first_row)
            first_row += table.num_rows

    def _batch(
        self,
        table: pa.Table,
        users: Mapping[str, str],
    ) -> Batch:
        """A slice of the table; ``users`` names the user's columns of it."""
        arrays = _plain_arrays(table)
        image = self._names("image", arrays, table.num_rows)
        point = self._names("point", arrays, table.num_rows)
        x = measured_floats(arrays[self.columns["x_px"]])
        y = measured_floats(arrays[self.columns["y_px"]])
        if self.frame is None:
            x_px = self.pixels.to_colmap(x)
            y_px = self.pixels.to_colmap(y)
        else:
            x_px, y_px = self.frame.to_colmap(x, y)
            x = self.pixels.from_colmap(x_px)
            y = self.pixels.from_colmap(y_px)
        batch = Batch(
            image=image,
            point=point,
            x_px=x_px,
            y_px=y_px,
            x_given_px=x,
            y_given_px=y,
            ground=None,
            users={name: arrays[source] for name, source in users.items()},
        )
        if self.points is not None:
            ground, row = self.points.heights(point, image)
            no_point = int(((row < 0) & np.isnan(ground)).sum())
            batch = replace(batch, ground=ground, no_point=no_point)
        elif self.ground_column is not None:
            batch = replace(batch, ground=measured_floats(arrays[self.ground_column]))
        if "distance_m" in self.columns:
            distance_m, no_distance = at_least_zero(arrays[self.columns["distance_m"]], above=True)
            batch = replace(batch, distance_m=distance_m, no_distance=no_distance)
        if self.sigma_column is not None:
            ground_sigma, no_sigma = at_least_zero(arrays[self.sigma_column])
            batch = replace(batch, ground_sigma=ground_sigma, no_sigma=no_sigma)
        return batch

    def _names(
        self,
        role: str,
        arrays: Mapping[str, pa.Array],
        rows: int,
    ) -> pa.StringArray:
        """The names of images or points; null in a column that was not read."""
        column = arrays.get(self.columns[role])
        if column is None:
            column = pa.nulls(rows)
        return column.cast(pa.string())


def _plain_arrays(table: pa.Table) -> dict[str, pa.Array]:
    """The columns of a table by their names, each in one piece and not as a dictionary."""
    arrays = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        arrays[name] = column.combine_chunks()
    return arrays


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
    if frame is not None:
        replaced -= {named["x_px"], named["y_px"]}
    if ground_column == "h_g_m" and ground_is_msl:
        replaced.add("h_g_m")
    passed_on = [name for name in scan.schema.names if name not in replaced]
    sources = _written_names(passed_on, ledger)
    user_fields = []
    for written, original in sources.items():
        user_fields.append(pa.field(written, scan.schema.field(original).type))
    return Observations(
        path=path,
        columns=named,
        ground_column=ground_column,
        rows=scan.rows,
        images=tuple(sorted(name for name in scan.images if name and name.strip())),
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
    scan = scan_csv(
        path,
        names,
        (named["image"], named["point"]),
        numbers,
        add,
    )
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
        if is_block:
            tied = rows_with_point(batch, named["image"], named["point"])
            has_points = has_points or tied.size > 0
            points = batch.column(1).take(tied).to_pandas()
            for point in points[points.duplicated()]:
                repeated.append(f"{point} in {batch.column(0)[0]}")
        names = batch.column(0)
        if not pa.types.is_dictionary(names.type):
            names = names.cast(pa.string())
        images.update(pc.unique(names).to_pylist())
        if sample is not None:
            sample.add(names)
    if repeated:
        count = len(repeated)
        ledger.add(
            messages.points_repeated(
                where=path.name,
                count=count,
                first=repeated[0],
            )
        )
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
    for user_name in users:
        name = user_name
        while name in _OURS or name in sources:
            name += "_input"
        if name != user_name:
            ledger.add(messages.column_renamed(column=user_name, written=name))
        sources[name] = user_name
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
                waiting = []
                count = 0
    if waiting:
        yield pa.Table.from_batches(waiting)
