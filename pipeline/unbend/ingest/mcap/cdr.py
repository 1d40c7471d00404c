"""CDR, the encoding of ROS 2 messages: all messages of a topic decoded at once, step by step.

A step reads at the cursors of all messages and moves them on. Numbers are aligned to their size, so
the layout of a run depends on where it begins modulo 8, which texts before it shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.buffers import Bytes, gather
from unbend.ingest.mcap.ros2_definitions import (
    MAX_COUNT,
    MessageField,
    NumberField,
    SequenceField,
    TextField,
)
from unbend.units import Integers, Mask, Rows

PlanStep = tuple[NumberField, ...] | TextField | SequenceField  # numbers in runs


HEAD = 4  # bytes of encapsulation; alignment counts from behind them


CDR_LE = 1  # plain CDR, little-endian; 0 is big-endian, larger are other encodings


ALIGN = 8


@dataclass(frozen=True)
class DecodePlan:
    """The wanted steps of a message: runs of numbers, texts, sequences; ``rest`` behind all else.

    Of sequences nothing is kept but, where ``counted``, how many elements they have.
    """

    steps: tuple[PlanStep, ...]
    wanted: frozenset[str]
    counted: bool = False
    rest: tuple[SequenceField, ...] = ()


def decode_plan(steps: Sequence[MessageField], wanted: frozenset[str] | None = None) -> DecodePlan:
    """What to do to get at some columns of a message of these steps.

    ``wanted``: paths, also of single elements, as ``q.0``; None for every number and text that each
    message has once, arrays as arrays, and how many elements sequences have (``path[]``; -1 where
    the message ends before that).
    """
    parts: list[MessageField] = []
    for step in steps:
        begin, after = f"{step.path}.", 0
        others = frozenset[str]() if wanted is None or step.path in wanted else wanted
        if isinstance(step, NumberField) and step.array:
            # an array of which only elements are wanted becomes its elements
            ends = (path[len(begin) :] for path in others if path.startswith(begin))
            for k in sorted(int(end) for end in ends if end.isdigit() and int(end) < step.count):
                if k > after:
                    parts.append(NumberField(f"{begin}{after}:{k}", step.kind, k - after, True))
                parts.append(NumberField(f"{begin}{k}", step.kind))
                after = k + 1
            if 0 < after < step.count:
                parts.append(NumberField(f"{begin}{after}:", step.kind, step.count - after, True))
        if not after:
            parts.append(step)
    singles = [step for step in parts if not isinstance(step, SequenceField)]
    paths = frozenset(step.path for step in singles)
    chosen = paths if wanted is None else paths & wanted
    last = max((k for k, step in enumerate(parts) if step.path in chosen), default=-1)
    if wanted is not None:
        return DecodePlan(tuple(_runs(parts[: last + 1])), chosen)
    rest = tuple(step for step in parts[last + 1 :] if isinstance(step, SequenceField))
    return DecodePlan(tuple(_runs(parts[: last + 1])), chosen, True, rest)


def _runs(steps: Sequence[MessageField]) -> list[PlanStep]:
    """Steps with neighbouring numbers put together."""
    result: list[PlanStep] = []
    for _, group in groupby(steps, lambda step: isinstance(step, NumberField)):
        part = list(group)
        run = tuple(step for step in part if isinstance(step, NumberField))
        result += [run] if run else [s for s in part if not isinstance(s, NumberField)]
    return result


@dataclass
class _Cursors:
    """Messages still read, without the encapsulation, and the place ``at`` of the next field."""

    data: Bytes
    row: Rows
    begin: Integers
    length: Integers
    big: Mask
    at: Integers
    columns: dict[str, NDArray[Any]] = field(default_factory=dict)

    def only(self, good: Mask) -> None:
        """Keep these messages only, and what was read of them."""
        if bool(good.all()):
            return
        for name in ("row", "begin", "length", "big", "at"):
            setattr(self, name, getattr(self, name)[good])
        self.columns = {name: column[good] for name, column in self.columns.items()}

    def count(self) -> Integers:
        """The 32-bit length that stands here; the cursors move behind it."""
        self.at = -(-self.at // 4) * 4
        self.only(self.at + 4 <= self.length)
        raw = gather(self.data, self.begin + self.at, 4).view("<u4")
        self.at = self.at + 4
        return np.where(self.big, raw.byteswap(), raw).astype(np.int64)


def decode(
    data: Bytes, begin: Integers, length: Integers, plan: DecodePlan
) -> tuple[Rows, dict[str, NDArray[Any]]]:
    """Decode messages of one definition.

    ``begin``, ``length``: (n,) of each in ``data``, with the encapsulation. Returns the rows that
    could be read, and their columns: numbers of their own kind, arrays as (m, count), texts as str.
    Left out are messages that end too early, and anything but plain CDR of either byte order
    (DDS-RTPS 2.2, section 10; not parameter lists, not XCDR2).

    >>> data = np.frombuffer(b"\\0\\1\\0\\0" + b"\\2\\0\\0\\0a\\0\\7\\0", np.uint8)
    >>> plan = decode_plan([TextField("s"), NumberField("x", "u2")])
    >>> decode(data, np.array([0]), np.array([12]), plan)[1]
    {'s': array(['a'], dtype='<U1'), 'x': array([7], dtype=uint16)}
    """
    rows = np.flatnonzero(length >= HEAD)
    rows = rows[(data[begin[rows]] == 0) & (data[begin[rows] + 1] <= CDR_LE)]
    begin, length = begin[rows], length[rows]
    big = data[begin + 1] & 1 == 0
    at = np.zeros(rows.shape, np.int64)
    cursors = _Cursors(data, rows, begin + HEAD, length - HEAD, big, at)
    for step in plan.steps:
        if isinstance(step, tuple):
            _read_numbers(cursors, step, plan.wanted)
        elif isinstance(step, TextField):
            _read_text(cursors, step, step.path in plan.wanted)
        else:
            _skip(cursors, step, plan.counted)
    # The last sequences are only counted: of a large message the beginning alone is there.
    rows = np.arange(cursors.row.shape[0])
    rest = _Cursors(data, rows, cursors.begin, cursors.length, cursors.big, cursors.at)
    for step in plan.rest:
        count = rest.count()
        column = np.full(rows.shape, -1, np.int64)
        column[rest.row] = count
        cursors.columns[f"{step.path}[]"] = column
        _skip_elements(rest, step, count)
    return cursors.row, cursors.columns


@lru_cache(maxsize=1024)
def _layout(
    run: tuple[NumberField, ...], wanted: frozenset[str], phase: int, big: bool
) -> tuple[np.dtype[Any] | None, int]:
    """The numpy type of the wanted numbers of a run that begins there, and its length."""
    names, kinds, offsets = [], [], []
    at = phase
    for numbers in run:
        size = np.dtype(numbers.kind).itemsize
        at = -(-at // size) * size
        if numbers.path in wanted:
            kind = np.dtype(numbers.kind.replace("?", "u1")).newbyteorder(">" if big else "<")
            names.append(numbers.path)
            kinds.append((kind, (numbers.count,)) if numbers.array else kind)
            offsets.append(at - phase)
        at += size * numbers.count
    if not names or at - phase >= MAX_COUNT:  # no message is that long
        return None, at - phase
    used = {"names": names, "formats": kinds, "offsets": offsets, "itemsize": at - phase}
    return np.dtype(used), at - phase  # type: ignore[call-overload]


def _read_numbers(cursors: _Cursors, run: tuple[NumberField, ...], wanted: frozenset[str]) -> None:
    key = (cursors.at % ALIGN + ALIGN * cursors.big).astype(np.int8)
    sizes = np.zeros(2 * ALIGN, np.int64)
    present = np.flatnonzero(np.bincount(key, minlength=2 * ALIGN)).tolist()
    for which in present:
        sizes[which] = _layout(run, wanted, which % ALIGN, which >= ALIGN)[1]
    good = cursors.at + sizes[key] <= cursors.length
    cursors.only(good)
    key = key[good]
    n = cursors.row.shape[0]
    for numbers in run:
        if numbers.path in wanted:
            shape = (n, numbers.count) if numbers.array else (n,)
            cursors.columns[numbers.path] = np.empty(shape, numbers.kind)
    for which in present:
        dtype, size = _layout(run, wanted, which % ALIGN, which >= ALIGN)
        if dtype is None:
            continue
        rows = slice(None) if len(present) == 1 else key == which
        records = gather(cursors.data, (cursors.begin + cursors.at)[rows], size).view(dtype)
        for name in dtype.names or ():
            cursors.columns[name][rows] = records[name]
    cursors.at = cursors.at + sizes[key]


def _read_text(cursors: _Cursors, step: TextField, wanted: bool) -> None:
    length = cursors.count()
    good = cursors.at + length <= cursors.length
    cursors.only(good)
    length = length[good]
    if wanted:  # without the NUL at the end
        texts = np.full(length.shape, "", object)
        begin = cursors.begin + cursors.at
        for size in np.unique(length[length > 1]).tolist():
            rows = np.flatnonzero(length == size)
            raw = gather(cursors.data, begin[rows], size - 1).view(f"S{size - 1}")
            different, places = np.unique(raw, return_inverse=True)
            known = [value.decode("utf-8", "backslashreplace") for value in different.tolist()]
            texts[rows] = np.array(known, object)[places]
        column = texts.astype(np.str_) if texts.size else np.empty(0, "U1")
        cursors.columns[step.path] = column
    cursors.at = cursors.at + length


def _skip(cursors: _Cursors, step: SequenceField, counted: bool = False) -> None:
    """Move behind a sequence; of its elements nothing is kept."""
    count = cursors.count()
    if counted:
        cursors.columns[f"{step.path}[]"] = count
    _skip_elements(cursors, step, count)


def _skip_elements(cursors: _Cursors, step: SequenceField, count: Integers) -> None:
    """Move behind so many elements; those of varying length one at a time in all messages."""
    good = count <= cursors.length  # an element has a byte at least
    cursors.only(good)
    count = count[good]
    only = step.steps[0] if len(step.steps) == 1 else None
    if isinstance(only, NumberField):
        size = np.dtype(only.kind).itemsize
        aligned = -(-cursors.at // size) * size
        cursors.at = np.where(count > 0, aligned + count * only.count * size, cursors.at)
        cursors.only(cursors.at <= cursors.length)
        return
    steps = _runs(step.steps)
    ends = np.full(cursors.row.shape, -1, np.int64)
    place = np.arange(cursors.row.shape[0])
    inner = _Cursors(cursors.data, place, cursors.begin, cursors.length, cursors.big, cursors.at)
    inner.columns["count"] = count
    done = 0
    while True:
        rest = inner.columns["count"] > done
        ends[inner.row[~rest]] = inner.at[~rest]
        inner.only(rest)
        if not inner.row.shape[0]:
            break
        for part in steps:
            if isinstance(part, tuple):
                _read_numbers(inner, part, frozenset())
            elif isinstance(part, TextField):
                _read_text(inner, part, False)
            else:
                _skip(inner, part)
        done += 1
    cursors.at = np.maximum(ends, 0)
    cursors.only(ends >= 0)
