"""PX4 logs (.ulg), decoded by pyulog -> channels in UTC. Needs the extra `unbend[ulog]`."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.flight.channels import Channel, Source, TimeArray
from pipeline.flight.clock import UNIX_US_FROM, stray_times
from pipeline.ingest.attitude import earth_frame_attitude
from pipeline.ingest.boot_clock import UtcReadings, fit_boot_clock, microseconds, timeline
from pipeline.ingest.buffers import open_view
from pipeline.ingest.channel_builder import DecodedRows, channel_of
from pipeline.ingest.fields import MessageMap, extract
from pipeline.ingest.log import Contents, Table, report_damage
from pipeline.ingest.px4_fields import CAPTURE_UTC_FIELD, TOPICS, UTC_FIELD, captured_rows
from pipeline.ingest.ulog.records import Walk, Whole, walk
from pipeline.ledger import Ledger

MAGIC = b"ULog\x01\x12\x35"
# What pyulog lets through from a damaged file, besides its own exceptions.
_COMPLAINTS = (
    ValueError, LookupError, TypeError, ArithmeticError, AttributeError, struct.error,
    RecursionError,
)  # fmt: skip

_ONE_BOOT = timeline([(np.zeros(1, np.int64), np.zeros(1, np.int64))])  # a log a boot
_ELEMENT = re.compile(r"\[(\d+)\]")


@dataclass(frozen=True)
class ULogFormat:
    """The registry's line of this format."""

    name: str = "ulog"
    title: str = "PX4 ULog"
    extensions: tuple[str, ...] = (".ulg", ".ulog")

    def matches(self, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        found, walked = _parsed(path, list(TOPICS))
        lost = _report_damage(found, walked, path.name, ledger)
        topics = found.data_list
        offset_ns, words = _clock(topics, ledger)
        channels = []
        several = {data.name for data in topics if data.multi_id}
        for data in topics:
            channel = _channel(data, TOPICS[data.name], data.name in several, offset_ns, ledger)
            if channel:
                channels.append(channel)
        table = partial(_table, path, offset_ns)
        bad = walked.bad_bytes
        return Contents(dict(walked.counts), tuple(channels), bad, lost, 1, words, table)


ULOG = ULogFormat()


def _parsed(path: Path, topics: list[str]) -> tuple[Any, Walk]:
    """The whole messages of some topics by pyulog, and what the file holds of all."""
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    except ImportError as error:
        raise LogError(
            "LOG-NEEDS-EXTRA",
            "PX4 logs are read with pyulog, which is not installed",
            where=str(path),
            remedy="pip install 'unbend[ulog]'",
        ) from error
    try:
        # It prints what `file_corruption` says.
        with open_view(path) as data, contextlib.redirect_stdout(io.StringIO()):
            walked = walk(data)
            return ULog(io.BufferedReader(Whole(data, walked), 1 << 20), topics), walked
    except (*_COMPLAINTS, ULogException) as error:
        raise LogError(
            "LOG-ULOG",
            f"pyulog cannot read it: {type(error).__name__}: {error}",
            where=str(path),
            remedy="copy it again from the vehicle",
        ) from error


def _report_damage(found: Any, walked: Walk, name: str, ledger: Ledger) -> int:
    """Enter what is damaged; how many messages were lost cannot be known, but whether."""
    report_damage(ledger, name, "message", walked.bad_bytes, walked.first_bad, walked.cut_bytes)
    for topic in sorted(walked.timeless):
        count = walked.counts[topic]
        what = f"{count} rows cannot be used: the log defines no field for timestamp"
        ledger.loss("LOG-FIELDS", what, where=topic, count=count)
    if found.file_corruption:
        ledger.loss(
            "LOG-ULOG-DAMAGE",
            "pyulog found damage; how many messages are lost is unknown",
            where=name,
            count=1,
        )
    if found.dropouts:
        lost_s = sum(drop.duration for drop in found.dropouts) / 1000.0
        ledger.loss(
            "LOG-DROPOUT",
            f"the logger could not keep up {len(found.dropouts)} times, {lost_s:.3f} s together",
            where=name,
            count=len(found.dropouts),
        )
    return int(found.file_corruption or walked.bad_bytes > 0)


def _times(data: Mapping[str, NDArray[Any]]) -> TimeArray:
    return microseconds(data["timestamp"]) * 1000


def _told(data: Any, field: str) -> UtcReadings | None:
    """What the messages of a topic say of UTC."""
    if field not in data.data:
        return None
    boot_ns, utc_us = _times(data.data), microseconds(data.data[field])
    usable = (utc_us > UNIX_US_FROM) & ~stray_times(boot_ns)
    fix = data.data.get("fix_type", np.empty(0))
    places = np.arange(boot_ns.shape[0])
    return UtcReadings(f"rows of {_name(data, True)}", places, boot_ns, utc_us * 1000, usable, fix)


def _clock(topics: list[Any], ledger: Ledger) -> tuple[int, str]:
    """UTC minus time since boot [ns], and where it comes from."""
    receivers = [_told(data, UTC_FIELD) for data in topics if TOPICS[data.name].position]
    # a camera's UTC is the autopilot's own clock, which it sets by its receiver now and then
    cameras = [_told(data, CAPTURE_UTC_FIELD) for data in topics if TOPICS[data.name].event]
    for sources in (receivers, cameras):
        told = [one for one in sources if one is not None and one.sound(_ONE_BOOT).places.size]
        if told:
            fit = fit_boot_clock(_ONE_BOOT, told, ledger).fits[0]
            words = "vehicle clock, set to UTC by the median of"
            return (fit.offset_ns, f"{words} {fit.rows} rows") if fit else (0, "")
    ledger.fallback(
        "TIME-NO-UTC",
        "no GPS row with a fix and UTC: time counts from boot, as if in 1970; events in this log "
        "can be used, matching by UTC is impossible",
        where="boot 0",
    )
    return 0, "vehicle clock; UTC is unknown"


def _name(data: Any, numbered: bool) -> str:
    return f"{data.name}[{data.multi_id}]" if numbered else str(data.name)


def _channel(
    data: Any, spec: MessageMap, numbered: bool, offset_ns: int, ledger: Ledger
) -> Channel | None:
    boot_ns, name = _times(data.data), _name(data, numbered)
    fields = {_ELEMENT.sub(r".\1", field): column for field, column in data.data.items()}
    columns = extract(fields, spec.columns)
    if "flags" in columns:
        columns = earth_frame_attitude(columns)
    boot = np.zeros(boot_ns.shape, np.int16)
    source = Source(data.name, str(data.multi_id) if numbered else None)
    rows = DecodedRows(name, source, boot_ns + offset_ns, boot, columns)
    stray = stray_times(boot_ns)
    if stray.any():
        ledger.loss(
            "TIME-STRAY",
            f"{int(stray.sum())} of {len(rows)} rows carry a time that fits none of their "
            "neighbours: they are not used",
            where=f"{name}, first at row {int(np.flatnonzero(stray)[0])}",
            count=int(stray.sum()),
        )
        rows = rows.take(~stray)
    return channel_of(captured_rows(rows, ledger) if spec.event else rows, spec, ledger)


def _table(path: Path, offset_ns: int, name: str, instance: str | None) -> Table:
    """The messages of one topic, for `Log.message`; instances follow each other."""
    chosen = [
        data
        for data in _parsed(path, [name])[0].data_list
        if data.name == name and instance in (None, str(data.multi_id))
    ]
    if not chosen:
        return {}
    time_ns = np.concatenate([_times(data.data) for data in chosen]) + offset_ns
    numbers = [np.full(len(data.data["timestamp"]), data.multi_id, np.int16) for data in chosen]
    fields = {
        field: np.concatenate([data.data[field] for data in chosen]) for field in chosen[0].data
    }
    return {"time_ns": time_ns, "instance": np.concatenate(numbers), **fields}
