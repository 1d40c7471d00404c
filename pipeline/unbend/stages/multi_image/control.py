"""Control points compared with where their rays meet, before and after the correction."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from unbend.block.image_rays import ImageRays, Orientations, sorted_rays
from unbend.block.intersection import point_heights
from unbend.config import Mission
from unbend.flight.heights import HeightSystem
from unbend.flight.stations import Stations
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef
from unbend.messages import Ledger, Message
from unbend.stages.correction import correct_batch
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.exposure_setup import orientations_of_mission
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.point_heights import points_above_sea
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.object_points import ObjectPoints, matching_rows
from unbend.tables.manifest.results import ControlPoint, ControlRecord
from unbend.tables.observations import Batch, Observations
from unbend.units import METRES_OF_A_FOOT, Array, Integers, Mask

BATCH_ROWS = 250_000
# Control is misread or wrong as a whole if its median distance from where its rays meet is larger
# than each of these three.
FAR_M = 1.0
FAR_SIGMAS = 5.0  # of that distance
FAR_EFFECTS = 3.0  # times as far as the correction moves the points
LIKELY_SHARE = 0.2  # of that distance: another reading is likely if it leaves less
OUTLIER_SIGMAS = 5.0  # beyond them a point is an outlier among the others
FEWEST_WITH_OUTLIERS = 5  # points: among fewer no outliers are looked for
ALLOWED_GROWTH = 0.25  # of squared residuals by the correction, in squares of its effect
NORMAL_OF_MEDIAN = 1.4826  # standard deviation over median absolute deviation
MOST_LISTED = 5  # outliers that a finding names


@dataclass(frozen=True, eq=False)
class ControlComparison:
    """Control points (p,) compared with the places where their rays meet.

    rays : (p,) how many rays each point has.
    before, after : (p, 3) place where the rays meet minus place of the control, to the east, north
        and up [m]: by the rays as measured and as corrected; NaN where they do not meet.
    sigma_m : (p,) standard deviation of the intersected height, by the sigmas of stations, pixels.
    sigma_stated : whether the sigmas of any station are known, not assumed.
    unmeasured : how many control points of the table are in no image.
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
        """(p,) which points have rays that meet, as measured and as corrected."""
        return np.asarray(np.isfinite(self.before + self.after).all(axis=1))

    def rms(self, values: Array) -> Array:
        """(3,) root mean squares of ``values`` (p, 3), over the points whose rays meet."""
        return np.asarray(np.sqrt(np.mean(values[self.used] ** 2, axis=0)))

    def part_explained(self) -> float:
        """The share of the mean square distance to the control that the correction removes.

        Negative if the distance grows.
        """
        before_m2 = float(np.sum(self.rms(self.before) ** 2))
        after_m2 = float(np.sum(self.rms(self.after) ** 2))
        return 1.0 - after_m2 / before_m2

    def record(self) -> ControlRecord:
        """The record for the manifest, in 0.1 mm; sigmas are None if they are not stated."""
        sigma_m = self.sigma_m
        if not self.sigma_stated:
            sigma_m = np.full(sigma_m.size, np.nan)
        points = []
        for row, name in enumerate(self.name):
            points.append(
                ControlPoint(
                    point=name,
                    rays=int(self.rays[row]),
                    before_m=rounded(self.before[row]),
                    after_m=rounded(self.after[row]),
                    sigma_u_m=rounded(sigma_m[row : row + 1])[0],
                )
            )
        median_m = np.nanmedian(self.sigma_m[self.used]) if self.sigma_stated else np.nan
        return ControlRecord(
            points=points,
            used=int(self.used.sum()),
            unmeasured=self.unmeasured,
            rms_before_m=rounded_known(self.rms(self.before)),
            rms_after_m=rounded_known(self.rms(self.after)),
            rms_refraction_m=rounded_known(self.rms(self.before - self.after)),
            mean_before_m=rounded_known(self.before[self.used].mean(axis=0)),
            mean_after_m=rounded_known(self.after[self.used].mean(axis=0)),
            part_explained=round(self.part_explained(), 4),
            sigma_u_m=rounded(np.atleast_1d(median_m))[0],
        )


def rounded_known(metres: Array) -> list[float]:
    """Lengths [m] rounded to 0.1 mm; for lengths without NaN."""
    return [round(value, 4) for value in metres.tolist()]


def rounded(metres: Array) -> list[float | None]:
    """Lengths [m] rounded to 0.1 mm, None for NaN."""
    numbers = []
    for value in metres.tolist():
        numbers.append(None if np.isnan(value) else round(value, 4))
    return numbers


@dataclass(frozen=True, eq=False)
class ControlRays:
    """Rays of control points, (n,) each.

    point : row of the control table.
    station : row of the stations, -1 without a station.
    before, after : (n, 3) directions in the camera, as measured and as corrected.
    """

    point: Integers
    station: Integers
    sigma_rad: Array
    before: Array
    after: Array

    @classmethod
    def joined(cls, parts: list["ControlRays"]) -> "ControlRays":
        """The rays of all ``parts``, in their order."""
        columns = []
        for field in fields(cls):
            columns.append(np.concatenate([getattr(part, field.name) for part in parts]))
        return cls(*columns)

    def usable(self) -> "ControlRays":
        """The rays that have a station and both directions."""
        has_directions = np.isfinite(self.before).all(axis=1) & np.isfinite(self.after).all(axis=1)
        rows = np.isfinite(self.sigma_rad) & has_directions & (self.station >= 0)
        return ControlRays(
            point=self.point[rows],
            station=self.station[rows],
            sigma_rad=self.sigma_rad[rows],
            before=self.before[rows],
            after=self.after[rows],
        )


def compare_control(
    mission: Mission,
    inputs: OpenedInputs,
    setup: CorrectionSetup,
    stations: Stations,
    heights: HeightSystem,
    ledger: Ledger,
) -> ControlComparison | None:
    """Compare control points with where their rays meet, before and after the correction.

    None for a mission without control. Refuses (CONTROL-MISSING) a table if none of its points is
    observed; a loss (CONTROL-RAYS), and None, if no rays meet. ``ledger`` gets what the comparison
    shows (`judge_control`).
    """
    section = mission.control
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
    all_rays = rays_of_control(inputs.observations, points, setup)
    # By all rays, because a point without usable rays counts as measured too.
    control = MeasuredControl.of(points, np.unique(all_rays.point), stations, heights)
    rays = all_rays.usable()
    point_number = np.searchsorted(control.row, rays.point)
    orientations = orientations_of_mission(mission, stations)
    meeting = meeting_points(rays, point_number, control.row.size, orientations)

    axes = enu_from_ecef(control.latitude_rad, control.longitude_rad)
    places = np.stack([meeting.before, meeting.after])  # (2, p, 3), earth-centred
    before, after = np.einsum("pij,kpj->kpi", axes, places - control.place())
    comparison = ControlComparison(
        name=tuple(points.name.take(pa.array(control.row)).to_pylist()),
        rays=np.bincount(point_number, minlength=control.row.size),
        before=before,
        after=after,
        sigma_m=meeting.sigma_m,
        sigma_stated=has_any_sigmas(stations, rays.station),
        unmeasured=len(points.name) - control.row.size,
    )
    if not comparison.used.any():
        ledger.add(messages.control_without_rays(where="control", count=control.row.size))
        return None
    readings = control.other_readings(section.reference, heights.home_h_msl_m)
    distance_by_reading = median_distances(readings, meeting.after, comparison.used)
    judge_control(comparison, distance_by_reading, ledger)
    return comparison


def has_any_sigmas(stations: Stations, row: Integers) -> bool:
    """Whether the sigmas of height and tilt are known for at least one station in ``row`` (n,)."""
    is_known = np.isfinite(stations.sigma_height_m) & np.isfinite(stations.sigma_tilt_rad)
    return bool(is_known[row].any())


def median_distances(readings: Mapping[str, Array], meeting: Array, used: Mask) -> dict[str, float]:
    """Median distance [m] from where rays meet to the control, for each reading of the control.

    readings : (p, 3) earth-centred places of the control, by the reading in words.
    meeting : (p, 3) earth-centred places where the rays meet.
    used : (p,) which points count.
    """
    distances = {}
    for words, place in readings.items():
        distance_m = np.linalg.norm(meeting - place, axis=1)
        distances[words] = float(np.median(distance_m[used]))
    return distances


@dataclass(frozen=True, eq=False)
class MeasuredControl:
    """Control points that are observed, (p,).

    row : their rows in the control table.
    h_m : height from the same zero as the heights of the stations in intersections: the ellipsoid
        if these are known above it, else sea level.
    undulation_m : of the geoid at the point.
    """

    row: Integers
    latitude_rad: Array
    longitude_rad: Array
    h_m: Array
    undulation_m: Array

    @classmethod
    def of(
        cls, points: ObjectPoints, row: Integers, stations: Stations, heights: HeightSystem
    ) -> "MeasuredControl":
        """The points in the rows ``row`` (p,) of ``points``, which has heights above sea level."""
        latitude = points.lat_rad[row]
        longitude = points.lon_rad[row]
        undulation = heights.undulation(latitude, longitude)
        above_ellipsoid = bool(np.isfinite(stations.h_ellipsoid_m).any())
        h_m = points.h_m[row] + (undulation if above_ellipsoid else 0.0)
        return cls(row, latitude, longitude, h_m, undulation)

    def place(self, h_m: Array | None = None) -> Array:
        """(p, 3) earth-centred places [m]; with other heights ``h_m`` (p,), if these are given."""
        height = self.h_m if h_m is None else h_m
        return ecef_of_geodetic(self.latitude_rad, self.longitude_rad, height)

    def other_readings(self, reference: str, home_h_msl_m: float | None) -> dict[str, Array]:
        """(p, 3) earth-centred places of the points if the table was misread, by mistake in words.

        ``reference`` is the zero of heights that the mission file states. The places by the height
        of the take-off ``home_h_msl_m`` are NaN if that is None, or 0, which changes nothing.
        """
        h_m = self.h_m
        undulation_m = self.undulation_m
        home_m = home_h_msl_m or np.nan
        # Numbers of the table. If they are feet, 0.3048 of each is right and 0.6952 are too much.
        stated_m = h_m if reference == "ellipsoid" else h_m - undulation_m
        too_high_in_feet_m = (1.0 - METRES_OF_A_FOOT) * stated_m
        below = self.place(h_m - undulation_m)
        above = self.place(h_m + undulation_m)
        above_takeoff = self.place(h_m + home_m)
        in_feet = self.place(h_m - too_high_in_feet_m)
        exchanged = ecef_of_geodetic(self.longitude_rad, self.latitude_rad, h_m)
        return {
            "heights above the ellipsoid read as heights above sea level": below,
            "heights above sea level read as heights above the ellipsoid": above,
            "heights above the take-off read as heights above sea level": above_takeoff,
            "heights in feet read as metres": in_feet,
            "latitude and longitude exchanged": exchanged,
        }


def rays_of_control(
    observations: Observations, points: ObjectPoints, setup: CorrectionSetup
) -> ControlRays:
    """The rays of all observations of control points, as measured and as corrected.

    Refuses (CONTROL-MISSING) control ``points`` if none is observed.
    """
    # Corrections without standard deviations, which are not needed here.
    setup = replace(setup, uncertainties=(None,) * len(setup.rays))
    images = pa.array(setup.images, pa.string())
    parts = []
    for batch in observations.batches(BATCH_ROWS):
        rows = np.flatnonzero(matching_rows(batch.point, points.name) >= 0)
        if rows.size:
            parts.append(rays_of_batch(batch.subset(rows), points, images, setup))
    if not parts:
        first = next(observations.batches(1)).point[0]
        raise messages.control_missing(
            where="control", total=len(points.name), name=str(points.name[0]), first=str(first)
        )
    return ControlRays.joined(parts)


def rays_of_batch(
    batch: Batch, points: ObjectPoints, images: pa.StringArray, setup: CorrectionSetup
) -> ControlRays:
    """The rays of a batch of observations of control points, as measured and as corrected.

    ``images`` are the names of the images of the stations, in the order of the stations.
    """
    station = matching_rows(batch.image, images)
    corrected = correct_batch(batch, station, setup.ground.heights(batch, station, setup), setup)
    before, sigma_rad = setup.directions(batch.x_px, batch.y_px, station)
    after, _ = setup.directions(corrected.x_corrected_px, corrected.y_corrected_px, station)
    point = matching_rows(batch.point, points.name)
    return ControlRays(point, station, sigma_rad, before, after)


class MeetingPoints(NamedTuple):
    """Where the rays of (p,) control points meet, as measured and as corrected.

    before, after : (p, 3) earth-centred places [m].
    sigma_m : (p,) standard deviation of the height of the corrected place.
    """

    before: Array
    after: Array
    sigma_m: Array


def meeting_points(
    rays: ControlRays, point_number: Integers, count: int, orientations: Orientations
) -> MeetingPoints:
    """Where the rays of ``count`` points meet, as measured and as corrected.

    ``point_number`` (n,) is the point of each ray, from 0. A point with too few rays, or with rays
    that are nearly parallel, is NaN. The place of any other point is the one nearest to its rays,
    even if these miss each other by far.
    """
    points = np.unique(point_number)
    sigma_m = np.full(count, np.nan)
    places = []
    for direction in (rays.before, rays.after):
        # The second pass, by the corrected rays, replaces the sigmas of the first.
        image_rays = ImageRays(rays.station, point_number, direction, rays.sigma_rad)
        by_point = sorted_rays(orientations, image_rays)
        nearest = by_point.positions(by_point.oriented) + by_point.origin
        heights = point_heights(orientations, image_rays)
        meets = ~(heights.few | heights.narrow)
        place = np.full((count, 3), np.nan)
        place[points[meets]] = nearest[meets]
        places.append(place)
        sigma_m[points] = heights.sigma_m
    before, after = places
    return MeetingPoints(before, after, sigma_m)


def judge_control(
    comparison: ControlComparison, distance_by_reading: Mapping[str, float], ledger: Ledger
) -> None:
    """Add to the ledger what control points show to be wrong.

    * One finding if the control is far from where its corrected rays meet, in the median.
    * Else a finding of outliers, and of a correction that takes rays away from the control.

    ``distance_by_reading`` is the median distance [m] from where the corrected rays meet to the
    control, for each other reading of the control.
    """
    used = comparison.used
    after = comparison.after[used]
    median_miss_m = float(np.median(np.linalg.norm(after, axis=1)))
    effect_m = length(comparison.rms(comparison.before - comparison.after))
    sigmas_m = comparison.sigma_m[used]
    sigmas_m = sigmas_m[np.isfinite(sigmas_m)]
    sigma_m = float(np.median(sigmas_m)) if sigmas_m.size else 0.0
    if median_miss_m > max(FAR_M, FAR_SIGMAS * sigma_m, FAR_EFFECTS * effect_m):
        ledger.add(far_control(int(used.sum()), median_miss_m, sigma_m, distance_by_reading))
        return
    deviation_m = np.linalg.norm(after - np.median(after, axis=0), axis=1)
    scatter_m = NORMAL_OF_MEDIAN * float(np.median(deviation_m))
    report_outliers(comparison, deviation_m, scatter_m, sigma_m, ledger)
    report_effect(comparison, scatter_m, sigma_m, effect_m, ledger)


def length(vector: Array) -> float:
    """The length of a vector."""
    return float(np.linalg.norm(vector))


def far_control(
    count: int, median_miss_m: float, sigma_m: float, distance_by_reading: Mapping[str, float]
) -> Message:
    """The finding of control that is ``median_miss_m`` from where its rays meet, which is far.

    It names the reading of the control with the smallest median distance [m], if that is less than
    a fifth of ``median_miss_m``; else the cause is unknown. ``sigma_m`` is the part that the sigmas
    of the stations explain.
    """
    likely = min(
        distance_by_reading,
        key=lambda reading: np.nan_to_num(distance_by_reading[reading], nan=np.inf),
    )
    distance_m = distance_by_reading[likely]
    if distance_m < LIKELY_SHARE * median_miss_m:
        return messages.control_reading(
            where="control", count=count, stated=median_miss_m, off=distance_m, likely=likely
        )
    return messages.control_far(where="control", count=count, stated=median_miss_m, sigma=sigma_m)


def report_outliers(
    comparison: ControlComparison,
    deviation_m: Array,
    scatter_m: float,
    sigma_m: float,
    ledger: Ledger,
) -> None:
    """Add a finding of control points with residuals far from the median residual.

    ``deviation_m`` is the distance of each used point's residual from the median residual,
    ``scatter_m`` its usual amount by these points, ``sigma_m`` by the sigmas of stations and
    pixels. No outliers are looked for among fewer than five points.
    """
    expected_m = max(scatter_m, sigma_m if comparison.sigma_stated else 0.0)
    is_outlier = deviation_m > OUTLIER_SIGMAS * expected_m
    if deviation_m.size < FEWEST_WITH_OUTLIERS or not bool(is_outlier.any()):
        return
    names = np.array(comparison.name)[comparison.used][is_outlier]
    ledger.add(
        messages.control_outlier(
            where="control",
            count=names.size,
            total=deviation_m.size,
            most=float(deviation_m.max()),
            median=float(np.median(deviation_m)),
            names=", ".join(names[:MOST_LISTED]),
        )
    )


def report_effect(
    comparison: ControlComparison,
    scatter_m: float,
    sigma_m: float,
    effect_m: float,
    ledger: Ledger,
) -> None:
    """Add a warning if control points are too noisy to show the effect of the correction.

    Otherwise add a finding if their residuals are clearly larger after the correction than before.
    ``effect_m`` is how far the correction moves points (rms). The noise is ``sigma_m``, by the
    sigmas of stations and pixels, if these are stated; else ``scatter_m``, that of the points.
    """
    count = int(comparison.used.sum())
    before_m = length(comparison.rms(comparison.before))
    after_m = length(comparison.rms(comparison.after))
    noise_m = scatter_m
    source = "the control points scatter"
    if comparison.sigma_stated:
        noise_m = sigma_m
        source = "the sigmas of stations and pixels move control points"
    if noise_m > effect_m:
        ledger.add(
            messages.control_noise(
                where="control", count=count, of=source, noise=noise_m, effect=effect_m
            )
        )
    elif after_m**2 - before_m**2 > ALLOWED_GROWTH * effect_m**2:
        ledger.add(messages.control_worse(where="control", count=count, was=before_m, now=after_m))
