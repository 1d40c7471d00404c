"""Records of a DataFlash log -> one table a message type, with the columns that pymavlink gives.

And which messages are wanted, their instances, and what their numbers of texts mean.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.buffers import allocate
from pipeline.ingest.dataflash.records import RecordWalker, read_records
from pipeline.ingest.fields import MessageMap, columns_of_group, message_maps
from pipeline.ingest.log import Table
from pipeline.ingest.stacking import PLACE, in_order
from pipeline.ledger import Ledger

INSTANCE_FIELDS = ("I", "Instance", "Id", "C")


def instance_of(table: Table) -> NDArray[Any]:
    """The instance of each row, -1 where the message has none.

    Only integers tell instances apart: in PID messages I is a term of the controller.
    """
    for field in INSTANCE_FIELDS:
        if field in table and table[field].dtype.kind in "iu":
            return table[field]
    rows = len(next(iter(table.values()))) if table else 0
    return np.full(rows, -1, np.int8)


MESSAGES: Mapping[str, MessageMap] = message_maps("dataflash")

# What EV and ERR mean, as far as they concern the filter and the receivers (AP_Logger.h); in ERR
# the second number is 0 where the trouble is over.
EVENTS = {60: "EKF_ALT_RESET", 62: "EKF_YAW_RESET", 67: "GPS_PRIMARY_CHANGED"}
ERRORS = {
    3: "COMPASS", 7: "FAILSAFE_GPS", 11: "GPS", 12: "CRASH_CHECK", 16: "EKFCHECK",
    17: "FAILSAFE_EKFINAV", 18: "BARO", 24: "EKF_PRIMARY", 29: "FAILSAFE_VIBE",
    31: "FAILSAFE_DEADRECKON",
}  # fmt: skip


def texts_of(message: str, field: str, table: Table) -> tuple[str, ...] | None:
    """What the autopilot says in each row of MSG, EV or ERR; None where no text is defined.

    >>> texts_of("ERR", "Subsys", {"Subsys": np.array([16], "u1"), "ECode": np.array([2], "u1")})
    ('ERR EKFCHECK 2',)
    """
    words = table.get(field)
    if words is None or words.dtype.kind != ("U" if message == "MSG" else "u"):
        return None
    if message == "MSG":
        return tuple(words.tolist())
    names = EVENTS if message == "EV" else ERRORS
    codes = table["ECode"].tolist() if "ECode" in table else [""] * words.shape[0]
    pairs = zip(words.tolist(), codes, strict=True)
    return tuple(f"{message} {names.get(number, number)} {code}".strip() for number, code in pairs)


# Accuracy and the ellipsoidal height come in a message of their own, at the time of the GPS row.
ACCURACY_MESSAGES = {"GPS": "GPA", "GPS2": "GPA2"}
ACCURACY = columns_of_group("accuracy")


def decode(found: RecordWalker, wanted: Mapping[str, Callable[[str], bool]]) -> dict[str, Table]:
    """The columns of some message types, in one pass over the file.

    ``wanted``: for each message type, which of its fields are wanted. Returns those that the log
    has, with `PLACE`, the byte where each row begins. Numbers have the type they are logged in;
    scaled ones (letters c, C, e, E, L) are float64 and divided, as pymavlink does; characters are
    text. Memory: the columns, and a block of the file. Types of one name that differ in their
    fields are one table; what a row does not have is NaN or empty. A field that was text and number
    is a column of objects (`without_objects`).
    """
    tables: dict[int, Table] = {}
    for number, count in enumerate(found.counts.tolist()):
        form = found.definitions[number]
        if form.name in wanted and count:
            table = tables[number] = {PLACE: allocate(count, np.int64)}
            for name in filter(wanted[form.name], form.fields):
                kind = np.dtype(np.float64) if name in form.divisors else form.dtype[name]
                table[name] = allocate(count, (kind.base, kind.shape))
    filled = dict.fromkeys(tables, 0)
    mask = np.array([number in tables for number in range(len(found.definitions))], np.bool_)
    for number, rows, places in read_records(found, mask):
        part = slice(filled[number], filled[number] + places.shape[0])
        filled[number] = part.stop
        for name, column in tables[number].items():
            divisor = found.definitions[number].divisors.get(name)
            if divisor is None:
                column[part] = places if name == PLACE else rows[name]
            else:
                np.divide(rows[name], divisor, out=column[part])
    by_name: dict[str, list[Table]] = {}
    for number in sorted(tables):
        columns = tables.pop(number).items()
        table = {name: texts(part) if part.dtype.kind == "S" else part for name, part in columns}
        by_name.setdefault(found.definitions[number].name, []).append(table)
    return {name: merge_tables(several) for name, several in by_name.items()}


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Character fields as text, cut at the first NUL.

    UTF-8, or Latin-1 where a field is not valid UTF-8, which is what pymavlink does.

    >>> texts(np.array([b"GPS", b"30\\xb0", b"a\\0b"]))
    array(['GPS', '30°', 'a'], dtype='<U3')
    """
    different, places = np.unique(raw, return_inverse=True)
    words = []
    for value in different.tolist():
        try:
            word = value.decode("utf-8")
        except UnicodeDecodeError:
            word = value.decode("latin-1")
        words.append(word.split("\0", 1)[0])
    return np.array(words, np.str_)[places] if words else np.empty(0, "U1")


def merge_tables(several: list[Table]) -> Table:
    """Tables of one message whose definition changed in the file, in the order of the file.

    Every value is as it is logged, see `join_pieces`; missing numbers of instances, which
    separate rows, are -1.
    """
    if len(several) == 1:
        return several[0]
    for name in INSTANCE_FIELDS:
        present = [table[name] for table in several if name in table]
        if present and all(column.dtype.kind in "iu" for column in present):
            for table in several:
                table.setdefault(name, np.full(table[PLACE].size, -1))
    return in_order(several)


def without_objects(table: Table, name: str, ledger: Ledger) -> Table:
    """A table without objects: the last value of a column decides between text and numbers."""
    columns = dict(table)
    for field, column in table.items():
        if column.dtype.kind != "O":
            continue
        known = [value for value in column.tolist() if value is not None]
        kind = str if isinstance(known[-1], str) else (int, float)
        lost = sum(not isinstance(value, kind) for value in known)
        if kind is str:
            words = [value if isinstance(value, str) else "" for value in column.tolist()]
            columns[field] = np.array(words, np.str_)
        else:
            numbers = [value if isinstance(value, kind) else np.nan for value in column.tolist()]
            columns[field] = np.array(numbers, np.float64)
        if lost:
            ledger.loss("LOG-REDEFINED", where=name, count=lost, total=len(known), field=field)
    return columns
