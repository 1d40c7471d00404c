"""PX4 logs (.ulg) -> channels in UTC."""

import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.errors import LogError
from unbend.flight.channels import Source
from unbend.flight.clock import STRAY_ROWS, UNIX_US_FROM, stray_times
from unbend.ingest.attitude import earth_frame_attitude
from unbend.ingest.boot_clock import UtcReadings, fit_clock, microseconds, nanoseconds, timeline
from unbend.ingest.buffers import open_view
from unbend.ingest.channel_builder import DecodedRows, captured_rows, channel_of, without_stray
from unbend.ingest.field_maps import CAPTURE_UTC_FIELD, PX4_TOPICS, UTC_FIELD, MessageMap, extract
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.message_tables import Table
from unbend.ingest.ulog.ulog_messages import APPENDED, FILE_HEADER, MAGIC, ULogMessages, flags_of
from unbend.messages import Ledger

SILENCE_NS = 100_000_000  # PX4 logs tens to hundreds of messages in this time


LONGEST_INTERVAL_NS = 200_000_000  # of a topic that shows whether anything was logged


_ONE_BOOT = timeline([(np.zeros(1, np.int64), np.zeros(1, np.int64))])  # a log a boot


_ELEMENT = re.compile(r"\[(\d+)\]")


Topic = tuple[str, int]  # its name and the instance


def read_log(path: Path, ledger: Ledger) -> Contents:
    """The contents of a PX4 log."""
    messages = _messages(path, list(PX4_TOPICS))
    messages.report_damage(ledger, path.name)
    numbered = {topic for topic, instance in messages.rows if instance}
    names = {
        (topic, instance): f"{topic}[{instance}]" if topic in numbered else topic
        for topic, instance in messages.rows
    }
    offset_ns, time_base = _clock(messages.rows, names, ledger)
    channels = []
    for (topic, instance), rows in messages.rows.items():
        source = Source(topic, str(instance) if topic in numbered else None)
        spec, name = PX4_TOPICS[topic], names[topic, instance]
        boot_ns = nanoseconds(rows["timestamp"])
        fields = {_ELEMENT.sub(r".\1", field): rows[field] for field in _names(rows)}
        columns = extract(fields, spec.columns)
        if "flags" in columns:
            columns = earth_frame_attitude(columns)
        boot = np.zeros(boot_ns.shape, np.int16)
        decoded = DecodedRows(name, source, boot_ns + offset_ns, boot, columns)
        decoded = without_stray(decoded, stray_times(boot_ns), ledger)
        decoded = captured_rows(decoded, ledger) if spec.event else decoded
        channel = channel_of(decoded, spec, ledger)
        if channel:
            channels.append(channel)
    times = [time_us for time_us, _ in messages.texts]
    boot_ns = nanoseconds(np.array(times, np.uint64))
    texts = {"text": tuple(text for _, text in messages.texts)}
    boot = np.zeros(boot_ns.shape, np.int16)
    said = DecodedRows("MSG", Source("MSG"), boot_ns + offset_ns, boot, {}, texts)
    if channel := channel_of(said, MessageMap((), text_field="text"), ledger):
        channels.append(channel)
    report_silences(messages, path.name, ledger)
    lost = int(messages.bad_bytes > 0 or messages.damaged_values > 0)
    return Contents(
        dict(messages.counts), tuple(channels), messages.bad_bytes, lost, 1, time_base,
        partial(_table, path, offset_ns), messages.parameters,
    )  # fmt: skip


ULOG = LogFormat(
    "ulog", "PX4 ULog", (".ulg", ".ulog"), lambda head: head.startswith(MAGIC), read_log
)


def _messages(path: Path, topics: list[str]) -> ULogMessages:
    """The messages of a file, those of some topics as rows."""
    refusal = partial(LogError, "LOG-ULOG", where=str(path))
    with open_view(path) as data:
        if data.size < FILE_HEADER:
            what = f"it ends after {data.size} of {FILE_HEADER} bytes of its header"
            raise refusal(what, remedy="copy it again from the vehicle")
        flags = flags_of(data)[0]
        if flags[0] & ~APPENDED or any(flags[1:]):
            what = f"it sets incompatible flags ({flags.hex()}) that this version does not know"
            remedy = "copy it again from the vehicle, or convert it with a newer tool of PX4"
            raise refusal(what, remedy=remedy)
        return ULogMessages(data, topics)


def _names(rows: NDArray[Any]) -> tuple[str, ...]:
    return rows.dtype.names or ()


def report_silences(messages: ULogMessages, name: str, ledger: Ledger) -> None:
    """Enter the times in which no topic has a message: whole ones were cut out, or never logged.

    Stamps of a topic that were sampled before the logger began, and stray ones, do not count.
    """
    parts, shortest = [], float(LONGEST_INTERVAL_NS)
    for rows in messages.rows.values():
        time_ns = nanoseconds(rows["timestamp"])[2:]
        time_ns = time_ns[~stray_times(time_ns)]
        interval = float(np.median(np.diff(time_ns))) if time_ns.size > STRAY_ROWS else np.inf
        if interval <= LONGEST_INTERVAL_NS:
            parts.append(time_ns)
            shortest = min(shortest, interval)
    if not parts:
        return
    begin = max(int(part[0]) for part in parts)
    time_ns = np.unique(np.concatenate(parts))
    steps = np.diff(time_ns[np.searchsorted(time_ns, begin) :])
    silent = steps > max(SILENCE_NS, 5.0 * shortest)
    if not silent.any():
        return
    first_s = float(time_ns[-1] - steps[np.argmax(silent) :].sum()) * 1e-9
    count, silent_ns = int(silent.sum()), float(steps[silent].sum())
    missing = round(messages.counts.total() / float(steps[~silent].sum()) * silent_ns)
    where, seconds = f"{name}, first {first_s:.3f} s after boot", silent_ns / 1e9
    ledger.loss("LOG-GAP/messages", where=where, count=count, seconds=seconds, messages=missing)


def _clock(rows_of: dict[Topic, Any], names: dict[Topic, str], ledger: Ledger) -> tuple[int, str]:
    """UTC minus time since boot [ns], and where it comes from."""
    by_role: dict[str, list[UtcReadings]] = {"position": [], "events": []}
    for field, role in ((UTC_FIELD, "position"), (CAPTURE_UTC_FIELD, "events")):
        for (topic, instance), rows in rows_of.items():
            if role in PX4_TOPICS[topic].roles and field in _names(rows):
                boot_ns, utc_us = nanoseconds(rows["timestamp"]), microseconds(rows[field])
                usable = (utc_us > UNIX_US_FROM) & ~stray_times(boot_ns)
                fix = rows["fix_type"] if "fix_type" in _names(rows) else np.empty(0)
                places, words = np.arange(len(rows)), f"rows of {names[topic, instance]}"
                readings = UtcReadings(words, places, boot_ns, utc_us * 1000, usable, fix)
                by_role[role].append(readings)
    receivers, cameras = by_role.values()
    utc_of = "GPS row with a fix and UTC"
    clock = fit_clock(_ONE_BOOT, receivers, ledger, cameras=cameras, utc_of=utc_of)
    if fit := clock.fits[0]:
        return fit.offset_ns, f"vehicle clock, set to UTC by the median of {fit.rows} rows"
    return 0, "vehicle clock; UTC is unknown"


def _table(path: Path, offset_ns: int, topic: str, instance: str | None) -> Table:
    """The messages of one topic, for `Log.message`; instances follow each other."""
    rows_of = {
        number: rows
        for (_, number), rows in _messages(path, [topic]).rows.items()
        if instance in (None, str(number))
    }
    if not rows_of:
        return {}
    rows = np.concatenate(list(rows_of.values()))
    numbers = np.repeat(np.array(list(rows_of), np.int16), [len(part) for part in rows_of.values()])
    table: Table = {"time_ns": nanoseconds(rows["timestamp"]) + offset_ns, "instance": numbers}
    return table | {field: rows[field] for field in _names(rows)}
