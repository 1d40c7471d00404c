"""CSV: a column has the type that fits each of its values, and nothing is altered.

A column is given a type only if each of its values can be had back from it. Digits that are no
plain number, such as 007, +49 or 12345678901234567890, stay text. What parts the fields, and
whether decimals have a comma, the file itself shows (`unbend.table_dialect`).
"""

import codecs
import io
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv

from unbend.table_dialect import BLANKS, TableForm, form_of
from unbend.tables import messages

_BLOCK_BYTES = 4 << 20
_SHOWN_BYTES = 1 << 18  # of a file, by which its form is known

_WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of zip archives, as .xlsx and .ods are, and of old .xls files."""

_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # spreadsheets write it as "Unicode text"


@dataclass(frozen=True)
class WrittenTable:
    """A table in a text file: its encoding, and how its lines are written."""

    path: Path
    encoding: str
    form: TableForm


def text_file(path: Path) -> WrittenTable:
    """Recognise the encoding and the form of a table by its first quarter of a megabyte.

    Raises ValueError for what is no text in UTF-8 or UTF-16, and as `form_of`.
    """
    with path.open("rb") as file:
        head = file.read(_SHOWN_BYTES)
        is_whole = not file.read(1)
    encoding = "utf-16" if head.startswith(_UTF_16) else "utf-8-sig"
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(head, is_whole)
    except UnicodeDecodeError as error:
        if head.startswith(_WORKBOOKS):
            raise ValueError(
                "it is a workbook or another archive, not a text: save it as CSV (in Excel: CSV "
                "UTF-8)"
            ) from None
        byte = error.object[error.start]
        raise ValueError(
            f"its text is not UTF-8 (byte 0x{byte:02x} at {error.start}): save it as UTF-8"
        ) from None
    lines = text.splitlines()
    if not is_whole and len(lines) > 1:
        del lines[-1]
    return WrittenTable(path, encoding, form_of(lines))


class _PartedByTabs(io.RawIOBase):
    """A file whose fields any number of blanks parts, read as though single tabs did."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._ready = b""

    def readable(self) -> bool:
        """It can be read."""
        return True

    def readinto(self, buffer: "memoryview[int]") -> int:  # type: ignore[override]
        """Fill a buffer with whole lines, or parts of those that were read before."""
        if not self._ready:
            self._ready = parted_by_tabs(self._file.read(1 << 20) + self._file.readline())
        part = self._ready[: len(buffer)]
        self._ready = self._ready[len(part) :]
        buffer[: len(part)] = part
        return len(part)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def parted_by_tabs(lines: bytes) -> bytes:
    """Lines with a tab in place of the blanks between fields; those within quotes stay.

    >>> parted_by_tabs(b'  IMG_1.JPG  1.5   2 \\n"a b" 3 4\\n')
    b'IMG_1.JPG\\t1.5\\t2\\n"a b"\\t3\\t4\\n'
    """
    lines = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", lines)
    if b'"' not in lines:
        return re.sub(rb"[ \t]+", b"\t", lines)
    return re.sub(rb'("[^"\n]*")|[ \t]+', lambda found: found[1] or b"\t", lines)


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
_TEXT = _Kind(pa.string(), "")
_PLAIN_NUMBER = _whole(
    "-?(?:0|[1-9][0-9]{0,14})",
    rf"[-+]?(?:(?:0|[1-9][0-9]*)\.[0-9]*|\.[0-9]+)(?:{_POWER})?",
    f"[-+]?(?:0|[1-9][0-9]*){_POWER}",
    _WORDS,
)
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
    except (OSError, ValueError) as error:
        raise messages.observations_csv_unreadable(where=path, error=str(error)) from None
    return names


def scan_csv(
    path: Path,
    names: Collection[str],
    texts: tuple[str, str],
    numbers: Collection[str],
    add_names: Callable[[pa.StringArray], None] | None = None,
) -> CsvScan:
    """Read a CSV once from end to end, to know the type of each of its columns.

    ``texts`` are the columns of images and points, text even where all are digits, ``numbers``
    float64 unless a value is no number. ``add_names`` is called with the images of the next rows.
    """
    kinds: dict[str, tuple[_Kind, ...]] = dict.fromkeys(names, _KINDS)
    for name in texts:
        kinds[name] = ()
    for name in numbers:
        kinds[name] = (_NUMBER,)
    filled = set(numbers)
    rows = 0
    images = set()
    try:
        decimal_comma = text_file(path).form.decimal_comma
        with open_csv(path, dict.fromkeys(names, pa.string())) as reader:
            for batch in reader:
                rows += batch.num_rows
                images.update(pc.unique(batch.column(texts[0])).to_pylist())
                if add_names is not None:
                    add_names(batch.column(texts[0]))
                for name in names:
                    values = batch.column(name)
                    kinds[name] = _kinds_that_hold(
                        kinds[name],
                        values,
                        decimal_comma=decimal_comma,
                    )
                    if values.null_count < len(values):
                        filled.add(name)
    except (OSError, ValueError) as error:
        raise messages.observations_csv_unreadable(where=path, error=str(error)) from None
    chosen = {name: _chosen_kind(kinds[name], is_filled=name in filled) for name in names}
    return CsvScan(
        rows=rows,
        images=images - {None},
        types={name: kind.type for name, kind in chosen.items()},
        codes=tuple(name for name, kind in chosen.items() if kind is _CODE),
    )


def _chosen_kind(kinds: tuple[_Kind, ...], *, is_filled: bool) -> _Kind:
    """The first of the kinds that hold a column; text where none does, and without a value."""
    return kinds[0] if is_filled and kinds else _TEXT


def _kinds_that_hold(
    kinds: tuple[_Kind, ...], values: pa.StringArray, *, decimal_comma: bool
) -> tuple[_Kind, ...]:
    """Those of some kinds that hold values, whose numbers may have a decimal comma."""
    numbers = with_points(values) if decimal_comma else values
    holding = []
    for kind in kinds:
        if kind.holds(numbers if kind.type == pa.float64() else values):
            holding.append(kind)
    return tuple(holding)


def with_points(values: pa.StringArray) -> pa.StringArray:
    """Numbers with a decimal comma as those with a decimal point; those with a point are none."""
    without_points = pc.replace_substring(values, ".", "_")
    return pc.replace_substring(without_points, ",", ".")


def open_csv(
    path: Path, types: Mapping[str, pa.DataType], only: list[str] | None = None
) -> pa_csv.CSVStreamingReader:
    """A stream of the rows of a CSV, in whatever form; only an empty field is null.

    ``NA`` is a country, and ``nan`` reads as a number where one is due.
    """
    file = text_file(path)
    form = file.form
    read = pa_csv.ReadOptions(block_size=_BLOCK_BYTES, skip_rows=form.lines_before)
    if not form.head_is_row:
        read.column_names = list(form.names)
    if file.encoding == "utf-16":
        read.encoding = "utf-16"
    separator = "\t" if form.separator == BLANKS else form.separator
    parse = pa_csv.ParseOptions(newlines_in_values=True, delimiter=separator)
    convert = pa_csv.ConvertOptions(
        column_types=types,
        include_columns=only,
        decimal_point="," if form.decimal_comma else ".",
        null_values=[""],
        strings_can_be_null=True,
        quoted_strings_can_be_null=False,
    )
    source = _PartedByTabs(path) if form.separator == BLANKS else path
    return pa_csv.open_csv(source, read, parse, convert)
