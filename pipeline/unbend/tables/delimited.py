"""CSV: a column has the type that fits each of its values, and nothing is altered.

A column is given a type only if each of its values can be had back from it. Digits that are no
plain number, such as 007, +49 or 12345678901234567890, stay text.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv

from unbend.tables import messages

_BLOCK_BYTES = 4 << 20


@dataclass(frozen=True, eq=False)
class _Kind:
    """A type, and the form of the values that it holds without changing them."""

    type: pa.DataType
    pattern: str
    parsed: bool = False

    def holds(self, values: pa.StringArray) -> bool:
        """Whether all values that are not null have the form, and can be read."""
        # Without a value, the least of booleans is null: then any type fits.
        if pc.min(pc.match_substring_regex(values, self.pattern)).as_py() is False:
            return False
        if self.parsed:
            try:
                values.cast(self.type)
            except pa.ArrowInvalid:  # the 31st of February
                return False
        return True


def _whole(*forms: str) -> str:
    """One of the forms, and spaces around it as the reader of numbers takes them."""
    return rf"^[ \t]*(?:{'|'.join(forms)})[ \t]*$"


_WORDS = "nan|NaN|[-+]?inf"
_POWER = "[eE][-+]?0?[0-9]{1,2}"
_DAY = "[0-9]{4}-[0-9]{2}-[0-9]{2}"
_SECOND = f"{_DAY}[ T][0-9]{{2}}:[0-9]{{2}}:[0-9]{{2}}"
_ANY_NUMBER = _whole(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", _WORDS)

_NUMBER = _Kind(pa.float64(), _ANY_NUMBER)
_CODE = _Kind(pa.string(), _ANY_NUMBER)
_PLAIN_NUMBER = _whole(
    "-?(?:0|[1-9][0-9]{0,14})", rf"[-+]?(?:(?:0|[1-9][0-9]*)\.[0-9]*|\.[0-9]+)(?:{_POWER})?",
    f"[-+]?(?:0|[1-9][0-9]*){_POWER}", _WORDS,
)  # fmt: skip
# In order of preference. The digits are as many as int64 and float64 hold exactly.
_KINDS = (
    _Kind(pa.int64(), _whole("0", "-?[1-9][0-9]{0,17}", "-?[1-8][0-9]{18}")),
    _Kind(pa.float64(), _PLAIN_NUMBER),
    _Kind(pa.bool_(), "^(?:true|True|TRUE|false|False|FALSE)$"),
    _Kind(pa.date32(), f"^{_DAY}$", parsed=True),
    _Kind(pa.timestamp("s"), f"^{_SECOND}$", parsed=True),
    _Kind(pa.timestamp("s", "UTC"), f"^{_SECOND}Z$", parsed=True),
    _Kind(pa.timestamp("ns"), rf"^{_SECOND}(?:\.[0-9]{{1,9}})?$", parsed=True),
    _Kind(pa.timestamp("ns", "UTC"), rf"^{_SECOND}(?:\.[0-9]{{1,9}})?Z$", parsed=True),
    _CODE,
)


@dataclass(frozen=True, eq=False)
class CsvScan:
    """What a CSV holds: its rows, its images, a type for each column, which digits are codes."""

    rows: int
    images: set[str]
    types: Mapping[str, pa.DataType]
    codes: tuple[str, ...]


def csv_names(path: Path) -> list[str]:
    """The names of the columns, in the order of the file."""
    try:
        with open_csv(path, {}) as reader:
            names: list[str] = reader.schema.names
    except (pa.ArrowInvalid, OSError, UnicodeDecodeError) as error:
        raise messages.observations_csv_unreadable(where=path, error=str(error)) from None
    if len(names) == 1 and any(mark in names[0] for mark in ";\t|"):
        raise messages.observations_without_commas(where=path)
    return names


def scan_csv(
    path: Path, names: Collection[str], texts: tuple[str, str], numbers: Collection[str],
    add_names: Callable[[pa.StringArray], None] | None = None,
) -> CsvScan:  # fmt: skip
    """Read a CSV once from end to end, to know the type of each of its columns.

    ``texts`` are the columns of images and points, text even where all are digits, ``numbers``
    float64 unless a value is no number. ``add_names`` is called with the images of the next rows.
    """
    image = texts[0]
    kinds: dict[str, tuple[_Kind, ...]] = {
        name: (_NUMBER,) if name in numbers else () if name in texts else _KINDS for name in names
    }
    filled = set(numbers)
    rows, images = 0, set()
    try:
        with open_csv(path, dict.fromkeys(names, pa.string())) as reader:
            for batch in reader:
                rows += batch.num_rows
                images.update(pc.unique(batch.column(image)).to_pylist())
                if add_names is not None:
                    add_names(batch.column(image))
                for name, left in kinds.items():
                    values = batch.column(name)
                    kinds[name] = tuple(kind for kind in left if kind.holds(values))
                    if values.null_count < len(values):
                        filled.add(name)
    except (pa.ArrowInvalid, OSError) as error:
        raise messages.observations_csv_unreadable(where=path, error=str(error)) from None
    chosen = {name: next(iter(left), None) for name, left in kinds.items() if name in filled}
    types = {name: kind.type if (kind := chosen.get(name)) else pa.string() for name in names}
    codes = tuple(name for name, kind in chosen.items() if kind is _CODE)
    return CsvScan(rows, images - {None}, types, codes)


def open_csv(
    path: Path, types: Mapping[str, pa.DataType], only: list[str] | None = None
) -> pa_csv.CSVStreamingReader:
    """A stream of the rows of a CSV; only an empty field is null.

    ``NA`` is a country, and ``nan`` reads as a number where one is due.
    """
    read = pa_csv.ReadOptions(block_size=_BLOCK_BYTES)
    parse = pa_csv.ParseOptions(newlines_in_values=True)
    nulls = {"null_values": [""], "strings_can_be_null": True, "quoted_strings_can_be_null": False}
    convert = pa_csv.ConvertOptions(column_types=types, include_columns=only, **nulls)
    return pa_csv.open_csv(path, read, parse, convert)
