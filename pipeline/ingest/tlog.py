"""MAVLink telemetry logs (.tlog): frames -> channels in UTC."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Channel, Source, TimeArray
from pipeline.flight.clock import UNIX_US_FROM, stray_times
from pipeline.ingest.base import Contents, Table, report_damage
from pipeline.ingest.build import Rows, channel_of
from pipeline.ingest.fields import MessageMap, extract
from pipeline.ingest.gimbal import north_only
from pipeline.ingest.heights import HEIGHT_OPTION, says_ellipsoid, with_ellipsoidal_heights
from pipeline.ingest.tlog_clock import (
    MICROSECOND,
    MILLISECOND,
    ROUND_MS,
    ROUND_US,
    Clocks,
    Key,
    Readings,
    clocks_of,
)
from pipeline.ingest.tlog_dialect import Dialect, Message, dialect
from pipeline.ingest.tlog_events import distinct, taken
from pipeline.ingest.tlog_fields import LABELS, MESSAGES, PARAM_VALUE, SYSTEM_TIME, wanted_fields
from pipeline.ingest.tlog_frames import frame_length
from pipeline.ingest.tlog_scan import Scan, Sent, scan
from pipeline.ingest.window import window_on
from pipeline.ledger import Ledger

READING = ("at", "source", "host_ns", "boot_ns", "utc_ns")
_LAST_US = 1 << 52  # stamps beyond are damage; below, nanoseconds fit into 64 bits


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
        known = dialect()
        wanted = wanted_fields()
        with window_on(path) as data:
            found = scan(data, known.extras, known.layouts(wanted))
        damaged = _report_damage(found, known, set(wanted), path, ledger)
        sent = {known.messages[number].name: part for number, part in found.sent.items()}
        found.sent.clear()  # a message is let go when its channels are made
        sent = _with_steady_host(sent, found.steady, ledger, path.name)
        clocks = clocks_of(_readings(sent), ledger)
        channels = _channels(sent, clocks, ledger)
        lost = _report_link(found, channels, path, ledger)
        return Contents(
            {known.name(key): count for key, count in found.counts.items() if count},
            tuple(channels),
            found.bad_bytes + damaged,
            lost,
            clocks.boots,
            clocks.words,
            partial(_table, path, clocks),
        )


TLOG = Tlog()


def _report_damage(
    found: Scan, known: Dialect, needed: set[str], path: Path, ledger: Ledger
) -> int:
    """Enter the damage; returns the bytes of frames whose checksum fails by damage."""
    report_damage(ledger, path.name, "message", found.bad_bytes, found.first_bad, found.cut_bytes)
    if found.unknown:
        count = sum(suspects.count for suspects in found.unknown.values())
        first = min(suspects.first for suspects in found.unknown.values())
        ledger.warning(
            "LOG-UNKNOWN-ID",
            f"{count} messages have ids that the dialect does not know "
            f"({', '.join(str(key) for key in sorted(found.unknown)[:8])}): not checked, not read",
            where=f"{path.name}, first at byte {first}",
            count=count,
        )
    damaged = 0
    for number, suspects in sorted(found.failed.items()):
        where = f"{path.name}, first at byte {suspects.first}"
        name = f"{known.name(number)} (id {number})"
        if found.counts[number] or known.name(number) in needed:
            damaged += suspects.size
            what = f"{suspects.count} messages {name} fail their checksum"
            ledger.loss("LOG-CRC", what, where=where, count=suspects.count)
        else:
            ledger.warning(
                "LOG-DIALECT",
                f"{suspects.count} messages {name} fail their checksum, all there are: another "
                "version of the dialect; nothing here needs them",
                where=where,
                count=suspects.count,
            )
    return damaged


def _report_link(found: Scan, channels: list[Channel], path: Path, ledger: Ledger) -> int:
    carriers = {(channel.source.system, channel.source.component) for channel in channels}
    lost = {source: count for source, count in found.lost.items() if source in carriers and count}
    for (system, component), count in sorted(lost.items()):
        ledger.warning(
            "LOG-LINK-LOSS",
            f"{count} messages of system {system}, component {component} are missing by "
            "their sequence numbers: the radio link lost them",
            where=path.name,
            count=count,
        )
    return sum(lost.values())


def _with_steady_host(
    sent: Mapping[str, Sent], steady_stamps: bool, ledger: Ledger, where: str
) -> dict[str, Sent]:
    """The messages with the ground station's stamps mended where they jump away and back.

    The stamps lie outside the checksum. A stray one takes the value of the one before it.
    """
    names = list(sent)
    if steady_stamps or not names:
        return dict(sent)
    at = np.concatenate([sent[name].at for name in names])
    host_us = np.concatenate([sent[name].host_us for name in names])
    order = np.argsort(at, kind="stable")
    steady = host_us[order]
    stray = stray_times(steady * MICROSECOND)
    count = int(np.count_nonzero(stray))
    if count == 0 or bool(stray.all()):
        return dict(sent)
    ledger.loss(
        "TIME-STRAY",
        f"{count} messages carry a stamp of the ground station that fits none of their "
        "neighbours: the one before is used",
        where=f"{where}, first at byte {int(at[order][stray][0])}",
        count=count,
    )
    good = np.flatnonzero(~stray)
    before = np.maximum(np.searchsorted(good, np.arange(steady.shape[0]), side="right") - 1, 0)
    host_us[order] = steady[good[before]]
    edges = np.cumsum([len(sent[name]) for name in names])[:-1]
    parts = zip(names, np.split(host_us, edges), strict=True)
    return {name: replace(sent[name], host_us=part) for name, part in parts}


def _readings(sent: Mapping[str, Sent]) -> Readings | None:
    """Every message with ``time_boot_ms`` of the systems that send more than SYSTEM_TIME."""
    systems = [part.source >> 8 for name, part in sent.items() if name in MESSAGES]
    carriers = np.unique(np.concatenate(systems)) if systems else np.empty(0, np.uint16)
    parts: list[dict[str, NDArray[Any]]] = []
    for name, part in sent.items():
        late = name in MESSAGES and MESSAGES[name].event  # when it was asked for, not when sent
        if late or "time_boot_ms" not in (part.records.dtype.names or ()):
            continue
        mine = np.isin(part.source >> 8, carriers)
        records = part.records[mine]
        utc_ns = np.zeros(records.shape, np.int64)
        if name == SYSTEM_TIME:
            unix_us = np.minimum(records["time_unix_usec"], _LAST_US).astype(np.int64)
            utc_ns = np.where(unix_us > UNIX_US_FROM, unix_us * MICROSECOND, 0)
        boot_ns = records["time_boot_ms"].astype(np.int64) * MILLISECOND
        host_ns = part.host_us[mine] * MICROSECOND
        columns = (part.at[mine], part.source[mine], host_ns, boot_ns, utc_ns)
        parts.append(dict(zip(READING, columns, strict=True)))
    if not any(part["at"].size for part in parts):
        return None
    order = np.argsort(np.concatenate([part["at"] for part in parts]), kind="stable")
    # one column after the other: together they would be the peak of memory
    return Readings(**{n: np.concatenate([part.pop(n) for part in parts])[order] for n in READING})


def _channels(sent: dict[str, Sent], clocks: Clocks, ledger: Ledger) -> list[Channel]:
    channels = []
    keys = [key for key in MESSAGES if key.partition(".")[0] in sent]
    for place, key in enumerate(keys):
        spec, message = MESSAGES[key], key.partition(".")[0]
        again = any(later.partition(".")[0] == message for later in keys[place + 1 :])
        part = sent[message] if again else sent.pop(message)
        for rows, records in _rows_of(key, spec, part, clocks):
            if key == "CAMERA_FEEDBACK":
                rows = rows.take(distinct(records, rows.name, ledger))
            if key == "CAMERA_IMAGE_CAPTURED":
                rows = rows.take(taken(records, rows.name, ledger))
            if spec.event:  # the link may deliver an exposure late
                rows = rows.take(np.argsort(rows.time_ns, kind="stable"))
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    if PARAM_VALUE in sent and _heights_are_ellipsoidal(sent[PARAM_VALUE], channels):
        return with_ellipsoidal_heights(channels, ledger, PARAM_VALUE)
    return channels


def _heights_are_ellipsoidal(parameters: Sent, channels: list[Channel]) -> bool:
    """Whether the last value of the vehicle's parameter asks for heights above the ellipsoid."""
    systems = {channel.source.system for channel in channels if "h_msl_m" in channel.columns}
    mine = np.isin(parameters.source >> 8, [system for system in systems if system is not None])
    records = parameters.records[mine]
    values = records["param_value"][records["param_id"] == HEIGHT_OPTION.encode()]
    return bool(values.shape[0]) and says_ellipsoid(float(values[-1]))


def _by_source(part: Sent) -> Iterator[tuple[Key, Sent]]:
    sources = np.unique(part.source)
    for number in sources.tolist():
        mine = slice(None) if sources.shape[0] == 1 else part.source == number
        yield divmod(number, 256), Sent(**{name: col[mine] for name, col in vars(part).items()})


def _rows_of(
    key: str, spec: MessageMap, part: Sent, clocks: Clocks
) -> Iterator[tuple[Rows, NDArray[Any]]]:
    """The rows of each sender and instance of a message, in SI and as they were sent."""
    message = key.partition(".")[0]
    several = bool(np.any(part.source != part.source[0]))
    for source, sent in _by_source(part):
        time_ns = _times(sent, spec.time_field, clocks, source)
        boot = clocks.boot(source, sent.at)
        for label, mine in _instances(sent.records, spec.id_field):
            name = key if label is None else f"{key}[{label}]"
            name += f"@{source[0]}/{source[1]}" if several else ""
            records = sent.records[mine]
            columns = extract(_fields(records), spec.columns)
            if key == "GIMBAL_DEVICE_ATTITUDE_STATUS":
                columns = north_only(columns)
            label_of = LABELS.get(key)
            labels = {label_of: tuple(map(_text, records[label_of].tolist()))} if label_of else {}
            origin = Source(message, label, *source)
            yield Rows(name, origin, time_ns[mine], boot[mine], columns, labels), records


def _fields(records: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The fields by name; those of an array also one by one, as ``q.0``."""
    fields = {}
    for name in records.dtype.names or ():
        fields[name] = records[name]
        if records[name].ndim == 2:
            fields |= {f"{name}.{k}": records[name][:, k] for k in range(records[name].shape[1])}
    return fields


def _times(sent: Sent, field: str, clocks: Clocks, source: Key) -> TimeArray:
    """UTC [ns] by the message's own time, or by when it was received."""
    host_ns = sent.host_us * MICROSECOND
    if field == "time_boot_ms":
        since_boot = sent.records[field].astype(np.int64) * MILLISECOND
        return clocks.utc_of_boot(source, sent.at, host_ns, since_boot, ROUND_MS)
    if not field:
        return clocks.utc_of_host(source, sent.at, host_ns)
    # time_usec: Unix time from some senders, time since boot from others, 0 when not known
    stamp_us = np.minimum(sent.records[field].astype(np.uint64), _LAST_US).astype(np.int64)
    stamp_ns = stamp_us * MICROSECOND
    since_boot = clocks.utc_of_boot(source, sent.at, host_ns, stamp_ns, ROUND_US)
    time_ns = np.where(stamp_us > UNIX_US_FROM, stamp_ns, since_boot)
    unknown = stamp_us == 0
    if unknown.any():
        time_ns[unknown] = clocks.utc_of_host(source, sent.at[unknown], host_ns[unknown])
    return time_ns


def _instances(
    records: NDArray[Any], field: str
) -> Iterator[tuple[str | None, NDArray[np.bool_] | slice]]:
    if not field:
        yield None, slice(None)
        return
    for value in np.unique(records[field]):
        yield _label(value), records[field] == value


def _label(value: Any) -> str:
    return _text(value) if isinstance(value, bytes) else str(int(value))


def _text(value: bytes) -> str:
    """A char[] field: cut at the first NUL."""
    return value.split(b"\0", 1)[0].decode("ascii", "backslashreplace")


def _table(path: Path, clocks: Clocks, name: str, instance: str | None) -> Table:
    """All messages of one type with their time, their sender and their fields as sent."""
    known = dialect()
    if name not in known.numbers:
        return {}
    message = known.messages[known.numbers[name]]
    with window_on(path) as data:
        part = scan(data, known.extras, {message.number: message.dtype}).sent.get(message.number)
    if part is None:
        return {}
    if instance is not None:
        if not message.instance_field:
            return {}
        ids = part.records[message.instance_field]
        same = [value for value in np.unique(ids) if _label(value) == instance]
        mine = np.isin(ids, same)
        part = Sent(**{field: column[mine] for field, column in vars(part).items()})
    return _columns_of(part, message, clocks) if len(part) else {}


def _columns_of(part: Sent, message: Message, clocks: Clocks) -> Table:
    time_ns, boot = np.empty(len(part), np.int64), np.empty(len(part), np.int16)
    field = next((name for name in ("time_boot_ms", "time_usec") if name in message.fields), "")
    for source, sent in _by_source(part):
        mine = part.source == source[0] * 256 + source[1]
        time_ns[mine] = _times(sent, field, clocks, source)
        boot[mine] = clocks.boot(source, sent.at)
    table: Table = {
        "time_ns": time_ns,
        "boot": boot,
        "system": part.source >> 8,
        "component": part.source & 0xFF,
    }
    for name in message.fields:
        raw = part.records[name]
        table[name] = _texts(raw) if name in message.texts else np.ascontiguousarray(raw)
    return table


def _texts(raw: NDArray[Any]) -> NDArray[Any]:
    """Char arrays as text; what is no ASCII becomes U+FFFD, as in the library."""
    different, places = np.unique(raw, return_inverse=True)
    cut = [value.split(b"\0", 1)[0].decode("ascii", "replace") for value in different.tolist()]
    return np.array(cut, np.str_)[places]
