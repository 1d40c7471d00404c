"""MCAP logs (.mcap) of ROS 2, PX4 and Foxglove: records -> channels in UTC."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.clock import BOOT_STEP_NS
from unbend.ingest.boot_clock import RECORDER_APART_S, BootClock, fit_clock
from unbend.ingest.channel_builder import channel_of, split_by_feedback
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.mcap import messages, topics
from unbend.ingest.mcap.mcap_reader import McapReader
from unbend.ingest.mcap.record_layout import MAGIC
from unbend.ingest.mcap.second_clock import report_second_clock, second_clock_of
from unbend.ingest.mcap.stamps import LOG_TIME, SEQUENCE, STAMP, times_of
from unbend.ingest.mcap.topic_samples import TopicSamples
from unbend.ingest.message_tables import PLACE, Table, in_order
from unbend.ingest.messages import recorder_disagrees
from unbend.ingest.timelines import Timeline, timeline
from unbend.ingest.utc_evidence import (
    UNCHECKED_SIGMA_S,
    UNCHECKED_WHY,
    ClockAssessment,
    Witness,
    is_possible,
)
from unbend.ingest.utc_readings import UtcReadings
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND, Mask, Rows


def read_log(path: Path, ledger: Ledger, witnesses: Sequence[Witness] = ()) -> Contents:
    """The contents of an MCAP log; ``witnesses`` are other clocks that show its date."""
    reader = McapReader(ledger, path.name)
    line = timeline(reader.read_file(path))  # reads the file: all below needs the whole pass
    lost = reader.report()
    series: list[TopicSamples] = []
    for topic in reader.topics.values():
        series += topic.named_series()
    make_names_unique(series)
    recorder = reader.recorder_readings()
    clock = boot_clock_of(line, series, recorder, ledger, witnesses)
    reader.release_topics()
    second_clock = second_clock_of(series, recorder, clock)
    channels = []
    unstamped = 0
    while series:  # memory of samples is released when their channel is made
        samples = series.pop(0)
        rows, unstamped_rows = samples.rows(clock, ledger)
        unstamped += unstamped_rows
        for part in split_by_feedback(rows, ledger):
            channel = channel_of(part, samples.spec, ledger)
            if channel is not None:
                channels.append(channel)
    if recorder is None:  # no message counts from a boot
        compare_with_recorder(channels, reader.recorded_ns, ledger)
    if second_clock is not None:
        report_second_clock(second_clock, channels, ledger)
    return Contents(
        messages=reader.counts.by_name(reader.names),
        channels=tuple(channels),
        bad_bytes=reader.damage.bad_bytes,
        lost_messages=lost,
        boots=clock.line.boots,
        time_base=_time_base(clock, unstamped),
        table=partial(_table, path, clock),
        utc_sigma_s=clock.sigma_s,
        clocks=clock.assessments,
        second_clock=second_clock,
        recorded_ns=reader.recorded_ns,
        unread_encodings=reader.unread_encodings,
    )


def compare_with_recorder(
    channels: Sequence[Channel], recorded_ns: int | None, ledger: Ledger
) -> None:
    """Report it if the first stamp is more than a minute from the first log_time.

    ``recorded_ns``: that log_time in Unix ns, None if unknown. Stamps and log_time are of clocks of
    computers, and either clock may be wrong. Dates that no log can have are not judged here.
    """
    begins_ns = [int(channel.time_ns[0]) for channel in channels if len(channel)]
    if recorded_ns is None or not begins_ns or not is_possible(min(begins_ns)):
        return
    apart_s = (recorded_ns - min(begins_ns)) / NANOSECONDS_PER_SECOND
    if abs(apart_s) > RECORDER_APART_S:
        ledger.add(
            recorder_disagrees(
                where="", recorder="log_time", apart_s=apart_s, used="header.stamp of the messages"
            )
        )


def _time_base(clock: BootClock, unstamped: int) -> str:
    """Where the UTC of the messages comes from, in words, for inspections and reports.

    ``unstamped``: how many messages have no time of their own, and therefore log_time.
    """
    counts_from_boot = clock.line.boot.size > 0
    if not counts_from_boot:
        time_base = "header.stamp of the messages"
    elif any(clock.utc_known):
        time_base = "the vehicle's time since boot, set to UTC by its GNSS messages"
    elif any(clock.fits):
        time_base = "the vehicle's time since boot, set by the recorder's clock"
    else:
        time_base = "the vehicle's time since boot; UTC is unknown"
    if unstamped:
        time_base += f"; log_time for {unstamped} messages without one"
    return time_base


def is_mcap(head: bytes) -> bool:
    """Whether a file begins as an MCAP does."""
    return head.startswith(MAGIC)


MCAP = LogFormat("mcap", "MCAP", (".mcap",), is_mcap, read_log)


def make_names_unique(series: list[TopicSamples]) -> None:
    """Make the names of series distinct, in place.

    The schema is added to names that several series have, and a number where that is not enough.
    """
    count_of_name = Counter(samples.name for samples in series)
    for samples in series:
        if count_of_name[samples.name] > 1:
            samples.name += f" ({samples.source.message})"
    count_so_far: Counter[str] = Counter()
    for samples in series:  # time since boot and Unix time under one name and schema
        count_so_far[samples.name] += 1
        if count_so_far[samples.name] > 1:
            samples.name += f" #{count_so_far[samples.name]}"


def boots_of_topics(line: Timeline, series: Sequence[TopicSamples]) -> Timeline:
    """The timeline without the boots at which no single topic's time since boot steps back.

    Messages of different topics may come late, and seem to step back against each other.
    """
    starts = np.flatnonzero(np.diff(line.boot) > 0) + 1
    is_boot = np.zeros(starts.shape, np.bool_)
    if starts.size:
        for samples in series:
            if samples.from_integer:
                is_boot |= _steps_back_at(line, starts, samples)
    boots_begun = np.zeros(line.boot.shape, np.int16)  # at each stretch: 0 or 1
    boots_begun[starts] = is_boot
    return replace(line, boot=np.cumsum(boots_begun, dtype=np.int16))


def _steps_back_at(line: Timeline, starts: Rows, samples: TopicSamples) -> Mask:
    """Whether the time since boot of a topic steps back at the begin of some stretches.

    ``starts``: (n,) rows of stretches in ``line``. Returns (n,); False where the topic has no
    message before, or none from there on.
    """
    places, boot_ns = samples.stamps(line)
    row_behind = np.searchsorted(places, line.first[starts])
    has_both_sides = (row_behind > 0) & (row_behind < places.shape[0])
    rows_between = row_behind[has_both_sides]
    step_ns = boot_ns[rows_between] - boot_ns[rows_between - 1]
    steps_back = np.zeros(starts.shape, np.bool_)
    steps_back[has_both_sides] = step_ns < -BOOT_STEP_NS
    return steps_back


def clock_of_stamps(line: Timeline) -> BootClock:
    """The clock of messages with stamps in Unix time, which are used unchanged and unchecked."""
    of_stamps = ClockAssessment(
        clock="header.stamp of the messages",
        use="UTC of the log",
        utc=None,
        apart_s=None,
        sigma_s=UNCHECKED_SIGMA_S,
        why=UNCHECKED_WHY,
    )
    return BootClock(
        line,
        fits=(None,),  # times are not converted
        utc_known=(False,),
        sigma_s=UNCHECKED_SIGMA_S,
        assessments=(of_stamps,),
    )


def boot_clock_of(
    line: Timeline,
    series: list[TopicSamples],
    recorder: UtcReadings | None,
    ledger: Ledger,
    witnesses: Sequence[Witness] = (),
) -> BootClock:
    """Fit UTC to the clock since boot that PX4's messages count.

    ``line`` is the timeline by the messages of all topics. In each boot UTC comes from the
    receivers among ``series``. If no receiver gives a possible UTC in any boot, cameras take their
    place. Other boots take it from ``recorder`` (log_time), which is reported. ``recorder`` is None
    if no message counts from a boot: the stamps are then used as they are. ``witnesses``: other
    clocks that show the date.
    """
    if recorder is None:
        return clock_of_stamps(line)
    if line.boots > 1:
        line = boots_of_topics(line, series)
    receivers: list[UtcReadings] = []
    cameras: list[UtcReadings] = []
    for samples in series:
        readings = samples.utc_readings()
        if readings is None:
            continue
        if samples.spec.position:
            receivers.append(readings)
        else:
            cameras.append(replace(readings, sigma_s=UNCHECKED_SIGMA_S, why=UNCHECKED_WHY))
    utc_of = "GNSS message with a fix and no log_time"
    clock = fit_clock(
        line, receivers, ledger, recorder, fallbacks=cameras, utc_of=utc_of, witnesses=witnesses
    )
    for number, fit in enumerate(clock.fits):
        if fit is not None and not clock.utc_known[number]:
            set_by_recorder = messages.set_by_log_time(
                boot=number, count=fit.rows, sigma_s=clock.sigma_s
            )
            ledger.add(set_by_recorder)
    return clock


def _table(path: Path, clock: BootClock, name: str, instance: str | None) -> Table:
    """The messages of a topic with their times and all fields; ``instance`` None for all of them.

    A topic of several schemas gives one table, in the order of the file. The table is empty where
    no message is of the instance. Raises LogError (LOG-NO-TABLE) where the topic has messages and
    none of them can be decoded.
    """
    reader = McapReader(Ledger(), path.name, only=name)
    # exhausts the generator without keeping its results: the whole file is read
    deque(reader.read_file(path), 0)
    has_decoded = False
    tables: list[Table] = []
    for topic in reader.topics.values():
        for decoded in _tables_of(topic, clock):
            has_decoded = True
            table = decoded
            if instance is not None:
                table = _rows_of_instance(decoded, topic.spec.id_field, instance)
            if table:
                tables.append(table)
    if not has_decoded:
        _refuse_undecoded(reader, name)
    if not tables:
        return {}
    table_of_topic = in_order(tables)
    del table_of_topic[PLACE]
    return table_of_topic


def _refuse_undecoded(reader: McapReader, name: str) -> None:
    """Raise a LogError (LOG-NO-TABLE) if the topic is not read or its messages do not fit."""
    reasons = list(reader.unread)
    for topic in reader.topics.values():
        if topic.failed:
            reasons.append(topic.misfit)
    if reasons:
        raise messages.topic_without_table(file=reader.file, name=name, reason=reasons[0].what)


def _tables_of(topic: topics.Topic, clock: BootClock) -> Iterator[Table]:
    """A table of the messages with integers as times (see `OwnTimes`), and one of the others.

    The blocks of the topic are removed, so that they are not twice in memory.
    """
    for from_integer in (False, True):
        blocks = topic.blocks[from_integer]
        topic.blocks[from_integer] = []
        if not blocks:
            continue
        block = in_order(blocks)
        del block[SEQUENCE]
        log_ns = block.pop(LOG_TIME)
        places = block[PLACE] if from_integer else None
        times = times_of(block.pop(STAMP), log_ns, places, clock, ledger=Ledger(), topic=topic.name)
        table: Table = {"time_ns": times.time_ns, "boot": times.boot, "log_time_ns": log_ns}
        yield table | block


def _rows_of_instance(table: Table, id_field: str, instance: str) -> Table:
    """The rows with the name ``instance`` in the field of names; an empty table without any."""
    for name, rows in topics.rows_by_name(table, id_field):
        if name == instance:
            return {field: column[rows] for field, column in table.items()}
    return {}
