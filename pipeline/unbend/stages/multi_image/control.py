"""Before and after on the user's own control: points intersected with and without refraction."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from unbend.block.image_rays import ImageRays, sorted_rays
from unbend.block.intersection import point_heights
from unbend.config import Mission
from unbend.errors import InputError
from unbend.flight.heights import HeightSystem
from unbend.flight.stations import Stations
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef
from unbend.messages import Ledger
from unbend.stages.correction import correct_batch
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.exposure_setup import orientations_of_mission
from unbend.stages.multi_image.point_heights import points_above_sea
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.object_points import ObjectPoints, matching_rows
from unbend.tables.observations import Batch
from unbend.units import Array, Integers, Mask

_BATCH_ROWS = 250_000
_FEET = 0.3048
_FAR_M, _FAR_SIGMAS, _FAR_EFFECTS = 1.0, 5.0, 3.0
"""Control farther than each of these from where its rays meet is not what it is said to be."""

_BETTER = 0.2  # of the distance, by another reading
_FEWEST = 5  # points, among which one may be an outlier
_WORSE = 0.25
"""Part of the square of what refraction moves, by which the square of misses may grow."""


@dataclass(frozen=True, eq=False)
class ControlComparison:
    """Intersected minus given places of control points (p, 3), east, north, up [m].

    ``before`` by the rays as measured, ``after`` by the corrected ones; NaN where they do not meet.
    ``sigma_m`` (p,) is what the sigmas of stations and pixels let a height miss, ``sigma_stated``
    whether those of the stations are known. ``unmeasured`` control points are in no image.
    """

    name: tuple[str, ...]
    rays: Integers
    before: Array
    after: Array
    sigma_m: Array
    sigma_stated: bool
    unmeasured: int

    @property
    def used(self) -> Mask:
        """(p,) points whose rays meet."""
        return np.asarray(np.isfinite(self.before + self.after).all(axis=1))

    def rms(self, values: Array) -> Array:
        """(3,) root mean squares of some (p, 3) of used points."""
        return np.asarray(np.sqrt(np.mean(values[self.used] ** 2, axis=0)))

    def part_explained(self) -> float:
        """The part of the mean square of what points missed that the correction takes away."""
        before, after = (float(np.sum(self.rms(v) ** 2)) for v in (self.before, self.after))
        return 1.0 - after / before

    def manifest(self) -> dict[str, Any]:
        """For the manifest: millimetres are enough, and null is what is not known."""

        def metres(values: ArrayLike) -> Any:
            found = [None if np.isnan(v) else round(v, 4) for v in np.atleast_1d(values).tolist()]
            return found if np.ndim(values) else found[0]

        sigma_m = self.sigma_m if self.sigma_stated else np.full(self.sigma_m.size, np.nan)
        points = zip(self.name, self.rays.tolist(), self.before, self.after, sigma_m, strict=True)
        return {
            "points": [
                {"point": name, "rays": rays, "before_m": metres(before), "after_m": metres(after),
                 "sigma_u_m": metres(sigma)}
                for name, rays, before, after, sigma in points
            ],
            "used": int(self.used.sum()),
            "unmeasured": self.unmeasured,
            "rms_before_m": metres(self.rms(self.before)),
            "rms_after_m": metres(self.rms(self.after)),
            "rms_refraction_m": metres(self.rms(self.before - self.after)),
            "mean_before_m": metres(self.before[self.used].mean(axis=0)),
            "mean_after_m": metres(self.after[self.used].mean(axis=0)),
            "part_explained": round(self.part_explained(), 4),
            "sigma_u_m": metres(np.nanmedian(self.sigma_m[self.used]))
            if self.sigma_stated else None,
        }  # fmt: skip


def compare_control(
    mission: Mission, inputs: OpenedInputs, setup: CorrectionSetup, stations: Stations, heights:
    HeightSystem, *, ledger: Ledger,
) -> ControlComparison | None:  # fmt: skip
    """Control points where their rays meet, before and after; None without control, or rays.

    Refuses (CONTROL-MISSING) a table of which no point is observed; CONTROL-RAYS is a loss.
    """
    section, observations = mission.control, inputs.observations
    if section is None or inputs.control is None:
        return None
    points = points_above_sea(
        inputs.control,
        section,
        section.reference,
        key="control",
        heights=heights,
        geoid=inputs.geoid,
        ledger=ledger,
    )
    setup = replace(setup, uncertainties=(None,) * len(setup.rays))
    images, parts = pa.array(setup.images, pa.string()), [np.empty((9, 0))]
    for batch in observations.batches(_BATCH_ROWS):
        rows = np.flatnonzero(matching_rows(batch.point, points.name) >= 0)
        if rows.size:
            parts.append(_rays_of(batch.taken(rows), points, images, setup))
    measured = np.concatenate(parts, axis=1)
    point = np.unique(measured[0].astype(np.int64))
    if not point.size:
        first = next(observations.batches(1)).point[0]
        raise InputError.of(
            "CONTROL-MISSING", "control", total=len(points.name), name=points.name[0], first=first
        )
    measured = measured[:, np.isfinite(measured).all(axis=0) & (measured[1] >= 0)]
    at = np.searchsorted(point, measured[0].astype(np.int64))
    orientations = orientations_of_mission(mission, stations)
    station = measured[1].astype(np.int64)
    of_stations = stations.sigma_height_m + stations.sigma_tilt_rad
    places = np.full((2, point.size, 3), np.nan)
    sigma = np.full(point.size, np.nan)
    for place, direction in zip(places, (measured[3:6], measured[6:]), strict=True):
        rays = ImageRays(station, at, direction.T, measured[2])
        r, found = sorted_rays(orientations, rays), point_heights(orientations, rays)
        meets, row = ~(found.few | found.narrow), np.unique(at)
        place[row[meets]] = (r.positions(r.oriented) + r.origin)[meets]
        sigma[row] = found.sigma_m
    lat, lon, h = points.lat_rad[point], points.lon_rad[point], points.h_m[point]
    undulation = heights.undulation(lat, lon)
    # Stations of which only the height above sea level is known count from there.
    h = h + (undulation if bool(np.isfinite(stations.h_ellipsoid_m).any()) else 0.0)
    axes, given = enu_from_ecef(lat, lon), ecef_of_geodetic(lat, lon, h)
    before, after = np.einsum("pij,kpj->kpi", axes, places - given)
    comparison = ControlComparison(
        tuple(points.name.take(pa.array(point)).to_pylist()),
        np.bincount(at, minlength=point.size),
        before, after, sigma, bool(np.isfinite(of_stations[station]).any()),
        len(points.name) - point.size,
    )  # fmt: skip
    if not comparison.used.any():
        ledger.loss("CONTROL-RAYS", where="control", count=point.size)
        return None
    stated = h if section.reference == "ellipsoid" else h - undulation
    readings = {
        "heights above the ellipsoid taken for those above sea level": (lat, lon, h - undulation),
        "heights above sea level taken for those above the ellipsoid": (lat, lon, h + undulation),
        "heights above the take-off taken for those above sea level": (
            lat, lon, h + (heights.home_h_msl_m or np.nan)),
        "heights in feet taken for metres": (lat, lon, h - (1.0 - _FEET) * stated),
        "latitude and longitude exchanged": (lon, lat, h),
    }  # fmt: skip
    used, corrected = comparison.used, places[1]
    off_m = {
        what: float(np.median(np.linalg.norm(corrected - ecef_of_geodetic(*read), axis=1)[used]))
        for what, read in readings.items()
    }
    judge_control(comparison, off_m, ledger)
    return comparison


def _rays_of(
    batch: Batch, points: ObjectPoints, images: pa.StringArray, setup: CorrectionSetup
) -> Array:
    """(9, n) control point, station, sigma [rad] and the directions measured and corrected."""
    station = matching_rows(batch.image, images)
    corrected = correct_batch(batch, station, setup.ground.heights(batch, station, setup), setup)
    before, sigma = setup.directions(batch.x_px, batch.y_px, station)
    after, _ = setup.directions(corrected.x_corrected_px, corrected.y_corrected_px, station)
    return np.vstack([matching_rows(batch.point, points.name), station, sigma, before.T, after.T])


def judge_control(
    comparison: ControlComparison, off_m: Mapping[str, float], ledger: Ledger
) -> None:
    """What control points say against themselves, the stations or the correction.

    ``off_m`` : median distance of the corrected points from the control in other readings [m].
    """
    used, where = comparison.used, "control"
    after, count = comparison.after[used], int(comparison.used.sum())
    misses = np.linalg.norm(after, axis=1)
    was, now, effect = (
        float(np.linalg.norm(comparison.rms(moved)))
        for moved in (comparison.before, comparison.after, comparison.before - comparison.after)
    )
    stated, known = float(np.median(misses)), comparison.sigma_m[used]
    sigma = float(np.median(known[np.isfinite(known)])) if np.isfinite(known).any() else 0.0
    if stated > max(_FAR_M, _FAR_SIGMAS * sigma, _FAR_EFFECTS * effect):
        likely = min(off_m, key=lambda reading: np.nan_to_num(off_m[reading], nan=np.inf))
        if off_m[likely] < _BETTER * stated:
            ledger.finding(
                "CONTROL-READING", where=where, count=count, stated=stated, likely=likely,
                off=off_m[likely],
            )  # fmt: skip
        else:
            ledger.finding("CONTROL-FAR", where=where, count=count, stated=stated, sigma=sigma)
        return
    apart = np.linalg.norm(after - np.median(after, axis=0), axis=1)
    usual = 1.4826 * float(np.median(apart))
    limit = _FAR_SIGMAS * max(usual, sigma if comparison.sigma_stated else 0.0)
    if count >= _FEWEST and bool((apart > limit).any()):
        names = np.array(comparison.name)[used][apart > limit]
        ledger.finding(
            "CONTROL-OUTLIER", where=where, count=names.size, total=count, most=apart.max(),
            median=np.median(apart), names=", ".join(names[:5]),
        )  # fmt: skip
    noise, of = usual, "the control points scatter"
    if comparison.sigma_stated:
        noise, of = sigma, "sigmas of stations and pixels let control points miss"
    if noise > effect:
        ledger.warning("CONTROL-NOISE", where=where, count=count, of=of, noise=noise, effect=effect)
    elif now**2 - was**2 > _WORSE * effect**2:
        ledger.finding("CONTROL-WORSE", where=where, count=count, was=was, now=now)
