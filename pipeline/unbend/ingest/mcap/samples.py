"""Which messages of MCAP logs are wanted, their times in any form, and their columns in SI."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Source, TimeArray
from unbend.flight.clock import BOOT_STEP_NS, UNIX_NS_FROM, UNIX_US_FROM
from unbend.ingest import fields
from unbend.ingest.attitude import earth_frame_attitude, ned_frd_of_enu_flu, replace_in_blocks
from unbend.ingest.boot_clock import (
    LOWEST_FIX,
    BootClock,
    Timeline,
    UtcReadings,
    microseconds,
    nanoseconds,
)
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.channel_builder import ColumnStores, DecodedRows, captured_rows, without_stray
from unbend.ingest.log import PLACE
from unbend.ingest.mcap.cdr import short
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND, Array, Mask, Rows

_NAMED_VALUE_INT = 4.0  # DebugValue.TYPE_NAMED_VALUE_INT: the value is in another field

_PX4 = {f"px4_msgs/{name}": spec for name, spec in fields.PX4_MESSAGES.items()}
_STAMPS = {"mavros_msgs/CamIMUStamp": "frame_stamp"}
_WITH_HEADER = {
    name: replace(spec, time_field=_STAMPS.get(name, "header.stamp"))
    for name, spec in fields.message_maps("ros").items()
}
SCHEMAS: Mapping[str, fields.MessageMap] = _WITH_HEADER | _PX4 | fields.message_maps("foxglove")

# JSON of a schema of the user's own: a time and a value, of a role only when it is named.
PLAIN_JSON = fields.MessageMap((fields.FieldColumn("value", ("value",)),))
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


Columns = Mapping[str, NDArray[Any]]
STAMP, LOG_TIME, SEQUENCE = "\0stamp_ns", "\0log_ns", "\0sequence"
"""Columns beside the fields: a message's own time and log_time [ns], and its number."""

_LAST_NS = 2**63 - 1
_ISO = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d+))?(Z|[+-]\d\d:\d\d)?")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

# A bare number is Unix time in the unit in which it lies between 1973 and 2286.
_UNITS = ((10**17, 1), (10**14, 10**3), (10**11, 10**6), (0, 10**9))


def stamp_of(value: Any) -> int:
    """Unix time [ns] of a time in JSON or protobuf; 0 when there is none.

    Seconds and nanoseconds, a number of seconds (or ms, us, ns: by its size), or RFC 3339.

    >>> stamp_of("2026-05-01T10:00:00.5Z"), stamp_of(1.5e9), stamp_of({"sec": 1, "nsec": 2})
    (1777629600500000000, 1500000000000000000, 1000000002)
    """
    if isinstance(value, bool) or value is None:
        return 0
    if isinstance(value, str):
        match = _ISO.fullmatch(value.strip())
        if not match:
            return 0
        seconds, fraction, zone = match.groups()
        moment = datetime.fromisoformat(seconds + ("+00:00" if zone in (None, "Z") else zone))
        time_ns = (moment - _EPOCH) // timedelta(seconds=1) * NANOSECONDS_PER_SECOND
        time_ns += int((fraction or "0")[:9].ljust(9, "0"))
    elif isinstance(value, int | float):
        if not abs(value) < 1e19:  # also not a number
            return 0
        factor = next(factor for least, factor in _UNITS if abs(value) >= least)
        time_ns = int(value) * factor + round((value - int(value)) * factor)
    else:
        whole = _first(value, ("sec", "secs", "seconds"))
        part = _first(value, ("nsec", "nsecs", "nanosec", "nanos"))
        time_ns = int(whole) * NANOSECONDS_PER_SECOND + int(part)
    return min(max(time_ns, 0), _LAST_NS)


def _first(value: Any, names: tuple[str, ...]) -> Any:
    for name in names:
        member = value.get(name) if isinstance(value, dict) else getattr(value, name, None)
        if member is not None:
            return member
    return 0


@dataclass
class TopicSamples:
    """What was read of one topic, or of one name in it.

    ``stamp_ns`` own times, 0 without; ``log_ns`` the recorder's by their first row, where needed;
    ``utc_us`` UTC beside the time since boot. ``counted`` stamps are microseconds, maybe from a
    boot: then ``places`` are those in the whole log; else ``sequence`` are the messages' numbers.
    """

    name: str
    source: Source
    spec: fields.MessageMap
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
        utc = columns.get(fields.UTC_FIELD if self.spec.position else fields.CAPTURE_UTC_FIELD)
        if utc is not None and utc.dtype.kind in "iu":
            self.utc_us.add(microseconds(utc))
        numbers = {name: part for name, part in columns.items() if part.dtype.kind in "biuf"}
        values = finished(self.source.message, fields.extract(numbers, self.spec.columns))
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


def in_sequence(sequence: NDArray[np.uint32], time_ns: TimeArray) -> Rows | None:
    """The order by (n,) numbers, where that puts times right that step back, else None.

    Numbers that repeat or contradict the times are of a recorder that counts anew, or a set clock.

    >>> in_sequence(np.array([0, 1, 4, 2], np.uint32), np.array([10, 11, 14, 12]))
    array([0, 1, 3, 2])
    """
    if bool(np.all(time_ns[1:] >= time_ns[:-1])):
        return None
    order = np.argsort(sequence, kind="stable")
    numbers, times = sequence[order], time_ns[order]
    rise = np.all(numbers[1:] > numbers[:-1]) and np.all(times[1:] >= times[:-1])
    return order if bool(rise) else None


def own_times(columns: Columns, time_field: str, count: int) -> tuple[TimeArray, bool]:
    """The messages' own times [ns], 0 without, and whether they are counted in microseconds.

    ``time_field`` names a Time of the (count,) columns, or microseconds from a boot or 1970.
    """
    if STAMP in columns:
        return columns[STAMP], False
    if f"{time_field}.sec" in columns:
        seconds = columns[f"{time_field}.sec"].astype(np.int64)
        names = [f"{time_field}.{name}" for name in ("nanosec", "nsec")]
        part = next((columns[name] for name in names if name in columns), np.int64(0))
        time_ns = seconds * NANOSECONDS_PER_SECOND + np.asarray(part).astype(np.int64)
        return np.asarray(time_ns, np.int64), False
    if time_field in columns and columns[time_field].dtype.kind in "iu":
        return nanoseconds(columns[time_field]), True
    return np.zeros(count, np.int64), False


def since_boot(stamp_ns: TimeArray) -> Mask:
    """Which counted stamps count from a boot; 0 is none, and large ones are Unix time."""
    return np.asarray((stamp_ns > 0) & (stamp_ns < UNIX_NS_FROM), np.bool_)


def good_rows(places: TimeArray, stamp_ns: TimeArray, clock: BootClock) -> Mask:
    """Which messages of a topic, at (n,) places and stamps [ns], have a time that fits the log.

    One that fits none of its neighbours there may have come late: it is used where it lies between
    its neighbours of the same topic, and within the times of the log.
    """
    line, counted = clock.line, since_boot(stamp_ns)
    good = np.asarray(line.good(places) | ~counted, np.bool_)
    misfits = np.flatnonzero(~good)
    if not misfits.size:
        return good
    boots, first, last = line.boot_of(places), line.begin[~line.stray], line.end[~line.stray]
    for number in np.unique(boots[misfits]).tolist():
        of_boot = line.boot[~line.stray] == number
        known = np.flatnonzero(good & counted & (boots == number))
        low, high = first[of_boot].min() - BOOT_STEP_NS, last[of_boot].max() + BOOT_STEP_NS
        bounds = np.concatenate([[low], stamp_ns[known], [high]])
        rows = misfits[boots[misfits] == number]
        after = np.searchsorted(known, rows)
        good[rows] = (bounds[after] < stamp_ns[rows]) & (stamp_ns[rows] < bounds[after + 1])
    return good


def times_of(
    stamp_ns: TimeArray, log_ns: TimeArray, places: TimeArray | None, clock: BootClock,
    *, ledger: Ledger, where: str,
) -> tuple[TimeArray, NDArray[np.int16], int]:  # fmt: skip
    """UTC [ns], boot, and how many messages have no time of their own: it is the recorder's.

    ``places`` of messages whose stamps are counted in microseconds, None of others.
    """
    none = stamp_ns == 0
    boot = np.zeros(stamp_ns.shape, np.int16)
    early = stamp_ns < UNIX_NS_FROM
    if places is not None:
        counted = since_boot(stamp_ns)
        boot = clock.line.boot_of(places)
        stamp_ns = np.where(counted, clock.utc(places, stamp_ns), stamp_ns)
        early &= ~counted
    count = int(np.count_nonzero(none))
    if count:
        what = f"{count} messages have no header.stamp: the recorder's time is used"
        ledger.fallback("TIME-LOG-TIME", what, where=where, count=count)
        stamp_ns[none] = log_ns[none]
        early[none] = log_ns[none] < UNIX_NS_FROM
    if bool(early.any()):
        ledger.fallback("TIME-NO-UTC/times-of", where=where)
    return stamp_ns, boot, count
