"""Fields of sound inputs put at their limits, and what no result of reading them may hold.

The structure of an input stays whole. The inputs by kind are those of
`extreme_tables`, `extreme_blocks`, `extreme_weather` and `extreme_missions`.
"""

import random
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unbend.messages import Ledger

LONG = 140_000  # characters of a field that has far too many; csv takes 131,072
MOST_LONG_FIELDS = 20  # of one file: thousands would fill the disk, and take half a minute
LONG_OF_MANY = 2000  # characters of each where there are more
WORDS = (
    "0",
    "-1",
    "-5",
    str(2**31),
    str(2**32),
    str(2**53 + 1),
    str(2**63 - 1),
    str(2**63),
    str(2**64 - 1),
    str(2**64),
    str(-(2**63)),
    str(-(2**63) - 1),
    "1e3",
    "1e18",
    "1e19",
    "1e308",
    "-1e308",
    "1e400",
    "-1e400",
    "5e-324",
    "-0.0",
    "nan",
    "-nan",
    "inf",
    "-inf",
    "1_0",
    "٣",
    "0x7",
    "9" * 1000,
    "-" + "9" * 1000,
    "1e" + "9" * 30,
    "1" + "0" * 308,
    "",
    " ",
    "x",
    "\0",
    "a" * LONG,
    "9" * LONG,
    f"1{' ' * LONG}x",
    "<" * LONG,
    "²",
    "0000-01-01T00:00:00",
    "0001-01-01T00:00:00Z",
    "9999-12-31T23:59:59.999999999Z",
    "10000-01-01T00:00:00Z",
    "-0001-01-01T00:00:00Z",
    "-9999-01-01",
    "1677-09-21T00:12:43",
    "2262-04-11T23:47:17Z",
    "0001-01-01T00:00:00+23:59",
    "9999-12-31T23:59:59-23:59",
    "2016-12-31T23:59:60Z",
    "2026-02-30T00:00:00Z",
    "2026-05-14",
    "0/0",
    "1/0",
    "1/5e-324",
    "1e308/1e-308",
    "1/" + "9" * 400,
    "1899-12-31",
    "2500-01-01 00:00:00",
)
_FIELD = re.compile(r"[^\s,;|<>\"=\[\]{}()]*\d[^\s,;|<>\"=\[\]{}()]*")
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Reader:
    """A kind of input.

    write : puts an input with values at their limits into a folder, by a draw.
    read : opens the input of the folder as the package does.
    """

    write: Callable[[Path, random.Random], None]
    read: Callable[[Path], object]


def extreme_fields(text, draw):
    """A text some of whose fields, or the numbers in them, are at their limits.

    One field, some, or those in one place of every line. The word may keep the width of the field,
    as tables of fixed columns have it.
    """
    pattern = draw.choice((_FIELD, _FIELD, _NUMBER))
    lines = text.split("\n")
    fields = [(row, field) for row, line in enumerate(lines) for field in pattern.finditer(line)]
    chosen = _chosen(fields, draw)
    words = [draw.choice(WORDS) for _ in range(draw.choice((1, 1, 3)))]
    if len(chosen) > MOST_LONG_FIELDS:
        words = [word[:LONG_OF_MANY] for word in words]
    keeps_width = draw.random() < 0.2
    for row, field in reversed(chosen):
        word = draw.choice(words)
        if keeps_width:
            width = len(field[0])
            word = word[:width].rjust(width)
        line = lines[row]
        lines[row] = line[: field.start()] + word + line[field.end() :]
    return "\n".join(lines)


def _chosen(fields, draw):
    """Fields by row: one, some, or one column."""
    how = draw.random()
    if how < 0.4:
        return [draw.choice(fields)]
    if how < 0.6:
        share = draw.choice((0.02, 0.2, 1.0))
        return [field for field in fields if draw.random() < share]
    places = {}
    in_columns = {}
    for row, field in fields:
        place = places.get(row, 0)
        places[row] = place + 1
        in_columns.setdefault(place, []).append((row, field))
    return in_columns[draw.choice(list(in_columns))]


def of_texts(files, read: Callable[[Path], object]) -> Reader:
    """A kind whose input are files of text by name, one of which has the extreme fields."""

    def write(folder, draw):
        spoilt = draw.choice(list(files))
        for name, text in files.items():
            content = extreme_fields(text, draw) if name == spoilt else text
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content, "utf-8")

    return Reader(write, read)


def of_text(name, text, read: Callable[[Path, Ledger], object]) -> Reader:
    """A kind whose input is one file of text."""

    def read_folder(folder):
        return with_ledger(lambda ledger: read(folder / name, ledger))

    return of_texts({name: text}, read_folder)


NUMBERS = (
    0.0, -0.0, 1.0, -1.0, 2.0**31, 2.0**32, 2.0**63, 2.0**64, 1e18, 1e19, 1e308, -1e308, 5e-324,
    np.nan, np.inf, -np.inf, 9.97e36, -9999.0, 1e20, 3.4e38,
)  # fmt: skip


def extreme_numbers(values, draw):
    """Numbers some of which are at the limits of their type: one, or those of a column, or all."""
    changed = values.copy()
    flat = changed.reshape(-1, changed.shape[-1] if changed.ndim else 1)
    rows = slice(None) if draw.random() < 0.4 else draw.randrange(flat.shape[0])
    column = draw.randrange(flat.shape[1])
    flat[rows, slice(None) if draw.random() < 0.2 else column] = extreme_number(values.dtype, draw)
    return flat.reshape(values.shape)


def extreme_number(kind, draw):
    """A value at the limits of a type of numpy."""
    if kind.kind == "f":
        with np.errstate(over="ignore"):
            return np.array(draw.choice(NUMBERS)).astype(kind)
    if kind.kind in "mM":
        limits = np.iinfo(np.int64)
        number = draw.choice((limits.min, limits.min + 1, limits.max, 0, -1))
        return np.array(number, np.int64).view(kind)
    limits = np.iinfo(kind)
    negative = max(-1, limits.min)
    middle = limits.max // 2
    numbers = (limits.min, limits.max, 0, 1, negative, middle, middle + 1)
    return kind.type(draw.choice(numbers))


# What a result may hold: nothing infinite, no number beyond all that is measured, no other times.
LARGEST = 1e15
OLDEST_NS = -2_208_988_800 * 10**9  # 1900
LATEST_NS = 7_258_118_400 * 10**9  # 2200
NO_TIME = -(2**63)


def impossible_values(value, name="result"):
    """What of a result no measurement can be, by the names that lead to it."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        known = value[~np.isnan(value)].astype(np.float64)
        if known.size and float(np.abs(known).max()) > LARGEST and "sigma" not in name:
            yield f"{name}: {known[np.argmax(np.abs(known))]}"
    elif isinstance(value, np.ndarray) and name.endswith("time_ns"):
        known = value[value != NO_TIME]
        if known.size and not OLDEST_NS <= int(known.min()) <= int(known.max()) <= LATEST_NS:
            yield f"{name}: {int(known.min())} to {int(known.max())}"
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from impossible_values(inner, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        for place, inner in enumerate(value):
            yield from impossible_values(inner, f"{name}[{place}]")
    elif isinstance(value, float) or (isinstance(value, int) and name.endswith("time_ns")):
        yield from impossible_values(np.array([value]), name)
    elif hasattr(value, "__dict__") and not callable(value):
        yield from impossible_values(vars(value), name)


def with_ledger(read: Callable[[Ledger], object]):
    """What a reader returns, its ledger's sentences written as a report does it."""
    ledger = Ledger()
    result = read(ledger)
    for entry in ledger:
        if not (entry.what and entry.code):
            raise AssertionError(entry)
    return result
