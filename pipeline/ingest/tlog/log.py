"""MAVLink telemetry logs (.tlog): frames -> channels in UTC."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Channel
from pipeline.flight.clock import stray_times
from pipeline.ingest.buffers import open_view
from pipeline.ingest.log import Contents, Table, report_damage
from pipeline.ingest.tlog.borrowed_clock import borrowed
from pipeline.ingest.tlog.channels import channels_of, label_of, times_of
from pipeline.ingest.tlog.clock import Clocks, clock_field, clocks_of
from pipeline.ingest.tlog.clock_readings import MICROSECOND, Key, by_source
from pipeline.ingest.tlog.dialect import Dialect, Message, dialect
from pipeline.ingest.tlog.fields import MESSAGES, wanted_fields
from pipeline.ingest.tlog.frames import frame_length
from pipeline.ingest.tlog.scan import SILENT_US, Scan, Silence, scan
from pipeline.ledger import Ledger

SILENT_NS = SILENT_US * MICROSECOND
_CARRIED = {key.partition(".")[0] for key in MESSAGES}
# When an exposure was asked for, not when it was sent, is the time in it.
_LATE = {key for key, spec in MESSAGES.items() if spec.event}


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
        with open_view(path) as data:
            late = {known.numbers[name] for name in _LATE if name in known.numbers}
            found = scan(data, known.extras, known.layouts(wanted), late)
        damaged = _report_damage(found, known, set(wanted), path, ledger)
        if not found.steady:
            _steady_host(found, ledger, path.name)
        sent = {known.messages[number].name: found.sent.pop(number) for number in [*found.sent]}
        parts = [part for name, part in sent.items() if name in _CARRIED]
        sources = {int(n) for p in parts for b in p.blocks() for n in np.unique(b["source"])}
        clocks = clocks_of(found.clock.readings({source >> 8 for source in sources}), ledger)
        clocks = borrowed(clocks, parts, ledger)
        channels = channels_of(sent, clocks, ledger)
        lost = _report_link(found, clocks, channels, path, ledger)
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
    report_damage(
        ledger, path.name, unit="message", bad_bytes=found.bad_bytes, first_bad=found.first_bad,
        cut_bytes=found.cut_bytes,
    )  # fmt: skip
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


def _report_link(
    found: Scan, clocks: Clocks, channels: list[Channel], path: Path, ledger: Ledger
) -> int:
    """Enter what the link lost of the senders of channels; returns how many messages at least."""
    carriers = {(channel.source.system, channel.source.component) for channel in channels}
    lost = Counter({key: count for key, count in found.lost.items() if key in carriers})
    silent: dict[Key, list[Silence]] = {}
    for silence in found.silences:
        if silence.source in carriers and clocks.ran_on(silence.source, silence.at, SILENT_NS):
            silent.setdefault(silence.source, []).append(silence)
            lost[silence.source] += silence.backward  # after seconds of silence nothing overtakes
    for (system, component), count in sorted((+lost).items()):
        ledger.loss(
            "LOG-LINK-LOSS",
            f"at least {count} messages of system {system}, component {component} are missing by "
            "their sequence numbers, which begin again after 256: the radio link lost them",
            where=path.name,
            count=count,
        )
    for (system, component), mine in sorted(silent.items()):
        ledger.loss(
            "LOG-GAP",
            f"nothing of system {system}, component {component} was recorded {len(mine)} times for "
            f"more than {SILENT_US / 1e6:.0f} s, {sum(one.seconds for one in mine):.1f} s "
            "together, while its clock ran on: the link was down, or bytes are missing",
            where=f"{path.name}, first before byte {mine[0].at}",
            count=len(mine),
        )
    return lost.total()


def _steady_host(found: Scan, ledger: Ledger, where: str) -> None:
    """Mend the ground station's stamps where they jump away and back.

    The stamps lie outside the checksum. A stray one takes the value of the one before it.
    """
    stores = [*found.sent.values(), found.clock.rows]
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
    ledger.loss(
        "TIME-STRAY",
        f"{count} messages carry a stamp of the ground station that fits none of their "
        "neighbours: the one before is used",
        where=f"{where}, first at byte {int(at[stray][0])}",
        count=count,
    )
    good = host_us[~stray]
    before = np.maximum(np.searchsorted(np.flatnonzero(~stray), np.flatnonzero(stray)) - 1, 0)
    for store in stores:
        for block in store.blocks():
            place = np.minimum(np.searchsorted(at[stray], block["at"]), count - 1)
            mine = at[stray][place] == block["at"]
            block["host_us"][mine] = good[before[place[mine]]]


def _table(path: Path, clocks: Clocks, name: str, instance: str | None) -> Table:
    """All messages of one type with their time, their sender and their fields as sent."""
    known = dialect()
    if name not in known.numbers:
        return {}
    message = known.messages[known.numbers[name]]
    with open_view(path) as data:
        sent = scan(data, known.extras, {message.number: message.dtype}).sent.get(message.number)
    if sent is None:
        return {}
    rows = sent.whole()
    if instance is not None:
        if not message.instance_field:
            return {}
        ids = rows["records"][message.instance_field]
        asked = [value for value in np.unique(ids) if label_of(value) == instance]
        rows = rows[np.isin(ids, asked)]
    return _columns_of(rows, message, clocks) if len(rows) else {}


def _columns_of(rows: NDArray[Any], message: Message, clocks: Clocks) -> Table:
    time_ns, boot = np.empty(len(rows), np.int64), np.empty(len(rows), np.int16)
    field = clock_field(message.fields)
    for source, mine in by_source(rows):
        time_ns[mine], boot[mine] = times_of(rows[mine], field, clocks, source)
    table: Table = {
        "time_ns": time_ns,
        "boot": boot,
        "system": rows["source"] >> 8,
        "component": rows["source"] & 0xFF,
    }
    for name in message.fields:
        raw = rows["records"][name]
        table[name] = _texts(raw) if name in message.texts else np.ascontiguousarray(raw)
    return table


def _texts(raw: NDArray[Any]) -> NDArray[Any]:
    """Char arrays as text; what is no ASCII becomes U+FFFD, as in the library."""
    different, places = np.unique(raw, return_inverse=True)
    cut = [value.split(b"\0", 1)[0].decode("ascii", "replace") for value in different.tolist()]
    return np.array(cut, np.str_)[places]
