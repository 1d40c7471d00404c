"""PX4 logs (.ulg) -> channels in UTC."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, Source
from unbend.flight.clock import LAST_US, STRAY_ROWS, stray_times
from unbend.ingest.attitude import earth_frame_attitude
from unbend.ingest.boot_clock import BootClock, fit_clock
from unbend.ingest.buffers import open_view
from unbend.ingest.channel_builder import (
    DecodedRows,
    captured_rows,
    channel_of,
    split_by_feedback,
    without_stray,
)
from unbend.ingest.field_maps import CAPTURE_UTC_FIELD, PX4_TOPICS, UTC_FIELD, MessageMap, extract
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.limits import SeriesLimit
from unbend.ingest.message_tables import Table, rows_by_value
from unbend.ingest.timelines import microseconds, nanoseconds, timeline
from unbend.ingest.ulog import messages
from unbend.ingest.ulog.ulog_messages import (
    APPENDED,
    FILE_HEADER,
    MAGIC,
    Text,
    ULogMessages,
    UlogTopic,
    flags_of,
)
from unbend.ingest.utc_evidence import FIRST_SET_US, UNCHECKED_SIGMA_S, UNCHECKED_WHY, Witness
from unbend.ingest.utc_readings import UtcReadings, rows_of
from unbend.messages import Ledger

BOOT_UTC = "boot_time_utc_us"  # information message: UTC at time since boot 0 [us since 1970]
SILENCE_NS = 100_000_000  # PX4 logs tens to hundreds of messages in this time
SILENT_INTERVALS = 5.0  # no silence is shorter than this many usual intervals of the fastest topic
MAX_STEADY_INTERVAL_NS = 200_000_000  # of a steady topic, which shows when nothing was logged
LONG_INTERVAL_PERCENTILE = 95.0  # of the intervals of a topic; the others may be silences
ROWS_BEFORE_LOG = 2  # of each topic: they may be sampled before the logger began

_ONE_BOOT = timeline([(np.zeros(1, np.int64), np.zeros(1, np.int64))])  # a ULog is of one boot
_ELEMENT = re.compile(r"\[(\d+)\]")

TopicRows = Mapping[UlogTopic, NDArray[Any]]


def read_log(path: Path, ledger: Ledger, witnesses: Sequence[Witness] = ()) -> Contents:
    """The contents of a PX4 log; ``witnesses`` are other clocks that show its date."""
    log = _messages(path, list(PX4_TOPICS))
    log.report_damage(ledger, path.name)
    sources = _sources(log.rows)
    clock = _clock(log, sources, ledger, witnesses)
    fit = clock.fits[0]
    offset_ns = 0 if fit is None else fit.offset_ns
    channels = []
    limit = SeriesLimit()
    for topic, rows_of_topic in log.rows.items():
        for source, rows in _rows_by_instance(sources[topic], rows_of_topic):
            if not limit.admits(len(rows)):
                continue
            channels += _channels_of_topic(topic, rows, source, offset_ns, ledger)
    limit.report(ledger, path.name)
    texts = _texts_channel(log.texts, offset_ns, ledger)
    if texts is not None:
        channels.append(texts)
    report_silences(log, path, ledger)
    return Contents(
        messages=dict(log.counts),
        channels=tuple(channels),
        bad_bytes=log.bad_bytes,
        # the format does not number messages: whether any is lost, not how many
        lost_messages=int(log.bad_bytes > 0 or log.damaged_values > 0),
        boots=1,
        time_base=_time_base(clock),
        table=partial(_table, path, offset_ns),
        parameters=log.parameters,
        utc_sigma_s=clock.sigma_s,
        clocks=clock.assessments,
    )


def is_ulog(head: bytes) -> bool:
    """Whether a file begins as a ULog does."""
    return head.startswith(MAGIC)


ULOG = LogFormat("ulog", "PX4 ULog", (".ulg", ".ulog"), is_ulog, read_log)


def _messages(path: Path, topics: list[str]) -> ULogMessages:
    """The messages of a file, those of ``topics`` as rows; LogError if it is not a whole ULog."""
    with open_view(path) as data:
        if data.size < FILE_HEADER:
            raise messages.header_cut_off(path=str(path), size=data.size, header_size=FILE_HEADER)
        flags = flags_of(data).incompatible
        if flags[0] & ~APPENDED or any(flags[1:]):
            raise messages.unknown_flags(path=str(path), flags=flags)
        return ULogMessages(data, topics)


def _field_names(rows: NDArray[Any]) -> tuple[str, ...]:
    """The names of the fields of messages."""
    return rows.dtype.names or ()


def _sources(rows_of_topic: TopicRows) -> dict[UlogTopic, Source]:
    """The source of each topic; it has a number of instance only if the topic has several."""
    numbered = {topic.name for topic in rows_of_topic if topic.instance}
    sources = {}
    for topic in rows_of_topic:
        instance = str(topic.instance) if topic.name in numbered else None
        sources[topic] = Source(topic.name, instance)
    return sources


def _rows_by_instance(source: Source, rows: NDArray[Any]) -> Iterator[tuple[Source, NDArray[Any]]]:
    """The sources in a topic with their rows: one for each id in the topic's field of ids.

    A topic without such a field, or with one id in all rows, is one source, as handed over.
    """
    spec = PX4_TOPICS.get(source.message)  # None in a table of a topic without a channel
    id_field = "" if spec is None else spec.id_field
    rows_of_id = list(rows_by_value(rows[id_field])) if id_field in _field_names(rows) else []
    if len(rows_of_id) <= 1:
        yield source, rows
        return
    for value, id_rows in rows_of_id:
        instance = str(value)
        if source.instance is not None:
            instance = f"{source.instance}.{value}"
        yield replace(source, instance=instance), rows[id_rows]


def _channel_name(source: Source) -> str:
    """The name of the channel of a topic."""
    if source.instance is None:
        return source.message
    return f"{source.message}[{source.instance}]"


def _channels_of_topic(
    topic: UlogTopic, rows: NDArray[Any], source: Source, offset_ns: int, ledger: Ledger
) -> list[Channel]:
    """The channel of a topic, or two of events (`feedback_apart`); none without usable rows.

    ``offset_ns`` is UTC minus time since boot.
    """
    spec = PX4_TOPICS[topic.name]
    boot_ns = nanoseconds(rows["timestamp"])
    fields = {
        _ELEMENT.sub(r".\1", name): rows[name] for name in _field_names(rows)
    }  # q[0] is "q.0"
    columns = extract(fields, spec.columns)
    if "flags" in columns:
        columns = earth_frame_attitude(columns)
    decoded = DecodedRows(
        name=_channel_name(source),
        source=source,
        time_ns=boot_ns + offset_ns,
        boot=np.zeros(boot_ns.shape, np.int16),
        columns=columns,
    )
    decoded = without_stray(decoded, stray_times(boot_ns), ledger)
    if spec.event:
        decoded = captured_rows(decoded, ledger)
    parts = [channel_of(part, spec, ledger) for part in split_by_feedback(decoded, ledger)]
    return [channel for channel in parts if channel is not None]


def _texts_channel(texts: list[Text], offset_ns: int, ledger: Ledger) -> Channel | None:
    """The channel of the vehicle's texts, None without any; ``offset_ns``: UTC minus boot time."""
    boot_ns = nanoseconds(np.array([text.time_us for text in texts], np.uint64))
    decoded = DecodedRows(
        name="MSG",
        source=Source("MSG"),
        time_ns=boot_ns + offset_ns,
        boot=np.zeros(boot_ns.shape, np.int16),
        columns={},
        labels={"text": tuple(text.words for text in texts)},
    )
    return channel_of(decoded, MessageMap((), text_field="text"), ledger)


class _Silences(NamedTuple):
    """Times in which no topic has a message.

    first_ns : time since boot at which the first begins.
    number : how many there are.
    silent_ns, logged_ns : the length of all of them together, and of the log without them.
    """

    first_ns: int
    number: int
    silent_ns: float
    logged_ns: float


def report_silences(log: ULogMessages, path: Path, ledger: Ledger) -> None:
    """Report times in which no topic has a message: messages were cut out, or not logged.

    If that is most of the time, the logger was not running all the time, and no loss is reported.
    """
    if _silences(log.rows) is None:
        return
    # Topics that are not read may have gone on: only a log with a silence is read again with them.
    silences = _silences(_messages(path, list(log.counts)).rows)
    if silences is None:
        return
    after_boot_s = silences.first_ns * 1e-9
    seconds = silences.silent_ns / 1e9
    if silences.silent_ns > silences.logged_ns:
        logged_s = silences.logged_ns / 1e9
        ledger.add(
            messages.logged_now_and_then(
                file=path.name,
                after_boot_s=after_boot_s,
                count=silences.number,
                seconds=seconds,
                logged_s=logged_s,
            )
        )
        return
    messages_per_ns = log.counts.total() / silences.logged_ns
    ledger.add(
        messages.messages_cut_out(
            file=path.name,
            after_boot_s=after_boot_s,
            count=silences.number,
            seconds=seconds,
            missing=round(messages_per_ns * silences.silent_ns),
        )
    )


def _silences(rows_of_topic: TopicRows) -> _Silences | None:
    """The times in which none of these topics has a message; None without any.

    How long a time must be to count, and from when on, the steady topics show: those with short
    intervals throughout. Without a steady topic there are no silences. Stray stamps are left out,
    and the first rows of each topic, which may be older than the log.
    """
    times_of_topics = []
    begin_ns = 0  # when all steady topics have begun
    shortest_ns = float("inf")  # the usual interval of the fastest steady topic
    for rows in rows_of_topic.values():
        time_ns = nanoseconds(rows["timestamp"])[ROWS_BEFORE_LOG:]
        time_ns = time_ns[~stray_times(time_ns)]
        times_of_topics.append(time_ns)
        if time_ns.size <= STRAY_ROWS:
            continue
        usual_ns, long_ns = np.percentile(
            np.diff(time_ns), [50.0, LONG_INTERVAL_PERCENTILE]
        ).tolist()
        is_steady = long_ns <= MAX_STEADY_INTERVAL_NS
        if is_steady:
            begin_ns = max(begin_ns, int(time_ns[0]))
            shortest_ns = min(shortest_ns, usual_ns)
    if not np.isfinite(shortest_ns):
        return None
    all_times_ns = np.unique(np.concatenate(times_of_topics))
    all_times_ns = all_times_ns[all_times_ns >= begin_ns]
    steps_ns = np.diff(all_times_ns)
    silent = steps_ns > max(SILENCE_NS, SILENT_INTERVALS * shortest_ns)
    if not silent.any():
        return None
    return _Silences(
        first_ns=int(all_times_ns[np.argmax(silent)]),
        number=int(np.count_nonzero(silent)),
        silent_ns=float(steps_ns[silent].sum()),
        logged_ns=float(steps_ns[~silent].sum()),
    )


def _clock(
    log: ULogMessages,
    sources: Mapping[UlogTopic, Source],
    ledger: Ledger,
    witnesses: Sequence[Witness],
) -> BootClock:
    """Fit UTC to the time since boot of a log.

    UTC is that of its receivers. Without a fix it is the UTC of camera captures; without these that
    of the boot, which the logger writes when the vehicle's clock has been set: by a receiver, a
    companion computer or a ground station. The UTC of the boot also shows the date of the log, as a
    weak witness.
    """
    unchecked = []
    for captures in _utc_readings(log.rows, sources, "events", CAPTURE_UTC_FIELD):
        unchecked.append(replace(captures, sigma_s=UNCHECKED_SIGMA_S, why=UNCHECKED_WHY))
    boot_time = _utc_of_boot_time(log)
    if not any(source.usable.any() for source in unchecked):
        unchecked += boot_time
    of_boot = [Witness(source.source, int(source.utc_ns[0]), is_weak=True) for source in boot_time]
    return fit_clock(
        _ONE_BOOT,
        _utc_readings(log.rows, sources, "position", UTC_FIELD),
        ledger,
        fallbacks=unchecked,
        utc_of="GPS row with a fix and UTC",
        witnesses=[*witnesses, *of_boot],
    )


def _utc_of_boot_time(log: ULogMessages) -> list[UtcReadings]:
    """A reading of the UTC of the boot, if the logger wrote it (`BOOT_UTC`); else an empty list."""
    utc_us = log.numbers.get(BOOT_UTC, 0.0)
    if not FIRST_SET_US < utc_us < LAST_US:  # also not a number
        return []
    one_row = np.zeros(1, np.int64)
    return [
        UtcReadings(
            source=f"values of {BOOT_UTC}",
            singular=f"value of {BOOT_UTC}",
            places=one_row,
            boot_ns=one_row,
            utc_ns=np.array([round(utc_us) * 1000], np.int64),
            usable=np.ones(1, np.bool_),
            sigma_s=UNCHECKED_SIGMA_S,
            why=UNCHECKED_WHY,
        )
    ]


def _time_base(clock: BootClock) -> str:
    """Where the UTC of a log comes from, in words, for inspections and reports."""
    fit = clock.fits[0]
    if fit is None:
        return "vehicle clock; UTC is unknown"
    return f"vehicle clock, set to UTC by the median of {fit.rows} rows"


def _utc_readings(
    rows_of_topic: TopicRows, sources: Mapping[UlogTopic, Source], role: str, field: str
) -> list[UtcReadings]:
    """UTC and time since boot in the rows of each topic with this role and this field of UTC."""
    readings = []
    for topic, rows in rows_of_topic.items():
        if role not in PX4_TOPICS[topic.name].roles or field not in _field_names(rows):
            continue
        boot_ns = nanoseconds(rows["timestamp"])
        utc_us = microseconds(rows[field])
        fix = rows["fix_type"] if "fix_type" in _field_names(rows) else np.empty(0)
        readings.append(
            rows_of(
                _channel_name(sources[topic]),
                places=np.arange(len(rows)),
                boot_ns=boot_ns,
                utc_ns=utc_us * 1000,
                usable=(utc_us > FIRST_SET_US) & ~stray_times(boot_ns),
                fix=fix,
            )
        )
    return readings


def _table(path: Path, offset_ns: int, topic: str, instance: str | None) -> Table:
    """The messages of a topic with their times and all fields, instance by instance.

    ``offset_ns``: UTC minus time since boot. ``instance`` None for all of them. The table is empty
    if there are no messages.
    """
    rows_of_instances = []
    instance_columns = []
    rows_of_topic = _messages(path, [topic]).rows
    sources = _sources(rows_of_topic)
    for key, rows_of_key in rows_of_topic.items():
        for source, rows_of_source in _rows_by_instance(sources[key], rows_of_key):
            label = source.instance or str(key.instance)
            if instance in (None, label):
                rows_of_instances.append(rows_of_source)
                instance_columns.append(np.full(len(rows_of_source), key.instance, np.int16))
    if not rows_of_instances:
        return {}
    rows = np.concatenate(rows_of_instances)
    table: Table = {
        "time_ns": nanoseconds(rows["timestamp"]) + offset_ns,
        "instance": np.concatenate(instance_columns),
    }
    for name in _field_names(rows):
        table[name] = rows[name]
    return table
