"""Stations: one row an exposure, with position and attitude of the camera, and the air."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.barometer_errors import NO_ERRORS, BarometerErrors
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.flight import messages
from unbend.flight.image_names import propose_differences, shift_of_names
from unbend.geodesy import longitudes_near, offset_geodetic
from unbend.messages import Message, Notes
from unbend.notebook import html_table, new_axes
from unbend.units import DEGREE, HECTOPASCAL, Array, Integers, Mask, Names

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STATION_OK = "ok"
OUTSIDE_LOG = "outside_log"
IN_GAP = "in_gap"
NO_POSITION = "no_position"
NO_ATTITUDE = "no_attitude"
HEIGHT_REFERENCE_UNKNOWN = "height_reference_unknown"
UNMATCHED = "unmatched"
SUSPECT = "suspect"
NO_TIME = np.iinfo(np.int64).min  # the ``time_ns`` of a station of unknown time
_QUATERNIONS = ("quaternion", "aircraft_quaternion")


def middle_time_ns(time_ns: Integers) -> int | None:
    """The median [Unix ns] of the known ones of (s,) times; None if all are `NO_TIME`."""
    known_ns = np.sort(time_ns[time_ns != NO_TIME])
    return int(known_ns[known_ns.size // 2]) if known_ns.size else None


@dataclass(frozen=True, eq=False)
class Stations:
    """Exposures; (s,) arrays, SI and radians, NaN where unknown.

    ``quaternion`` (s, 4) is w, x, y, z with v_camera = R(q) v_enu, east-north-up at the station,
    up along the ellipsoid normal, w >= 0; ``aircraft_quaternion`` likewise with v_body (forward,
    right, down). Positions are those of the projection centre. Air was measured at the exposure;
    that of the cabin may be stated or assumed. ``sigma_horizontal_m`` is of each level axis,
    ``sigma_tilt_rad`` about each of the body's level axes, ``sigma_yaw_rad`` about its vertical
    axis. ``status`` is ok, or names what is missing, or is suspect: then ``suspect_reason`` is not
    empty, and the station may be ``suspect_m`` off. ``accepted`` marks suspect stations that the
    mission file wants used all the same. ``from_boot`` marks times that count from a boot of the
    vehicle: their UTC is not known.
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
    from_boot: Mask = field(default_factory=lambda: np.zeros(0, np.bool_))

    def __post_init__(self) -> None:
        n = self.image.shape[0]
        if not self.from_boot.shape[0]:
            object.__setattr__(self, "from_boot", np.zeros(n, np.bool_))
        for column in fields(self):
            shape = getattr(self, column.name).shape
            expected = (n, 4) if column.name in _QUATERNIONS else (n,)
            if shape != expected:
                raise ValueError(f"stations: {column.name} is {shape} for {n} stations")

    def __len__(self) -> int:
        return int(self.image.shape[0])

    def __repr__(self) -> str:
        """How many stations each camera has, how many have each status, and the time span."""
        by_camera = counts_in_words(self.camera)
        by_status = counts_in_words(self.status)
        known_ns = self.utc_ns[self.utc_ns != NO_TIME]
        span = "no UTC"
        if known_ns.size:
            first, last = np.array([known_ns.min(), known_ns.max()]).astype("datetime64[ns]")
            span = f"{first.astype('datetime64[s]')} to {last.astype('datetime64[s]')} UTC"
        return f"<Stations: {by_camera}; {by_status}; {span}>"

    def _repr_html_(self) -> str:
        """A table of names, times, places, heights and status, for notebooks."""
        columns = {
            "image": self.image,
            "camera": self.camera,
            "time_utc": _utc(self.utc_ns),
            "lat_deg": np.degrees(self.lat_rad),
            "lon_deg": np.degrees(self.lon_rad),
            "h_msl_m": self.h_msl_m,
            "h_ellipsoid_m": self.h_ellipsoid_m,
            "status": self.status,
        }
        return html_table(repr(self), columns)

    @property
    def ok(self) -> Mask:
        """(s,) True for stations that can be used: status ok, or suspect and accepted."""
        return np.asarray((self.status == STATION_OK) | self.accepted)

    @property
    def utc_ns(self) -> Integers:
        """(s,) UTC [Unix ns]; `NO_TIME` where it is unknown."""
        return np.where(self.from_boot, NO_TIME, self.time_ns)

    @property
    def mean_latitude_rad(self) -> float:
        """Mean latitude of the flight [rad]; 45 degrees if no station has a latitude."""
        latitudes_rad = self._known_of_usable(self.lat_rad)
        return float(latitudes_rad.mean()) if latitudes_rad.size else float(np.pi / 4.0)

    @property
    def median_longitude_rad(self) -> float:
        """The median longitude of the flight [rad], in [-pi, pi]; NaN if all are unknown."""
        longitudes_rad = self._known_of_usable(self.lon_rad)
        if not longitudes_rad.size:
            return math.nan
        median = float(np.median(longitudes_near(longitudes_rad, longitudes_rad[0])))
        return math.remainder(median, 2.0 * math.pi)  # a median in [-pi, pi] keeps all its bits

    def _known_of_usable(self, values: Array) -> Array:
        """The known (not NaN) ones of (s,) values, of usable stations only.

        The place of a suspect station would move the middle of the flight. Without a known value at
        a usable station, those of all stations are returned.
        """
        is_known = np.isfinite(values)
        usable = is_known & self.ok
        return values[usable] if bool(usable.any()) else values[is_known]

    def with_status(self, where: Mask, status: str) -> Stations:
        """Give the usable stations for which ``where`` (s,) is True another status.

        Stations that cannot be used (`ok` is False) keep the status that they have.
        """
        is_changed = where & self.ok
        accepted = self.accepted & ~is_changed
        return replace(self, status=np.where(is_changed, status, self.status), accepted=accepted)

    def as_suspect(self, where: Mask, reason: str, off_m: float | Array, *, use: bool) -> Stations:
        """Mark the stations for which ``where`` (s,) is True as suspect.

        Marks stations that are usable (`ok`); with ``use`` False also those already suspect.
        ``use`` True leaves marked stations usable (`ok`). ``off_m`` is how far off they may be [m],
        NaN where unknown. The reason is added to those that a station has.
        """
        can_be_marked = self.ok
        if not use:
            can_be_marked = self.ok | (self.status == SUSPECT)
        marked = where & can_be_marked
        reasons = self.suspect_reason.copy()
        for row in np.flatnonzero(marked):
            reasons[row] = f"{reasons[row]}; {reason}" if reasons[row] else reason
        return replace(
            self,
            suspect_reason=reasons,
            suspect_m=np.where(marked, np.fmax(self.suspect_m, off_m), self.suspect_m),
            accepted=np.where(marked, use, self.accepted),
            status=np.where(marked, SUSPECT, self.status),
        )

    def moved(self, enu_m: NDArray[np.float64]) -> Stations:
        """The stations moved by (s, 3) metres east, north and up.

        Stations with an unknown place, or an unknown move (NaN), stay.
        """
        rows = np.flatnonzero(np.isfinite(enu_m).all(axis=1) & np.isfinite(self.lat_rad))
        # Only the change of height counts: where the ellipsoidal height is unknown, that above sea
        # level or 0 m serves as the start.
        ellipsoidal_m = self.h_ellipsoid_m[rows]
        substitute_m = np.nan_to_num(self.h_msl_m[rows])
        start_m = np.where(np.isfinite(ellipsoidal_m), ellipsoidal_m, substitute_m)
        lat_rad = self.lat_rad.copy()
        lon_rad = self.lon_rad.copy()
        h_msl_m = self.h_msl_m.copy()
        h_ellipsoid_m = self.h_ellipsoid_m.copy()
        lat_rad[rows], lon_rad[rows], end_m = offset_geodetic(
            lat_rad[rows], lon_rad[rows], start_m, enu_m[rows]
        )
        h_msl_m[rows] += end_m - start_m
        h_ellipsoid_m[rows] += end_m - start_m
        return replace(
            self, lat_rad=lat_rad, lon_rad=lon_rad, h_msl_m=h_msl_m, h_ellipsoid_m=h_ellipsoid_m
        )

    def rows(self, numbers: Integers) -> Stations:
        """The stations of these row numbers, in their order."""
        chosen = {column.name: getattr(self, column.name)[numbers] for column in fields(self)}
        return Stations(**chosen)

    def to_pandas(self) -> Any:
        """The stations as a pandas DataFrame with the columns of ``stations.parquet``."""
        import pandas as pd

        return pd.DataFrame(station_columns(self))

    def plot(self, axis: Axes | None = None) -> Axes:
        """Draw the stations from above, camera by camera; those that cannot be used as crosses.

        ``axis`` : axes to draw on; by default those of a new figure. Refuses (ConfigError
        PLOT-MATPLOTLIB) where matplotlib is not installed.
        """
        if axis is None:
            (axis,) = new_axes(1)
        latitude_deg = np.degrees(self.lat_rad)
        middle_rad = self.median_longitude_rad
        longitude_deg = np.degrees(longitudes_near(self.lon_rad, middle_rad))
        for camera in sorted(set(self.camera.tolist())):
            rows = self.ok & (self.camera == camera)
            axis.plot(longitude_deg[rows], latitude_deg[rows], ".", label=camera or "no camera")
        unusable = ~self.ok & np.isfinite(latitude_deg + longitude_deg)
        if unusable.any():
            axis.plot(longitude_deg[unusable], latitude_deg[unusable], "rx", label="not usable")
        # A degree of longitude is shorter than a degree of latitude.
        axis.set_aspect(1.0 / math.cos(self.mean_latitude_rad), adjustable="datalim")
        axis.ticklabel_format(useOffset=False)
        axis.set_xlabel("longitude [deg]")
        axis.set_ylabel("latitude [deg]")
        axis.legend()
        return axis


def counts_in_words(words: Names) -> str:
    """How often each word occurs, the most frequent first.

    The empty word is written as "without a camera".

    >>> counts_in_words(np.array(["ok", "in_gap", "ok"], dtype=object))
    '2 ok, 1 in_gap'
    """
    counts = Counter(words.tolist()).most_common()
    return ", ".join(f"{number} {word or 'without a camera'}" for word, number in counts) or "none"


def empty_stations(image: Names, camera: Names, status: str) -> Stations:
    """Stations with names and a status only: no time, and NaN in all other columns."""
    n = image.shape[0]
    columns: dict[str, Any] = {column.name: np.full(n, np.nan) for column in fields(Stations)}
    for name in _QUATERNIONS:
        columns[name] = np.full((n, 4), np.nan)
    columns["image"] = image
    columns["camera"] = camera
    columns["time_ns"] = np.full(n, NO_TIME, np.int64)
    columns["suspect_reason"] = np.full(n, "", dtype=object)
    columns["accepted"] = np.zeros(n, dtype=np.bool_)
    columns["from_boot"] = np.zeros(n, dtype=np.bool_)
    columns["status"] = np.full(n, status, dtype=object)
    return Stations(**columns)


def join_stations(parts: list[Stations]) -> Stations:
    """Stations of several cameras or sources, one after the other."""
    joined: dict[str, Any] = {}
    for column in fields(Stations):
        joined[column.name] = np.concatenate([getattr(part, column.name) for part in parts])
    return Stations(**joined)


def station_columns(stations: Stations) -> dict[str, Any]:
    """The columns of ``stations.parquet`` by name: degrees, UTC; NaT, NaN or None if unknown."""
    columns: dict[str, Any] = {}
    for name in (column.name for column in fields(stations)):
        if name == "time_ns":
            columns["time_utc"] = _utc(stations.utc_ns)
        elif name not in ("accepted", "from_boot"):
            columns |= _columns_of_field(name, getattr(stations, name))
    return columns


def _columns_of_field(name: str, values: NDArray[Any]) -> dict[str, Any]:
    """The columns of ``stations.parquet`` that a field of the stations becomes."""
    if name in _QUATERNIONS:
        prefix = name.removesuffix("quaternion") + "q_"
        return {f"{prefix}{axis}": values[:, column] for column, axis in enumerate("wxyz")}
    if name.endswith("_rad"):
        return {name.removesuffix("rad") + "deg": np.degrees(values)}
    if name == "suspect_reason":
        return {name: [reason or None for reason in values]}
    return {name: values}


def _utc(time_ns: Integers) -> NDArray[np.datetime64]:
    """Times [Unix ns] as numpy times; NaT for `NO_TIME`."""
    time = time_ns.astype("datetime64[ns]")
    time[time_ns == NO_TIME] = np.datetime64("NaT", "ns")
    return time


def append_unmatched_images(
    stations: Stations, images: tuple[str, ...], *, where: str
) -> tuple[Stations, Notes]:
    """Append a station of status UNMATCHED for each observed image that has no exposure.

    Reports images without an exposure, and exposures without an observed image. ``images``: all
    images with observations. ``where``: the key of the mission file that names the exposures.
    """
    observed = np.array(images, dtype=str)
    is_unused = ~np.isin(stations.image.astype(str), observed)
    unused = stations.image[is_unused].tolist()
    notes: list[Message] = []
    if unused:
        notes.append(messages.exposures_unused(images=unused))
    unknown = sorted(set(images).difference(stations.image.tolist()))
    if not unknown:
        return stations, tuple(notes)
    known = stations.image.tolist()
    proposal = propose_differences(unknown, known)
    if not proposal:
        shift = shift_of_names(images, known)
        proposal = messages.names_shifted(shift=shift) if shift else ""
    notes.append(
        messages.images_unmatched(
            where=where,
            images=unknown,
            unused=unused,
            like=_neighbour_by_name(stations, unknown[0]),
            proposal=proposal,
        )
    )
    image = np.array(unknown, dtype=object)
    camera = np.full(image.shape, "", dtype=object)
    unmatched = empty_stations(image, camera, UNMATCHED)
    return join_stations([stations, unmatched]), tuple(notes)


def _neighbour_by_name(stations: Stations, image: str) -> str | None:
    """The exposure that precedes an image in the order of names: it probably begins like the image.

    The first exposure if the image precedes all; None without exposures.
    """
    if len(stations) == 0:
        return None
    ordered = np.sort(stations.image.astype(str))
    before = int(np.searchsorted(ordered, image)) - 1
    return str(ordered[max(before, 0)])


# Between barometer and profile at one exposure: 8 hPa are some 80 m of height.
LARGEST_PRESSURE_MISFIT_PA = 800.0

_SCALE_M_PER_K = 29.27  # gas constant of dry air over gravity: scale height over temperature [m/K]


def flag_height_misfits(
    stations: Stations,
    profile: Profile | ProfileSeries,
    errors: BarometerErrors = NO_ERRORS,
    *,
    use_suspect: bool = False,
) -> tuple[Stations, Notes]:
    """Mark stations as suspect if their pressure is more than 8 hPa from the expected reading.

    That is the pressure of the profile at the station's height, with the ``errors`` of the
    barometer. Either the height is wrong, or the barometer failed. With ``use_suspect`` the
    stations stay usable.
    """
    expected_pa = errors.reading(profile.pressure(stations.h_msl_m))
    misfit_pa = np.abs(stations.pressure_pa - expected_pa)
    with np.errstate(invalid="ignore"):
        wrong = stations.ok & (misfit_pa > LARGEST_PRESSURE_MISFIT_PA)
    count = int(np.count_nonzero(wrong))
    if count == 0:
        return stations, ()
    message = messages.station_heights_suspect(
        count=count,
        worst_hpa=float(np.nanmax(misfit_pa[wrong])) / HECTOPASCAL,
        first=stations.image[np.argmax(wrong)],
    )
    temperature_k = profile.temperature(stations.h_msl_m)
    off_m = misfit_pa * _SCALE_M_PER_K * temperature_k / stations.pressure_pa
    reason = "barometer and GNSS height contradict each other"
    return stations.as_suspect(wrong, reason, off_m, use=use_suspect), (message,)


def unusable_station_notes(stations: Stations) -> Iterator[Message]:
    """A loss for each status other than ok and UNMATCHED, with the images that have it."""
    for status in sorted(set(stations.status.tolist()) - {STATION_OK, UNMATCHED}):
        images = stations.image[stations.status == status]
        yield messages.stations_flagged(status=status, images=images.tolist())


@dataclass(frozen=True)
class SigmaLimits:
    """The largest sigmas of stations that a mission allows; None for no limit."""

    horizontal_m: float | None = None
    height_m: float | None = None
    tilt_rad: float | None = None


def sigma_notes(stations: Stations, limits: SigmaLimits) -> Iterator[Message]:
    """Report the median sigmas of usable stations, and each limit that some of them exceed.

    An unknown sigma (NaN) exceeds every limit.
    """
    ok = stations.ok
    if not ok.any():
        return
    max_tilt_deg = None if limits.tilt_rad is None else limits.tilt_rad / DEGREE
    horizontal = _StationSigma(
        quantity="position (per axis)",
        unit="m",
        values=stations.sigma_horizontal_m[ok],
        limit=limits.horizontal_m,
    )
    height = _StationSigma(
        quantity="height",
        unit="m",
        values=stations.sigma_height_m[ok],
        limit=limits.height_m,
    )
    tilt = _StationSigma(
        quantity="attitude (about a level axis)",
        unit="deg",
        values=stations.sigma_tilt_rad[ok] / DEGREE,
        limit=max_tilt_deg,
    )
    image = stations.image[ok]
    for sigma in (horizontal, height, tilt):
        yield from sigma.beyond_limit(image)
    yield messages.station_sigmas(
        stations=image.size, medians=[horizontal.median, height.median, tilt.median]
    )


@dataclass(frozen=True, eq=False)
class _StationSigma:
    """One sigma of usable stations, (m,) in ``unit``, and the largest that is allowed."""

    quantity: str
    unit: str
    values: Array
    limit: float | None

    @property
    def median(self) -> str:
        """The quantity with the median of its known values and the unit, for a note."""
        if not np.isfinite(self.values).any():
            return f"{self.quantity} unknown"
        return f"{self.quantity} {np.nanmedian(self.values):.2f} {self.unit}"

    def beyond_limit(self, image: Names) -> Iterator[Message]:
        """The loss of stations with a sigma that exceeds the limit or is unknown.

        ``image`` : (m,) names of the stations. No message without a limit.
        """
        if self.limit is None:
            return
        count = int(np.count_nonzero(~(self.values <= self.limit)))  # counts NaN too
        if count == 0:
            return
        worst = int(np.argmax(np.nan_to_num(self.values, nan=np.inf)))
        sigma = float(self.values[worst])
        yield messages.stations_worse_than_needed(
            count=count,
            total=self.values.size,
            quantity=self.quantity,
            limit=self.limit,
            unit=self.unit,
            worst=image[worst],
            sigma=sigma if np.isfinite(sigma) else None,
        )
