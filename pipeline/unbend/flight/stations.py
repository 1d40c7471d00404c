"""Stations: one row an exposure, with position and attitude of the camera, and the air."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.flight.image_names import proposal
from unbend.geodesy import offset_geodetic
from unbend.messages import Entry, Notes, loss, note
from unbend.units import DEGREE, HECTOPASCAL, Array, Integers, Mask, Names

STATION_OK = "ok"
OUTSIDE_LOG = "outside_log"
IN_GAP = "in_gap"
NO_POSITION = "no_position"
NO_ATTITUDE = "no_attitude"
HEIGHT_REFERENCE_UNKNOWN = "height_reference_unknown"
UNMATCHED = "unmatched"
SUSPECT = "suspect"
NO_TIME = np.iinfo(np.int64).min  # time of a station that has none

_QUATERNIONS = ("quaternion", "aircraft_quaternion")


@dataclass(frozen=True, eq=False)
class Stations:
    """Exposures; (s,) arrays, SI and radians, NaN where unknown.

    ``quaternion`` (s, 4) is w, x, y, z with v_camera = R(q) v_enu, east-north-up at the station,
    up along the ellipsoid normal, w >= 0; ``aircraft_quaternion`` likewise with v_body (forward,
    right, down). Positions are those of the projection centre. Air was measured at the exposure;
    that of the cabin may be stated or assumed. ``sigma_tilt_rad`` is about each of the body's level
    axes, ``sigma_yaw_rad`` about its vertical one. ``suspect_reason`` is empty but for stations
    that contradict other evidence, which may be ``suspect_m`` off. ``status`` is ok or names what
    is missing; ``accepted`` are suspect ones that the mission file wants used all the same.
    """

    image: Names
    camera: Names
    time_ns: Integers
    lat_rad: Array
    lon_rad: Array
    h_msl_m: Array
    h_ellipsoid_m: Array
    quaternion: Array
    aircraft_quaternion: Array
    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array
    cabin_pressure_pa: Array
    cabin_temperature_k: Array
    cabin_vapour_pressure_pa: Array
    sigma_cabin_pressure_pa: Array
    sigma_cabin_temperature_k: Array
    sigma_horizontal_m: Array
    sigma_height_m: Array
    sigma_tilt_rad: Array
    sigma_yaw_rad: Array
    suspect_reason: Names
    suspect_m: Array
    accepted: Mask
    status: Names

    def __post_init__(self) -> None:
        n = self.image.shape[0]
        for field in fields(self):
            shape = getattr(self, field.name).shape
            if shape != ((n, 4) if field.name in _QUATERNIONS else (n,)):
                raise ValueError(f"stations: {field.name} is {shape} for {n} stations")

    def __len__(self) -> int:
        return int(self.image.shape[0])

    @property
    def ok(self) -> Mask:
        """(s,) which stations can be used."""
        return np.asarray((self.status == STATION_OK) | self.accepted)

    @property
    def mean_latitude_rad(self) -> float:
        """Latitude of the flight [rad]; 45 degrees where no station has one."""
        known = self.lat_rad[np.isfinite(self.lat_rad)]
        return float(known.mean()) if known.size else float(np.pi / 4.0)

    def with_status(self, where: Mask, status: str) -> Stations:
        """The stations with another status where a mask is True and they were ok."""
        changed = where & self.ok
        accepted = self.accepted & ~changed
        return replace(self, status=np.where(changed, status, self.status), accepted=accepted)

    def as_suspect(self, where: Mask, reason: str, off_m: float | Array, *, use: bool) -> Stations:
        """The stations marked as suspect where a mask is True and they were ok or suspect.

        A reason is added to those that a station has; ``off_m`` is how far off they may be [m], NaN
        where unknown; ``use`` leaves them usable (`ok`).
        """
        where = where & self.ok if use else where & (self.ok | (self.status == SUSPECT))
        reasons = [f"{known}; {reason}" if known else reason for known in self.suspect_reason]
        return replace(
            self,
            suspect_reason=np.where(where, np.array(reasons, dtype=object), self.suspect_reason),
            suspect_m=np.where(where, np.fmax(self.suspect_m, off_m), self.suspect_m),
            accepted=np.where(where, use, self.accepted),
            status=np.where(where, SUSPECT, self.status),
        )

    def moved(self, enu_m: NDArray[np.float64]) -> Stations:
        """The same moved by (n, 3) east, north and up [m], where that is known."""
        at = np.flatnonzero(np.isfinite(enu_m).all(axis=1) & np.isfinite(self.lat_rad))
        # Only the difference counts here, so any height will do where the ellipsoidal is unknown.
        start = self.h_ellipsoid_m[at]
        start = np.where(np.isfinite(start), start, np.nan_to_num(self.h_msl_m[at]))
        place = (self.lat_rad, self.lon_rad, self.h_msl_m, self.h_ellipsoid_m)
        lat, lon, h_msl, h_ellipsoid = (values.copy() for values in place)
        lat[at], lon[at], end = offset_geodetic(lat[at], lon[at], start, enu_m[at])
        h_msl[at] += end - start
        h_ellipsoid[at] += end - start
        return replace(self, lat_rad=lat, lon_rad=lon, h_msl_m=h_msl, h_ellipsoid_m=h_ellipsoid)

    def rows(self, which: Integers) -> Stations:
        """Some of the stations, in the order of ``which``."""
        return Stations(*(getattr(self, field.name)[which] for field in fields(self)))

    def to_pandas(self) -> Any:
        """The stations as a pandas DataFrame with the columns of ``stations.parquet``."""
        import pandas as pd

        return pd.DataFrame(station_columns(self))


def empty_stations(image: Names, camera: Names, status: str) -> Stations:
    """Stations of which only the name is known."""
    n = image.shape[0]
    blank: dict[str, Any] = {field.name: np.full(n, np.nan) for field in fields(Stations)}
    blank |= {name: np.full((n, 4), np.nan) for name in _QUATERNIONS}
    blank |= {
        "image": image, "camera": camera, "status": np.full(n, status, dtype=object),
        "time_ns": np.full(n, NO_TIME, np.int64), "accepted": np.zeros(n, dtype=np.bool_),
        "suspect_reason": np.full(n, "", dtype=object),
    }  # fmt: skip
    return Stations(**blank)


def join_stations(parts: list[Stations]) -> Stations:
    """Stations of several cameras or sources, one after the other."""
    joined = (np.concatenate([getattr(p, field.name) for p in parts]) for field in fields(Stations))
    return Stations(*joined)


def station_columns(stations: Stations) -> dict[str, Any]:
    """Columns of ``stations.parquet``: degrees, UTC, null (NaT, NaN) where unknown."""
    time = stations.time_ns.astype("datetime64[ns]")
    time[stations.time_ns == NO_TIME] = np.datetime64("NaT")
    columns: dict[str, Any] = {}
    for field in fields(stations):
        name, values = field.name, getattr(stations, field.name)
        if name in _QUATERNIONS:
            prefix = name.removesuffix("quaternion") + "q_"
            columns |= {f"{prefix}{axis}": values[:, k] for k, axis in enumerate("wxyz")}
        elif name.endswith("_rad"):
            columns[name.removesuffix("rad") + "deg"] = np.degrees(values)
        else:
            columns[name] = values
    del columns["accepted"]
    columns = {{"time_ns": "time_utc"}.get(name, name): v for name, v in columns.items()}
    reasons = [reason or None for reason in stations.suspect_reason]
    return columns | {"time_utc": time, "suspect_reason": reasons}


def append_unmatched_images(stations: Stations, images: tuple[str, ...]) -> tuple[Stations, Notes]:
    """The stations, with a row for every image that was measured but never exposed in the log."""
    notes = []
    unknown = np.array(sorted(set(images) - set(stations.image.tolist())), dtype=object)
    unused = stations.image[~np.isin(stations.image.astype(str), np.array(images, dtype=str))]
    if unused.size:
        names = _first_three(unused)
        notes.append(note("STATIONS-UNUSED", count=unused.size, names=names))
    if unknown.size == 0:
        return stations, tuple(notes)
    what = f"{unknown.size} images have observations but no exposure: {_first_three(unknown)}"
    if unused.size:
        what += f"; exposures without observations: {names}"
    elif len(stations):
        ordered = np.sort(stations.image.astype(str))  # its neighbour there begins as it does
        like = str(ordered[max(int(np.searchsorted(ordered, unknown[0])) - 1, 0)])
        what += f"; exposures are called like {like!r}"
    if near := proposal(unknown.tolist(), stations.image.tolist()):
        what += f"; {near}"
    notes.append(loss("IMAGES-UNMATCHED", what, where="events", count=int(unknown.size)))
    camera = np.full(unknown.shape, "", dtype=object)
    unmatched = empty_stations(unknown, camera, UNMATCHED)
    return join_stations([stations, unmatched]), tuple(notes)


def _first_three(images: Names) -> str:
    return ", ".join(images[:3].tolist()) + (" ..." if images.size > 3 else "")


# Barometer against profile at one exposure: 8 hPa are some 80 m of height.
LARGEST_PRESSURE_MISFIT_PA = 800.0

_SCALE_M_PER_K = 29.27  # the gas constant of dry air over gravity: scale height of 1 K


def flag_height_misfits(
    stations: Stations, profile: Profile | ProfileSeries, *, use_suspect: bool = False
) -> tuple[Stations, Notes]:
    """Mark stations whose pressure is more than 8 hPa from that of the flight's profile.

    Their height is wrong, or their barometer failed. They stay usable with ``use_suspect``.
    """
    misfit = stations.pressure_pa - profile.pressure(stations.h_msl_m)
    with np.errstate(invalid="ignore"):
        wrong = stations.ok & (np.abs(misfit) > LARGEST_PRESSURE_MISFIT_PA)
    if not bool(wrong.any()):
        return stations, ()
    worst, first = float(np.nanmax(np.abs(misfit[wrong]))), stations.image[np.argmax(wrong)]
    entry = loss("STATIONS-HEIGHT", count=int(wrong.sum()), worst=worst / HECTOPASCAL, first=first)
    off_m = np.abs(misfit) * _SCALE_M_PER_K * profile.temperature(stations.h_msl_m)
    off_m = off_m / stations.pressure_pa
    reason = "barometer and GNSS height contradict each other"
    return stations.as_suspect(wrong, reason, off_m, use=use_suspect), (entry,)


def unusable_station_notes(stations: Stations) -> Iterator[Entry]:
    """A loss for each reason why stations cannot be used."""
    for status in sorted(set(stations.status.tolist()) - {STATION_OK, UNMATCHED}):
        images = stations.image[stations.status == status]
        what = f"{images.size} exposures are {status}: {_first_three(images)}"
        yield loss("STATIONS-FLAGGED", what, count=int(images.size))


def sigma_notes(
    stations: Stations,
    max_horizontal_m: float | None,
    max_height_m: float | None,
    max_tilt_rad: float | None,
) -> Iterator[Entry]:
    """How well stations are known; a loss for each limit that some, or unknown ones, exceed."""
    medians = []
    for what, sigma, limit, factor, unit in (
        ("position (per axis)", stations.sigma_horizontal_m, max_horizontal_m, 1.0, "m"),
        ("height", stations.sigma_height_m, max_height_m, 1.0, "m"),
        ("attitude (about a level axis)", stations.sigma_tilt_rad, max_tilt_rad, 1 / DEGREE, "deg"),
    ):
        sigma = sigma[stations.ok] * factor
        is_known = bool(np.isfinite(sigma).any())
        medians.append(what + (f" {np.nanmedian(sigma):.2f} {unit}" if is_known else " unknown"))
        large = np.zeros(sigma.size, bool) if limit is None else ~(sigma <= limit * factor)
        if limit is not None and bool(large.any()):
            worst = int(np.argmax(np.nan_to_num(sigma, nan=np.inf)))
            size = f"{sigma[worst]:.2f} {unit}" if np.isfinite(sigma[worst]) else "an unknown sigma"
            yield loss("STATIONS-SIGMA/worse", where="stations", count=int(large.sum()), size=size,
                       total=sigma.size, quantity=what, limit=limit * factor, unit=unit,
                       worst=stations.image[stations.ok][worst])  # fmt: skip
    if bool(stations.ok.any()):
        what = f"sigmas of the stations, in the median: {', '.join(medians)}"
        yield note("STATIONS-SIGMA", what, where="stations", count=int(stations.ok.sum()))
