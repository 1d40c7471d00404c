"""Messages of a telemetry log as they were sent -> channels, block by block."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Array, Channel, Source, TimeArray
from pipeline.flight.clock import UNIX_US_FROM
from pipeline.ingest.ardupilot_heights import (
    HEIGHT_OPTION,
    selects_ellipsoid,
    with_ellipsoidal_heights,
)
from pipeline.ingest.attitude import earth_frame_attitude
from pipeline.ingest.boot_clock import microseconds
from pipeline.ingest.buffers import ColumnStore, allocate
from pipeline.ingest.channel_builder import DecodedRows, channel_of
from pipeline.ingest.fields import MessageMap, extract
from pipeline.ingest.tlog.borrowed_clock import unix_us
from pipeline.ingest.tlog.clock import CLOCK_FIELDS, Clocks
from pipeline.ingest.tlog.clock_readings import MICROSECOND, Key, by_source
from pipeline.ingest.tlog.events import distinct, taken
from pipeline.ingest.tlog.fields import LABELS, MESSAGES, PARAM_VALUE
from pipeline.ledger import Ledger

Group = tuple[int, Any]
"""Who sent a message (system times 256 plus component), and its instance as sent, or None."""


def channels_of(sent: dict[str, ColumnStore], clocks: Clocks, ledger: Ledger) -> list[Channel]:
    """The channels of the wanted messages, each of which is let go on the way."""
    channels = []
    keys: dict[str, list[str]] = {}
    for key in MESSAGES:
        keys.setdefault(key.partition(".")[0], []).append(key)
    for message, mine in keys.items():
        for series in _series(mine, sent.pop(message), clocks) if message in sent else ():
            spec, rows = series.spec, series.rows()
            if series.key == "CAMERA_FEEDBACK":
                rows = rows.take(distinct(series.records(), rows.name, ledger))
            if series.key == "CAMERA_IMAGE_CAPTURED":
                rows = rows.take(taken(series.records(), rows.name, ledger))
            if spec.event:  # the link may deliver an exposure late
                rows = rows.take(np.argsort(rows.time_ns, kind="stable"))
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    if PARAM_VALUE in sent and _heights_are_ellipsoidal(sent[PARAM_VALUE].whole(), channels):
        return with_ellipsoidal_heights(channels, ledger, PARAM_VALUE)
    return channels


def _heights_are_ellipsoidal(parameters: NDArray[Any], channels: list[Channel]) -> bool:
    """Whether the last value of the vehicle's parameter asks for heights above the ellipsoid."""
    systems = {channel.source.system for channel in channels if "h_msl_m" in channel.columns}
    mine = np.isin(parameters["source"] >> 8, [system for system in systems if system is not None])
    records = parameters["records"][mine]
    values = records["param_value"][records["param_id"] == HEIGHT_OPTION.encode()]
    return bool(values.shape[0]) and selects_ellipsoid(float(values[-1]))


@dataclass
class _Series:
    """A channel as it is filled: ``count`` rows of one sender and instance."""

    key: str
    spec: MessageMap
    name: str
    source: Source
    count: int
    done: int = 0
    columns: dict[str, Array] = field(default_factory=dict)
    sent: list[NDArray[Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.time_ns = allocate(self.count, np.int64)
        self.boot = allocate(self.count, np.int16)

    def add(self, rows: NDArray[Any], clocks: Clocks) -> None:
        """The next messages; a column takes memory when it has its first value."""
        part = slice(self.done, self.done + rows.shape[0])
        source = (self.source.system or 0, self.source.component or 0)
        time_ns, boot = times_of(rows, self.spec.time_field, clocks, source)
        self.time_ns[part], self.boot[part] = time_ns, boot
        values = extract(_fields(rows["records"]), self.spec.columns)
        needed = self.spec.position or self.spec.attitude
        if self.key == "GIMBAL_DEVICE_ATTITUDE_STATUS":
            values = earth_frame_attitude(values)
        for name, column in values.items():
            if name not in self.columns and (needed or bool(np.isfinite(column).any())):
                self.columns[name] = allocate(self.count, np.float64)
                self.columns[name][:] = np.nan
            if name in self.columns:
                self.columns[name][part] = column
        if self.spec.event:
            self.sent.append(rows["records"])
        self.done += rows.shape[0]

    def records(self) -> NDArray[Any]:
        """The messages of a camera as they were sent."""
        return np.concatenate(self.sent)

    def rows(self) -> DecodedRows:
        """What was added, with the texts that belong to it."""
        label = LABELS.get(self.key)
        texts = {label: tuple(map(text_of, self.records()[label].tolist()))} if label else {}
        return DecodedRows(self.name, self.source, self.time_ns, self.boot, self.columns, texts)


def _series(keys: list[str], store: ColumnStore, clocks: Clocks) -> list[_Series]:
    """The series of one message, for each key, sender and instance."""
    field = MESSAGES[keys[0]].id_field
    counts: Counter[Group] = Counter()
    for block in store.blocks():
        counts.update({group: rows.shape[0] for group, rows in _split(block, field)})
    several = len({source for source, _ in counts}) > 1
    found: dict[Group, list[_Series]] = {}
    for group in sorted(counts):
        sender, label = divmod(group[0], 256), None if group[1] is None else label_of(group[1])
        for key in keys:
            name = key if label is None else f"{key}[{label}]"
            name += f"@{sender[0]}/{sender[1]}" if several else ""
            origin = Source(key.partition(".")[0], label, *sender)
            series = _Series(key, MESSAGES[key], name, origin, counts[group])
            found.setdefault(group, []).append(series)
    for block in store.drained():
        for group, rows in _split(block, field):
            for series in found[group]:
                series.add(rows, clocks)
    return [series for each in found.values() for series in each]


def _split(rows: NDArray[Any], field: str) -> Iterator[tuple[Group, NDArray[Any]]]:
    """Messages by their sender and instance."""
    for source, mine in by_source(rows):
        part = rows[mine]
        number = source[0] * 256 + source[1]
        if not field:
            yield (number, None), part
            continue
        for value in np.unique(part["records"][field]):
            yield (number, value.item()), part[part["records"][field] == value]


def _fields(records: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The fields by name; those of an array also one by one, as ``q.0``."""
    fields = {}
    for name in records.dtype.names or ():
        fields[name] = records[name]
        if records[name].ndim == 2:
            fields |= {f"{name}.{k}": records[name][:, k] for k in range(records[name].shape[1])}
    return fields


def times_of(
    rows: NDArray[Any], field: str, clocks: Clocks, source: Key
) -> tuple[TimeArray, NDArray[np.int16]]:
    """UTC [ns] of messages by their own time, or by when they were received, and their boot.

    Parameters
    ----------
    rows : (n,) of one sender, as a scan keeps them.
    field : the message's own time, or "".
    """
    at, host_ns = rows["at"], rows["host_us"] * MICROSECOND
    if not field:
        return clocks.utc_of_host(source, at, host_ns), clocks.boot(source, at)
    unit, turn = CLOCK_FIELDS[field]
    stamp = microseconds(rows["records"][field])
    since_boot = stamp * unit
    placed = clocks.placed(source, at, since_boot)
    time_ns = clocks.utc_of_boot(source, placed, host_ns, since_boot, turn)
    boot = clocks.boot(source, placed)
    if field == "time_boot_ms":
        own_us = unix_us(rows["records"])
        if source in clocks.doubted or not own_us.any():
            return time_ns, boot
        return np.where(own_us > 0, own_us * MICROSECOND, time_ns), boot
    # time_usec: Unix time from some senders, time since boot from others, 0 when not known
    time_ns = np.where(stamp > UNIX_US_FROM, since_boot, time_ns)
    other = (stamp == 0) | (stamp > UNIX_US_FROM)
    if other.any():
        boot[other] = clocks.boot(source, at[other])
        unknown = stamp == 0
        time_ns[unknown] = clocks.utc_of_host(source, at[unknown], host_ns[unknown])
    return time_ns, boot


def label_of(value: Any) -> str:
    """An instance in words: a number or a name."""
    return text_of(value) if isinstance(value, bytes) else str(int(value))


def text_of(value: bytes) -> str:
    """A char[] field: cut at the first NUL."""
    return value.split(b"\0", 1)[0].decode("ascii", "backslashreplace")
