"""ArduPilot DataFlash logs (.bin): the registry's entry of this format, and how one is read."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.ingest.boot_clock import Timeline, timeline
from pipeline.ingest.buffers import open_view
from pipeline.ingest.dataflash.channels import (
    LogClock,
    channels_of,
    clock_of,
    parameters_of,
    stamps,
    wanted_fields,
)
from pipeline.ingest.dataflash.fields import ACCURACY, INSTANCE_FIELDS, instance_of
from pipeline.ingest.dataflash.records import FMT_START, RecordWalker, find_records
from pipeline.ingest.dataflash.tables import Decoded, decode, without_objects
from pipeline.ingest.fields import is_number
from pipeline.ingest.log import Contents, Table, report_damage
from pipeline.ledger import Ledger

# Fields that are used as they are logged, without a field map that checks that they are numbers.
_NUMBERS = {*INSTANCE_FIELDS, "TimeUS", "GMS", "GWk", "Status", "Value"} | {
    field for column in ACCURACY for field in column.fields
}


@dataclass(frozen=True)
class DataFlash:
    """The registry's entry of this format."""

    name: str = "dataflash"
    title: str = "ArduPilot DataFlash"
    extensions: tuple[str, ...] = (".bin",)

    def matches(self, head: bytes) -> bool:
        return head.startswith(FMT_START)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        wanted = wanted_fields()
        with open_view(path) as data:
            walker = RecordWalker(data, wanted)
            line = timeline(stamps(data, walker))
            index = walker.index()
            tables = decode(data, index, wanted)
        report_damage(
            ledger, path.name, unit="record", bad_bytes=index.bad_bytes, first_bad=index.first_bad,
            cut_bytes=index.cut_bytes,
        )  # fmt: skip
        for refused in index.refused:
            what = f"an FMT record is not valid: {refused}"
            ledger.loss("LOG-BAD-FORMAT", what, where=path.name, count=1)
        return contents_of(
            index.message_counts(), line, tables, ledger, bad_bytes=index.bad_bytes,
            reread=partial(_decode_all_fields, path),
        )  # fmt: skip


DATAFLASH = DataFlash()


def read_tables(path: Path, names: Collection[str] | None = None) -> dict[str, Table]:
    """All messages of some types, or of every type, as columns; no channels are made.

    Parameters
    ----------
    path : a DataFlash log.
    names : the types; all where it is None.

    Returns the columns of each type, bit-equal with what pymavlink's DFReader gives.
    """
    return {name: table.columns for name, table in _decode_all_fields(path, names).items()}


def _decode_all_fields(path: Path, names: Collection[str] | None) -> dict[str, Decoded]:
    with open_view(path) as data:
        index = find_records(data, names)
        chosen = index.message_counts() if names is None else names
        return decode(data, index, dict.fromkeys(chosen, lambda _: True))


def contents_of(
    counts: Mapping[str, int],
    line: Timeline,
    tables: dict[str, Decoded],
    ledger: Ledger,
    *,
    bad_bytes: int,
    reread: Callable[[set[str]], dict[str, Decoded]],
) -> Contents:
    """The contents of a log, binary or text.

    Parameters
    ----------
    counts : of the messages of each type.
    line : the power-ups.
    tables : the wanted fields of the wanted types; they are used up.
    bad_bytes : that belong to no message.
    reread : reads all fields of some types, when they are asked for.
    """
    timed = timed_tables(tables, ledger)
    clock = clock_of(line, timed, ledger)

    def table(name: str, instance: str | None) -> Table:
        decoded = reread({name})
        return stamped(decoded[name], clock, instance) if name in decoded else {}

    lost = 0  # neither records nor lines carry a sequence number
    parameters = parameters_of(timed)
    channels = channels_of(timed, parameters, clock, ledger)
    return Contents(
        counts, channels, bad_bytes, lost, clock.line.boots, clock.description, table, parameters
    )  # fmt: skip


def timed_tables(tables: dict[str, Decoded], ledger: Ledger) -> dict[str, Decoded]:
    """The tables with a time since boot, without the rows that lack it.

    Columns are dropped which a damaged definition makes no numbers, or no text, where these are
    needed.
    """
    result = {}
    for name in list(tables):
        table = without_objects(tables.pop(name), name, ledger)
        count = table.places.size
        odd = [
            field
            for field, column in table.columns.items()
            if (field in _NUMBERS and not is_number(column))
            or (field == "Name" and column.ndim != 1)
        ]
        if odd:
            what = f"{', '.join(odd)} of {count} rows hold no numbers, by their definition"
            ledger.loss("LOG-FIELDS", what, where=name, count=count)
            columns = {f: column for f, column in table.columns.items() if f not in odd}
            table = Decoded(columns, table.places)
        time = table.columns.get("TimeUS")
        if time is None or not is_number(time):
            what = f"{count} rows have no time: the log defines no field TimeUS"
            ledger.loss("LOG-FIELDS", what, where=name, count=count)
            continue
        result[name] = table.take(np.isfinite(time)) if time.dtype.kind == "f" else table
    return result


def stamped(decoded: Decoded, clock: LogClock, instance: str | None) -> Table:
    """A table with UTC and boot before its own columns; only an instance, where one is given."""
    table, places = decoded.columns, decoded.places
    if "TimeUS" in table and is_number(table["TimeUS"]):
        added: Table = {"time_ns": clock.utc(table, places), "boot": clock.line.boot_of(places)}
        table = added | table
    if instance is None:
        return table
    rows = instance_of(table).astype(np.str_) == instance
    return {field: column[rows] for field, column in table.items()} if rows.any() else {}
