"""Object points with their heights, from a table of the user, looked up by name."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from unbend.tables.geodata import messages
from unbend.tables.text_columns import (
    LINE_OF_FIRST_ROW,
    degrees_of,
    largest_of,
    numbers_of,
    refuse_beyond,
    require_names,
    text_table,
)
from unbend.units import Array, Integers

_CODES = (messages.POINTS_TABLE, messages.POINTS_COLUMN)


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """Points (p,) by name: positions on WGS 84, heights [m] in the reference of the observations.

    ``of_image`` : names of images (i,), and heights (i + 1,) that points without a height take in
    each of these images; the last one is for other images. None: such points have no height.
    """

    name: pa.StringArray
    lat_rad: Array
    lon_rad: Array
    h_m: Array
    of_image: tuple[pa.StringArray, Array] | None = None

    def heights(
        self,
        point: pa.StringArray,
        image: pa.StringArray,
    ) -> tuple[Array, Integers]:
        """(n,) heights [m] of observations, NaN where unknown, and (n,) rows of their points.

        ``point``, ``image`` (n,) : names of each observation's point and image. The row is -1 for
        a point that is not in the table.
        """
        row = matching_rows(point, self.name)
        h_m = np.append(self.h_m, np.nan)[row]  # the last one for row -1
        if self.of_image is not None:
            images, h_of_image = self.of_image
            h_m = np.where(np.isnan(h_m), h_of_image[matching_rows(image, images)], h_m)
        return h_m, row


def matching_rows(name: pa.StringArray, table_names: pa.StringArray) -> Integers:
    """(n,) the row in ``table_names`` of each name, -1 if it is not there, or null.

    Characters may be composed in one array and decomposed in the other (Unicode NFC, NFD).

    >>> matching_rows(pa.array(["b", None, "x", "a"]), pa.array(["a", "b"])).tolist()
    [1, -1, -1, 0]
    >>> matching_rows(pa.array(["A\\u0308"]), pa.array(["\\u00c4"])).tolist()
    [0]
    """
    encoded = name.dictionary_encode()
    distinct_names = encoded.dictionary
    is_ascii = pc.all(pc.string_is_ascii(table_names), min_count=0)
    if not is_ascii.as_py():
        table_names = pc.utf8_normalize(table_names, form="NFC")
        distinct_names = pc.utf8_normalize(distinct_names, form="NFC")
    row = pc.fill_null(pc.index_in(distinct_names, value_set=table_names), -1)
    row_of_code = row.to_numpy(zero_copy_only=False).astype(np.int64)
    row_of_code = np.append(row_of_code, -1)  # the last one: of null
    codes = pc.fill_null(encoded.indices, len(distinct_names))
    return np.asarray(row_of_code[codes.to_numpy(zero_copy_only=False)])


def read_object_points(
    path: Path, columns: Mapping[str, str], *, key: str
) -> tuple[pa.StringArray, dict[str, Array]]:
    """The names (p,) of points, and the other columns (p,) by quantity, of a CSV or Parquet table.

    ``columns`` : the user's names of columns by quantity: point, height, and x, y or longitude,
    latitude. ``key`` : the key of ``columns`` in the mission file, for messages. Refuses
    (InputError) a missing column, a column without numbers, and points that occur twice.
    """
    if path.suffix.lower() in (".parquet", ".pq"):
        points, values = _points_of_parquet(path, columns, key)
    else:
        points, values = _points_of_text(path, columns, key)
    counted = points.value_counts()
    if len(counted) == 0:
        raise messages.points_empty(where=path)
    is_repeated = pc.greater(counted.field("counts"), 1)
    repeated = counted.filter(is_repeated).field("values")
    if len(repeated):
        first = repr(repeated[0].as_py())
        raise messages.points_repeated(where=path, count=len(repeated), first=first)
    return points, values


def _points_of_parquet(
    path: Path, columns: Mapping[str, str], key: str
) -> tuple[pa.StringArray, dict[str, Array]]:
    """As `read_object_points`, of a Parquet table; names may occur twice."""
    try:
        required = [(quantity, name, f"{key}.{quantity}") for quantity, name in columns.items()]
        names_in_file = pq.read_schema(path).names
        require_names(messages.POINTS_COLUMN, path, names_in_file, required)
        table = pq.read_table(path, columns=list(columns.values()))
        points = table[columns["point"]].cast(pa.string()).combine_chunks()
        values = {}
        for quantity, name in columns.items():
            if quantity != "point":
                values[quantity] = table[name].cast(pa.float64(), safe=False).to_numpy()
    except (pa.ArrowException, OSError) as error:
        raise messages.points_table(where=path, error=str(error)) from None
    lines = np.arange(len(points)) + LINE_OF_FIRST_ROW  # as of a CSV, for messages
    for quantity, numbers in values.items():
        name = columns[quantity]
        largest = largest_of(quantity)
        refuse_beyond(
            numbers,
            largest,
            path,
            messages.POINTS_TABLE,
            column=name,
            lines=lines,
        )
    return points, values


def _points_of_text(
    path: Path, columns: Mapping[str, str], key: str
) -> tuple[pa.StringArray, dict[str, Array]]:
    """As `read_object_points`, of a text table; names may occur twice."""
    text = text_table(path, columns, codes=_CODES, key=key)
    lines = text.index.to_numpy()
    code = messages.POINTS_TABLE
    values = {}
    for quantity, name in columns.items():
        largest = largest_of(quantity)
        if quantity in ("latitude", "longitude"):
            degrees = degrees_of(text, name, path, code, quantity=quantity)
            refuse_beyond(
                degrees,
                largest,
                path,
                code,
                column=name,
                lines=lines,
            )
            values[quantity] = degrees
        elif quantity != "point":
            values[quantity] = numbers_of(text, name, path, code, largest)
    points = text[columns["point"]].str.strip()
    return pa.array(points, pa.string()), values
