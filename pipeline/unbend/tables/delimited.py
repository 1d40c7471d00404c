"""CSV: each column gets the type that fits all of its values, and no value is altered.

A column gets a type only if its text can be restored from the typed values. Digits that are not
plain numbers, such as 007, +49 or 12345678901234567890, stay text. The separator of the fields and
the decimal mark are recognised from the file (`unbend.table_dialect`).
"""

import codecs
import io
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv

from unbend.table_dialect import BLANKS, TableForm, form_of
from unbend.tables import messages

_BLOCK_BYTES = 4 << 20  # that Arrow reads and converts at a time
_HEAD_BYTES = 1 << 18  # at the start of a file, from which its form is recognised

_WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of zip archives, as .xlsx and .ods are, and of old .xls files."""

_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # spreadsheets write it as "Unicode text"


@dataclass(frozen=True)
class TextTable:
    """A table in a text file, its encoding, and its form: separator, header and decimal mark."""

    path: Path
    encoding: str
    form: TableForm


def text_file(path: Path) -> TextTable:
    """Recognise the encoding and the form of a table from its first quarter of a megabyte.

    Raises ValueError if the text is neither UTF-8 nor UTF-16, and where `form_of` does.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
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
        del lines[-1]  # cut off by the limit of bytes
    return TextTable(path, encoding, form_of(lines))


class _TabSeparatedFile(io.RawIOBase):
    """A file with fields separated by blanks, read as UTF-8 with one tab in place of the blanks.

    ``encoding``: ``utf-16``, or any name of UTF-8.
    """

    def __init__(self, path: Path, encoding: str) -> None:
        self._file: IO[bytes] | codecs.StreamRecoder = path.open("rb")
        if encoding == "utf-16":
            self._file = codecs.EncodedFile(
                self._file, data_encoding="utf-8", file_encoding=encoding
            )
        self._unread = b""  # converted lines that no buffer has taken yet

    def readable(self) -> bool:
        """Always True, as `io.RawIOBase` asks of a file that can be read."""
        return True

    def readinto(self, buffer: "memoryview[int]") -> int:  # type: ignore[override]
        """Fill the buffer with the next converted bytes; returns their number, 0 at the end."""
        if not self._unread:
            whole_lines = self._file.read(1 << 20) + self._file.readline()
            self._unread = separated_by_tabs(whole_lines)
        part = self._unread[: len(buffer)]
        self._unread = self._unread[len(part) :]
        buffer[: len(part)] = part
        return len(part)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def separated_by_tabs(lines: bytes) -> bytes:
    """Replace the blanks between fields by one tab; blanks within quotes stay.

    Blanks at the ends of a line are removed.

    >>> separated_by_tabs(b'  IMG_1.JPG  1.5   2 \\n"a b" 3 4\\n')
    b'IMG_1.JPG\\t1.5\\t2\\n"a b"\\t3\\t4\\n'
    """
    lines = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", lines)
    if b'"' not in lines:
        return re.sub(rb"[ \t]+", b"\t", lines)
    # Group 1 is a quoted field, which stays; without it the match is blanks.
    return re.sub(rb'("[^"\n]*")|[ \t]+', lambda match: match[1] or b"\t", lines)


@dataclass(frozen=True, eq=False)
class _Kind:
    """A type, and the regular expression of the texts that it represents without loss.

    ``is_checked_by_cast``: whether a text of this form can still be invalid, as 2025-02-31 is.
    """

    type: pa.DataType
    pattern: str
    is_checked_by_cast: bool = False

    def fits(self, values: pa.StringArray) -> bool:
        """Whether all values that are not null match the pattern and can be converted."""
        # The minimum of booleans is False if one does not match, and None if all are null.
        if pc.min(pc.match_substring_regex(values, self.pattern)).as_py() is False:
            return False
        if self.is_checked_by_cast:
            try:
                values.cast(self.type)
            except pa.ArrowInvalid:  # the 31st of February
                return False
        return True


def _any_of(*forms: str) -> str:
    """A regular expression of a whole field that has one of the forms, with blanks around it.

    Arrow ignores these blanks when it reads numbers.
    """
    return rf"^[ \t]*(?:{'|'.join(forms)})[ \t]*$"


_WORDS = "nan|NaN|[-+]?inf"
_POWER = "[eE][-+]?0?[0-9]{1,2}"
_DAY = "[0-9]{4}-[0-9]{2}-[0-9]{2}"
_SECOND = f"{_DAY}[ T][0-9]{{2}}:[0-9]{{2}}:[0-9]{{2}}"  # a date and a time to the second
_ANY_NUMBER = _any_of(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", _WORDS)

_NUMBER = _Kind(pa.float64(), _ANY_NUMBER)
_CODE = _Kind(pa.string(), _ANY_NUMBER)  # digits that stay text, such as 007
_TEXT = _Kind(pa.string(), "")
_PLAIN_NUMBER = _any_of(
    "-?(?:0|[1-9][0-9]{0,14})",
    rf"[-+]?(?:(?:0|[1-9][0-9]*)\.[0-9]*|\.[0-9]+)(?:{_POWER})?",
    f"[-+]?(?:0|[1-9][0-9]*){_POWER}",
    _WORDS,
)
# In order of preference. The patterns allow as many digits as int64 and float64 represent exactly.
_KINDS = (
    _Kind(pa.int64(), _any_of("0", "-?[1-9][0-9]{0,17}", "-?[1-8][0-9]{18}")),
    _Kind(pa.float64(), _PLAIN_NUMBER),
    _Kind(pa.bool_(), "^(?:true|True|TRUE|false|False|FALSE)$"),
    _Kind(pa.date32(), f"^{_DAY}$", is_checked_by_cast=True),
    _Kind(pa.timestamp("s"), f"^{_SECOND}$", is_checked_by_cast=True),
    _Kind(pa.timestamp("s", "UTC"), f"^{_SECOND}Z$", is_checked_by_cast=True),
    _Kind(pa.timestamp("ns"), rf"^{_SECOND}(?:\.[0-9]{{1,9}})?$", is_checked_by_cast=True),
    _Kind(pa.timestamp("ns", "UTC"), rf"^{_SECOND}(?:\.[0-9]{{1,9}})?Z$", is_checked_by_cast=True),
    _CODE,
)


@dataclass(frozen=True, eq=False)
class CsvScan:
    """The contents of a CSV: the number of rows, the names of images and the types of columns.

    ``codes`` are the columns of digits that stay text.
    """

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
    """Read all rows of a CSV to find the type of each of its columns.

    ``names`` are all columns. ``texts`` are the columns of images and of points: text, even if all
    values are digits. ``numbers`` become float64, or text if a value is not a number. ``add_names``
    is called with the images (n,) of each block of rows, in their order.
    """
    kinds: dict[str, tuple[_Kind, ...]] = dict.fromkeys(names, _KINDS)  # that still fit a column
    for name in texts:
        kinds[name] = ()
    for name in numbers:
        kinds[name] = (_NUMBER,)
    filled = set(numbers)  # columns with a value; an empty column of numbers is float64 too
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
                    kinds[name] = _kinds_that_fit(
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
    """The first of the kinds that fit a column; text if none fits or the column has no value."""
    if not kinds or not is_filled:
        return _TEXT
    return kinds[0]


def _kinds_that_fit(
    kinds: tuple[_Kind, ...], values: pa.StringArray, *, decimal_comma: bool
) -> tuple[_Kind, ...]:
    """The kinds that fit all values (n,), in their order.

    ``decimal_comma``: whether 1,5 is one and a half in this file.
    """
    numbers = points_for_commas(values) if decimal_comma else values
    fitting = []
    for kind in kinds:
        texts = numbers if kind.type == pa.float64() else values
        if kind.fits(texts):
            fitting.append(kind)
    return tuple(fitting)


def points_for_commas(values: pa.StringArray) -> pa.StringArray:
    """Replace decimal commas by points; a text with a point becomes one that is not a number.

    >>> points_for_commas(pa.array(["1,5", "1.000"])).to_pylist()
    ['1.5', '1_000']
    """
    without_points = pc.replace_substring(values, ".", "_")
    return pc.replace_substring(without_points, ",", ".")


def open_csv(
    path: Path, types: Mapping[str, pa.DataType], only: list[str] | None = None
) -> pa_csv.CSVStreamingReader:
    """Open a CSV as a stream of record batches; its form is recognised by `text_file`.

    ``types`` of columns by name; Arrow infers the others. ``only`` names the columns to read, None
    for all. Only an empty field is null: ``NA`` can be the code of Namibia.
    """
    file = text_file(path)
    form = file.form
    read = pa_csv.ReadOptions(block_size=_BLOCK_BYTES, skip_rows=form.lines_before)
    if not form.head_is_row:
        read.column_names = list(form.names)
    has_blanks = form.separator == BLANKS
    if file.encoding == "utf-16" and not has_blanks:
        read.encoding = "utf-16"
    separator = "\t" if has_blanks else form.separator
    parse = pa_csv.ParseOptions(newlines_in_values=True, delimiter=separator)
    convert = pa_csv.ConvertOptions(
        column_types=types,
        include_columns=only,
        decimal_point="," if form.decimal_comma else ".",
        null_values=[""],
        strings_can_be_null=True,
        quoted_strings_can_be_null=False,
    )
    source = _TabSeparatedFile(path, file.encoding) if has_blanks else path
    return pa_csv.open_csv(source, read, parse, convert)
