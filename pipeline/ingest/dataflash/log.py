"""ArduPilot DataFlash logs (.bin): what the registry needs, and the story of reading one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.ingest.boot_clock import Timeline, timeline
from pipeline.ingest.buffers import open_view
from pipeline.ingest.dataflash.channels import channels_of, wanted
from pipeline.ingest.dataflash.columns import Decoded, decode, settled
from pipeline.ingest.dataflash.fields import ACCURACY, INSTANCE_FIELDS, instance_of
from pipeline.ingest.dataflash.records import FMT_START, Walk, Walker, walk
from pipeline.ingest.dataflash.time import Clock, clock_of, stamps
from pipeline.ingest.fields import is_number
from pipeline.ingest.log import Contents, Table, report_damage
from pipeline.ledger import Ledger

# Fields that are used as they are logged, before any map of fields asks whether they are numbers.
_NUMBERS = {*INSTANCE_FIELDS, "TimeUS", "GMS", "GWk", "Status", "Value"} | {
    field for column in ACCURACY for field in column.fields
}


@dataclass(frozen=True)
class DataFlash:
    """The registry's line of this format."""

    name: str = "dataflash"
    title: str = "ArduPilot DataFlash"
    extensions: tuple[str, ...] = (".bin",)

    def matches(self, head: bytes) -> bool:
        return head.startswith(FMT_START)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        needed = wanted()
        with open_view(path) as data:
            walker = Walker(data, needed)
            line = timeline(stamps(data, walker))
            found = walker.found()
            tables = decode(data, found, needed)
        _report_damage(found, path, ledger)
        again = partial(_decoded, path)
        return contents_of(counts_of(found), found.bad_bytes, line, tables, again, ledger)


DATAFLASH = DataFlash()


def read_tables(path: Path, names: Collection[str] | None = None) -> dict[str, Table]:
    """All messages of some types, or of every type, as columns; no channels are made.

    Parameters
    ----------
    path : a DataFlash log.
    names : the types; all where it is None.

    Returns the columns of each type, bit-equal with what pymavlink's DFReader gives.
    """
    return {name: one.columns for name, one in _decoded(path, names).items()}


def _decoded(path: Path, names: Collection[str] | None) -> dict[str, Decoded]:
    """All fields of some types, or of every type."""
    with open_view(path) as data:
        found = walk(data, names)
        chosen = counts_of(found) if names is None else names
        return decode(data, found, dict.fromkeys(chosen, _every_field))


def contents_of(
    counts: Mapping[str, int],
    bad_bytes: int,
    line: Timeline,
    tables: dict[str, Decoded],
    again: Callable[[set[str]], dict[str, Decoded]],
    ledger: Ledger,
) -> Contents:
    """What a log holds, binary or text.

    Parameters
    ----------
    counts : of the messages of each type.
    bad_bytes : that belong to no message.
    line : the power-ups.
    tables : the wanted fields of the wanted types; they are used up.
    again : reads all fields of some types, when they are asked for.
    """
    timed = timed_only(tables, ledger)
    clock = clock_of(line, timed, ledger)
    return Contents(
        counts,
        channels_of(timed, clock, ledger),
        bad_bytes,
        0,  # neither records nor lines carry a sequence number
        clock.line.boots,
        clock.words,
        partial(_table, again, clock),
    )


def counts_of(found: Walk) -> dict[str, int]:
    """How many messages of each type there are."""
    result: Counter[str] = Counter()
    for form, count in zip(found.definitions, found.counts.tolist(), strict=True):
        if count:
            result[form.name] += count
    return dict(result)


def timed_only(tables: dict[str, Decoded], ledger: Ledger) -> dict[str, Decoded]:
    """The tables with a time since boot, without the rows that lack it."""
    result = {}
    for name in list(tables):
        table = settled(tables.pop(name), name, ledger)
        table = _with_numbers(table, name, ledger)
        time = table.columns.get("TimeUS")
        if time is None or not is_number(time):
            what = f"{table.places.size} rows have no time: the log defines no field TimeUS"
            ledger.loss("LOG-FIELDS", what, where=name, count=table.places.size)
            continue
        result[name] = table.take(np.isfinite(time)) if time.dtype.kind == "f" else table
    return result


def _with_numbers(table: Decoded, name: str, ledger: Ledger) -> Decoded:
    """A table without what a damaged definition makes no number, or no text, where it is needed."""
    odd = [
        field
        for field, column in table.columns.items()
        if (field in _NUMBERS and not is_number(column)) or (field == "Name" and column.ndim != 1)
    ]
    if not odd:
        return table
    count = table.places.size
    what = f"{', '.join(odd)} of {count} rows hold no numbers, by their definition"
    ledger.loss("LOG-FIELDS", what, where=name, count=count)
    return Decoded({f: c for f, c in table.columns.items() if f not in odd}, table.places)


def _every_field(_: str) -> bool:
    return True


def _table(
    again: Callable[[set[str]], dict[str, Decoded]], clock: Clock, name: str, instance: str | None
) -> Table:
    """The messages of one type, for `Log.message`."""
    decoded = again({name})
    return stamped(decoded[name], clock, instance) if name in decoded else {}


def stamped(decoded: Decoded, clock: Clock, instance: str | None) -> Table:
    """A table with UTC and boot before its own columns; only an instance, where one is given."""
    table, places = decoded.columns, decoded.places
    if "TimeUS" in table and is_number(table["TimeUS"]):
        added: Table = {"time_ns": clock.utc(table, places), "boot": clock.line.boot_of(places)}
        table = added | table
    if instance is None:
        return table
    rows = instance_of(table).astype(np.str_) == instance
    return {field: column[rows] for field, column in table.items()} if rows.any() else {}


def _report_damage(found: Walk, path: Path, ledger: Ledger) -> None:
    report_damage(
        ledger, path.name, unit="record", bad_bytes=found.bad_bytes, first_bad=found.first_bad,
        cut_bytes=found.cut_bytes,
    )  # fmt: skip
    for refused in found.refused:
        ledger.loss(
            "LOG-BAD-FORMAT", f"an FMT record makes no sense: {refused}", where=path.name, count=1
        )
