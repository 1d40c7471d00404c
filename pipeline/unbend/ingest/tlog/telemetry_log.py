"""MAVLink telemetry logs (.tlog): frames -> channels in UTC."""

from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.clock import stray_times
from unbend.ingest.buffers import open_view
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.message_tables import Table
from unbend.ingest.tlog.borrowed_clocks import with_borrowed_clocks
from unbend.ingest.tlog.clock_samples import MICROSECOND, Key, by_source
from unbend.ingest.tlog.dialect import (
    MESSAGES,
    crc_extras,
    message_of_name,
    name_of,
    wanted_layouts,
)
from unbend.ingest.tlog.frames import frame_length
from unbend.ingest.tlog.scan import SILENT_US, Scan, Silence
from unbend.ingest.tlog.sender_clocks import Clocks, clock_field, clocks_of
from unbend.ingest.tlog.tlog_channels import channels_of, label_of, times_of
from unbend.messages import Ledger

SILENT_NS = SILENT_US * MICROSECOND


_CARRIED = {key.partition(".")[0] for key in MESSAGES}


# Messages whose time is that of the exposure, not of sending.
_LATE = {key for key, spec in MESSAGES.items() if spec.event}


def read_log(path: Path, ledger: Ledger) -> Contents:
    """The contents of a telemetry log."""
    wanted = wanted_layouts()
    with open_view(path) as data:
        late = {number for number in wanted if name_of(number) in _LATE}
        result = Scan(data, crc_extras(), wanted, late)
    result.report_bytes(ledger, path.name, "message")
    if result.unknown:
        count = sum(rejected.count for rejected in result.unknown.values())
        first = min(rejected.first for rejected in result.unknown.values())
        where, ids = f"{path.name}, first at byte {first}", sorted(result.unknown)[:8]
        ledger.warning("LOG-UNKNOWN-ID", where=where, count=count, ids=", ".join(map(str, ids)))
    damaged = 0
    for number, rejected in sorted(result.failed.items()):
        where = f"{path.name}, first at byte {rejected.first}"
        name = f"{name_of(number)} (id {number})"
        if result.counts[number] or number in wanted:
            damaged += rejected.size
            what = f"{rejected.count} messages {name} fail their checksum"
            ledger.loss("LOG-CRC", what, where=where, count=rejected.count)
        else:
            ledger.warning("LOG-DIALECT", where=where, count=rejected.count, name=name)
    if not result.steady:
        _replace_stray_stamps(result, ledger, path.name)
    sent = {name_of(number): result.sent.pop(number) for number in [*result.sent]}
    parts = [part for name, part in sent.items() if name in _CARRIED]
    sources = {int(n) for p in parts for b in p.blocks() for n in np.unique(b["source"])}
    clocks = clocks_of(result.clock.readings({source >> 8 for source in sources}), ledger)
    clocks = with_borrowed_clocks(clocks, parts, ledger)
    found, parameters = channels_of(sent, clocks, ledger)
    lost = _report_link(result, clocks, found, path, ledger)
    counts = {name_of(key): count for key, count in result.counts.items() if count}
    return Contents(
        counts, tuple(found), result.bad_bytes + damaged, lost, clocks.boots,
        clocks.description, partial(_table, path, clocks), parameters,
    )  # fmt: skip


def is_tlog(head: bytes) -> bool:
    """Whether a file begins with two frames, or one that is all of it."""
    first = frame_length(head, 0)
    return first > 0 and (first == len(head) or frame_length(head, first) > 0)


TLOG = LogFormat("tlog", "MAVLink telemetry", (".tlog", ".rlog"), is_tlog, read_log)


def _report_link(
    result: Scan, clocks: Clocks, found: list[Channel], path: Path, ledger: Ledger
) -> int:
    """Enter the messages of the senders of channels that the link lost; returns the least count."""
    carriers = {(channel.source.system, channel.source.component) for channel in found}
    lost = Counter({key: count for key, count in result.lost.items() if key in carriers})
    silent: dict[Key, list[Silence]] = {}
    for silence in result.silences:
        if silence.source in carriers and clocks.advanced(silence.source, silence.at, SILENT_NS):
            silent.setdefault(silence.source, []).append(silence)
            # after seconds of silence no message overtakes another: the step is a loss
            lost[silence.source] += silence.backward
    for (system, component), count in sorted((+lost).items()):
        ledger.loss(
            "LOG-LINK-LOSS/radio", where=path.name, count=count, system=system, component=component
        )
    for (system, component), silences in sorted(silent.items()):
        where, seconds = f"{path.name}, first before byte {silences[0].at}", SILENT_US / 1e6
        ledger.loss(
            "LOG-GAP/sender", where=where, count=len(silences), system=system, component=component,
            least=seconds, seconds=sum(silence.seconds for silence in silences),
        )  # fmt: skip
    return lost.total()


def _replace_stray_stamps(result: Scan, ledger: Ledger, where: str) -> None:
    """Replace stamps of the ground station, which no checksum covers, that jump and return."""
    stores = [*result.sent.values(), result.clock.rows]
    blocks = [block for store in stores[:-1] for block in store.blocks()]
    if not blocks:
        return
    at = np.concatenate([block["at"] for block in blocks])
    order = np.argsort(at, kind="stable")
    at = at[order]
    host_us = np.concatenate([block["host_us"] for block in blocks])[order]
    stray = stray_times(host_us * MICROSECOND)
    count = int(np.count_nonzero(stray))
    if count == 0 or bool(stray.all()):
        return
    ledger.loss("TIME-STRAY", where=f"{where}, first at byte {int(at[stray][0])}", count=count)
    good = host_us[~stray]
    before = np.maximum(np.searchsorted(np.flatnonzero(~stray), np.flatnonzero(stray)) - 1, 0)
    for store in stores:
        for block in store.blocks():
            place = np.minimum(np.searchsorted(at[stray], block["at"]), count - 1)
            replaced = at[stray][place] == block["at"]
            block["host_us"][replaced] = good[before[place[replaced]]]


def _table(path: Path, clocks: Clocks, name: str, instance: str | None) -> Table:
    """All messages of one type with their time, their sender and their fields as sent."""
    message = message_of_name().get(name)
    if message is None:
        return {}
    with open_view(path) as data:
        scan = Scan(data, crc_extras(), {message.number: message.dtype})
    store = scan.sent.get(message.number)
    if store is None:
        return {}
    rows = store.whole()
    if instance is not None:
        if not message.instance_field:
            return {}
        ids = rows["records"][message.instance_field]
        asked = [value for value in np.unique(ids) if label_of(value) == instance]
        rows = rows[np.isin(ids, asked)]
    if not len(rows):
        return {}
    time_ns, boot = np.empty(len(rows), np.int64), np.empty(len(rows), np.int16)
    field = clock_field(message.fields)
    for source, of_source in by_source(rows):
        part = times_of(rows[of_source], field, clocks, source)
        time_ns[of_source], boot[of_source] = part
    table: Table = {"time_ns": time_ns, "boot": boot, "system": rows["source"] >> 8}
    table["component"] = rows["source"] & 0xFF
    for name in message.fields:
        raw = table[name] = np.ascontiguousarray(rows["records"][name])
        if name in message.texts:  # bytes beyond ASCII become U+FFFD, as in the library
            values, places = np.unique(raw, return_inverse=True)
            texts = [v.split(b"\0", 1)[0].decode("ascii", "replace") for v in values.tolist()]
            table[name] = np.array(texts, np.str_)[places]
    return table
