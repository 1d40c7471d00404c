"""Messages of a telemetry log as they were sent -> channels."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, Source, TimeArray
from unbend.ingest.attitude import earth_frame_attitude
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.channel_builder import ColumnStores, DecodedRows, channel_of, with_both_heights
from unbend.ingest.field_maps import extract
from unbend.ingest.limits import SeriesLimit
from unbend.ingest.message_tables import rows_by_value
from unbend.ingest.messages import failed_exposures
from unbend.ingest.timelines import microseconds
from unbend.ingest.tlog import messages
from unbend.ingest.tlog.borrowed_clocks import unix_us
from unbend.ingest.tlog.clock_samples import MICROSECOND
from unbend.ingest.tlog.dialect import (
    LABELS,
    MESSAGES,
    PARAM_VALUE,
    message_of_key,
    message_of_name,
)
from unbend.ingest.tlog.sender_clocks import (
    CLOCK_FIELDS,
    MAX_DELAY_NS,
    Clocks,
    SenderClock,
    clock_field,
)
from unbend.ingest.tlog.senders import Sender, by_sender, systems_of
from unbend.ingest.utc_evidence import FIRST_SET_US
from unbend.messages import Ledger
from unbend.units import Mask, Rows

MISSING_CHUNK = "..."  # in a text, where a part was lost


def channels_of(
    sent: dict[str, ColumnStore], clocks: Clocks, ledger: Ledger
) -> tuple[list[Channel], dict[str, float]]:
    """The channels of the wanted messages, and the last values of the parameters.

    ``sent``: the stores of messages by name. The messages are removed from it, so that they are not
    twice in memory.
    """
    keys_of_message = _keys_of_messages()
    channels = []
    limit = SeriesLimit()
    for message, keys in keys_of_message.items():
        if message not in sent:
            continue
        store = sent.pop(message)
        for series in _series_of_message(keys, store, clocks, limit):
            rows = _rows_of_series(series, ledger)
            rows = _in_time_order(rows, is_event=series.spec.event)
            channel = channel_of(rows, series.spec, ledger)
            if channel is not None:
                channels.append(channel)
    limit.report(ledger, "")
    parameters = {}
    if PARAM_VALUE in sent:
        systems = _systems_with_height(channels)
        parameters = _last_values(sent[PARAM_VALUE].whole(), systems)
    return with_both_heights(channels, parameters, ledger, PARAM_VALUE), parameters


def _keys_of_messages() -> dict[str, list[str]]:
    """The keys of `MESSAGES` by message: a message may become several channels."""
    keys_of_message: dict[str, list[str]] = {}
    for key in MESSAGES:
        keys_of_message.setdefault(message_of_key(key), []).append(key)
    return keys_of_message


def _rows_of_series(series: "_Series", ledger: Ledger) -> DecodedRows:
    """The rows of a series, without repeated exposures, and with chunks of a text joined."""
    rows = series.rows()
    if series.key == "CAMERA_FEEDBACK":
        exposures = distinct_exposures(series.records(), rows.name, ledger)
        return rows.take(exposures)
    if series.key == "CAMERA_IMAGE_CAPTURED":
        images = captured_images(series.records(), rows.name, ledger)
        return rows.take(images)
    if series.key == "STATUSTEXT":
        return whole_texts(rows, series.records())
    return rows


def _in_time_order(rows: DecodedRows, *, is_event: bool) -> DecodedRows:
    """The rows in the order of their time; as they are where a clock was set back.

    Messages overtake each other by up to some seconds: a step back of `MAX_DELAY_NS` or more is of
    the clock. Events are put in order in any case, because the link may deliver them much later.
    """
    is_in_order = bool(np.all(rows.time_ns[1:] >= rows.time_ns[:-1]))
    if is_in_order:
        return rows
    steps_back_ns = np.maximum.accumulate(rows.time_ns) - rows.time_ns
    clock_was_set_back = int(np.max(steps_back_ns)) >= MAX_DELAY_NS
    if clock_was_set_back and not is_event:
        return rows
    order = np.argsort(rows.time_ns, kind="stable")
    return rows.take(order)


def _systems_with_height(channels: Sequence[Channel]) -> list[int]:
    """The systems with a channel that has heights: their parameters are used."""
    systems = []
    for channel in channels:
        if "h_msl_m" in channel.columns:
            systems.append(channel.source.system or 0)
    return systems


def _last_values(rows: NDArray[Any], systems: Sequence[int]) -> dict[str, float]:
    """The last value of each parameter that these systems sent; ``rows``: all PARAM_VALUE."""
    is_chosen = np.isin(systems_of(rows["source"]), systems)
    records = rows["records"][is_chosen]
    names = map(text_of, records["param_id"].tolist())
    values = records["param_value"].tolist()
    return dict(zip(names, values, strict=True))


class _SeriesId(NamedTuple):
    """A sender, and the instance as it sent it: a number or bytes, None without instances."""

    sender: Sender
    instance: Any


class _Series:
    """A channel during reading: the messages of one sender and instance.

    ``key``: of `MESSAGES`. ``label``: the instance in words, None of a message without instances.
    """

    def __init__(self, key: str, sender: Sender, label: str | None) -> None:
        self.key = key
        self.spec = MESSAGES[key]
        self.sender = sender
        self.source = Source(
            message=message_of_key(key),
            instance=label,
            system=sender.system,
            component=sender.component,
        )
        self.name = key if label is None else f"{key}[{label}]"
        self.time_ns = ColumnStore("i8")
        self.boot = ColumnStore("i2")
        self.columns = ColumnStores(self.spec)
        self._records: list[NDArray[Any]] = []

    def add(self, rows: NDArray[Any], clocks: Clocks) -> None:
        """Add the next messages, as `Scan.sent` has them."""
        records = rows["records"]
        field = clock_field(records.dtype.names or ())
        times = times_of(rows, field, clocks, self.sender)
        self.time_ns.add(times.utc_ns)
        self.boot.add(times.boot)
        values = extract(_fields_of(records), self.spec.columns)
        if self.key == "GIMBAL_DEVICE_ATTITUDE_STATUS":
            values = earth_frame_attitude(values)
        self.columns.add(values, rows.shape[0])
        if self.spec.event or self.spec.text_field:
            self._records.append(records)

    def records(self) -> NDArray[Any]:
        """The messages as they were sent; kept of exposures and texts only."""
        return np.concatenate(self._records)

    def rows(self) -> DecodedRows:
        """All rows, with the texts that belong to them; the series is emptied."""
        labels = {}
        if self.key in LABELS:
            label = LABELS[self.key]
            texts = self.records()[label].tolist()
            labels[label] = tuple(map(text_of, texts))
        return DecodedRows(
            name=self.name,
            source=self.source,
            time_ns=self.time_ns.whole(),
            boot=self.boot.whole(),
            columns=self.columns.whole(),
            labels=labels,
        )


def _fields_of(records: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The fields of messages; the elements of an array also one by one, as "q.0"."""
    fields = {}
    for name in records.dtype.names or ():
        column = records[name]
        fields[name] = column
        if column.ndim == 2:
            for index in range(column.shape[1]):
                fields[f"{name}.{index}"] = column[:, index]
    return fields


def _series_of_message(
    keys: list[str],
    store: ColumnStore,
    clocks: Clocks,
    limit: SeriesLimit,
) -> list[_Series]:
    """The series of one message, for each sender, instance and key; the store is emptied.

    The names have the sender if there are several.
    """
    series_of_id = _series_by_id(keys, store, clocks, limit)
    all_series: list[_Series] = []
    for series_id in sorted(series_of_id):
        all_series += series_of_id[series_id]
    senders = {series.sender for series in all_series}
    if len(senders) > 1:
        _add_senders_to_names(all_series)
    return all_series


def _series_by_id(
    keys: list[str],
    store: ColumnStore,
    clocks: Clocks,
    limit: SeriesLimit,
) -> dict[_SeriesId, list[_Series]]:
    """The series of each sender and instance, one for each key.

    Senders and instances beyond the limit have none.
    """
    series_of_id: dict[_SeriesId, list[_Series]] = {}
    message = message_of_key(keys[0])
    instance_field = message_of_name()[message].instance_field
    for series_id, rows in _rows_by_id(store, instance_field):
        if series_id not in series_of_id:
            if not limit.admits(rows.shape[0]):
                continue
            label = None if series_id.instance is None else label_of(series_id.instance)
            series_of_id[series_id] = [_Series(key, series_id.sender, label) for key in keys]
        for series in series_of_id[series_id]:
            series.add(rows, clocks)
    return series_of_id


def _add_senders_to_names(all_series: list[_Series]) -> None:
    """Add system and component of the sender to the name of each series, as in ATTITUDE@1/1."""
    for series in all_series:
        series.name += f"@{series.sender.system}/{series.sender.component}"


def _rows_by_id(
    store: ColumnStore,
    instance_field: str,
) -> Iterator[tuple[_SeriesId, NDArray[Any]]]:
    """The messages of each sender and instance, block by block; the store is emptied."""
    for block in store.drained():
        for sender, rows_of_sender in by_sender(block):
            for instance, rows in _by_instance(block[rows_of_sender], instance_field):
                yield _SeriesId(sender, instance), rows


def _by_instance(
    rows: NDArray[Any],
    instance_field: str,
) -> Iterator[tuple[Any, NDArray[Any]]]:
    """Each instance, as sent, with its messages.

    ``instance_field``: the name of the field with the instance; without such a field, "", the only
    instance is None.
    """
    if not instance_field:
        yield None, rows
        return
    instances = rows["records"][instance_field]
    for instance, rows_of_instance in rows_by_value(instances):
        yield instance, rows[rows_of_instance]


class SentTimes(NamedTuple):
    """UTC [ns] and boot of (n,) messages of a sender."""

    utc_ns: TimeArray
    boot: NDArray[np.int16]


def times_of(
    rows: NDArray[Any],
    field: str,
    clocks: Clocks,
    sender: Sender,
) -> SentTimes:
    """UTC and boot of (n,) messages of a sender.

    ``field``: the name of the field with the messages' own time, by which UTC comes from

    - "": the time of reception.
    - ``time_boot_ms``: the time since boot; of images the UTC that they carry, if it is right.
    - ``time_usec``: Unix time from some senders, time since boot from others; the time of reception
      if it is 0, which means unknown.
    """
    places = rows["place"]
    host_ns = rows["host_us"] * MICROSECOND
    clock = clocks.clock_of(sender)
    if not field:
        return SentTimes(
            clock.utc_of_host(places, host_ns),
            clock.boot_at(places),
        )
    unit_ns, wrap_ns = CLOCK_FIELDS[field]
    stamp = microseconds(rows["records"][field])  # cut at what no log can last
    stamp_ns = stamp * unit_ns
    boot_places = clock.boot_places(places, stamp_ns)
    time_ns = clock.utc_of_boot(boot_places, host_ns, stamp_ns, wrap_ns)
    boot = clock.boot_at(boot_places)
    if field == "time_boot_ms":
        if sender not in clocks.wrong_utc:
            time_ns = _with_utc_of_images(rows, clock, time_ns)
        return SentTimes(time_ns, boot)
    is_unix = stamp > FIRST_SET_US
    is_unknown = stamp == 0
    time_ns = np.where(
        is_unix,
        clock.utc_of_stated(places, stamp_ns),
        time_ns,
    )
    not_since_boot = is_unix | is_unknown
    if not_since_boot.any():
        boot[not_since_boot] = clock.boot_at(places[not_since_boot])
        received_ns = host_ns[is_unknown]
        time_ns[is_unknown] = clock.utc_of_host(places[is_unknown], received_ns)
    return SentTimes(time_ns, boot)


def _with_utc_of_images(
    rows: NDArray[Any],
    clock: SenderClock,
    time_ns: TimeArray,
) -> TimeArray:
    """``time_ns``, replaced by the UTC [ns] that the messages carry where they carry one.

    Only images do.
    """
    utc_us = unix_us(rows["records"])
    if not utc_us.any():
        return time_ns
    utc_of_images_ns = clock.utc_of_stated(rows["place"], utc_us * MICROSECOND)
    return np.where(utc_us > 0, utc_of_images_ns, time_ns)


def label_of(value: Any) -> str:
    """The label of an instance: its number or its name."""
    if isinstance(value, bytes):
        return text_of(value)
    return str(int(value))


def text_of(value: bytes) -> str:
    """The text of a char[] field, up to the first NUL; bytes beyond ASCII are escaped."""
    letters, _, _ = value.partition(b"\0")
    return letters.decode("ascii", "backslashreplace")


def whole_texts(rows: DecodedRows, records: NDArray[Any]) -> DecodedRows:
    """The rows of an autopilot's texts, with the chunks of one text joined.

    Chunks of one text have the same id and count from 0; a text of a single chunk has the id 0.
    "..." is in the place of missing chunks. A joined text is in the row of its first chunk.
    """
    texts: list[str] = []
    first_rows: list[int] = []
    text_of_id: dict[int, int] = {}  # the number in ``texts`` of the latest text of an id
    next_chunk: dict[int, int] = {}  # by id, the number of the chunk that is due
    ids = records["id"].tolist()
    chunks = records["chunk_seq"].tolist()
    for row, text in enumerate(rows.labels["text"]):
        text_id = ids[row]
        chunk = chunks[row]
        is_later_chunk = text_id != 0 and chunk != 0
        due = next_chunk.get(text_id, 0)
        if is_later_chunk and text_id in text_of_id and chunk >= due:
            missing = MISSING_CHUNK if chunk > due else ""
            texts[text_of_id[text_id]] += missing + text
        else:  # a new text; its first chunks may be missing
            text_of_id[text_id] = len(texts)
            texts.append(MISSING_CHUNK + text if is_later_chunk else text)
            first_rows.append(row)
        next_chunk[text_id] = chunk + 1
    with_texts = rows.take(np.array(first_rows, np.intp))
    return replace(with_texts, labels={"text": tuple(texts)})


def distinct_exposures(records: NDArray[Any], name: str, ledger: Ledger) -> Rows:
    """The rows of CAMERA_FEEDBACK that are exposures: the first row of each exposure time.

    ArduPilot repeats a row while it waits for the next pulse, maybe already with the next image
    index. Rows without a time are distinguished by their index; rows with neither time nor place
    are dropped. ``name``: of the channel, for the reports of all this.
    """
    times_us = records["time_usec"]
    indices = records["img_idx"].astype(np.uint64)
    is_empty = (times_us == 0) & (records["lat"] == 0) & (records["lng"] == 0)
    empty_rows = int(np.count_nonzero(is_empty))
    if empty_rows:
        total = records.shape[0]
        ledger.add(messages.empty_feedback(channel=name, count=empty_rows, total=total))
    keys = np.where(times_us == 0, indices, times_us)
    first_rows = _first_of_each(keys, ~is_empty, "the time of an exposure", name, ledger)
    with_unix_time = int(np.count_nonzero(times_us[first_rows] > FIRST_SET_US))
    if with_unix_time:
        ledger.add(messages.times_of_triggers(channel=name, count=with_unix_time))
    unseen = np.setdiff1d(indices[~is_empty], indices[first_rows])
    if unseen.size:
        without_feedback = messages.numbers_without_feedback(
            channel=name,
            count=unseen.size,
            first=int(unseen[0]),
        )
        ledger.add(without_feedback)
    return first_rows


def captured_images(records: NDArray[Any], name: str, ledger: Ledger) -> Rows:
    """The rows of CAMERA_IMAGE_CAPTURED that are images: the first row of each, as some repeat.

    ``name``: of the channel, for the reports of failed and repeated images.
    """
    failed = records["capture_result"] == 0
    failures = int(np.count_nonzero(failed))
    if failures:
        total = records.shape[0]
        ledger.add(failed_exposures(channel=name, count=failures, total=total))
    # One image has one time and one index: both, of 32 bits each, are one number.
    keys = records["time_boot_ms"].astype(np.int64) << 32
    keys |= records["image_index"].astype(np.int64) & 0xFFFFFFFF
    return _first_of_each(keys, ~failed, "an image", name, ledger)


def _first_of_each(
    keys: NDArray[Any],
    good: Mask,
    key_words: str,
    name: str,
    ledger: Ledger,
) -> Rows:
    """The first of the good rows of each key, rising; the repeated rows are reported.

    ``keys``: (n,) of all rows. ``good``: (n,) mask of the rows that count. ``key_words``: what a
    key is, for the report.
    """
    rows = np.flatnonzero(good)
    _, first = np.unique(keys[rows], return_index=True)
    repeats = int(rows.size - first.size)
    if repeats:
        repeated = messages.repeated_events(
            channel=name,
            count=repeats,
            total=keys.size,
            what=key_words,
        )
        ledger.add(repeated)
    return rows[np.sort(first)]
