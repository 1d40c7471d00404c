"""Messages of a telemetry log as they were sent -> channels."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, Source, TimeArray
from unbend.flight.clock import UNIX_US_FROM
from unbend.ingest.attitude import earth_frame_attitude
from unbend.ingest.boot_clock import microseconds
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.channel_builder import ColumnStores, DecodedRows, channel_of, with_both_heights
from unbend.ingest.field_maps import extract
from unbend.ingest.tlog.borrowed_clocks import unix_us
from unbend.ingest.tlog.clock_samples import MICROSECOND, Key, by_source
from unbend.ingest.tlog.dialect import LABELS, MESSAGES, PARAM_VALUE, message_of_name
from unbend.ingest.tlog.sender_clocks import CLOCK_FIELDS, LATEST_NS, Clocks, clock_field
from unbend.messages import Ledger
from unbend.units import Mask, Rows


def channels_of(
    sent: dict[str, ColumnStore], clocks: Clocks, ledger: Ledger
) -> tuple[list[Channel], dict[str, float]]:
    """The channels of the wanted messages, whose memory is freed on the way, and the parameters."""
    channels = []
    keys_of: dict[str, list[str]] = {}
    for key in MESSAGES:
        keys_of.setdefault(key.partition(".")[0], []).append(key)
    for message, keys in keys_of.items():
        for series in _series(keys, sent.pop(message), clocks) if message in sent else ():
            spec, rows = series.spec, series.rows()
            if series.key == "CAMERA_FEEDBACK":
                rows = rows.take(distinct_exposures(series.records(), rows.name, ledger))
            if series.key == "STATUSTEXT":
                rows = whole_texts(rows, series.records())
            if series.key == "CAMERA_IMAGE_CAPTURED":
                rows = rows.take(captured_images(series.records(), rows.name, ledger))
            late = spec.event  # the link delivers exposures late, and others overtake each other
            if not bool(np.all(rows.time_ns[1:] >= rows.time_ns[:-1])):
                newest = np.maximum.accumulate(rows.time_ns)
                late |= int(np.max(newest - rows.time_ns)) < LATEST_NS
            rows = rows.take(np.argsort(rows.time_ns, kind="stable")) if late else rows
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    parameters: dict[str, float] = {}
    if PARAM_VALUE in sent:
        rows_sent = sent[PARAM_VALUE].whole()
        systems = [c.source.system or 0 for c in channels if "h_msl_m" in c.columns]
        records = rows_sent["records"][np.isin(rows_sent["source"] >> 8, systems)]
        names = map(text_of, records["param_id"].tolist())
        parameters = dict(zip(names, records["param_value"].tolist(), strict=True))
    return with_both_heights(channels, parameters, ledger, PARAM_VALUE), parameters


class _Series:
    """A channel during reading: the messages of one sender and instance."""

    def __init__(self, key: str, sender: Key, label: str | None) -> None:
        self.key, self.spec = key, MESSAGES[key]
        self.source = Source(key.partition(".")[0], label, *sender)
        self.name = key if label is None else f"{key}[{label}]"
        self.time_ns, self.boot = ColumnStore("i8"), ColumnStore("i2")
        self.columns = ColumnStores(self.spec)
        self.sent: list[NDArray[Any]] = []

    def add(self, rows: NDArray[Any], clocks: Clocks) -> None:
        """Add the next messages."""
        records, fields = rows["records"], {}
        names = records.dtype.names or ()
        sender = (self.source.system or 0, self.source.component or 0)
        time_ns, boot = times_of(rows, clock_field(names), clocks, sender)
        self.time_ns.add(time_ns)
        self.boot.add(boot)
        for name in names:
            fields[name] = records[name]
            if records[name].ndim == 2:  # the elements of an array also one by one, as "q.0"
                elements = range(records[name].shape[1])
                fields |= {f"{name}.{k}": records[name][:, k] for k in elements}
        values = extract(fields, self.spec.columns)
        if self.key == "GIMBAL_DEVICE_ATTITUDE_STATUS":
            values = earth_frame_attitude(values)
        self.columns.add(values, rows.shape[0])
        if self.spec.event or self.spec.text_field:
            self.sent.append(records)

    def records(self) -> NDArray[Any]:
        """The messages of a camera as they were sent."""
        return np.concatenate(self.sent)

    def rows(self) -> DecodedRows:
        """All rows, with the texts that belong to them."""
        label = LABELS.get(self.key)
        texts = {label: tuple(map(text_of, self.records()[label].tolist()))} if label else {}
        times = self.time_ns.whole(), self.boot.whole()
        return DecodedRows(self.name, self.source, *times, self.columns.whole(), texts)


def _series(keys: list[str], store: ColumnStore, clocks: Clocks) -> list[_Series]:
    """The series of one message, for each key, sender and instance."""
    by_group: dict[tuple[int, Any], list[_Series]] = {}  # by sender, and instance as sent or None
    field = message_of_name()[keys[0]].instance_field
    for block in store.drained():
        for sender, of_sender in by_source(block):
            rows = block[of_sender]
            for value in np.unique(rows["records"][field]) if field else (None,):
                group = (sender[0] * 256 + sender[1], None if value is None else value.item())
                if group not in by_group:
                    label = None if value is None else label_of(value.item())
                    by_group[group] = [_Series(key, sender, label) for key in keys]
                part = rows if value is None else rows[rows["records"][field] == value]
                for series in by_group[group]:
                    series.add(part, clocks)
    result = [series for group in sorted(by_group) for series in by_group[group]]
    if len({source for source, _ in by_group}) > 1:
        for series in result:
            series.name += f"@{series.source.system}/{series.source.component}"
    return result


def times_of(
    rows: NDArray[Any], field: str, clocks: Clocks, source: Key
) -> tuple[TimeArray, NDArray[np.int16]]:
    """UTC [ns] and boot of (n,) messages of a sender, by their own time or that of reception."""
    at, host_ns, own = rows["at"], rows["host_us"] * MICROSECOND, clocks.of(source)
    if not field:
        return own.utc_of_host(at, host_ns), own.boot(at)
    unit, turn = CLOCK_FIELDS[field]
    stamp = microseconds(rows["records"][field])
    since_boot = stamp * unit
    placed = own.boot_places(at, since_boot)
    time_ns = own.utc_of_boot(placed, host_ns, since_boot, turn)
    boot = own.boot(placed)
    if field == "time_boot_ms":
        own_us = unix_us(rows["records"])
        if source in clocks.wrong_utc or not own_us.any():
            return time_ns, boot
        return np.where(own_us > 0, own_us * MICROSECOND, time_ns), boot
    # time_usec: Unix time from some senders, time since boot from others, 0 when not known
    time_ns = np.where(stamp > UNIX_US_FROM, since_boot, time_ns)
    other = (stamp == 0) | (stamp > UNIX_US_FROM)
    if other.any():
        boot[other] = own.boot(at[other])
        unknown = stamp == 0
        time_ns[unknown] = own.utc_of_host(at[unknown], host_ns[unknown])
    return time_ns, boot


def label_of(value: Any) -> str:
    """The label of an instance: its number or its name."""
    return text_of(value) if isinstance(value, bytes) else str(int(value))


def text_of(value: bytes) -> str:
    """A char[] field: cut at the first NUL."""
    return value.split(b"\0", 1)[0].decode("ascii", "backslashreplace")


def whole_texts(rows: DecodedRows, records: NDArray[Any]) -> DecodedRows:
    """An autopilot's texts; chunks of one id, not 0, are joined, "..." stands for missing ones."""
    texts: list[str] = []
    firsts: list[int] = []
    open_texts: dict[int, tuple[int, int]] = {}  # by id, the text and the number of the next chunk
    chunks = zip(rows.labels["text"], records["id"].tolist(), records["chunk_seq"], strict=True)
    for row, (text, number, chunk) in enumerate(chunks):
        begun, due = open_texts.get(number, (-1, 0))
        if number and chunk and begun >= 0 and chunk >= due:
            texts[begun] += ("..." if chunk > due else "") + text
        else:
            begun = len(texts)
            texts.append(("..." if number and chunk else "") + text)
            firsts.append(row)
        open_texts[number] = begun, int(chunk) + 1
    return replace(rows.take(np.array(firsts, np.intp)), labels={"text": tuple(texts)})


def distinct_exposures(table: NDArray[Any], name: str, ledger: Ledger) -> Rows:
    """The rows of CAMERA_FEEDBACK that are exposures, each time once with its first index.

    ArduPilot repeats a row while it waits for the next pulse, maybe already with the next index.
    """
    empty = (table["time_usec"] == 0) & (table["lat"] == 0) & (table["lng"] == 0)
    if empties := int(empty.sum()):
        what = f"{empties} of {table.shape[0]} rows have neither time nor place: no exposure"
        ledger.note("EVENT-EMPTY", what, where=name, count=empties)
    times, indices = table["time_usec"], table["img_idx"].astype(np.uint64)
    keys = np.where(times == 0, indices, times)
    first = _first_of_each(keys, ~empty, "the time of an exposure", name, ledger)
    by_unix = int(np.count_nonzero(times[first] > UNIX_US_FROM))
    if by_unix:
        ledger.note("EVENTS-TRIGGER-TIME/distinct-exposures", where=name, count=by_unix)
    unseen = np.setdiff1d(indices[~empty], indices[first])
    if unseen.shape[0]:
        number = int(unseen[0])
        ledger.warning("EVENT-NO-PULSE/feedback", where=name, count=unseen.size, first=number)
    return first


def captured_images(table: NDArray[Any], name: str, ledger: Ledger) -> Rows:
    """The rows of CAMERA_IMAGE_CAPTURED that are images, each once: cameras repeat some."""
    failed = table["capture_result"] == 0
    if failures := int(failed.sum()):
        what = f"{failures} of {table.shape[0]} rows report that the camera took no image"
        ledger.warning("EVENT-FAILED", what, where=name, count=failures)
    keys = table["time_boot_ms"].astype(np.int64) << 32
    keys |= table["image_index"].astype(np.int64) & 0xFFFFFFFF
    return _first_of_each(keys, ~failed, "an image", name, ledger)


def _first_of_each(keys: NDArray[Any], good: Mask, of: str, name: str, ledger: Ledger) -> Rows:
    """The first of the good rows of each key."""
    rows = np.flatnonzero(good)
    first = np.sort(np.unique(keys[rows], return_index=True)[1])
    if repeats := int(rows.size - first.size):
        what = f"{repeats} of {keys.size} rows repeat {of}"
        ledger.note("EVENT-REPEAT", what, where=name, count=repeats)
    return rows[first]
