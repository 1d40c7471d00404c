"""The wanted messages of MCAP logs, and what was read of them: columns in SI units, times."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Source, TimeArray
from unbend.flight.clock import UNIX_NS_FROM
from unbend.ingest.attitude import earth_frame_attitude, ned_frd_of_enu_flu, replace_in_blocks
from unbend.ingest.boot_clock import BootClock
from unbend.ingest.buffers import ColumnStore
from unbend.ingest.channel_builder import ColumnStores, DecodedRows, captured_rows, without_stray
from unbend.ingest.field_maps import (
    CAPTURE_UTC_FIELD,
    PX4_MESSAGES,
    UTC_FIELD,
    FieldColumn,
    MessageMap,
    extract,
    is_number,
    message_maps,
)
from unbend.ingest.mcap import messages
from unbend.ingest.mcap.ros2_definitions import short_name
from unbend.ingest.mcap.stamps import (
    LOG_TIME,
    SEQUENCE,
    STAMP,
    Columns,
    good_rows,
    order_by_sequence,
    since_boot,
    times_of,
)
from unbend.ingest.message_tables import PLACE
from unbend.ingest.timelines import Timeline, microseconds
from unbend.ingest.utc_evidence import FIRST_SET_US
from unbend.ingest.utc_readings import LOWEST_FIX, UtcReadings, rows_of
from unbend.messages import Ledger
from unbend.units import Array, Integers

_NAMED_VALUE_INT = 4.0  # DebugValue.TYPE_NAMED_VALUE_INT: the value is in another field
_NO_ORIENTATION = -1.0  # of the first covariance of an Imu (sensor_msgs/Imu)
_ROS_FIX = 0.0  # NavSatStatus: STATUS_FIX and better; -1 is none

_STAMP_FIELDS = {"mavros_msgs/CamIMUStamp": "frame_stamp"}


def _schemas() -> dict[str, MessageMap]:
    """The maps of the wanted messages by name; those of ROS 2 have their time in the header."""
    schemas = {}
    for name, spec in message_maps("ros").items():
        time_field = _STAMP_FIELDS.get(name, "header.stamp")
        schemas[name] = replace(spec, time_field=time_field)
    for name, spec in PX4_MESSAGES.items():
        schemas[f"px4_msgs/{name}"] = spec
    schemas.update(message_maps("foxglove"))
    return schemas


SCHEMAS: Mapping[str, MessageMap] = _schemas()

# JSON of any other schema: a time and a value, which has a role only if the mission names one.
PLAIN_JSON = MessageMap((FieldColumn("value", ("value",)),))
# Texts that belong to each event, and where they may be.
LABELS: Mapping[str, tuple[str, ...]] = {
    "file_url": ("file_url",),
    "frame_id": ("header.frame_id", "frame_id"),
}


def message_name(schema: str) -> str:
    """The name of a schema as `SCHEMAS` has it: encodings separate its parts in different ways.

    >>> message_name("sensor_msgs::msg::NavSatFix"), message_name("foxglove_msgs/msg/RawImage")
    ('sensor_msgs/NavSatFix', 'foxglove.RawImage')
    """
    return short_name(schema.replace("::", "/")).replace("foxglove_msgs/", "foxglove.")


def converted_columns(schema: str, columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns of messages as the package uses them, from the decoded fields in SI units.

    - Attitudes follow the package's convention. An Imu with -1 as first covariance has none
      (sensor_msgs/Imu).
    - The value of a DebugValue is the integer where the message has its type.
    - A status of ROS becomes a fix as MAVLink counts it: 3D or none.
    - Variances become sigmas. The accuracy of a NavSatFix with the covariance type 0 is unknown.
    """
    result = dict(columns)
    if schema.endswith("/GimbalDeviceAttitudeStatus") and "flags" in result:
        result = earth_frame_attitude(result)
    if schema.endswith("/DebugValue"):
        kind = result.pop("kind", None)
        integer = result.pop("integer", None)
        if kind is not None and integer is not None:
            result["value"] = np.where(kind == _NAMED_VALUE_INT, integer, result["value"])
    if "ros_w" in result:
        _replace_ros_attitude(result)
    if "status" in result:
        has_fix = result.pop("status") >= _ROS_FIX
        result["fix"] = np.where(has_fix, float(LOWEST_FIX), 0.0)
    if "covariance_type" in result:
        _replace_variances(result)
    return result


def _replace_ros_attitude(columns: dict[str, Array]) -> None:
    """Replace the attitude of ROS (ENU, FLU) by that of the package (NED, FRD), in the same memory.

    NaN where the message has no attitude.
    """
    components = [columns.pop(f"ros_{axis}") for axis in "wxyz"]
    replace_in_blocks(ned_frd_of_enu_flu, components)
    first_covariance = columns.pop("covariance_0", None)
    if first_covariance is not None:
        is_unknown = first_covariance == _NO_ORIENTATION
        for component in components:
            component[is_unknown] = np.nan
    columns.update(zip(("q_w", "q_x", "q_y", "q_z"), components, strict=True))


def _replace_variances(columns: dict[str, Array]) -> None:
    """Replace the variances [m2] of a NavSatFix by sigmas; NaN where the accuracy is unknown."""
    covariance_type = columns.pop("covariance_type")
    is_known = covariance_type > 0.0
    variances = []
    for name in ("variance_0", "variance_1", "variance_2"):  # east, north, up
        variance = columns.pop(name, np.full(is_known.shape, np.nan))
        variances.append(np.where(is_known, np.maximum(variance, 0.0), np.nan))
    east, north, up = variances
    columns["sigma_h_m"] = np.sqrt(east / 2.0 + north / 2.0)
    columns["sigma_v_m"] = np.sqrt(up)


def _int64_store() -> ColumnStore:
    return ColumnStore("i8")


def _uint32_store() -> ColumnStore:
    return ColumnStore("u4")


@dataclass
class TopicSamples:
    """What was read of one topic, or of one name in its messages: a row for each message.

    from_integer : whether the stamps were integers of microseconds (see `OwnTimes`).
    stamp_ns : the messages' own times, 0 without.
    places : of the messages in the log, only if ``from_integer``.
    sequence : the recorder's numbers of the messages, only if not ``from_integer``.
    log_ns : the first row of each block with messages without a stamp, and the recorder's times of
        all messages of the block.
    least_delays_ns : of each block with Unix time, the delay [ns] of the quickest message: the
        recorder's time minus its stamp.
    utc_us : UTC that the messages have in another field than their own time.
    labels : texts that belong to events, by the names of `LABELS`.
    """

    name: str
    source: Source
    spec: MessageMap
    from_integer: bool = False
    stamp_ns: ColumnStore = field(default_factory=_int64_store)
    places: ColumnStore = field(default_factory=_int64_store)
    sequence: ColumnStore = field(default_factory=_uint32_store)
    log_ns: list[tuple[int, TimeArray]] = field(default_factory=list)
    least_delays_ns: list[int] = field(default_factory=list)
    utc_us: ColumnStore = field(default_factory=_int64_store)
    labels: dict[str, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = ColumnStores(self.spec)

    def add(self, columns: Columns) -> None:
        """Add the next messages: their decoded fields, and the columns of their times."""
        rows_before = len(self.stamp_ns)
        count = columns[STAMP].shape[0]
        self.stamp_ns.add(columns[STAMP])
        if self.from_integer:
            self.places.add(columns[PLACE])
        else:
            self.sequence.add(columns[SEQUENCE])
        with_utc = (columns[STAMP] > UNIX_NS_FROM) & (columns[LOG_TIME] > UNIX_NS_FROM)
        if bool(with_utc.any()):
            delay_ns = columns[LOG_TIME][with_utc] - columns[STAMP][with_utc]
            self.least_delays_ns.append(int(delay_ns.min()))
        some_without_stamp = bool((columns[STAMP] == 0).any())
        if some_without_stamp:
            self.log_ns.append((rows_before, columns[LOG_TIME]))
        utc_field = UTC_FIELD if self.spec.position else CAPTURE_UTC_FIELD
        utc = columns.get(utc_field)
        if utc is not None and is_number(utc) and utc.dtype.kind in "iu":
            self.utc_us.add(microseconds(utc))
        numbers = {name: column for name, column in columns.items() if is_number(column)}
        values = extract(numbers, self.spec.columns)
        self.columns.add(converted_columns(self.source.message, values), count)
        if self.spec.event:
            self._add_labels(columns, rows_before, count)

    def _add_labels(self, columns: Columns, rows_before: int, count: int) -> None:
        """Add the texts of the next ``count`` exposures, "" where they have none.

        ``rows_before``: how many exposures precede them. A label begins with the first block that
        has one of its fields.
        """
        for name, paths in LABELS.items():
            path = next((path for path in paths if path in columns), None)
            if path is not None:
                values = columns[path].tolist()
                texts = ["" if value is None else str(value) for value in values]
            elif name in self.labels:
                texts = [""] * count
            else:
                continue
            self.labels.setdefault(name, [""] * rows_before).extend(texts)

    def counts_from_boot(self) -> bool:
        """Whether any of the messages has a time since boot."""
        blocks = self.stamp_ns.blocks() if self.from_integer else ()
        return any(bool(since_boot(block).any()) for block in blocks)

    def stamps(self, line: Timeline) -> tuple[Integers, TimeArray]:
        """Places and times since boot [ns] of the messages that have one, without stray stamps."""
        places = _copied(self.places)
        stamp_ns = _copied(self.stamp_ns)
        good = since_boot(stamp_ns) & line.good(places)
        return places[good], stamp_ns[good]

    def utc_readings(self) -> UtcReadings | None:
        """The UTC and the time since boot of these messages; None if they do not have both."""
        if not self.from_integer or not len(self.utc_us):
            return None
        utc_us = _copied(self.utc_us)
        stamp_ns = _copied(self.stamp_ns)
        is_set = utc_us > FIRST_SET_US
        fix = self.columns.stores.get("fix", ColumnStore("f8"))  # empty of messages without
        return rows_of(
            self.name,
            places=_copied(self.places),
            boot_ns=stamp_ns,
            utc_ns=utc_us * 1000,
            usable=is_set & since_boot(stamp_ns),
            fix=_copied(fix),
        )

    def rows(self, clock: BootClock, ledger: Ledger) -> tuple[DecodedRows, int]:
        """All rows, and how many of them have the recorder's time; the samples are emptied.

        Rows with stray stamps are dropped. The rows are not sorted by log_time: a clock that was
        set back would shuffle parts of the flight.
        """
        stamp_ns = self.stamp_ns.whole()
        log_ns = np.zeros(stamp_ns.shape, np.int64)
        for first, part in self.log_ns:
            log_ns[first : first + part.shape[0]] = part
        self.log_ns.clear()
        places = self.places.whole() if self.from_integer else None
        times = times_of(stamp_ns, log_ns, places, clock, ledger=ledger, topic=self.name)
        rows = DecodedRows(
            name=self.name,
            source=self.source,
            time_ns=times.time_ns,
            boot=times.boot,
            columns=self.columns.whole(),
            labels={name: tuple(texts) for name, texts in self.labels.items()},
        )
        if places is None:
            rows = _sorted_by_sequence(rows, self.sequence.whole(), ledger)
        else:
            is_stray = ~good_rows(places, stamp_ns, clock)
            rows = without_stray(rows, is_stray, ledger)
        if self.spec.event:
            rows = captured_rows(rows, ledger)
        return rows, times.unstamped


def _sorted_by_sequence(
    rows: DecodedRows, sequence: NDArray[np.uint32], ledger: Ledger
) -> DecodedRows:
    """The rows in the order of `order_by_sequence`, which is reported; else as they are."""
    order = order_by_sequence(sequence, rows.time_ns)
    if order is None:
        return rows
    ledger.add(
        messages.messages_reordered(
            topic=rows.name,
            first=int(np.flatnonzero(np.diff(order) != 1)[0]) + 1,
            count=int(np.count_nonzero(order != np.arange(len(rows)))),
            total=len(rows),
        )
    )
    return rows.take(order)


def _copied(store: ColumnStore) -> NDArray[Any]:
    """A copy of all rows of a store, which is not emptied."""
    return np.concatenate([np.empty(0, store.dtype), *store.blocks()])
