"""Which messages of MCAP logs are wanted, their times in any form, and their columns in SI."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Source, TimeArray
from unbend.flight.clock import UNIX_US_FROM
from unbend.ingest.attitude import earth_frame_attitude, ned_frd_of_enu_flu, replace_in_blocks
from unbend.ingest.boot_clock import (
    LOWEST_FIX,
    BootClock,
    Timeline,
    UtcReadings,
    microseconds,
)
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.channel_builder import ColumnStores, DecodedRows, captured_rows, without_stray
from unbend.ingest.field_maps import (
    CAPTURE_UTC_FIELD,
    PX4_MESSAGES,
    UTC_FIELD,
    FieldColumn,
    MessageMap,
    extract,
    message_maps,
)
from unbend.ingest.mcap.ros2_definitions import short
from unbend.ingest.mcap.stamps import (
    LOG_TIME,
    SEQUENCE,
    STAMP,
    Columns,
    good_rows,
    in_sequence,
    since_boot,
    times_of,
)
from unbend.ingest.message_tables import PLACE
from unbend.messages import Ledger
from unbend.units import Array

_NAMED_VALUE_INT = 4.0  # DebugValue.TYPE_NAMED_VALUE_INT: the value is in another field


_PX4 = {f"px4_msgs/{name}": spec for name, spec in PX4_MESSAGES.items()}


_STAMPS = {"mavros_msgs/CamIMUStamp": "frame_stamp"}


_WITH_HEADER = {
    name: replace(spec, time_field=_STAMPS.get(name, "header.stamp"))
    for name, spec in message_maps("ros").items()
}


SCHEMAS: Mapping[str, MessageMap] = _WITH_HEADER | _PX4 | message_maps("foxglove")


# JSON of a schema of the user's own: a time and a value, of a role only when it is named.
PLAIN_JSON = MessageMap((FieldColumn("value", ("value",)),))


# Texts that belong to each event, and where they may be.
LABELS: Mapping[str, str] = {"file_url": "file_url", "frame_id": "header.frame_id frame_id"}


def known_name(schema: str) -> str:
    """The name of a message in `SCHEMAS`, whatever the encoding writes between its parts.

    >>> known_name("sensor_msgs/msg/NavSatFix"), known_name("foxglove_msgs/msg/RawImage")
    ('sensor_msgs/NavSatFix', 'foxglove.RawImage')
    """
    return short(schema).replace("foxglove_msgs/", "foxglove.")


def finished(schema: str, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns as decoded -> columns in use: one attitude convention, sigmas, a fix as in MAVLink.

    An Imu whose first covariance is -1 has no orientation (sensor_msgs/Imu); a NavSatFix whose
    covariance type is 0 does not know its accuracy.
    """
    result = dict(columns)
    if schema.endswith("/GimbalDeviceAttitudeStatus") and "flags" in result:
        result = earth_frame_attitude(result)
    if schema.endswith("/DebugValue"):
        kind, whole = result.pop("kind", None), result.pop("integer", None)
        if kind is not None and whole is not None:
            result["value"] = np.where(kind == _NAMED_VALUE_INT, whole, result["value"])
    if "ros_w" in result:
        q = [result.pop(f"ros_{axis}") for axis in "wxyz"]
        replace_in_blocks(ned_frd_of_enu_flu, q)
        if "covariance_0" in result:
            unknown = result.pop("covariance_0") == -1.0
            for part in q:
                part[unknown] = np.nan
        result |= {f"q_{axis}": part for axis, part in zip("wxyz", q, strict=True)}
    if "status" in result:
        result["fix"] = np.where(result.pop("status") >= 0.0, float(LOWEST_FIX), 0.0)
    if "covariance_type" in result:
        known = result.pop("covariance_type") > 0.0
        variances = [result.pop(f"variance_{k}", np.full(known.shape, np.nan)) for k in range(3)]
        east, north, up = (np.where(known, np.maximum(part, 0.0), np.nan) for part in variances)
        result |= {"sigma_h_m": np.sqrt(east / 2.0 + north / 2.0), "sigma_v_m": np.sqrt(up)}
    return result


@dataclass
class TopicSamples:
    """What was read of one topic, or of one name in it.

    ``stamp_ns`` own times, 0 without; ``log_ns`` the recorder's by their first row, where needed;
    ``utc_us`` UTC beside the time since boot. ``counted`` stamps are microseconds, maybe from a
    boot: then ``places`` are those in the whole log; else ``sequence`` are the messages' numbers.
    """

    name: str
    source: Source
    spec: MessageMap
    counted: bool = False
    stamp_ns: ColumnStore = field(default_factory=lambda: ColumnStore("i8"))
    places: ColumnStore = field(default_factory=lambda: ColumnStore("i8"))
    sequence: ColumnStore = field(default_factory=lambda: ColumnStore("u4"))
    log_ns: list[tuple[int, TimeArray]] = field(default_factory=list)
    utc_us: ColumnStore = field(default_factory=lambda: ColumnStore("i8"))
    labels: dict[str, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = ColumnStores(self.spec)

    def add(self, columns: Columns) -> None:
        """The next messages, as decoded."""
        before, count = len(self.stamp_ns), columns[STAMP].shape[0]
        self.stamp_ns.add(columns[STAMP])
        if self.counted:
            self.places.add(columns[PLACE])
        else:
            self.sequence.add(columns[SEQUENCE])
        if not bool(columns[STAMP].all()):
            self.log_ns.append((before, columns[LOG_TIME]))
        utc = columns.get(UTC_FIELD if self.spec.position else CAPTURE_UTC_FIELD)
        if utc is not None and utc.dtype.kind in "iu":
            self.utc_us.add(microseconds(utc))
        numbers = {name: part for name, part in columns.items() if part.dtype.kind in "biuf"}
        values = finished(self.source.message, extract(numbers, self.spec.columns))
        self.columns.add(values, count)
        if self.spec.event:
            for name, paths in LABELS.items():
                path = next((path for path in paths.split() if path in columns), None)
                values_of = [None] * count if path is None else columns[path].tolist()
                texts = ["" if value is None else str(value) for value in values_of]
                if path is not None or name in self.labels:
                    self.labels.setdefault(name, [""] * before).extend(texts)

    def stamps(self, line: Timeline) -> tuple[TimeArray, TimeArray]:
        """Places and times since boot [ns] of the messages that count it."""
        places, stamp_ns = _copied(self.places), _copied(self.stamp_ns)
        good = since_boot(stamp_ns) & line.good(places)
        return places[good], stamp_ns[good]

    def utc_readings(self) -> UtcReadings | None:
        """UTC beside the time since boot in these messages; None where they have none."""
        if not self.counted or not len(self.utc_us):
            return None
        utc_us, stamp_ns, places = map(_copied, (self.utc_us, self.stamp_ns, self.places))
        usable = (utc_us > UNIX_US_FROM) & since_boot(stamp_ns)
        fix = self.columns.stores.get("fix", ColumnStore("f8"))
        words = f"rows of {self.name}"
        return UtcReadings(words, places, stamp_ns, utc_us * 1000, usable, _copied(fix))

    def rows(self, clock: BootClock, ledger: Ledger) -> tuple[DecodedRows, int]:
        """All of it, handed over, and how many messages had no time of their own.

        Never in the order of log_time: a clock that was set back would shuffle parts of the flight.
        """
        stamp_ns = self.stamp_ns.whole()
        log_ns = np.zeros(stamp_ns.shape, np.int64)
        for first, part in self.log_ns:
            log_ns[first : first + part.shape[0]] = part
        self.log_ns.clear()
        places = self.places.whole() if self.counted else None
        good = None if places is None else good_rows(places, stamp_ns, clock)
        time_ns, boot, count = times_of(
            stamp_ns, log_ns, places, clock, ledger=ledger, where=self.name
        )
        labels = {name: tuple(texts) for name, texts in self.labels.items()}
        rows = DecodedRows(self.name, self.source, time_ns, boot, self.columns.whole(), labels)
        order = None if self.counted else in_sequence(self.sequence.whole(), time_ns)
        if order is not None:
            moved = int(np.count_nonzero(order != np.arange(len(rows))))
            where = f"{self.name}, first at row {np.flatnonzero(np.diff(order) != 1)[0] + 1}"
            ledger.note("LOG-REORDERED", where=where, count=moved, total=len(rows))
            rows = rows.take(order)
        if good is not None:
            rows = without_stray(rows, ~good, ledger)
        return captured_rows(rows, ledger) if self.spec.event else rows, count


def _copied(store: ColumnStore) -> NDArray[Any]:
    return np.concatenate([np.empty(0, store.dtype), *store.blocks()])
