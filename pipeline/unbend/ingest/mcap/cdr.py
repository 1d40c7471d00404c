"""CDR, the encoding of ROS 2 messages: all messages of a topic decoded at once, step by step.

Each message has a cursor, the place of its next field. A step reads one field, or a run of numbers
that follow each other, at the cursors of all messages and moves the cursors on. Numbers are aligned
to their size. So the layout of a run depends on where it begins modulo 8, and texts before it shift
that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple

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
from unbend.ingest.message_tables import text_column
from unbend.units import Integers, Mask, Rows

ENCAPSULATION = 4  # [bytes] before the first field; alignment counts from behind them
CDR_LE = 1  # plain CDR, little-endian; 0 is big-endian, larger are other encodings
ALIGN = 8  # [bytes] of the largest number
LENGTH_SIZE = 4  # [bytes] of the length of a text or sequence

NumberRun = tuple[NumberField, ...]
PlanStep = NumberRun | TextField | SequenceField


@dataclass
class StepBudget:
    """How many texts and elements of sequences may still be read one by one.

    Each is read in all messages of a batch at once, and takes some 50 us, however few messages and
    bytes these are. ``dropped``: how many messages were not decoded because no step was left.
    """

    steps_left: int = 20_000  # 1 s; usual are tens for each 4 MiB of messages
    dropped: int = 0

    @classmethod
    def of_file(cls, size: int) -> StepBudget:
        """The budget of a file of ``size`` bytes: more for a larger one, 0.8 s a MB."""
        return cls(cls.steps_left + size // 64)

    def spend(self, rows: int) -> bool:
        """Take one step from the budget, which is read in ``rows`` messages at once.

        False if no step is left; the messages then count as dropped.
        """
        if self.steps_left > 0:
            self.steps_left -= 1
            return True
        self.dropped += rows
        return False


@dataclass(frozen=True)
class DecodePlan:
    """How messages of one definition are decoded.

    steps : what is read one after the other, up to the last wanted field: runs of numbers, texts,
        sequences.
    wanted : paths of the numbers and texts that become columns; the others are passed over.
    counted : whether the number of elements of each sequence becomes a column too.
    trailing : sequences behind all wanted fields, which are counted as far as a message has them.
    """

    steps: tuple[PlanStep, ...]
    wanted: frozenset[str]
    counted: bool = False
    trailing: tuple[SequenceField, ...] = ()


def decode_plan(
    steps: Sequence[MessageField],
    wanted: frozenset[str] | None = None,
) -> DecodePlan:
    """The plan to decode the wanted columns of messages with these fields.

    ``wanted``: paths, also of single elements of an array, as ``q.0``. None means all numbers and
    texts outside of sequences, with arrays as arrays, and the number of elements of each sequence
    (``path[]``; -1 where the message ends before it).
    """
    message_fields: list[MessageField] = []
    for step in steps:
        message_fields += _split_array(step, wanted)
    paths = frozenset(part.path for part in message_fields if not isinstance(part, SequenceField))
    chosen_paths = paths if wanted is None else paths & wanted
    end = 0  # behind the last chosen field: what follows need not be decoded
    for number, part in enumerate(message_fields):
        if part.path in chosen_paths:
            end = number + 1
    plan_steps = tuple(_plan_steps(message_fields[:end]))
    if wanted is not None:
        return DecodePlan(plan_steps, chosen_paths)
    trailing = tuple(part for part in message_fields[end:] if isinstance(part, SequenceField))
    return DecodePlan(plan_steps, chosen_paths, counted=True, trailing=trailing)


def _split_array(step: MessageField, wanted: frozenset[str] | None) -> list[MessageField]:
    """Split an array of numbers into its wanted elements and the pieces between these.

    Any other field is returned as it is, and so is an array that is wanted as a whole, or with no
    wanted elements.
    """
    if wanted is None or step.path in wanted:
        return [step]
    if not isinstance(step, NumberField) or not step.array:
        return [step]
    elements = _wanted_elements(step, wanted)
    if not elements:
        return [step]
    parts: list[MessageField] = []
    end = 0
    for index in elements:
        if index > end:
            piece = f"{step.path}.{end}:{index}"
            parts.append(NumberField(piece, step.kind, index - end, array=True))
        parts.append(NumberField(f"{step.path}.{index}", step.kind))
        end = index + 1
    if end < step.count:
        parts.append(NumberField(f"{step.path}.{end}:", step.kind, step.count - end, array=True))
    return parts


def _wanted_elements(step: NumberField, wanted: frozenset[str]) -> list[int]:
    """The indices of the wanted elements of an array, rising; each has the path ``array.index``."""
    prefix = f"{step.path}."
    elements = []
    for path in wanted:
        index = path.removeprefix(prefix)
        if index != path and index.isdigit() and int(index) < step.count:
            elements.append(int(index))
    return sorted(elements)


def _plan_steps(steps: Sequence[MessageField]) -> list[PlanStep]:
    """The steps of a plan: neighbouring numbers are one step, each text and sequence is a step."""
    plan_steps: list[PlanStep] = []
    for _, group in groupby(steps, lambda step: isinstance(step, NumberField)):
        neighbours = list(group)
        numbers = tuple(step for step in neighbours if isinstance(step, NumberField))
        if numbers:
            plan_steps.append(numbers)
        else:
            plan_steps += [step for step in neighbours if not isinstance(step, NumberField)]
    return plan_steps


def _aligned(offsets: Integers, size: int) -> Integers:
    """Offsets rounded up to multiples of ``size``."""
    return np.asarray(-(-offsets // size) * size, np.int64)


@dataclass
class _Cursors:
    """The messages that are still read, (n,): places, cursors and what was read so far.

    data : bytes with all messages.
    row : the row of each message among those handed to `decode`.
    begin, length : where each begins in ``data``, and its bytes, without the encapsulation.
    is_big_endian : of each.
    offset : the cursor of each: bytes from its ``begin`` to its next field.
    budget : of steps that are taken one by one.
    columns : the values that were read, a row for each message.
    """

    data: Bytes
    row: Rows
    begin: Integers
    length: Integers
    is_big_endian: Mask
    offset: Integers
    budget: StepBudget = field(default_factory=StepBudget)
    columns: dict[str, NDArray[Any]] = field(default_factory=dict)

    def keep_only(self, good: Mask) -> None:
        """Drop all messages but the good ones, in place, with their rows of the columns."""
        if bool(good.all()):
            return
        self.row = self.row[good]
        self.begin = self.begin[good]
        self.length = self.length[good]
        self.is_big_endian = self.is_big_endian[good]
        self.offset = self.offset[good]
        self.columns = {name: column[good] for name, column in self.columns.items()}

    def independent(self) -> _Cursors:
        """New cursors at the same places, which move and lose messages without these.

        They share the budget, and have no columns yet. Their ``row`` is the row of each message
        among these.
        """
        rows = np.arange(self.row.shape[0])
        return _Cursors(
            data=self.data,
            row=rows,
            begin=self.begin,
            length=self.length,
            is_big_endian=self.is_big_endian,
            offset=self.offset,
            budget=self.budget,
        )

    def take_step(self) -> bool:
        """Take one step from the budget; if none is left, drop all messages and return False."""
        if self.budget.spend(self.row.shape[0]):
            return True
        self.keep_only(np.zeros(self.row.shape, np.bool_))
        return False

    def read_length(self) -> Integers:
        """Read the 32-bit length of a text or sequence, and move the cursors behind it.

        Messages that end within the length are dropped first: the result has one row for each of
        those that stay.
        """
        self.offset = _aligned(self.offset, LENGTH_SIZE)
        self.keep_only(self.offset + LENGTH_SIZE <= self.length)
        raw = gather(self.data, self.begin + self.offset, LENGTH_SIZE).view("<u4")
        self.offset = self.offset + LENGTH_SIZE
        return np.where(self.is_big_endian, raw.byteswap(), raw).astype(np.int64)


class DecodedMessages(NamedTuple):
    """The rows of the messages that could be read, rising, and their columns by path."""

    rows: Rows
    columns: dict[str, NDArray[Any]]


def decode(
    data: Bytes,
    begin: Integers,
    length: Integers,
    plan: DecodePlan,
    budget: StepBudget | None = None,
) -> DecodedMessages:
    """Decode messages of one definition.

    ``begin``, ``length``: (n,) place in ``data`` and bytes of each, with the encapsulation. Returns
    the m rows that could be read, and their columns: numbers (m,) of their own kind, arrays of
    numbers (m, count), texts (m,) as str. ``budget``: of all messages of the log.
    Left out are messages that end too early, and anything but plain CDR of either byte order
    (DDS-RTPS 2.2, section 10; not parameter lists, not XCDR2).

    >>> data = np.frombuffer(b"\\0\\1\\0\\0" + b"\\2\\0\\0\\0a\\0\\7\\0", np.uint8)
    >>> plan = decode_plan([TextField("s"), NumberField("x", "u2")])
    >>> decode(data, np.array([0]), np.array([12]), plan).columns
    {'s': array(['a'], dtype='<U1'), 'x': array([7], dtype=uint16)}
    """
    with_head = np.flatnonzero(length >= ENCAPSULATION)
    first_byte = data[begin[with_head]]
    second_byte = data[begin[with_head] + 1]  # these two are the encoding, high byte first
    is_plain = (first_byte == 0) & (second_byte <= CDR_LE)
    rows = with_head[is_plain]
    cursors = _Cursors(
        data=data,
        row=rows,
        begin=begin[rows] + ENCAPSULATION,
        length=length[rows] - ENCAPSULATION,
        is_big_endian=second_byte[is_plain] != CDR_LE,
        offset=np.zeros(rows.shape, np.int64),
        budget=budget or StepBudget(),
    )
    for step in plan.steps:
        if not cursors.row.shape[0]:
            break
        if isinstance(step, tuple):
            _read_numbers(cursors, step, plan.wanted)
        elif isinstance(step, TextField):
            _read_text(cursors, step, wanted=step.path in plan.wanted)
        else:
            _skip_sequence(cursors, step, counted=plan.counted)
    _count_trailing(cursors, plan.trailing)
    return DecodedMessages(cursors.row, cursors.columns)


def _count_trailing(cursors: _Cursors, sequences: Sequence[SequenceField]) -> None:
    """Add columns with the numbers of elements of the last sequences; -1 where a message ends.

    No message is dropped for that, because of a large message only the beginning is there: other
    cursors move through these sequences, and lose the messages that end.
    """
    not_ended = cursors.independent()
    for step in sequences:
        count = not_ended.read_length()
        column = np.full(cursors.row.shape, -1, np.int64)
        column[not_ended.row] = count
        cursors.columns[f"{step.path}[]"] = column
        _skip_elements(not_ended, step, count)


class _Layout(NamedTuple):
    """A run of numbers: the numpy type with the wanted ones, None without any, and its bytes."""

    dtype: np.dtype[Any] | None
    size: int


@lru_cache(maxsize=1024)
def _layout(run: NumberRun, wanted: frozenset[str], phase: int, *, big: bool) -> _Layout:
    """The layout of a run that begins ``phase`` bytes behind a multiple of `ALIGN`.

    ``big``: the message is big-endian.
    """
    names = []
    kinds = []
    offsets = []
    end = phase  # of the numbers so far: bytes from the multiple of `ALIGN` on
    for numbers in run:
        size = np.dtype(numbers.kind).itemsize
        end = -(-end // size) * size  # the next multiple of the size
        if numbers.path in wanted:
            kind = np.dtype(numbers.kind.replace("?", "u1"))
            kind = kind.newbyteorder(">" if big else "<")
            names.append(numbers.path)
            kinds.append((kind, (numbers.count,)) if numbers.array else kind)
            offsets.append(end - phase)
        end += size * numbers.count
    length = end - phase
    if not names or length >= MAX_COUNT:  # no message is that long
        return _Layout(None, length)
    layout = {"names": names, "formats": kinds, "offsets": offsets, "itemsize": length}
    return _Layout(np.dtype(layout), length)  # type: ignore[call-overload]


def _read_numbers(
    cursors: _Cursors,
    run: NumberRun,
    wanted: frozenset[str],
) -> None:
    """Read the wanted numbers of a run, and move behind it; drop messages that end within it.

    The layout of a run depends on its offset modulo `ALIGN` and on the byte order of the message.
    These arrangements are numbered: by that offset, plus `ALIGN` in big-endian messages.
    """
    arrangement = (cursors.offset % ALIGN + ALIGN * cursors.is_big_endian).astype(np.int8)
    layouts = {}
    sizes = np.zeros(2 * ALIGN, np.int64)
    messages_of_each = np.bincount(arrangement, minlength=2 * ALIGN)
    for number in np.flatnonzero(messages_of_each).tolist():
        layouts[number] = _layout(run, wanted, phase=number % ALIGN, big=number >= ALIGN)
        sizes[number] = layouts[number].size
    is_whole = cursors.offset + sizes[arrangement] <= cursors.length
    cursors.keep_only(is_whole)
    arrangement = arrangement[is_whole]
    _add_empty_columns(cursors, run, wanted)
    for number, layout in layouts.items():
        rows = slice(None) if len(layouts) == 1 else arrangement == number
        _fill_columns(cursors, layout, rows)
    cursors.offset = cursors.offset + sizes[arrangement]


def _add_empty_columns(cursors: _Cursors, run: NumberRun, wanted: frozenset[str]) -> None:
    """Add columns, not yet filled, for the wanted numbers of a run."""
    count = cursors.row.shape[0]
    for numbers in run:
        if numbers.path in wanted:
            shape = (count, numbers.count) if numbers.array else (count,)
            cursors.columns[numbers.path] = np.empty(shape, numbers.kind)


def _fill_columns(cursors: _Cursors, layout: _Layout, rows: Mask | slice) -> None:
    """Read a run of one layout at the cursors of some rows, into the same rows of the columns."""
    if layout.dtype is None:
        return
    places = (cursors.begin + cursors.offset)[rows]
    records = gather(cursors.data, places, layout.size).view(layout.dtype)
    for name in layout.dtype.names or ():
        cursors.columns[name][rows] = records[name]


def _read_text(cursors: _Cursors, step: TextField, *, wanted: bool) -> None:
    """Move behind a text, and read it into its column if it is wanted."""
    if not cursors.take_step():
        return
    length = cursors.read_length()
    is_whole = cursors.offset + length <= cursors.length
    cursors.keep_only(is_whole)
    length = length[is_whole]
    if wanted:
        begin = cursors.begin + cursors.offset
        cursors.columns[step.path] = _texts(cursors.data, begin, length)
    cursors.offset = cursors.offset + length


def _texts(data: Bytes, begin: Integers, length: Integers) -> NDArray[Any]:
    """(n,) texts at these places of ``data``; ``length`` [bytes] counts the NUL at the end."""
    if not length.size:
        return np.empty(0, "U1")
    texts = np.full(length.shape, "", object)
    for size in np.unique(length[length > 1]).tolist():  # of length 1 is the NUL alone
        rows = np.flatnonzero(length == size)
        size_without_nul = size - 1
        raw = gather(data, begin[rows], size_without_nul).view(f"S{size_without_nul}")
        distinct, number_of_row = np.unique(raw, return_inverse=True)
        decoded = [value.decode("utf-8", "backslashreplace") for value in distinct.tolist()]
        texts[rows] = np.array(decoded, object)[number_of_row]
    return text_column(texts)


def _skip_sequence(cursors: _Cursors, step: SequenceField, *, counted: bool = False) -> None:
    """Move behind a sequence; if ``counted``, its number of elements becomes a column."""
    count = cursors.read_length()
    if counted:
        cursors.columns[f"{step.path}[]"] = count
    _skip_elements(cursors, step, count)


def _skip_elements(cursors: _Cursors, step: SequenceField, count: Integers) -> None:
    """Move behind the elements of a sequence; ``count`` is their number in each message.

    Elements of numbers alone are passed all at once. Other elements are passed one after the other:
    the first in all messages, then the second in all that have a second, and so on.
    """
    is_possible = count <= cursors.length  # an element has a byte at least
    cursors.keep_only(is_possible)
    count = count[is_possible]
    numbers = tuple(part for part in step.steps if isinstance(part, NumberField))
    if len(numbers) == len(step.steps):
        _skip_numbers(cursors, numbers, count)
    else:
        _skip_one_by_one(cursors, step, count)


def _skip_one_by_one(cursors: _Cursors, step: SequenceField, count: Integers) -> None:
    """Move behind ``count`` elements of any kind, an element at a time in all messages.

    Other cursors move, and lose each message when its elements are passed; its offset is then kept.
    """
    ends = np.full(cursors.row.shape, -1, np.int64)  # -1 of messages that end too early
    unfinished = cursors.independent()
    unfinished.columns["count"] = count  # a column, as it loses the same messages
    steps = _plan_steps(step.steps)
    passed = 0
    while True:
        has_more = unfinished.columns["count"] > passed
        is_passed = ~has_more
        ends[unfinished.row[is_passed]] = unfinished.offset[is_passed]
        unfinished.keep_only(has_more)
        if not unfinished.row.shape[0] or not unfinished.take_step():
            break
        _skip_steps(unfinished, steps)
        passed += 1
    cursors.offset = np.maximum(ends, 0)  # 0 for messages that the next line drops
    cursors.keep_only(ends >= 0)


def _skip_numbers(cursors: _Cursors, run: NumberRun, count: Integers) -> None:
    """Move behind ``count`` elements, each of them the numbers of a run.

    Bytes that align are only in front of an element, so an empty sequence has none. The size of an
    element depends on its phase, which is its offset modulo `ALIGN`. The sizes of 2, 4, 8 ...
    elements at each phase follow by doubling; the binary digits of ``count`` show which to add.
    """
    phases = np.arange(ALIGN)
    sizes = [_layout(run, frozenset(), phase, big=False).size for phase in phases.tolist()]
    bytes_at_phase = np.minimum(sizes, MAX_COUNT)  # no message is that long
    offset = cursors.offset
    count_left = count
    while count_left.any():
        is_odd = count_left % 2 == 1
        offset = np.where(is_odd, offset + bytes_at_phase[offset % ALIGN], offset)
        twice = bytes_at_phase + bytes_at_phase[(phases + bytes_at_phase) % ALIGN]
        bytes_at_phase = np.minimum(twice, MAX_COUNT)
        count_left = count_left // 2
    cursors.offset = offset
    cursors.keep_only(cursors.offset <= cursors.length)


def _skip_steps(cursors: _Cursors, steps: Sequence[PlanStep]) -> None:
    """Move behind one element of a sequence, which consists of these steps."""
    for step in steps:
        if not cursors.row.shape[0]:
            return
        if isinstance(step, tuple):
            _read_numbers(cursors, step, frozenset())
        elif isinstance(step, TextField):
            _read_text(cursors, step, wanted=False)
        else:
            _skip_sequence(cursors, step)
