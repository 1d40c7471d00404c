"""ArduPilot DataFlash logs (.bin): what the registry needs, and the story of reading one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.flight.boots import timeline
from pipeline.ingest.base import Contents, Table, report_damage
from pipeline.ingest.dataflash_channels import channels_of, wanted
from pipeline.ingest.dataflash_columns import Decoded, decode, settled
from pipeline.ingest.dataflash_fields import instance_of
from pipeline.ingest.dataflash_records import FMT_START, Walk, Walker, walk
from pipeline.ingest.dataflash_time import Clock, clock_of, stamps
from pipeline.ingest.window import window_on
from pipeline.ledger import Ledger


@dataclass(frozen=True)
class DataFlash:
    """The registry's line of this format."""

    name: str = "dataflash"
    title: str = "ArduPilot DataFlash"
    extensions: tuple[str, ...] = (".bin",)

    def matches(self, head: bytes) -> bool:
        return head.startswith(FMT_START)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        with window_on(path) as data:
            walker = Walker(data, wanted())
            line = timeline(stamps(data, walker))
            found = walker.found()
            tables = decode(data, found, wanted())
        _report_damage(found, path, ledger)
        tables = timed_only(tables, ledger)
        clock = clock_of(line, tables, ledger)
        return Contents(
            counts_of(found),
            channels_of(tables, clock, ledger),
            found.bad_bytes,
            0,  # records carry no sequence number
            clock.line.boots,
            clock.words,
            partial(_table, path, clock),
        )


DATAFLASH = DataFlash()


def read_tables(path: Path, names: Collection[str] | None = None) -> dict[str, Table]:
    """All messages of some types, or of every type, as columns; no channels are made.

    Parameters
    ----------
    path : a DataFlash log.
    names : the types; all where it is None.

    Returns the columns of each type, bit-equal with what pymavlink's DFReader gives.
    """
    with window_on(path) as data:
        found = walk(data, names)
        chosen = counts_of(found) if names is None else names
        decoded = decode(data, found, dict.fromkeys(chosen, _every_field))
    return {name: one.columns for name, one in decoded.items()}


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
        time = table.columns.get("TimeUS")
        if time is None or time.dtype.kind not in "iuf":
            what = f"{table.places.size} rows have no time: the log defines no field TimeUS"
            ledger.loss("LOG-FIELDS", what, where=name, count=table.places.size)
            continue
        result[name] = table.take(np.isfinite(time)) if time.dtype.kind == "f" else table
    return result


def _every_field(_: str) -> bool:
    return True


def _table(path: Path, clock: Clock, name: str, instance: str | None) -> Table:
    """The messages of one type, for `Log.message`."""
    with window_on(path) as data:
        decoded = decode(data, walk(data, {name}), {name: _every_field})
    return stamped(decoded[name], clock, instance) if name in decoded else {}


def stamped(decoded: Decoded, clock: Clock, instance: str | None) -> Table:
    """A table with UTC and boot before its own columns; only an instance, where one is given."""
    table, places = decoded.columns, decoded.places
    if "TimeUS" in table and table["TimeUS"].dtype.kind in "iuf":
        added: Table = {"time_ns": clock.utc(table, places), "boot": clock.line.boot_of(places)}
        table = added | table
    if instance is None:
        return table
    rows = instance_of(table).astype(np.str_) == instance
    return {field: column[rows] for field, column in table.items()} if rows.any() else {}


def _report_damage(found: Walk, path: Path, ledger: Ledger) -> None:
    report_damage(ledger, path.name, "record", found.bad_bytes, found.first_bad, found.cut_bytes)
    for refused in found.refused:
        ledger.loss(
            "LOG-BAD-FORMAT", f"an FMT record makes no sense: {refused}", where=path.name, count=1
        )
