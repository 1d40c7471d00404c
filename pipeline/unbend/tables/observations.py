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
from unbend.tables.measured_columns import measured_floats, valid_magnitudes
from unbend.tables.name_hashes import hashes_of
from unbend.tables.observation_files import (
    OpenedTable,
    Records,
    csv_records,
    in_memory,
    open_file,
    plain_arrays,
    row_slices,
)
from unbend.tables.pixels import COLMAP, ImageFrame, PixelSystem
from unbend.tables.refraction_mark import Direction, refuse_marked_table
from unbend.tables.row_sample import RowSample
from unbend.tables.text_columns import refuse_other_pixels, require_columns
from unbend.tables.written_columns import DISPLACED_COLUMNS, OBSERVATION_COLUMNS
from unbend.units import Array, Mask

_SCANNED_ROWS = 1 << 20  # read at a time when a table is opened: only the names of images
_SELECTED_ROWS = 1 << 18  # read at a time when some rows are selected
_ALL_ROWS = 1 << 62  # as a limit that no table reaches

# A user's column with one of these names could be mistaken for a result, in either direction.
_OURS = OBSERVATION_COLUMNS.keys() | DISPLACED_COLUMNS.keys()


@dataclass(frozen=True, eq=False)
class Batch:
    """Rows (n,) of the table of observations, in the order of the file.

    ``x_px``, ``y_px`` are COLMAP's pixels; ``x_given_px``, ``y_given_px`` the pixels of the table.
    ``ground`` are ground heights [m], None without a column or object points for them.
    ``users`` are the user's other columns by the names that they are written with.

    ``distance_m`` are slant ranges, NaN if absent or invalid; ``no_distance`` counts the invalid
    ones: zero, negative, infinite or other text. ``ground_sigma`` are standard deviations of ground
    heights [m], and ``no_sigma`` counts the invalid ones, but zero is valid. ``no_point`` counts
    rows with a point that the table of object points lacks.

    Consecutive rows have ``first_row``, the index of the first one in the table. Selected rows have
    ``numbers`` (n,), their indices in the table, and in a sample ``weight`` (n,), how many rows of
    the table each one represents.
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
        """The indices of the batch's rows in the table."""
        if self.numbers is not None:
            return self.numbers
        return slice(self.first_row, self.first_row + len(self))

    def __len__(self) -> int:
        return len(self.image)

    def number_of(self, row: int) -> int:
        """The index in the table of a row of the batch."""
        if self.numbers is not None:
            return int(self.numbers[row])
        return self.first_row + row

    def is_image_missing(self, rows: NDArray[np.int64]) -> Mask:
        """(k,) whether the cell of the image is empty or blank, for rows (k,) of the batch."""
        names = pc.fill_null(self.image.take(pa.array(rows)), "")
        is_blank = pc.equal(pc.utf8_trim_whitespace(names), "")
        return np.asarray(is_blank.to_numpy(zero_copy_only=False), np.bool_)

    def subset(self, rows: NDArray[np.int64]) -> "Batch":
        """A batch of the rows (k,) of this one, without the user's columns.

        The counts, such as ``no_distance``, remain those of this batch.
        """
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
    """A table of observations that was opened and checked; `batches` read its rows.

    ``columns`` : image, point, x_px, y_px and perhaps distance_m -> the name of the column.
    ``images`` are the sorted names of all images, without empty and blank ones. ``user_fields`` are
    the columns that pass through to the results, with their names there. ``pixels`` is the system
    of the table's pixels, ``frame`` that of coordinates in millimetres, else None. ``points`` are
    the object points that give the ground heights, None if they do not. ``has_points`` is False for
    a block in which no keypoint belongs to a point, such as a database of COLMAP.
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
    # The batch of `sampled` with its points, once it was read.
    _sampled_batch: list[Batch] = field(init=False, repr=False, default_factory=list)
    # Names that the user's columns are written with -> names in the table.
    _sources: Mapping[str, str] = field(repr=False, default_factory=dict)
    _records: Records = field(
        repr=False,
        default=lambda rows, only, first: iter(()),
    )

    def sampled(self, *, points: bool = False) -> Batch:
        """The rows that were drawn when the table was opened, without the user's columns.

        ``points``: whether names of points are needed; else they are null, unless they are read for
        the heights. A batch with them is kept for the next call.
        """
        if self._sampled_batch:
            return self._sampled_batch[0]
        sample = self.sample or RowSample(0)
        unread: tuple[str, ...] = ()
        if not points and self.points is None:
            unread = (self.columns["point"],)

        def rows_of_sample(records: pa.RecordBatch, first_row: int) -> NDArray[np.int64]:
            begin, end = np.searchsorted(sample.number, (first_row, first_row + len(records)))
            return sample.number[begin:end] - first_row

        batch = replace(self._selected(rows_of_sample, unread=unread), weight=sample.weights)
        if points:
            self._sampled_batch.append(batch)
        return batch

    def rows_of_points(
        self,
        choose: Callable[[NDArray[np.uint64]], NDArray[np.int64]],
        most_rows: int = _ALL_ROWS,
    ) -> Batch:
        """The rows with chosen points, without the user's columns.

        ``choose`` gets the hashes (n,) of the points of n rows (see `hashes_of`), and returns the
        indices (k,) of those to take. Reading ends after about ``most_rows`` rows. Keypoints of a
        block that belong to no point are left out: they tie no images.
        """

        def rows_of_hashes(records: pa.RecordBatch, _: int) -> NDArray[np.int64]:
            point = self.columns["point"]
            if not self.is_block:
                return choose(hashes_of(records[point].cast(pa.string())))
            tied_rows = rows_with_point(records, self.columns["image"], point)
            if tied_rows.size == 0:
                return tied_rows
            return tied_rows[choose(hashes_of(records[point].take(tied_rows)))]

        # Without points the first part is enough: no row of it is taken.
        return self._selected(rows_of_hashes, most_rows=most_rows if self.has_points else 0)

    def _selected(
        self,
        choose: Callable[[pa.RecordBatch, int], NDArray[np.int64]],
        *,
        unread: tuple[str, ...] = (),
        most_rows: int = _ALL_ROWS,
    ) -> Batch:
        """The chosen rows of the table, without the user's columns.

        ``choose`` gets consecutive rows and the index of the first in the table, and returns the
        indices (k,) within these rows. ``unread`` are columns to leave out. Reading ends with the
        part in which ``most_rows`` are reached.
        """
        image = self.columns["image"]
        wanted = {*self.columns.values(), self.ground_column, self.sigma_column}
        wanted -= {None, image, *unread}
        names = [image, *sorted(name for name in wanted if name)]
        first_row = 0
        parts = []
        numbers = []
        for records in self._records(_SELECTED_ROWS, names, 0):
            rows = choose(records, first_row)
            parts.append(records.take(pa.array(rows)))
            numbers.append(rows + first_row)
            first_row += len(records)
            if first_row >= most_rows:
                break
        batch = self._batch_of(pa.Table.from_batches(parts), {})
        return replace(batch, numbers=np.concatenate(numbers))

    def rows_of_part(self, batch_rows: int) -> int:
        """How many rows each part of the results has, but for the last: at most ``batch_rows``."""
        # A block has many more keypoints than tie points: with 32,768 they take less than 100 MB.
        return min(batch_rows, 1 << 15) if self.is_block else batch_rows

    def batches(
        self, batch_rows: int, first_part: int = 0, stop: int | None = None
    ) -> Iterator[Batch]:
        """All rows of the parts from ``first_part`` up to, not including, ``stop``, in their order.

        A part has `rows_of_part` rows; the parts count from 0, and without ``stop`` the last one is
        included. Earlier rows are skipped without decoding them, if the format allows that.
        """
        batch_rows = self.rows_of_part(batch_rows)
        first_row = first_part * batch_rows
        slices = row_slices(self._records(batch_rows, None, first_row), batch_rows)
        for table in islice(slices, None if stop is None else stop - first_part):
            users = {field.name: self._sources[field.name] for field in self.user_fields}
            yield replace(self._batch_of(table, users), first_row=first_row)
            first_row += table.num_rows

    def _batch_of(self, table: pa.Table, users: Mapping[str, str]) -> Batch:
        """The rows of ``table`` with pixels and heights converted; row indices are not set.

        ``users`` : names that the user's columns are written with -> names in the table.
        """
        arrays = plain_arrays(table)
        image = self._names("image", arrays, table.num_rows)
        point = self._names("point", arrays, table.num_rows)
        x = measured_floats(arrays[self.columns["x_px"]])
        y = measured_floats(arrays[self.columns["y_px"]])
        if self.frame is None:
            x_px = self.pixels.to_colmap(x)
            y_px = self.pixels.to_colmap(y)
        else:  # x and y are in the unit of the frame, until they are pixels
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
            ground, row_of_point = self.points.heights(point, image)
            no_point = int(((row_of_point < 0) & np.isnan(ground)).sum())
            batch = replace(batch, ground=ground, no_point=no_point)
        elif self.ground_column is not None:
            batch = replace(batch, ground=measured_floats(arrays[self.ground_column]))
        if "distance_m" in self.columns:
            distance_m, no_distance = valid_magnitudes(
                arrays[self.columns["distance_m"]], zero_is_valid=False
            )
            batch = replace(batch, distance_m=distance_m, no_distance=no_distance)
        if self.sigma_column is not None:
            ground_sigma, no_sigma = valid_magnitudes(arrays[self.sigma_column])
            batch = replace(batch, ground_sigma=ground_sigma, no_sigma=no_sigma)
        return batch

    def _names(self, role: str, arrays: Mapping[str, pa.Array], rows: int) -> pa.StringArray:
        """(rows,) names of the role "image" or "point"; all null if the column was not read.

        ``arrays`` are the columns that were read, by name.
        """
        column = arrays.get(self.columns[role])
        if column is None:
            column = pa.nulls(rows)
        return column.cast(pa.string())


def open_observations(  # noqa: PLR0913
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
    """Open a table of observations, and check its columns, its marks of refraction and its images.

    Parameters
    ----------
    path : the file, or the name of a ``table`` in memory.
    columns : image, point, x_px, y_px -> the user's name of the column; distance_m too, if there
        is one: it also passes through to the results.
    ground_column : the column of ground heights, or None if there is none.
    ground_is_msl : whether these heights are above mean sea level, as our ``h_g_m`` is. Any other
        column named ``h_g_m`` passes through as ``h_g_m_input``.
    ledger : where notes and losses are added.
    sigma_column : the column of standard deviations of the ground heights, which passes through.
    direction : whether refraction will be removed from these observations or applied to them.
    pixels : the pixel system of the table and of the results.
    frame : the frame of coordinates that are not pixels; these pass through to the results.
    most_rows : draw that many rows, spread over the images, for `Observations.sampled`.
    file_format : csv, parquet, or one of `BLOCKS`; by default the ending of the file decides.
    table : a table in memory, which is read in the place of the file.

    Refuses (InputError) a table that already has refraction removed (or applied), lacks a column,
    or has two columns of one name. A point that occurs twice in an image of a block is a loss.
    """
    opened = open_file(path, file_format) if table is None else in_memory(table)
    schema = opened.schema
    named = {role: name for role, name in columns.items() if name is not None}
    wanted = [(role, name, f"observations.columns.{role}") for role, name in named.items()]
    if ground_column:
        wanted.append(("ground height", ground_column, "ground.height.column"))
    if sigma_column:
        wanted.append(("sigma of the ground", sigma_column, "ground.sigma_column"))
    refuse_marked_table(path, schema, direction, is_file=table is None)
    refuse_other_pixels(path, schema, direction, named)
    require_columns(path, schema, wanted)

    # Read the images of all rows, and the types of the columns of a CSV.
    sample = None if most_rows is None else RowSample(most_rows)
    if opened.kind == "csv":
        numbers = {named["x_px"], named["y_px"], ground_column or ""} & set(schema.names)
        scan = _scan_of_csv(path, schema.names, named, numbers, sample, ledger)
        require_columns(path, scan.schema, wanted)  # now with the types that the values have
    else:
        scan = _scan_of_names(path, opened, named, sample, ledger)
    if scan.rows == 0:
        raise messages.observations_empty(where=path)

    # The user's columns that pass through: all that the results do not replace.
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
    """Facts about a table that need all of its rows, and the function that reads them again."""

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
    """Read all rows of a CSV for their images and for the types of its columns.

    ``names`` are all columns, ``named`` maps image and point to theirs, and ``numbers`` are the
    columns that have to be numbers. Adds the images to ``sample`` and notes to ``ledger``.
    """
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
    """Read the images of all rows of a table that is not a CSV; adds them to ``sample``.

    ``named`` maps image and point to their columns. For a block, also reads whether there are
    points, and adds a loss to ``ledger`` if a point occurs twice in an image.
    """
    is_block = opened.kind in BLOCKS
    only = [named["image"], named["point"]] if is_block else [named["image"]]
    rows = 0
    images: set[str | None] = set()
    repeated: list[str] = []
    has_points = not is_block
    for batch in opened.records(_SCANNED_ROWS, only, 0):
        rows += batch.num_rows
        if is_block:  # one batch an image
            tied_rows = rows_with_point(batch, named["image"], named["point"])
            has_points = has_points or tied_rows.size > 0
            points = batch.column(1).take(tied_rows).to_pandas()
            for point in points[points.duplicated()]:
                repeated.append(f"{point} in {batch.column(0)[0]}")
        names = batch.column(0)
        if not pa.types.is_dictionary(names.type):
            names = names.cast(pa.string())
        images.update(pc.unique(names).to_pylist())
        if sample is not None:
            sample.add(names)
    if repeated:
        ledger.add(
            messages.points_repeated(where=path.name, count=len(repeated), first=repeated[0])
        )
    return _Scan(
        rows=rows,
        images=images,
        schema=opened.schema,
        records=opened.records,
        has_points=has_points,
    )


def _written_names(users: list[str], ledger: Ledger) -> dict[str, str]:
    """Name that each of the user's columns is written with -> its name in the table.

    A name of a result gets the ending ``_input``, with a note in the ledger.
    """
    sources: dict[str, str] = {}
    for user_name in users:
        written_name = user_name
        while written_name in _OURS or written_name in sources:
            written_name += "_input"
        if written_name != user_name:
            ledger.add(messages.column_renamed(column=user_name, written=written_name))
        sources[written_name] = user_name
    return sources
