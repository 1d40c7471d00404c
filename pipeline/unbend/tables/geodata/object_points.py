"""Object points with their heights, from a table of the user's, looked up by name."""

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
    """Points by name, (p,); places [rad] on WGS 84, heights [m] as observations have them.

    ``of_image`` are names of images, (i,), and (i + 1,) heights that points without one take there,
    and in other images.
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
        """(n,) heights [m] of named points, NaN where unknown; and their rows, -1 without one."""
        row = matching_rows(point, self.name)
        h_m = np.append(self.h_m, np.nan)[row]
        if self.of_image is not None:
            names, usual = self.of_image
            h_m = np.where(np.isnan(h_m), usual[matching_rows(image, names)], h_m)
        return h_m, row


def matching_rows(name: pa.StringArray, known: pa.StringArray) -> Integers:
    """(n,) the row of each name among those that are known, -1 where it is not.

    Characters may be composed in the one and decomposed in the other (Unicode NFC, NFD).

    >>> matching_rows(pa.array(["b", None, "x", "a"]), pa.array(["a", "b"])).tolist()
    [1, -1, -1, 0]
    >>> matching_rows(pa.array(["A\\u0308"]), pa.array(["\\u00c4"])).tolist()
    [0]
    """
    encoded = name.dictionary_encode()
    different = encoded.dictionary
    is_plain = pc.all(pc.string_is_ascii(known), min_count=0)
    if not is_plain.as_py():
        known = pc.utf8_normalize(known, form="NFC")
        different = pc.utf8_normalize(different, form="NFC")
    row = pc.fill_null(pc.index_in(different, value_set=known), -1)
    row_of_code = row.to_numpy(zero_copy_only=False).astype(np.int64)
    row_of_code = np.append(row_of_code, -1)  # the last one: of null
    codes = pc.fill_null(encoded.indices, len(different))
    return np.asarray(row_of_code[codes.to_numpy(zero_copy_only=False)])


def read_object_points(
    path: Path, columns: Mapping[str, str], *, key: str
) -> tuple[pa.StringArray, dict[str, Array]]:
    """Names (p,), and the other columns as numbers by quantity, of a CSV or Parquet table.

    ``columns`` : point, height, and x, y or longitude, latitude -> the user's names; ``key`` that
    of the mission file which names them. Refuses
    (InputError) a column that is not there or holds no numbers, and names that occur twice.
    """
    if path.suffix.lower() in (".parquet", ".pq"):
        given, values = _points_of_parquet(path, columns, key)
    else:
        given, values = _points_of_text(path, columns, key)
    counted = given.value_counts()
    if len(counted) == 0:
        raise messages.points_empty(where=path)
    is_repeated = pc.greater(counted.field("counts"), 1)
    repeated = counted.filter(is_repeated).field("values")
    if len(repeated):
        first = repr(repeated[0].as_py())
        raise messages.points_repeated(where=path, count=len(repeated), first=first)
    return given, values


def _points_of_parquet(
    path: Path, columns: Mapping[str, str], key: str
) -> tuple[pa.StringArray, dict[str, Array]]:
    """Names (p,), and the other columns as numbers, of a Parquet table."""
    try:
        wanted = [(quantity, name, f"{key}.{quantity}") for quantity, name in columns.items()]
        present = pq.read_schema(path).names
        require_names(messages.POINTS_COLUMN, path, present, wanted)
        table = pq.read_table(path, columns=list(columns.values()))
        given = table[columns["point"]].cast(pa.string()).combine_chunks()
        values = {}
        for quantity, name in columns.items():
            if quantity != "point":
                values[quantity] = table[name].cast(pa.float64(), safe=False).to_numpy()
    except (pa.ArrowException, OSError) as error:
        raise messages.points_table(where=path, error=str(error)) from None
    rows = np.arange(len(given)) + LINE_OF_FIRST_ROW
    for quantity, numbers in values.items():
        name = columns[quantity]
        largest = largest_of(quantity)
        refuse_beyond(
            numbers,
            largest,
            path,
            messages.POINTS_TABLE,
            column=name,
            lines=rows,
        )
    return given, values


def _points_of_text(
    path: Path, columns: Mapping[str, str], key: str
) -> tuple[pa.StringArray, dict[str, Array]]:
    """Names, and the other columns by quantity, of a table that is text."""
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
