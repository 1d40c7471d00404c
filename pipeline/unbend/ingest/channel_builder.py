"""Decoded rows -> a channel: rows without a fix, attitudes, rising time, both heights."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import Channel, Source, TimeArray
from unbend.flight.clock import new_readings, rows_in_time_order
from unbend.ingest.attitude import quaternion_of_euler, replace_in_blocks, unit_quaternions
from unbend.ingest.boot_clock import LOWEST_FIX
from unbend.ingest.buffers import ColumnStore, allocate, copy_rows
from unbend.ingest.field_maps import MessageMap
from unbend.ingest.flight_log import utc_text
from unbend.messages import Entry, Kind, Ledger
from unbend.units import Array, Mask, Rows


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

    def take(self, rows: Mask | Rows) -> "DecodedRows":
        """The rows of a mask or an index."""
        kept = np.asarray(np.flatnonzero(rows) if rows.dtype == np.bool_ else rows, np.intp)
        times = copy_rows(self.time_ns, kept), copy_rows(self.boot, kept)
        columns = {name: copy_rows(column, kept) for name, column in self.columns.items()}
        labels = {n: tuple(np.asarray(t, object)[rows].tolist()) for n, t in self.labels.items()}
        return DecodedRows(self.name, self.source, *times, columns, labels)


class ColumnStores:
    """Columns made piece by piece; one takes memory when it has its first value, NaN before."""

    def __init__(self, spec: MessageMap) -> None:
        self.stores: dict[str, ColumnStore] = {}
        self._needed = spec.position or spec.attitude  # also without a value
        self._length = 0

    def add(self, values: Mapping[str, Array], count: int) -> None:
        """The next ``count`` rows of each column; NaN where ``values`` lacks one."""
        for name, column in values.items():
            if name not in self.stores and (self._needed or bool(np.isfinite(column).any())):
                self.stores[name] = ColumnStore("f8")
                self.stores[name].add(np.broadcast_to(np.nan, self._length))
        for name, store in self.stores.items():
            store.add(values.get(name, np.broadcast_to(np.nan, count)))
        self._length += count

    def whole(self) -> dict[str, Array]:
        """All rows; the stores are empty then."""
        return {name: store.whole() for name, store in self.stores.items()}


def channel_of(rows: DecodedRows, spec: MessageMap, ledger: Ledger) -> Channel | None:
    """A channel from decoded rows, or None when nothing is left; drops are in the ledger."""
    if spec.text_field:
        return channel_of_texts(rows, spec)
    needed = {"lat_rad", "lon_rad"} if spec.position else set()
    if spec.attitude:
        euler = "roll_rad" in rows.columns
        needed |= {"pitch_rad", "yaw_rad"} if euler else {"q_w", "q_x", "q_y", "q_z"}
    if absent := sorted(needed - set(rows.columns)):
        what = f"{len(rows)} rows cannot be used: the log defines no field for {', '.join(absent)}"
        ledger.loss("LOG-FIELDS", what, where=rows.name, count=len(rows))
        return None
    if not spec.event and not any(np.isfinite(column).any() for column in rows.columns.values()):
        return None  # no values: what is dropped of them is not worth an entry
    if spec.position:
        lat, lon = rows.columns["lat_rad"], rows.columns["lon_rad"]
        good = np.isfinite(lat) & np.isfinite(lon) & ~((lat == 0.0) & (lon == 0.0))
        if "fix" in rows.columns:
            good &= rows.columns["fix"] >= LOWEST_FIX
        if dropped := int(np.count_nonzero(~good)):
            what = f"{dropped} of {len(rows)} rows have no fix and are not used"
            ledger.note("POSITION-NO-FIX", what, where=rows.name, count=dropped)
            rows = rows.take(good)
    rows = _without_repeats(rows, ledger, event=spec.event)
    if spec.event:
        events = dict(rows.columns)
        if "event_index" not in events:  # before rows are dropped, which must not shift the numbers
            events["event_index"] = np.arange(len(rows), dtype=np.float64)
        if {"lat_rad", "lon_rad"} <= events.keys():
            nowhere = (events["lat_rad"] == 0.0) & (events["lon_rad"] == 0.0)
            for name in {"lat_rad", "lon_rad", "h_msl_m"} & events.keys():
                events[name] = np.where(nowhere, np.nan, events[name])
        rows = replace(rows, columns=events)
    rows = _in_rising_time(rows, ledger)
    columns = dict(rows.columns)
    if spec.attitude:  # unit quaternions, in the memory of what was logged
        if "roll_rad" in columns:
            parts = [columns.pop(f"{name}_rad") for name in ("roll", "pitch", "yaw")]
            parts.append(allocate(parts[0].shape[0], np.float64))
            replace_in_blocks(lambda angles: quaternion_of_euler(*angles.T[:3]), parts)
        else:
            parts = [columns.pop(f"q_{axis}") for axis in "wxyz"]
            replace_in_blocks(unit_quaternions, parts)
        columns |= dict(zip(("q_w", "q_x", "q_y", "q_z"), parts, strict=True))
    columns = {name: values for name, values in columns.items() if np.isfinite(values).any()}
    if len(rows) == 0 or not columns:
        return None
    spare = spec.spare_rank
    rank = spec.rank if spare is None or rows.source.instance in (None, "0") else spare
    channel = Channel(
        rows.name, rows.time_ns, columns, rows.source, rows.boot, (), rank, rows.labels,
        {column.name: column.unit for column in spec.columns if column.unit},
    )  # fmt: skip
    roles = tuple(role for role in spec.roles if channel.fits_role(role))
    return replace(channel, roles=roles)


def channel_of_texts(rows: DecodedRows, spec: MessageMap) -> Channel | None:
    """What an autopilot says, in the order of time; texts of one time are lines of one row."""
    order = np.argsort(rows.time_ns, kind="stable")
    time_ns, first = np.unique(rows.time_ns[order], return_index=True)
    words = [rows.labels["text"][row].strip() for row in order.tolist()]
    bounds = [*first.tolist(), len(words)]
    texts = tuple("\n".join(words[a:b]) for a, b in pairwise(bounds))
    if not time_ns.size:
        return None
    boot = rows.boot[order][first]
    return Channel(rows.name, time_ns, {}, rows.source, boot, (), spec.rank, {"text": texts})


def without_stray(rows: DecodedRows, stray: Mask, ledger: Ledger) -> DecodedRows:
    """The rows without those whose time since boot fits none of their neighbours."""
    if not stray.any():
        return rows
    count, where = int(np.count_nonzero(stray)), f"{rows.name}, first at row {np.argmax(stray)}"
    ledger.loss("TIME-STRAY/rows", where=where, count=count, total=len(rows))
    return rows.take(~stray)


_FAILED = 0.0  # of ``result``: 1 is success, -1 a camera that does not answer (CameraCapture.msg)


def captured_rows(rows: DecodedRows, ledger: Ledger) -> DecodedRows:
    """The rows of a camera without those that report that it took no image.

    An index that is 0 in all of several rows is dropped: mavros never fills it in.
    """
    columns: dict[str, Array] = dict(rows.columns)
    failed = columns.pop("result", np.ones(len(rows))) == _FAILED
    index = columns.get("event_index", np.empty(0))
    if index.shape[0] > 1 and not index.any():
        del columns["event_index"]
        what = f"all {len(rows)} rows have the index 0: they are numbered from 0 in order"
        ledger.note("EVENT-NO-INDEX", what, where=rows.name, count=len(rows))
    rows = replace(rows, columns=columns)
    if not failed.any():
        return rows
    what = f"{int(failed.sum())} of {len(rows)} rows report that the camera took no image"
    ledger.warning("EVENT-FAILED", what, where=rows.name, count=int(failed.sum()))
    return rows.take(~failed)


def _without_repeats(rows: DecodedRows, ledger: Ledger, *, event: bool) -> DecodedRows:
    """The rows without those of the time of the row before, or equal to any earlier row."""
    if bool(np.all(rows.time_ns[1:] > rows.time_ns[:-1])):
        return rows
    _, first, group = np.unique(rows.time_ns, return_index=True, return_inverse=True)
    original = first[group]
    equal = (original != np.arange(len(rows))) & bool(rows.columns)
    for column in rows.columns.values():
        same = column == column[original]
        equal &= same | (np.isnan(column) & np.isnan(column[original]))
    repeats = equal | ~new_readings(rows.time_ns)
    if not repeats.any():
        return rows
    count = int(np.count_nonzero(repeats))
    what = f"{count} of {len(rows)} rows repeat the time of a row before and are not used"
    kind = Kind.LOSS if event else Kind.NOTE
    ledger.add(Entry(kind, "TIME-REPEAT", what, rows.name, count))
    return rows.take(~repeats)


def _in_rising_time(rows: DecodedRows, ledger: Ledger) -> DecodedRows:
    """The rows in strictly increasing time; where a clock was set back, a new boot begins."""
    if bool(np.all(rows.time_ns[1:] > rows.time_ns[:-1])):
        return rows
    kept, stretch = rows_in_time_order(rows.time_ns)
    lost = np.setdiff1d(np.arange(len(rows)), kept)
    if lost.shape[0]:
        first = utc_text(int(rows.time_ns[lost[0]]))
        what = f"{lost.shape[0]} of {len(rows)} rows are out of order in time and are not used"
        where = f"{rows.name}, first at row {lost[0]}, stamped {first}"
        ledger.loss("TIME-BACKWARD", what, where=where, count=int(lost.shape[0]))
    result = rows.take(kept)
    if not stretch.any():
        return result
    ledger.warning("TIME-SET-BACK", where=rows.name, count=int(stretch.max()))
    numbers = np.stack([result.boot, stretch])
    boot = np.unique(numbers, axis=1, return_inverse=True)[1].reshape(-1)
    return replace(result, boot=boot.astype(np.int16))


# AP_GPS.h, DriverOptions::HeightEllipsoid: the receiver's height goes through the filter as it is.
HEIGHT_OPTION = "GPS_DRV_OPTIONS"
_HEIGHT_ELLIPSOID = 1 << 4


def with_both_heights(
    channels: Iterable[Channel], parameters: Mapping[str, float], ledger: Ledger, where: str
) -> list[Channel]:
    """The channels with both heights, where the receiver gave the undulation with one of them.

    ``where``: of the settings, which may say that heights above sea level are above the ellipsoid.
    """
    value = parameters.get(HEIGHT_OPTION, 0.0)  # a float; of damaged ones anything
    ellipsoidal = 0.0 <= value < 2**15 and bool(int(value) & _HEIGHT_ELLIPSOID)
    if ellipsoidal:
        ledger.note("HEIGHT-ELLIPSOID", where=where, height_option=HEIGHT_OPTION)
    result = []
    for channel in channels:
        columns = dict(channel.columns)
        undulation, logged = columns.pop("undulation_m", None), columns.get("h_msl_m")
        if logged is not None and undulation is not None:
            if ellipsoidal:
                columns |= {"h_ellipsoid_m": logged, "h_msl_m": logged - undulation}
            columns.setdefault("h_ellipsoid_m", logged + undulation)
        elif logged is not None and ellipsoidal:
            columns = {"h_ellipsoid_m": columns.pop("h_msl_m")} | columns
        result.append(replace(channel, columns=columns))
    return result
