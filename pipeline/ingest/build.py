"""Decoded rows -> a channel: fixes, attitudes, and time that rises."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Array, Channel, Source, TimeArray
from pipeline.flight.clock import increasing
from pipeline.ingest.fields import MessageMap
from pipeline.ingest.frames import positive_scalar, quaternion_of_euler
from pipeline.ledger import Entry, Kind, Ledger

LOWEST_FIX = 3  # 3D; both GPS_FIX_TYPE of MAVLink and GPS.Status of ArduPilot


@dataclass(frozen=True)
class Rows:
    """The rows of one channel as decoded: times in the order of the file, columns in SI."""

    name: str
    source: Source
    time_ns: TimeArray
    boot: NDArray[np.int16]
    columns: Mapping[str, Array]
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Rows:
        """The rows of a mask or an index."""
        return Rows(
            self.name,
            self.source,
            self.time_ns[rows],
            self.boot[rows],
            {name: column[rows] for name, column in self.columns.items()},
            {
                name: tuple(np.asarray(label, object)[rows].tolist())
                for name, label in self.labels.items()
            },
        )


def channel_of(rows: Rows, spec: MessageMap, rank: int, ledger: Ledger) -> Channel | None:
    """A channel from decoded rows, or None when nothing is left; drops are in the ledger."""
    needed = {"lat_rad", "lon_rad"} if spec.position else set()
    if spec.attitude:
        euler = "roll_rad" in rows.columns
        needed |= {"pitch_rad", "yaw_rad"} if euler else {"q_w", "q_x", "q_y", "q_z"}
    if absent := sorted(needed - set(rows.columns)):
        what = f"{len(rows)} rows cannot be used: the log defines no field for {', '.join(absent)}"
        ledger.loss("LOG-FIELDS", what, where=rows.name, count=len(rows))
        return None
    if spec.position:
        rows = _with_fix(rows, ledger)
    rows = _rising(rows, ledger, event=spec.event)
    columns = _attitude(dict(rows.columns)) if spec.attitude else dict(rows.columns)
    if spec.event and len(rows):
        columns = _event(columns, len(rows))
    columns = {
        name: values for name, values in columns.items() if bool(np.any(np.isfinite(values)))
    }
    if len(rows) == 0 or not columns:
        return None
    channel = Channel(
        rows.name, rows.time_ns, columns, rows.source, rows.boot, (), rank, rows.labels
    )
    roles = tuple(role for role in spec.roles if channel.can_play(role))
    return Channel(
        rows.name, rows.time_ns, columns, rows.source, rows.boot, roles, rank, rows.labels
    )


def _with_fix(rows: Rows, ledger: Ledger) -> Rows:
    lat, lon = rows.columns["lat_rad"], rows.columns["lon_rad"]
    good = np.isfinite(lat) & np.isfinite(lon) & ~((lat == 0.0) & (lon == 0.0))
    if "fix" in rows.columns:
        good &= rows.columns["fix"] >= LOWEST_FIX
    dropped = int(np.count_nonzero(~good))
    if dropped:
        ledger.note(
            "POSITION-NO-FIX",
            f"{dropped} of {len(rows)} rows have no fix and are not used",
            where=rows.name,
            count=dropped,
        )
    return rows.take(good)


def _rising(rows: Rows, ledger: Ledger, *, event: bool) -> Rows:
    keep = increasing(rows.time_ns)
    dropped = int(np.count_nonzero(~keep))
    if not dropped:
        return rows
    equal = bool(np.all(rows.time_ns[~keep] == np.maximum.accumulate(rows.time_ns)[~keep]))
    step = "repeat the time of" if equal else "are not later than"
    what = f"{dropped} of {len(rows)} rows {step} a row before and are not used"
    kind = Kind.LOSS if event else Kind.NOTE if equal else Kind.WARNING
    ledger.add(Entry(kind, "TIME-BACKWARD", what, rows.name, dropped))
    return rows.take(keep)


def _attitude(columns: dict[str, Array]) -> dict[str, Array]:
    if "roll_rad" in columns:
        angles = (columns.pop("roll_rad"), columns.pop("pitch_rad"), columns.pop("yaw_rad"))
        q = quaternion_of_euler(*angles)
    else:
        q = positive_scalar(np.stack([columns.pop(f"q_{axis}") for axis in "wxyz"], axis=1))
    return columns | {f"q_{axis}": q[:, k] for k, axis in enumerate("wxyz")}


def _event(columns: dict[str, Array], n: int) -> dict[str, Array]:
    if "event_index" not in columns:
        columns["event_index"] = np.arange(n, dtype=np.float64)
    if "lat_rad" in columns and "lon_rad" in columns:
        nowhere = (columns["lat_rad"] == 0.0) & (columns["lon_rad"] == 0.0)
        for name in ("lat_rad", "lon_rad", "h_msl_m"):
            if name in columns:
                columns[name] = np.where(nowhere, np.nan, columns[name])
    return columns
