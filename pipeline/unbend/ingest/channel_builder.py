"""Decoded rows -> a channel: rows without a fix, attitudes, rising time, both heights."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, Source, TimeArray
from unbend.flight.clock import new_readings, rows_in_time_order
from unbend.ingest import messages
from unbend.ingest.attitude import (
    QUATERNION,
    quaternion_of_euler,
    replace_in_blocks,
    unit_quaternions,
)
from unbend.ingest.buffers import ColumnStore, allocate, copy_rows
from unbend.ingest.field_maps import MessageMap
from unbend.ingest.flight_log import utc_text
from unbend.ingest.utc_readings import LOWEST_FIX
from unbend.messages import Kind, Ledger
from unbend.units import LARGEST_NUMBER, Array, Mask, Rows

SENT = ".sent"  # ends the name of a channel of trigger commands; that of shutter pulses has none
_BEHIND_PULSES = 10  # added to the rank of trigger commands: the channel of pulses is chosen first
_EULER = ("roll_rad", "pitch_rad", "yaw_rad")


@dataclass(frozen=True)
class DecodedRows:
    """The rows of one channel as decoded: times in the order of the file, columns in SI."""

    name: str
    source: Source
    time_ns: TimeArray
    boot: NDArray[np.int16]
    columns: Mapping[str, Array]
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    def time_rises(self) -> bool:
        """Whether each row is later than the row before it."""
        return bool(np.all(self.time_ns[1:] > self.time_ns[:-1]))

    def take(self, rows: Mask | Rows) -> "DecodedRows":
        """The rows that a mask or an array of row numbers selects, copied."""
        index = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        kept = np.asarray(index, np.intp)
        columns = {}
        for name, column in self.columns.items():
            columns[name] = copy_rows(column, kept)
        labels = {}
        for name, texts in self.labels.items():
            kept_texts = np.asarray(texts, object)[kept]
            labels[name] = tuple(kept_texts.tolist())
        return DecodedRows(
            name=self.name,
            source=self.source,
            time_ns=copy_rows(self.time_ns, kept),
            boot=copy_rows(self.boot, kept),
            columns=columns,
            labels=labels,
        )


class ColumnStores:
    """Columns made piece by piece; a column takes no memory before its first value."""

    def __init__(self, spec: MessageMap) -> None:
        self.stores: dict[str, ColumnStore] = {}
        # Columns of these without any value are kept: else they would be reported as absent.
        self._keeps_empty = spec.position or spec.attitude
        self._length = 0

    def add(self, values: Mapping[str, Array], count: int) -> None:
        """Add the next ``count`` rows to each column; NaN to columns that ``values`` lacks."""
        for name, column in values.items():
            if name in self.stores:
                continue
            if self._keeps_empty or has_value(column):
                self.stores[name] = ColumnStore("f8")
                rows_before = np.broadcast_to(np.nan, self._length)
                self.stores[name].add(rows_before)
        without_values = np.broadcast_to(np.nan, count)
        for name, store in self.stores.items():
            store.add(values.get(name, without_values))
        self._length += count

    def whole(self) -> dict[str, Array]:
        """All rows by column; empties the stores."""
        return {name: store.whole() for name, store in self.stores.items()}


def has_value(column: Array) -> bool:
    """Whether a column has a value in any row."""
    return bool(np.isfinite(column).any())


def limited(column: Array) -> Array:
    """Limit the finite numbers of a column (n,) to +-`LARGEST_NUMBER`, which no usual log reaches.

    Sums and squares of larger numbers might overflow before these are rejected as implausible.
    """
    if column.size == 0:
        return column
    highest = column.max()
    lowest = column.min()
    if np.isnan(highest):  # some values are unknown: a slower search passes over them
        highest = np.fmax.reduce(column)
        lowest = np.fmin.reduce(column)
    if highest <= LARGEST_NUMBER and lowest >= -LARGEST_NUMBER:
        return column
    is_too_large = np.isfinite(column) & (np.abs(column) > LARGEST_NUMBER)
    return np.where(is_too_large, np.copysign(LARGEST_NUMBER, column), column)


def channel_of(rows: DecodedRows, spec: MessageMap, ledger: Ledger) -> Channel | None:
    """The channel of decoded rows; None if no row or no value is left.

    Rows that cannot be used are dropped and reported: those without a fix, repeats, and rows out of
    the order of time.
    """
    if spec.text_field:
        return channel_of_texts(rows, spec)
    rows = replace(rows, columns={name: limited(rows.columns[name]) for name in rows.columns})
    absent = sorted(_needed_columns(rows, spec) - set(rows.columns))
    if absent:
        count = len(rows)
        ledger.add(messages.rows_without_field(where=rows.name, count=count, fields=absent))
        return None
    if not spec.event and not any(map(has_value, rows.columns.values())):
        return None  # without values, dropped rows are not reported
    if spec.position:
        rows = _with_fix(rows, ledger)
    rows = _without_repeats(rows, ledger, event=spec.event)
    if spec.event:  # numbered after repeats are dropped, before rows out of order are
        rows = _numbered_exposures(rows)
    rows = _in_rising_time(rows, ledger)
    columns = dict(rows.columns)
    if spec.attitude:
        _make_unit_quaternions(columns)
    with_values = {name: column for name, column in columns.items() if has_value(column)}
    if len(rows) == 0 or not with_values:
        return None
    return _channel(rows, with_values, spec)


def _channel(
    rows: DecodedRows,
    columns: Mapping[str, Array],
    spec: MessageMap,
) -> Channel:
    """The channel of rows with their final ``columns``, and the roles that these allow."""
    logged_units = {}
    for column in spec.columns:
        if column.unit:
            logged_units[column.name] = column.unit
    channel = Channel(
        name=rows.name,
        time_ns=rows.time_ns,
        columns=columns,
        source=rows.source,
        boot=rows.boot,
        rank=_rank(rows, spec),
        labels=rows.labels,
        logged_units=logged_units,
    )
    roles = filter(channel.fits_role, spec.roles)
    return replace(channel, roles=tuple(roles))


def _needed_columns(rows: DecodedRows, spec: MessageMap) -> set[str]:
    """The columns without which the rows of a message are of no use."""
    needed = set()
    if spec.position:
        needed |= {"lat_rad", "lon_rad"}
    if spec.attitude:
        has_angles = "roll_rad" in rows.columns
        needed |= set(_EULER) if has_angles else set(QUATERNION)
    return needed


def _rank(rows: DecodedRows, spec: MessageMap) -> int:
    """The rank of a channel among candidates for a role.

    The channel with the smallest rank is chosen. Commands of a trigger rank behind the pulses of
    the shutter. All instances but the first have the spare rank of the message, if it has one.
    """
    if rows.name.endswith(SENT):
        return spec.rank + _BEHIND_PULSES
    is_first = rows.source.instance in (None, "0")
    if spec.spare_rank is None or is_first:
        return spec.rank
    return spec.spare_rank


def _with_fix(rows: DecodedRows, ledger: Ledger) -> DecodedRows:
    """Drop rows of a position without a fix, and report them; the place 0, 0 means no fix."""
    lat_rad = rows.columns["lat_rad"]
    lon_rad = rows.columns["lon_rad"]
    good = np.isfinite(lat_rad) & np.isfinite(lon_rad)
    good &= (lat_rad != 0.0) | (lon_rad != 0.0)
    if "fix" in rows.columns:
        good &= rows.columns["fix"] >= LOWEST_FIX
    dropped = int(np.count_nonzero(~good))
    if not dropped:
        return rows
    total = len(rows)
    ledger.add(messages.rows_without_fix(channel=rows.name, count=dropped, total=total))
    return rows.take(good)


def _numbered_exposures(rows: DecodedRows) -> DecodedRows:
    """Number exposures, and replace unknown places and attitudes by NaN.

    - ``event_index`` is the number of the row, unless the log numbers the exposures.
    - The place 0, 0 means unknown, and so does a latitude beyond a pole: in MAVLink the largest
      integer means unknown.
    - A logged attitude becomes the columns `QUATERNION`.
    """
    columns = dict(rows.columns)
    if "event_index" not in columns:
        columns["event_index"] = np.arange(len(rows), dtype=np.float64)
    if "lat_rad" in columns and "lon_rad" in columns:
        lat_rad = columns["lat_rad"]
        lon_rad = columns["lon_rad"]
        nowhere = (lat_rad == 0.0) & (lon_rad == 0.0)
        nowhere |= np.abs(lat_rad) > _POLE_RAD
        for name in ("lat_rad", "lon_rad", "h_msl_m"):
            if name in columns:
                columns[name] = np.where(nowhere, np.nan, columns[name])
    columns |= _attitudes_of_exposures(columns)
    return replace(rows, columns=columns)


def _attitudes_of_exposures(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns `QUATERNION` from the attitude logged with each exposure; empty without one.

    A row with all angles 0 has no attitude: NaN.
    """
    logged = [f"camera_{name}" for name in QUATERNION]
    if all(name in columns for name in logged):
        components = [columns[name] for name in logged]
        quaternions = unit_quaternions(np.stack(components, axis=1))
    elif all(name in columns for name in _EULER):
        angles = [columns[name] for name in _EULER]
        quaternions = quaternion_of_euler(*angles)
        is_unknown = np.all(np.equal(angles, 0.0), axis=0)
        quaternions[is_unknown] = np.nan
    else:
        return {}
    return dict(zip(QUATERNION, quaternions.T, strict=True))


def split_by_feedback(rows: DecodedRows, ledger: Ledger) -> list[DecodedRows]:
    """Split the rows of events into pulses of a shutter (``feedback`` > 0) and trigger commands.

    Rows of one kind stay one part. If there are both, the pulses come first and keep the name; the
    name of the commands gets the suffix `SENT`.
    """
    feedback = rows.columns.get("feedback")
    if feedback is None:
        return [rows]
    is_pulse = feedback > 0.0
    if is_pulse.all() or not is_pulse.any():
        return [rows]
    sent = replace(rows.take(~is_pulse), name=f"{rows.name}{SENT}")
    ledger.add(
        messages.pulses_and_commands(
            channel=rows.name,
            pulses=int(np.count_nonzero(is_pulse)),
            sent=sent.name,
            commands=len(sent),
        )
    )
    return [rows.take(is_pulse), sent]


def _make_unit_quaternions(columns: dict[str, Array]) -> None:
    """Replace Euler angles or quaternions by unit quaternions, in place."""
    has_angles = "roll_rad" in columns
    logged = _EULER if has_angles else QUATERNION
    parts = [columns[name] for name in logged]
    for name in logged:
        del columns[name]
    if has_angles:
        count = parts[0].shape[0]
        fourth_part = allocate(count, np.float64)
        parts.append(fourth_part)
        replace_in_blocks(_quaternion_of_angles, parts)
    else:
        replace_in_blocks(unit_quaternions, parts)
    columns.update(zip(QUATERNION, parts, strict=True))


def _quaternion_of_angles(numbers: Array) -> Array:
    """(n, 4) roll, pitch, yaw [rad] and an unused column -> (n, 4) quaternions w, x, y, z."""
    roll_rad = numbers[:, 0]
    pitch_rad = numbers[:, 1]
    yaw_rad = numbers[:, 2]
    return quaternion_of_euler(roll_rad, pitch_rad, yaw_rad)


def channel_of_texts(rows: DecodedRows, spec: MessageMap) -> Channel | None:
    """The channel of an autopilot's texts in the order of time; None without any.

    Texts of the same time are lines of one row.
    """
    order = np.argsort(rows.time_ns, kind="stable")
    time_ns, first_lines = np.unique(rows.time_ns[order], return_index=True)
    if not time_ns.size:
        return None
    logged = rows.labels["text"]
    lines = [logged[row].strip() for row in order.tolist()]
    bounds = [*first_lines.tolist(), len(lines)]
    texts = []
    for begin, end in pairwise(bounds):
        texts.append("\n".join(lines[begin:end]))
    return Channel(
        name=rows.name,
        time_ns=time_ns,
        columns={},
        source=rows.source,
        boot=rows.boot[order][first_lines],
        rank=spec.rank,
        labels={"text": tuple(texts)},
    )


def without_stray(rows: DecodedRows, stray: Mask, ledger: Ledger) -> DecodedRows:
    """Drop the rows marked in ``stray`` (n,), and report them.

    The time since boot of a stray row does not fit its neighbours.
    """
    if not stray.any():
        return rows
    ledger.add(
        messages.stray_rows(
            channel=rows.name,
            first=int(np.argmax(stray)),
            count=int(np.count_nonzero(stray)),
            total=len(rows),
        )
    )
    return rows.take(~stray)


_POLE_RAD = np.pi / 2.0
_FAILED = 0.0  # ``result`` of CameraCapture.msg: 1 is success, -1 a camera that does not answer


def captured_rows(rows: DecodedRows, ledger: Ledger) -> DecodedRows:
    """The rows of a camera, without rows that report a failed exposure.

    The column ``result`` is dropped, and an ``event_index`` that is 0 in all of several rows:
    mavros never fills it in.
    """
    columns: dict[str, Array] = dict(rows.columns)
    index = columns.get("event_index")
    has_several = index is not None and index.shape[0] > 1
    if has_several and not np.any(index):
        del columns["event_index"]
        ledger.add(messages.exposures_without_index(channel=rows.name, count=len(rows)))
    result = columns.pop("result", None)
    captures = replace(rows, columns=columns)
    if result is None:
        return captures
    failed = result == _FAILED
    if not failed.any():
        return captures
    count = int(np.count_nonzero(failed))
    ledger.add(messages.failed_exposures(channel=rows.name, count=count, total=len(rows)))
    return captures.take(~failed)


def _without_repeats(rows: DecodedRows, ledger: Ledger, *, event: bool) -> DecodedRows:
    """Drop repeated rows, and report them: as a loss if they are events.

    A repeat has the time of the row directly before it, or the time and all values of the first row
    with its time.
    """
    if rows.time_rises():
        return rows  # no two rows have the same time
    repeats = _equal_to_first_of_time(rows) | ~new_readings(rows.time_ns)
    count = int(np.count_nonzero(repeats))
    if not count:
        return rows
    kind = Kind.LOSS if event else Kind.NOTE
    ledger.add(messages.repeated_rows(kind=kind, channel=rows.name, count=count, total=len(rows)))
    return rows.take(~repeats)


def _equal_to_first_of_time(rows: DecodedRows) -> Mask:
    """(n,) True for rows with all values of an earlier row, the first with the same time."""
    if not rows.columns:
        return np.zeros(len(rows), np.bool_)
    _, first, group = np.unique(rows.time_ns, return_index=True, return_inverse=True)
    first_of_time = first[group]
    is_equal = first_of_time != np.arange(len(rows))
    for column in rows.columns.values():
        value_of_first = column[first_of_time]
        both_unknown = np.isnan(column) & np.isnan(value_of_first)
        is_equal &= (column == value_of_first) | both_unknown
    return np.asarray(is_equal, np.bool_)


def _in_rising_time(rows: DecodedRows, ledger: Ledger) -> DecodedRows:
    """The rows in strictly rising time; where a clock was set back, a new boot begins.

    Rows that are dropped, and settings of the clock, are reported.
    """
    if rows.time_rises():
        return rows
    # stretch: for each kept row, how often the clock was set back before it
    kept, stretch = rows_in_time_order(rows.time_ns)
    all_rows = np.arange(len(rows))
    lost = np.setdiff1d(all_rows, kept)
    if lost.size:
        first = int(lost[0])
        ledger.add(
            messages.rows_out_of_order(
                channel=rows.name,
                first=first,
                stamp=utc_text(int(rows.time_ns[first])),
                count=int(lost.size),
                total=len(rows),
            )
        )
    result = rows.take(kept)
    if not stretch.any():
        return result
    settings = int(stretch.max())
    ledger.add(messages.clock_set_back(channel=rows.name, count=settings))
    # each boot of the vehicle and each stretch in it becomes a boot of its own
    boot_and_stretch = np.stack([result.boot, stretch])
    _, boot = np.unique(boot_and_stretch, axis=1, return_inverse=True)
    boot = boot.reshape(-1)
    return replace(result, boot=boot.astype(np.int16))


# AP_GPS.h, DriverOptions::HeightEllipsoid: the filter gets the ellipsoidal height of the receiver.
HEIGHT_OPTION = "GPS_DRV_OPTIONS"
_HEIGHT_ELLIPSOID = 1 << 4
_MAX_OPTION = 1 << 15  # a parameter is a float; a damaged one may be anything


def with_both_heights(
    channels: Iterable[Channel],
    parameters: Mapping[str, float],
    ledger: Ledger,
    where: str,
) -> list[Channel]:
    """The channels with heights above sea level and above the ellipsoid, where both are known.

    One height and the undulation give the other height. If `HEIGHT_OPTION` among the ``parameters``
    has the bit for it, heights logged as above sea level are above the ellipsoid; this is reported,
    with the name ``where`` of the message that has the parameters.
    """
    option = parameters.get(HEIGHT_OPTION, 0.0)
    is_ellipsoidal = 0.0 <= option < _MAX_OPTION and bool(int(option) & _HEIGHT_ELLIPSOID)
    if is_ellipsoidal:
        ledger.add(messages.heights_above_ellipsoid(where=where, parameter=HEIGHT_OPTION))
    result = []
    for channel in channels:
        columns = _with_both_heights(channel.columns, is_ellipsoidal=is_ellipsoidal)
        result.append(replace(channel, columns=columns))
    return result


def _with_both_heights(
    columns: Mapping[str, Array],
    *,
    is_ellipsoidal: bool,
) -> dict[str, Array]:
    """The columns with ``h_msl_m`` and ``h_ellipsoid_m``, as far as known, without undulation.

    ``is_ellipsoidal``: the numbers logged as ``h_msl_m`` are heights above the ellipsoid.
    """
    result = dict(columns)
    undulation_m = result.pop("undulation_m", None)
    logged_m = result.get("h_msl_m")
    if logged_m is None:
        return result
    if undulation_m is not None and is_ellipsoidal:
        result["h_ellipsoid_m"] = logged_m
        result["h_msl_m"] = logged_m - undulation_m
    elif undulation_m is not None:
        result.setdefault("h_ellipsoid_m", logged_m + undulation_m)
    elif is_ellipsoidal:
        del result["h_msl_m"]
        result.setdefault("h_ellipsoid_m", logged_m)
    return result
