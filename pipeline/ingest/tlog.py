"""MAVLink telemetry logs (.tlog): frames -> channels in UTC."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Channel, Source, TimeArray
from pipeline.flight.clock import UNIX_US_FROM
from pipeline.ingest.base import Contents, report_damage
from pipeline.ingest.build import Rows, channel_of
from pipeline.ingest.fields import MessageMap, extract
from pipeline.ingest.tlog_clock import Clocks, Timed, clocks_of
from pipeline.ingest.tlog_fields import MESSAGES
from pipeline.ingest.tlog_frames import (
    Frames,
    FrameWalk,
    frame_length,
    lost_by_source,
    payloads,
    walk,
)
from pipeline.ledger import Ledger

SYSTEM_TIME = "SYSTEM_TIME"


@dataclass(frozen=True)
class Dialect:
    """What is needed of pymavlink's dialect, by message id."""

    names: Mapping[int, str]
    extras: Mapping[int, int]
    dtypes: Mapping[str, np.dtype[Any]]
    ids: Mapping[str, int]


@dataclass(frozen=True)
class Tlog:
    """The registry's line of this format."""

    name: str = "tlog"
    title: str = "MAVLink telemetry"
    extensions: tuple[str, ...] = (".tlog", ".rlog")

    def matches(self, head: bytes) -> bool:
        first = frame_length(head, 0)
        return first > 0 and (first == len(head) or frame_length(head, first) > 0)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        data = path.read_bytes()
        dialect = _dialect()
        found = walk(data, dialect.extras)
        frames = found.frames.take(found.valid)
        damaged = _report_damage(found, dialect, path, ledger)
        tables = _Tables(data, frames, dialect)
        clocks = clocks_of(tables.timed(), frames, ledger)
        channels = _channels(tables, clocks, ledger)
        carriers = {(c.source.system, c.source.component) for c in channels}
        lost = {
            source: count
            for source, count in lost_by_source(found.frames).items()
            if source in carriers and count
        }
        for (system, component), count in sorted(lost.items()):
            ledger.warning(
                "LOG-LINK-LOSS",
                f"{count} messages of system {system}, component {component} are missing by "
                "their sequence numbers: the radio link lost them",
                where=path.name,
                count=count,
            )
        return Contents(
            _counts(frames, dialect),
            channels,
            found.bad_bytes + damaged,
            sum(lost.values()),
            clocks.boots,
            clocks.words,
        )


TLOG = Tlog()


def _dialect() -> Dialect:
    from pymavlink.dialects.v20 import all as library

    classes = dict(library.mavlink_map)
    wanted = {key.partition(".")[0] for key in MESSAGES} | {SYSTEM_TIME}
    names = {key: str(found.msgname) for key, found in classes.items()}
    ids = {name: key for key, name in names.items() if name in wanted}
    return Dialect(
        names,
        {key: int(found.crc_extra) for key, found in classes.items()},
        {
            name: _dtype(classes[key].unpacker.format, classes[key].ordered_fieldnames)
            for name, key in ids.items()
        },
        ids,
    )


def _dtype(layout: str, fields: list[str]) -> np.dtype[Any]:
    """The numpy type of a struct format such as ``<If10s``, which has one item a field.

    >>> _dtype("<If10s", ["time_boot_ms", "value", "name"]).itemsize
    18
    """
    kinds: list[tuple[str, str] | tuple[str, str, int]] = []
    items = re.findall(r"(\d*)([a-zA-Z])", layout)
    for field, (count, letter) in zip(fields, items, strict=True):
        if letter == "s":
            kinds.append((field, f"S{count or 1}"))
        elif count:
            kinds.append((field, f"<{letter}", int(count)))
        else:
            kinds.append((field, f"<{letter}"))
    return np.dtype(kinds)


def _name(dialect: Dialect, message_id: int) -> str:
    return dialect.names.get(message_id, f"UNKNOWN_{message_id}")


def _counts(frames: Frames, dialect: Dialect) -> dict[str, int]:
    ids, counts = np.unique(frames.message_id, return_counts=True)
    pairs = zip(ids.tolist(), counts.tolist(), strict=True)
    return {_name(dialect, key): int(count) for key, count in pairs}


def _report_damage(found: FrameWalk, dialect: Dialect, path: Path, ledger: Ledger) -> int:
    """Enter the damage; returns the bytes of frames whose checksum fails by damage."""
    report_damage(ledger, path.name, "message", found.bad_bytes, found.first_bad, found.cut_bytes)
    strange = ~np.isin(found.frames.message_id, list(dialect.names))
    if strange.any():
        ids = np.unique(found.frames.message_id[strange]).tolist()
        ledger.warning(
            "LOG-UNKNOWN-ID",
            f"{int(strange.sum())} messages have ids that the dialect does not know "
            f"({', '.join(str(key) for key in ids[:8])}): not checked, not read",
            where=f"{path.name}, first at byte {int(found.frames.at[strange][0])}",
            count=int(strange.sum()),
        )
    damaged = 0
    failed = found.frames.take(~found.valid)
    sound = set(np.unique(found.frames.message_id[found.valid]).tolist())
    for key in np.unique(failed.message_id).tolist():
        rows = failed.message_id == key
        count = int(np.count_nonzero(rows))
        where = f"{path.name}, first at byte {int(failed.at[rows][0])}"
        name = f"{_name(dialect, key)} (id {key})"
        if key in sound or key in dialect.ids.values():
            damaged += int(np.sum(failed.start[rows] + failed.length[rows] - failed.at[rows])) + 2
            ledger.loss(
                "LOG-CRC", f"{count} messages {name} fail their checksum", where=where, count=count
            )
        else:
            ledger.warning(
                "LOG-DIALECT",
                f"{count} messages {name} fail their checksum, all there are: another version of "
                "the dialect; nothing here needs them",
                where=where,
                count=count,
            )
    return damaged


class _Tables:
    """The wanted messages, decoded on demand: rows among all frames, and fields."""

    def __init__(self, data: bytes, frames: Frames, dialect: Dialect) -> None:
        self.data = data
        self.frames = frames
        self.dialect = dialect

    def rows(self, message: str) -> NDArray[np.intp]:
        key = self.dialect.ids.get(message)
        if key is None:  # an older dialect of the library does not know it
            return np.empty(0, np.intp)
        return np.flatnonzero(self.frames.message_id == key)

    def fields(self, message: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        return payloads(self.data, self.frames.take(rows), self.dialect.dtypes[message])

    def timed(self) -> list[Timed]:
        """Rows, time since boot [ns], and UTC [ns] (0 unknown) of messages with time_boot_ms."""
        wanted = [key for name, key in self.dialect.ids.items() if name != SYSTEM_TIME]
        carriers = np.unique(self.frames.system[np.isin(self.frames.message_id, wanted)])
        result = []
        for message, dtype in self.dialect.dtypes.items():
            rows = self.rows(message)
            rows = rows[np.isin(self.frames.system[rows], carriers)]
            if "time_boot_ms" not in (dtype.names or ()) or rows.shape[0] == 0:
                continue
            table = self.fields(message, rows)
            boot_ns = table["time_boot_ms"].astype(np.int64) * 1_000_000
            utc_ns = np.zeros(rows.shape, np.int64)
            if message == SYSTEM_TIME:
                unix_us = np.minimum(table["time_unix_usec"], 1 << 52).astype(np.int64)
                utc_ns = np.where(unix_us > UNIX_US_FROM, unix_us * 1000, 0)
            result.append((rows, boot_ns, utc_ns))
        return result


def _channels(tables: _Tables, clocks: Clocks, ledger: Ledger) -> tuple[Channel, ...]:
    channels = []
    for key, spec in MESSAGES.items():
        for rows, records in _rows_of(key, spec, tables, clocks):
            if key == "CAMERA_FEEDBACK":
                rows = rows.take(_distinct(records, rows.name, ledger))
            if spec.event:  # the link may deliver an exposure late
                rows = rows.take(np.argsort(rows.time_ns, kind="stable"))
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    return tuple(channels)


def _rows_of(
    key: str, spec: MessageMap, tables: _Tables, clocks: Clocks
) -> Iterator[tuple[Rows, NDArray[Any]]]:
    """The rows of each sender and instance of a message, in SI and as they were sent."""
    message = key.partition(".")[0]
    rows = tables.rows(message)
    if rows.shape[0] == 0:
        return
    table = tables.fields(message, rows)
    sources = tables.frames.system[rows] * 256 + tables.frames.component[rows]
    unique = np.unique(sources)
    for source in unique:
        sent = table[sources == source]
        system, component = int(source) // 256, int(source) % 256
        places = rows[sources == source]
        time_ns, boot = _times(sent, places, spec, clocks, (system, component))
        for label, part in _instances(sent, spec):
            name = key if label is None else f"{key}[{label}]"
            name += f"@{system}/{component}" if unique.shape[0] > 1 else ""
            records = sent[part]
            columns = extract({f: records[f] for f in records.dtype.names or ()}, spec.columns)
            origin = Source(message, label, system, component)
            yield Rows(name, origin, time_ns[part], boot[part], columns), records


def _times(
    table: NDArray[Any],
    rows: NDArray[np.intp],
    spec: MessageMap,
    clocks: Clocks,
    source: tuple[int, int],
) -> tuple[TimeArray, NDArray[np.int16]]:
    boot = clocks.boot(source, rows)
    if not spec.time_field:
        return clocks.utc_of_host(source, rows), boot
    if spec.time_field == "time_boot_ms":
        since_boot = table["time_boot_ms"].astype(np.int64) * 1_000_000
        return clocks.utc_of_boot(source, since_boot, rows), boot
    # time_usec: Unix time from some senders, time since boot from others, 0 when not known
    stamp_us = np.minimum(table["time_usec"], 1 << 52).astype(np.int64)
    since_boot = clocks.utc_of_boot(source, stamp_us * 1000, rows)
    time_ns = np.where(stamp_us > UNIX_US_FROM, stamp_us * 1000, since_boot)
    return np.where(stamp_us == 0, clocks.utc_of_host(source, rows), time_ns), boot


def _instances(
    table: NDArray[Any], spec: MessageMap
) -> Iterator[tuple[str | None, NDArray[np.intp]]]:
    if not spec.id_field:
        yield None, np.arange(table.shape[0])
        return
    for value in np.unique(table[spec.id_field]):
        label = _text(value) if isinstance(value, bytes) else str(int(value))
        yield label, np.flatnonzero(table[spec.id_field] == value)


def _text(value: bytes) -> str:
    """A char[] field: cut at the first NUL."""
    return value.split(b"\0", 1)[0].decode("ascii", "backslashreplace")


def _distinct(table: NDArray[Any], name: str, ledger: Ledger) -> NDArray[np.intp]:
    """The rows of CAMERA_FEEDBACK that are exposures of a camera: no empty ones, each once.

    ArduPilot sends a row again while the next pulse is awaited, at times already with the next
    index: the time is what tells exposures apart, and the first row of a time has its index.
    """
    empty = (table["time_usec"] == 0) & (table["lat"] == 0) & (table["lng"] == 0)
    rows = np.flatnonzero(~empty)
    times, indices = table["time_usec"][rows], table["img_idx"][rows].astype(np.uint64)
    keys = np.where(times == 0, indices, times)
    first = np.sort(np.unique(keys, return_index=True)[1])
    empties, repeats = int(empty.sum()), int(rows.shape[0] - first.shape[0])
    if empties:
        ledger.note(
            "EVENT-EMPTY",
            f"{empties} of {table.shape[0]} rows have neither time nor place: no exposure",
            where=name,
            count=empties,
        )
    if repeats:
        ledger.note(
            "EVENT-REPEAT",
            f"{repeats} of {table.shape[0]} rows repeat the time of an exposure",
            where=name,
            count=repeats,
        )
    unseen = np.setdiff1d(indices, indices[first])
    if unseen.shape[0]:
        ledger.warning(
            "EVENT-NO-PULSE",
            f"{unseen.shape[0]} image indices never got a time of their own (the first is "
            f"{int(unseen[0])}): the camera was triggered and its feedback was lost",
            where=name,
            count=int(unseen.shape[0]),
        )
    return rows[first]
