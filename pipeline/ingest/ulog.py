"""PX4 logs (.ulg), decoded by pyulog -> channels in UTC. Needs the extra `unbend[ulog]`."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.flight.channels import Channel, Source, TimeArray
from pipeline.flight.clock import LAST_US, UNIX_US_FROM, fit_offset, fresh, report_fit
from pipeline.ingest.base import Contents, Table, report_damage
from pipeline.ingest.build import LOWEST_FIX, Rows, channel_of
from pipeline.ingest.fields import MessageMap, column, extract
from pipeline.ledger import Ledger

MAGIC = b"ULog\x01\x12\x35"
FILE_HEADER = 16
RECEIVERS = ("vehicle_gps_position", "sensor_gps")

# What pyulog lets through from a damaged file, besides its own exceptions.
_COMPLAINTS = (
    ValueError, LookupError, TypeError, ArithmeticError, AttributeError, struct.error,
    RecursionError,
)  # fmt: skip

# Fields were renamed when PX4 1.14 went from scaled integers to doubles: both are here.
_GNSS = MessageMap(
    (
        column("lat_rad", "latitude_deg", "deg"),
        column("lat_rad", "lat", "degE7"),
        column("lon_rad", "longitude_deg", "deg"),
        column("lon_rad", "lon", "degE7"),
        column("h_msl_m", "altitude_msl_m"),
        column("h_msl_m", "alt", "mm"),
        column("h_ellipsoid_m", "altitude_ellipsoid_m", missing=0.0),
        column("h_ellipsoid_m", "alt_ellipsoid", "mm", missing=0.0),
        column("sigma_h_m", "eph"),
        column("sigma_v_m", "epv"),
        column("fix", "fix_type"),
    ),
    ("height", "position"),
    20,
    position=True,
)
_SHOT = MessageMap(
    (
        column("lat_rad", "lat", "deg"),
        column("lon_rad", "lon", "deg"),
        column("h_msl_m", "alt"),
        column("event_index", "seq"),
    ),
    ("events",),
    10,
)
TOPICS: Mapping[str, MessageMap] = {
    "vehicle_global_position": MessageMap(
        (
            column("lat_rad", "lat", "deg"),
            column("lon_rad", "lon", "deg"),
            column("h_msl_m", "alt"),
            column("h_ellipsoid_m", "alt_ellipsoid", missing=0.0),
        ),
        ("position",),
        10,
        position=True,
    ),
    "vehicle_gps_position": _GNSS,
    "sensor_gps": _GNSS,
    "vehicle_attitude": MessageMap(
        tuple(column(f"q_{axis}", f"q[{k}]") for k, axis in enumerate("wxyz")),
        ("attitude",),
        10,
        attitude=True,
    ),
    "sensor_baro": MessageMap(
        (column("pressure_pa", "pressure"), column("board_temperature_k", "temperature", "degC")),
        ("pressure", "cabin_pressure"),
        20,
    ),
    "vehicle_air_data": MessageMap(
        (
            column("pressure_pa", "baro_pressure_pa"),
            column("board_temperature_k", "baro_temp_celcius", "degC"),
        ),
        ("pressure",),
        10,
    ),
    "airspeed": MessageMap(
        (
            column("temperature_k", "air_temperature_celsius", "degC"),
            column("airspeed_m_s", "true_airspeed_m_s"),
        ),
        ("temperature", "airspeed"),
        30,
    ),
    "sensor_hygrometer": MessageMap(
        (
            column("temperature_k", "temperature", "degC"),
            column("relative_humidity", "humidity", "%"),
        ),
        ("temperature", "humidity", "cabin_temperature", "cabin_humidity"),
        20,
    ),
    "camera_capture": _SHOT,
    "camera_trigger": MessageMap((column("event_index", "seq"),), ("events",), 40),
}


@dataclass(frozen=True)
class ULogFormat:
    """The registry's line of this format."""

    name: str = "ulog"
    title: str = "PX4 ULog"
    extensions: tuple[str, ...] = (".ulg", ".ulog")

    def matches(self, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def read(self, path: Path, ledger: Ledger) -> Contents:
        found = _parsed(path, None)
        lost = _report_damage(found, path, ledger)
        offset_ns, words = _clock(found, ledger)
        messages: dict[str, int] = {}
        channels = []
        several = {data.name for data in found.data_list if data.multi_id}
        for data in found.data_list:
            messages[data.name] = messages.get(data.name, 0) + len(data.data["timestamp"])
            spec = TOPICS.get(data.name)
            channel = spec and _channel(data, spec, data.name in several, offset_ns, ledger)
            if channel:
                channels.append(channel)
        table = partial(_table, path, offset_ns)
        return Contents(messages, tuple(channels), 0, lost, 1, words, table)


ULOG = ULogFormat()


def _parsed(path: Path, topics: list[str] | None) -> Any:
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    except ImportError as error:
        raise LogError(
            "LOG-NEEDS-EXTRA",
            "PX4 logs are read with pyulog, which is not installed",
            where=str(path),
            remedy="pip install 'unbend[ulog]'",
        ) from error
    try:
        # It prints what `file_corruption` says, and leaves a file open that it opened and refused.
        with path.open("rb") as stream, contextlib.redirect_stdout(io.StringIO()):
            return ULog(stream, topics)
    except (*_COMPLAINTS, ULogException) as error:
        raise LogError(
            "LOG-ULOG",
            f"pyulog cannot read it: {type(error).__name__}: {error}",
            where=str(path),
            remedy="copy it again from the vehicle",
        ) from error


def _report_damage(found: Any, path: Path, ledger: Ledger) -> int:
    """Enter what is damaged; how many messages were lost cannot be known, but whether."""
    if found.file_corruption:
        ledger.loss(
            "LOG-ULOG-DAMAGE",
            "pyulog found damage; how many messages are lost is unknown",
            where=path.name,
            count=1,
        )
    else:
        report_damage(ledger, path.name, "message", 0, -1, _cut_bytes(path))
    if found.dropouts:
        lost_s = sum(drop.duration for drop in found.dropouts) / 1000.0
        ledger.warning(
            "LOG-DROPOUT",
            f"the logger could not keep up {len(found.dropouts)} times, {lost_s:.3f} s together",
            where=path.name,
            count=len(found.dropouts),
        )
    return int(found.file_corruption)


def _cut_bytes(path: Path) -> int:
    """How many bytes of a last message are there that the end of the file cuts off."""
    left = path.stat().st_size - FILE_HEADER
    with path.open("rb") as stream:
        stream.seek(FILE_HEADER)
        while len(head := stream.read(3)) == 3:
            size = 3 + int.from_bytes(head[:2], "little")
            if size > left:
                break
            left -= size
            stream.seek(size - 3, io.SEEK_CUR)
    return left


def _times(data: Mapping[str, NDArray[Any]]) -> TimeArray:
    raw = data["timestamp"].astype(np.uint64)
    return np.asarray(np.minimum(raw, np.uint64(LAST_US)).astype(np.int64) * 1000, np.int64)


def _clock(found: Any, ledger: Ledger) -> tuple[int, str]:
    """UTC minus time since boot [ns], and where it comes from."""
    for data in sorted(found.data_list, key=lambda data: (data.name, data.multi_id)):
        if data.name not in RECEIVERS or "time_utc_usec" not in data.data:
            continue
        utc_us = np.minimum(data.data["time_utc_usec"], np.uint64(LAST_US)).astype(np.int64)
        usable = (utc_us > UNIX_US_FROM) & (data.data["fix_type"] >= LOWEST_FIX)
        utc_ns, boot_ns = utc_us[usable] * 1000, _times(data.data)[usable]
        moved = fresh(utc_ns)
        fit = fit_offset(utc_ns[moved], boot_ns[moved])
        if fit is not None:
            report_fit(ledger, f"{fit.rows} rows of {data.name}", fit.spread_ns, "boot 0", fit.rows)
            return fit.offset_ns, f"vehicle clock, set to UTC by the median of {fit.rows} GPS rows"
    ledger.fallback(
        "TIME-NO-UTC",
        "no GPS row with a fix and UTC: time counts from boot, as if in 1970; events in this log "
        "can be used, matching by UTC is impossible",
        where="boot 0",
    )
    return 0, "vehicle clock; UTC is unknown"


def _channel(
    data: Any, spec: MessageMap, numbered: bool, offset_ns: int, ledger: Ledger
) -> Channel | None:
    time_ns = _times(data.data) + offset_ns
    instance = str(data.multi_id) if numbered else None
    name = f"{data.name}[{instance}]" if numbered else data.name
    boot = np.zeros(time_ns.shape, np.int16)
    columns = extract(data.data, spec.columns)
    return channel_of(Rows(name, Source(data.name, instance), time_ns, boot, columns), spec, ledger)


def _table(path: Path, offset_ns: int, name: str, instance: str | None) -> Table:
    """The messages of one topic, for `Log.message`; instances follow each other."""
    chosen = [
        data
        for data in _parsed(path, [name]).data_list
        if data.name == name and instance in (None, str(data.multi_id))
    ]
    if not chosen:
        return {}
    time_ns = np.concatenate([_times(data.data) for data in chosen]) + offset_ns
    numbers = [np.full(len(data.data["timestamp"]), data.multi_id, np.int16) for data in chosen]
    fields = {
        field: np.concatenate([data.data[field] for data in chosen]) for field in chosen[0].data
    }
    return {"time_ns": time_ns, "instance": np.concatenate(numbers), **fields}
