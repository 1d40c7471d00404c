"""MAVLink telemetry logs (.tlog, .rlog): frames -> channels in UTC."""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel
from unbend.flight.clock import stray_times
from unbend.ingest.buffers import ColumnStore, open_view
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.message_tables import Table
from unbend.ingest.tlog import messages
from unbend.ingest.tlog.borrowed_clocks import with_borrowed_clocks
from unbend.ingest.tlog.clock_samples import MICROSECOND
from unbend.ingest.tlog.dialect import (
    MESSAGES,
    MessageDefinition,
    crc_extras,
    message_of_key,
    message_of_name,
    name_of,
    wanted_layouts,
)
from unbend.ingest.tlog.frames import frame_length
from unbend.ingest.tlog.scan import SILENT_US, Scan, Silence
from unbend.ingest.tlog.sender_clocks import Clocks, KnownDates, clock_field, clocks_of
from unbend.ingest.tlog.senders import Sender, by_sender, components_of, systems_of
from unbend.ingest.tlog.tlog_channels import channels_of, label_of, times_of
from unbend.ingest.utc_evidence import Witness
from unbend.ingest.utc_readings import LOWEST_FIX
from unbend.messages import Ledger
from unbend.units import Integers

SILENT_NS = SILENT_US * MICROSECOND
RECEIVER_MESSAGES = ("GPS_RAW_INT", "GPS2_RAW")
LISTED_IDS = 8  # of the unknown ones, in the ledger
_CHANNEL_MESSAGES = {message_of_key(key) for key in MESSAGES}
# Keys of `MESSAGES` of messages that have the time of an exposure, not that of sending.
_EXPOSURE_KEYS = {key for key, spec in MESSAGES.items() if spec.event}


def read_log(
    path: Path,
    ledger: Ledger,
    witnesses: Sequence[Witness] = (),
) -> Contents:
    """The contents of a telemetry log; ``witnesses`` are other clocks that show its date."""
    scan = _scan_of(path)
    scan.report_bytes(ledger, path.name, "message")
    damaged_bytes = _report_rejected(scan, path.name, ledger)
    if not scan.steady:  # before the stamps are used: in messages, and in readings of clocks
        _replace_stray_stamps(scan, ledger, path.name)
    message_counts = {}
    for number, count in scan.counts.items():
        if count:
            message_counts[name_of(number)] = count
    sent = {name_of(number): store for number, store in scan.sent.items()}
    scan.sent.clear()  # `channels_of` frees the stores in ``sent``, message by message
    stores_of_channels = [store for name, store in sent.items() if name in _CHANNEL_MESSAGES]
    dates = KnownDates(
        systems_with_fix(sent),
        tuple(witnesses),
    )
    # The readings have no name, so that they are freed before the peak of memory in `channels_of`.
    clocks = clocks_of(scan.clock.readings(_systems_of_stores(stores_of_channels)), ledger, dates)
    clocks = with_borrowed_clocks(clocks, stores_of_channels, ledger)
    channels, parameters = channels_of(sent, clocks, ledger)
    lost = _report_link(scan, clocks, channels, path.name, ledger)
    return Contents(
        messages=message_counts,
        channels=tuple(channels),
        bad_bytes=scan.bad_bytes + damaged_bytes,
        lost_messages=lost,
        boots=clocks.boots,
        time_base=clocks.description,
        table=partial(_table, path, clocks),
        parameters=parameters,
        utc_sigma_s=clocks.utc_sigma_s,
        clocks=clocks.assessments,
    )


def _scan_of(path: Path) -> Scan:
    """The scan of a file, with the messages that channels and clocks are made of."""
    wanted = wanted_layouts()
    exposure_ids = {number for number in wanted if name_of(number) in _EXPOSURE_KEYS}
    with open_view(path) as data:
        return Scan(data, crc_extras(), wanted, exposure_ids)


def systems_with_fix(sent: Mapping[str, ColumnStore]) -> frozenset[int]:
    """The systems that sent a position of a GNSS receiver with a fix."""
    systems: set[int] = set()
    for name in RECEIVER_MESSAGES:
        if name not in sent:
            continue
        for block in sent[name].blocks():
            fix_type = block["records"]["fix_type"]
            has_fix = fix_type >= LOWEST_FIX
            with_fix = systems_of(block["source"][has_fix])
            systems |= set(np.unique(with_fix).tolist())
    return frozenset(systems)


def _systems_of_stores(stores: list[ColumnStore]) -> set[int]:
    """The systems that sent the messages in these stores."""
    systems: set[int] = set()
    for store in stores:
        for block in store.blocks():
            senders = np.unique(block["source"])
            systems |= set(systems_of(senders).tolist())
    return systems


def is_tlog(head: bytes) -> bool:
    """Whether a file, by its first bytes ``head``, begins with two frames, or is one frame."""
    first = frame_length(head, 0)
    if not first:
        return False
    return first == len(head) or frame_length(head, first) > 0


TLOG = LogFormat(
    name="tlog",
    title="MAVLink telemetry",
    extensions=(".tlog", ".rlog"),
    matches=is_tlog,
    read=read_log,
)


def _report_rejected(scan: Scan, file: str, ledger: Ledger) -> int:
    """Report frames that are not accepted; returns how many bytes of them are damage.

    A checksum that fails is damage if the log has good messages of that type, or if the type is
    wanted. Otherwise the type may have other fields in the dialect of the sender.
    """
    if scan.unknown:
        ledger.add(
            messages.unknown_ids(
                file=file,
                first=min(rejected.first for rejected in scan.unknown.values()),
                count=sum(rejected.count for rejected in scan.unknown.values()),
                ids=sorted(scan.unknown)[:LISTED_IDS],
            )
        )
    damaged_bytes = 0
    wanted = wanted_layouts()
    for number, rejected in sorted(scan.failed.items()):
        is_damage = scan.counts[number] > 0 or number in wanted
        report = messages.checksums_fail if is_damage else messages.another_dialect
        rejected_frames = report(
            file=file,
            first=rejected.first,
            count=rejected.count,
            name=f"{name_of(number)} (id {number})",
        )
        ledger.add(rejected_frames)
        if is_damage:
            damaged_bytes += rejected.size
    return damaged_bytes


def _report_link(
    scan: Scan,
    clocks: Clocks,
    channels: list[Channel],
    file: str,
    ledger: Ledger,
) -> int:
    """Report the messages that the link lost; returns how many are missing at least.

    These are the numbers missing in the sequence of a sender. Its silences are reported too. Only
    senders of channels count.
    """
    senders = set()
    for channel in channels:
        senders.add((channel.source.system, channel.source.component))
    lost: Counter[Sender] = Counter()
    for sender, count in scan.lost.items():
        if sender in senders:
            lost[sender] = count
    silences_of: dict[Sender, list[Silence]] = {}
    for silence in scan.silences:
        sender = silence.source
        if sender in senders and clocks.advances_at(sender, silence.place, SILENT_NS):
            silences_of.setdefault(sender, []).append(silence)
            # after seconds of silence no message overtakes another: a step back is a loss
            lost[sender] += silence.backward
    for sender, count in sorted((+lost).items()):  # + leaves out senders that lost none
        lost_message = messages.lost_by_radio(
            file=file,
            count=count,
            system=sender.system,
            component=sender.component,
        )
        ledger.add(lost_message)
    for sender, silences in sorted(silences_of.items()):
        silent_message = messages.sender_silent(
            file=file,
            byte=silences[0].place,
            count=len(silences),
            system=sender.system,
            component=sender.component,
            least_s=SILENT_US / 1e6,
            total_s=sum(silence.seconds for silence in silences),
        )
        ledger.add(silent_message)
    return lost.total()


def _replace_stray_stamps(scan: Scan, ledger: Ledger, file: str) -> None:
    """Replace, in place, stamps of the ground station that jump and return.

    No checksum covers the stamps. A stray stamp gets the value of the last good stamp before it, or
    of the first good stamp. If all are stray, they stay as they are.
    """
    blocks = [block for store in scan.sent.values() for block in store.blocks()]
    if not blocks:
        return
    places = np.concatenate([block["place"] for block in blocks])
    host_us = np.concatenate([block["host_us"] for block in blocks])
    order = np.argsort(places, kind="stable")
    places = places[order]
    host_us = host_us[order]
    stray = stray_times(host_us * MICROSECOND)
    count = int(np.count_nonzero(stray))
    if count == 0 or bool(stray.all()):
        return
    stray_places = places[stray]
    first = int(stray_places[0])
    ledger.add(messages.stray_stamps(file=file, first=first, count=count))
    good_us = host_us[~stray]
    good_before = np.searchsorted(places[~stray], stray_places) - 1
    replacement_us = good_us[np.maximum(good_before, 0)]
    for store in (*scan.sent.values(), scan.clock.rows):
        for block in store.blocks():
            _replace_stamps(block, stray_places, replacement_us)


def _replace_stamps(
    block: NDArray[Any],
    stray_places: Integers,
    replacement_us: Integers,
) -> None:
    """Replace the stamps of those messages or readings of a block that are at stray places.

    ``stray_places``: (n,) rising places in the file. ``replacement_us``: (n,) their new stamps.
    """
    first_not_before = np.searchsorted(stray_places, block["place"])
    stray_row = np.minimum(first_not_before, stray_places.shape[0] - 1)
    is_stray = stray_places[stray_row] == block["place"]
    block["host_us"][is_stray] = replacement_us[stray_row[is_stray]]


def _table(
    path: Path,
    clocks: Clocks,
    name: str,
    instance: str | None,
) -> Table:
    """The messages of one type with their time, their sender and their fields as sent.

    ``instance`` None for all messages. The table is empty if there are none.
    """
    message = message_of_name().get(name)
    if message is None:
        return {}
    rows = _messages_of_type(path, message)
    if instance is not None and len(rows):
        rows = _rows_of_instance(rows, message, instance)
    if not len(rows):
        return {}
    time_ns = np.empty(len(rows), np.int64)
    boot = np.empty(len(rows), np.int16)
    field = clock_field(message.fields)
    for sender, part in by_sender(rows):
        times = times_of(rows[part], field, clocks, sender)
        time_ns[part] = times.utc_ns
        boot[part] = times.boot
    table: Table = {
        "time_ns": time_ns,
        "boot": boot,
        "system": systems_of(rows["source"]),
        "component": components_of(rows["source"]),
    }
    for name_of_field in message.fields:
        column = np.ascontiguousarray(rows["records"][name_of_field])
        is_text = name_of_field in message.texts
        table[name_of_field] = _texts(column) if is_text else column
    return table


def _messages_of_type(path: Path, message: MessageDefinition) -> NDArray[Any]:
    """All messages of one type as `Scan.sent` has them; an empty array without any."""
    wanted = {message.number: message.dtype}
    with open_view(path) as data:
        scan = Scan(data, crc_extras(), wanted)
    if message.number not in scan.sent:
        return np.empty(0)
    return scan.sent[message.number].whole()


def _rows_of_instance(
    rows: NDArray[Any], message: MessageDefinition, instance: str
) -> NDArray[Any]:
    """The messages of the instance with this label; none if the message has no instances."""
    if not message.instance_field:
        return rows[:0]
    instances = rows["records"][message.instance_field]
    wanted = [value for value in np.unique(instances) if label_of(value) == instance]
    return rows[np.isin(instances, wanted)]


def _texts(raw: NDArray[Any]) -> NDArray[np.str_]:
    """(n,) char[] fields as texts up to the first NUL; bytes beyond ASCII become U+FFFD."""
    values, value_of_row = np.unique(raw, return_inverse=True)
    texts = []
    for value in values.tolist():
        letters, _, _ = value.partition(b"\0")
        texts.append(letters.decode("ascii", "replace"))
    return np.array(texts, np.str_)[value_of_row]
