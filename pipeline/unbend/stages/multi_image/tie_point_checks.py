"""Tie points compared with stations, cameras, mounts, times and heights of a mission."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from unbend.block.diagnosis import Finding, diagnosis
from unbend.block.given_heights import scatter_of
from unbend.block.image_rays import MINIMUM_ANGLE_RAD, ImageRays, Orientations, straightened
from unbend.block.intersection import Intersection, point_heights
from unbend.block.possible_mistakes import StatedMission
from unbend.config import Mission
from unbend.flight.heights import HeightSystem, ground_offsets
from unbend.flight.stations import Stations
from unbend.geodesy import geodetic_of_ecef
from unbend.messages import Ledger, Message
from unbend.refraction.camera.camera import Camera
from unbend.stages.exposure_setup import orientations_of_mission
from unbend.stages.multi_image import messages
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import METRES_OF_A_FOOT, Array, Mask, Names

FEWEST_TIE_POINTS = 10
TOO_MUCH_IN_FEET = 1.0 - METRES_OF_A_FOOT  # share of a number in feet, if it is taken for metres
# Residuals over their sigmas when all findings are corrected: beyond the first, the findings
# explain only a part of the residuals; beyond the second, they do not explain them.
PART_FACTOR = 1.5
POOR_FACTOR = 5.0
TERRAIN_FITS = 0.2  # of the points' relief: a smaller scatter about a model means that it fits
FLAT = 0.002  # of the flying height: a smaller scatter about a model is not judged
FAR_BETTER = 0.5  # of the scatter: less than this in another order is evidence for that order
PANE_RAD = 1e-4  # sigma for the refraction of a window, which is not removed from the rays
MOST_MEET = 0.5  # share of the points whose rays meet at least if nothing is wrong
SMALLEST_SHOWN_PX = 0.001  # a tenth of the best accuracy of a measured pixel
MOST_WORST_IMAGES = 3  # that a finding names

TO_CHANGE = {
    "TIES-HEIGHT": (
        "ground.height (its column or unit), ground.reference, mission.undulation_m, or the "
        "reference of the heights of the stations"
    ),
    "TIES-TIME": "delay_s under events, or the clock of the times",
    "TIES-FOCAL": "{}: fx_px and fy_px (f_px, params, metric.focal_mm)",
    "TIES-CALIBRATION": "{}: cx_px, cy_px, distortion (k1 ...; or params, file, metric)",
    "TIES-PIXELS": "{}: x_px, y_px",
    "TIES-CAMERAS": "image or channel of both cameras under events, or their names under cameras",
}
"""What to change, by the code of a finding; {} is its key. For other codes it is the key alone."""


@dataclass(frozen=True, eq=False)
class TieEvidence:
    """Tie points, and what they are compared with: stations, cameras and ground of a mission.

    stations : (s,) stations of all images.
    terrain : the elevation model; None without one.
    later : makes the stations of the same exposures, in the same rows, as if these had been some
        seconds later; None if the stations are not those of events.
    """

    mission: Mission
    heights: HeightSystem
    stations: Stations
    ties: TiePoints
    terrain: ElevationModel | None = None
    later: Callable[[float], Stations] | None = None

    @cached_property
    def offset_m(self) -> Array:
        """(s,) what to add to stated ground heights [m] to get heights above sea level."""
        reference = self.mission.ground.reference_of_values
        return ground_offsets(reference, self.stations, self.heights)

    @cached_property
    def undulation_m(self) -> Array:
        """(s,) undulation at the stations [m], ellipsoidal height minus height above sea level.

        0 if only one of these two heights of a station is known.
        """
        return np.nan_to_num(self.stations.h_ellipsoid_m - self.stations.h_msl_m)

    def orientations(self, seconds: float = 0.0) -> Orientations:
        """Position and attitude of the stations, as if the exposures were ``seconds`` later.

        Only stations that are ok have an orientation. Without `later` the ``seconds`` have no
        effect.
        """
        stations = self.stations if self.later is None else self.later(seconds)
        stations = stations.with_status(~self.stations.ok, "suspect")
        return orientations_of_mission(self.mission, stations)

    def rays(self, cameras: Mapping[str, Camera], axes: Mapping[str, str]) -> ImageRays:
        """The measured rays of tie points, with the stated ground heights above the ellipsoid.

        ``cameras`` are the interior orientations; ``axes`` gives, by camera, other axes of the
        pixels than stated, as for `tie_rays`. If no tie point has a height, all have the constant
        height of the mission, or NaN without one. Rays through a window have larger sigmas, because
        its refraction is not removed.
        """
        stations = self.stations
        sections = self.mission.cameras
        rays = tie_rays(self.ties, stations.image, stations.camera, cameras, axes)
        given_m = rays.height_m
        if given_m is None or np.isnan(given_m).all():
            given_m = np.full(rays.image.size, self.mission.ground.constant_m, np.float64)
        behind_pane = [bool(name and sections[name].pane) for name in stations.camera]
        pane_rad = PANE_RAD * np.array(behind_pane, np.bool_)
        return replace(
            rays,
            sigma_rad=np.hypot(rays.sigma_rad, pane_rad[rays.image]),
            height_m=given_m + (self.offset_m + self.undulation_m)[rays.image],
        )

    def pixel_rad(self, rays: ImageRays) -> float:
        """The angle of one pixel [rad] at the principal point: the median over ``rays``."""
        cameras = self.mission.interior_orientations
        names = self.stations.camera[rays.image]
        focal_px = np.array([cameras[name].fx_px for name in names])
        return float(1.0 / np.median(focal_px))

    def on_terrain(self, model: ElevationModel) -> tuple[TieEvidence, str]:
        """The evidence with heights of the elevation model as the ground heights of tie points.

        They are heights of the model where the rays of each point meet. Also returns in words
        whether the model fits better in another order (`model_in_other_order`). The refraction of
        the rays is removed for the heights at which they meet, not for stated heights.
        """
        orientations = self.orientations()
        rays = self.rays(self.mission.interior_orientations, {})
        straight_rays = straightened(orientations, replace(rays, height_m=None))
        points = point_heights(orientations, straight_rays)
        has_met = np.isfinite(points.h_m)  # of the distinct points, in the order of their numbers
        latitude, longitude, point_m = geodetic_of_ecef(*points.position_m[has_met].T)
        row, column = model.nodes(latitude, longitude)
        model_m = model.heights(row, column)
        ground_of_point = np.full(self.ties.point.max() + 1, np.nan)
        ground_of_point[np.unique(rays.point)[has_met]] = model_m
        ties = replace(self.ties, ground=ground_of_point[self.ties.point])
        station_m = self.stations.h_msl_m[self.stations.ok]
        reordered = model_in_other_order(
            model, row, column, point_m=point_m, model_m=model_m, station_m=station_m
        )
        return replace(self, ties=ties), reordered

    def other_heights_m(self, rays: ImageRays) -> dict[str, float]:
        """By how much stations are too low above the ground [m] if heights are misread.

        For each mistake in words. Positive if it makes the ground too high or the stations too low,
        else negative; NaN if unknown.
        """
        undulation_m = float(np.nanmedian(self.undulation_m))
        offset_m = float(np.nanmedian(self.offset_m))
        ground_m = np.nan
        if rays.height_m is not None and np.isfinite(rays.height_m).any():
            given_m = rays.height_m[np.isfinite(rays.height_m)]
            ground_m = float(np.median(given_m)) - undulation_m - offset_m
        station_m = float(np.nanmedian(self.stations.h_msl_m[self.stations.ok]))
        home_m = (
            self.heights.home_h_msl_m or 0.0
        )  # 0 if unknown: that mistake explains nothing then
        return {
            "heights above the ellipsoid were read as heights above sea level": -undulation_m,
            "heights above sea level were read as heights above the ellipsoid": undulation_m,
            "heights above sea level were read as heights above the take-off": offset_m,
            "heights of the ground in feet were read as metres": TOO_MUCH_IN_FEET * ground_m,
            "heights of the stations in feet were read as metres": -TOO_MUCH_IN_FEET * station_m,
            "heights above the take-off were read as heights above sea level": -home_m,
        }


def model_in_other_order(
    model: ElevationModel,
    row: Array,
    column: Array,
    *,
    point_m: Array,
    model_m: Array,
    station_m: Array,
) -> str:
    """How much better a model fits points with its rows or columns reversed or exchanged, in words.

    ``point_m`` (n,) are heights of the points in the cells ``row``, ``column`` (n,), ``model_m``
    (n,) those of the model there, ``station_m`` (s,) those of the stations. Empty if the model fits
    as it is, if it is off by too little to judge, or if no other order fits far better.
    """
    scatter_m = scatter_of(model_m - point_m)
    if not np.isfinite(scatter_m) or scatter_m <= TERRAIN_FITS * scatter_of(point_m):
        return ""
    above_ground_m = np.nanmedian(station_m - np.nanmedian(model_m))
    if scatter_m <= FLAT * above_ground_m:
        return ""
    cell = np.array([row, column])
    size = np.array(model.size)[:, None]
    best_m = np.inf
    orders = list(product((False, True), repeat=3))  # exchanged, rows reversed, columns reversed
    for is_exchanged, *is_reversed in orders[1:]:  # the first, all False, is the stated order
        other_cell = cell[::-1] if is_exchanged else cell
        other_cell = np.where(np.array(is_reversed)[:, None], size - 1 - other_cell, other_cell)
        best_m = min(best_m, scatter_of(model.heights(*other_cell) - point_m))
    if best_m >= FAR_BETTER * scatter_m:
        return ""
    return (
        f"the elevation model is wrong by {scatter_m:.0f} m or more at a tenth of the points, and "
        f"by {best_m:.0f} m with its rows or columns reversed or exchanged"
    )


def check_tie_points(evidence: TieEvidence, ledger: Ledger) -> None:
    """Add a finding for each part of the mission file that tie points contradict.

    Only if these findings together explain how far the rays miss each other. Else `report_misses`
    adds one finding of how far the rays miss, which lists them as partial explanations. Nothing is
    checked with fewer than ten tie points in usable images.
    """
    cameras = evidence.mission.interior_orientations
    stations = evidence.stations
    rays = evidence.rays(cameras, {})
    usable_points = np.unique(rays.point[stations.ok[rays.image]])
    if usable_points.size < FEWEST_TIE_POINTS:
        return
    reordered = ""  # in which other order of rows and columns the elevation model fits, in words
    if evidence.terrain is not None:
        evidence, reordered = evidence.on_terrain(evidence.terrain)
        rays = evidence.rays(cameras, {})  # the same, with the heights of the model
    intersection, findings = diagnosis(stated_mission(evidence, rays))
    if reordered and not any(finding.code == "TIES-HEIGHT" for finding in findings):
        of_model = Finding(
            code="TIES-HEIGHT",
            key="ground.height.dem",
            what=reordered,
            log_ratio=np.inf,
            sigma_factor=intersection.sigma_factor,
        )
        findings = (*findings, of_model)
    # The factor of each finding is that after correcting it and all before; of the last, after all.
    is_explained = bool(findings) and findings[-1].sigma_factor < POOR_FACTOR
    if is_explained:
        remaining = findings[-1].sigma_factor
        count = intersection.point.size
        for finding in findings:
            ledger.add(message_with_change(evidence.mission, finding, remaining, count=count))
    explanations = "; ".join(f"{mistake_in_words(finding)} ({finding.key})" for finding in findings)
    report_misses(
        stations,
        intersection,
        rays,
        ledger,
        pixel_rad=evidence.pixel_rad(rays),
        oriented=evidence.mission.stations.orientation is not None,
        explained=is_explained,
        explanations=explanations,
    )


def stated_mission(evidence: TieEvidence, rays: ImageRays) -> StatedMission:
    """What the mission file states, as far as tie points can contradict it.

    Without mounts, if a table gives the attitudes of the cameras themselves.
    """
    mission = evidence.mission
    orientation = mission.stations.orientation
    has_mounts = orientation is None or orientation.angles == "roll_pitch_yaw"
    later = None
    if evidence.later is not None:
        later = lru_cache(8)(evidence.orientations)  # the same few delays are asked for again
    return StatedMission(
        orientations=evidence.orientations(),
        cameras=mission.interior_orientations,
        rays=evidence.rays,
        mounts=mission.mounts if has_mounts else {},
        shifted=later,
        sigma_heights_m=mission.ground.sigma_m or 0.0,
        other_heights_m=evidence.other_heights_m(rays),
        one_height=mission.ground.constant_m is not None,
    )


def message_with_change(
    mission: Mission, finding: Finding, sigma_factor: float, *, count: int
) -> Message:
    """The message of a finding by ``count`` tie points, with what to change.

    ``sigma_factor`` : residuals over their sigmas when all findings are corrected. The message
    first names another flight as the cause, if `is_of_another_flight`.
    """
    change = what_to_change(mission, finding)
    if is_of_another_flight(finding, sigma_factor):
        finding, change = of_another_flight(mission, finding, change)
    return messages.ties_contradict(
        code=finding.code,
        where=finding.key,
        count=count,
        mistake=mistake_in_words(finding),
        decades=float(finding.log_ratio / np.log(10.0)),
        change=change,
        residual=float(sigma_factor) if sigma_factor > PART_FACTOR else None,
    )


def what_to_change(mission: Mission, finding: Finding) -> str:
    """What to change for a finding: keys of the mission file, or columns of the observations."""
    if finding.code == "TIES-PIXELS" and finding.label == "upward":
        axes = " and ".join(flipped_axes(mission, finding.cameras))
        has_pixels = mission.observations.unit == "px"
        return f"{axes} in the table of observations" if has_pixels else axes
    return TO_CHANGE.get(finding.code, "{}").format(finding.key)


def is_of_another_flight(finding: Finding, sigma_factor: float) -> bool:
    """Whether the stations are likely of another flight than the observations.

    They are if heights differ by more than datums do, and the rays do not meet well even after the
    correction of all findings (``sigma_factor``: residuals over their sigmas then).
    """
    return finding.beyond_datums and sigma_factor > PART_FACTOR


def of_another_flight(mission: Mission, finding: Finding, change: str) -> tuple[Finding, str]:
    """The finding and what to ``change``, in words, with another flight as the first cause."""
    key = "log.path"
    if mission.stations.trajectory is not None:
        key = "stations.trajectory.path"
    if mission.stations.orientation is not None:
        key = "stations.orientation.path"
    paths = f"{key} or observations.path"
    what = f"{paths} may be of another flight: {finding.what}"
    return replace(finding, what=what), f"{paths}; if both are of this flight, {change}"


def flipped_axes(mission: Mission, cameras: Sequence[str]) -> list[str]:
    """How to turn the y axis of the coordinates of ``cameras`` to the other direction, in words.

    For coordinates in millimetres it is a key. For pixels, which have no such key, it is a formula
    for the column of y, for each height of images.
    """
    section = mission.observations
    if section.unit != "px":
        return [f"cameras.{name}.metric.axes" for name in cameras]
    cameras_of_height: dict[int, list[str]] = {}
    for name in cameras:
        height_px = mission.interior_orientations[name].height_px
        cameras_of_height.setdefault(height_px, []).append(name)
    column = section.columns.y_px
    changes = []
    for height_px, names in cameras_of_height.items():
        # If the centre of the first pixel is 0, that of the last is the count of pixels less 1.
        largest_px = height_px - 1 if section.pixel_origin == "centre" else height_px
        changes.append(f"{column} of {', '.join(names)} to {largest_px} - {column}")
    return changes


def mistake_in_words(finding: Finding) -> str:
    """The mistake of a finding, and other mistakes that explain the tie points equally well."""
    mistakes = "; or ".join((finding.what, *finding.also))
    if finding.also:
        return f"equally likely by the tie points: {mistakes}"
    return mistakes


def report_misses(
    stations: Stations,
    intersection: Intersection,
    rays: ImageRays,
    ledger: Ledger,
    *,
    pixel_rad: float,
    oriented: bool,
    explained: bool,
    explanations: str,
) -> None:
    """Add to the ledger how far the rays of tie points miss each other.

    A note if other findings have ``explained`` the misses, or if the rays meet and there are no
    ``explanations``; else a finding, with the worst cameras and images.

    pixel_rad : the angle of one pixel.
    oriented : the stations are those of a table of orientations.
    explanations : mistakes that explain a part of the misses, in words; empty without any.
    """
    point_of_ray = np.searchsorted(intersection.point, rays.point)
    miss_rad = np.sqrt(np.mean(intersection.residual_rad**2, axis=1))
    # A point is judged if it has a place, if its rays cross at a sufficient angle for a place, or
    # if some of its rays contradict the others.
    is_judged = intersection.used | (intersection.angle_rad >= MINIMUM_ANGLE_RAD)
    is_judged[point_of_ray[intersection.bad]] = True
    where = "stations.orientation.path" if oriented else "stations"
    count = intersection.point.size
    misses = describe_misses(intersection, miss_rad, pixel_rad)
    most_meet = intersection.used.sum() >= MOST_MEET * is_judged.sum()
    is_poor = intersection.sigma_factor > POOR_FACTOR  # False for NaN: nothing checks the rays
    rays_meet = most_meet and not is_poor
    if explained or (rays_meet and not explanations):
        ledger.add(messages.ties_miss(oriented=oriented, where=where, count=count, misses=misses))
        return
    line_m = intersection.position_m[point_of_ray] - intersection.orientations.centre_m[rays.image]
    rays_missed = RaysMissed(
        camera=stations.camera[rays.image],
        is_judged=is_judged[point_of_ray],
        is_lost=(intersection.bad | np.isnan(miss_rad)) & is_judged[point_of_ray],
        miss_rad=miss_rad,
        distance_m=np.linalg.norm(line_m, axis=1),
    )
    misses += rays_missed.by_camera()
    worst = worst_images(stations, rays, rays_missed.is_lost)
    if worst:
        misses += f"; most of {', '.join(worst)}"
    ledger.add(
        messages.ties_do_not_meet(
            oriented=oriented, where=where, count=count, misses=misses, nearest=explanations
        )
    )


@dataclass(frozen=True, eq=False)
class RaysMissed:
    """Rays of tie points, (r,) each, and how far they miss the other rays of their points.

    is_judged : the point of the ray has a place, or would have one if its rays met.
    is_lost : the ray is of a judged point, but meets no other ray of this point.
    miss_rad : distance from the point in the image, rms of x and y; NaN without a place.
    distance_m : from the camera to the point.
    """

    camera: Names
    is_judged: Mask
    is_lost: Mask
    miss_rad: Array
    distance_m: Array

    def by_camera(self) -> str:
        """How many rays of each camera are lost, and how far the others miss, in words."""
        text = ""
        for camera in sorted(set(self.camera.tolist())):
            of_camera = self.camera == camera
            lost = self.is_lost[of_camera].sum()
            text += f"; {camera}: {lost} of {of_camera.sum()} rays intersect no other ray"
            met = of_camera & ~self.is_lost & self.is_judged
            if met.any():
                metres = np.median(self.miss_rad[met] * self.distance_m[met])
                degrees = np.degrees(np.median(self.miss_rad[met]))
                text += (
                    f", the others miss each other by {degrees:.2g} deg, {metres:.2g} m, in the "
                    "median"
                )
        return text


def describe_misses(intersection: Intersection, miss_rad: Array, pixel_rad: float) -> str:
    """How far the rays of tie points miss each other, in words.

    ``miss_rad`` (r,) is how far each ray misses its point, ``pixel_rad`` the angle of one pixel.
    """
    points = int(intersection.used.sum())
    count = intersection.point.size
    if not points:
        return (
            f"no rays of {count} tie points intersect at an angle that is large enough for a check"
        )
    if np.isnan(miss_rad).all():
        return f"the rays of {points} of {count} tie points do not intersect"
    pixels = np.sqrt(np.nanmean(miss_rad**2)) / pixel_rad
    return (
        f"the rays of {points} of {count} tie points miss each other by {in_pixels(pixels)} (rms). "
        "The orientations are not adjusted. For this check alone, the refraction of us1976 is "
        "removed from the rays, that of windows is not"
    )


def in_pixels(pixels: float) -> str:
    """A distance in the image in words, with two digits below 1 px.

    >>> in_pixels(0.0314), in_pixels(12.34), in_pixels(0.0)
    ('0.031 px', '12.3 px', 'less than 0.001 px')
    """
    if pixels < SMALLEST_SHOWN_PX:
        return f"less than {SMALLEST_SHOWN_PX} px"
    if pixels < 1.0:
        return f"{pixels:.2g} px"
    return f"{pixels:.1f} px"


def worst_images(stations: Stations, rays: ImageRays, lost: Mask) -> list[str]:
    """The three images with the largest share of lost rays, the worst first; none without any.

    ``lost`` (r,) is True for rays that meet no other ray of their point.
    """
    ray_count = np.bincount(rays.image, minlength=stations.image.size)
    lost_count = np.bincount(rays.image[lost], minlength=ray_count.size)
    share = lost_count / np.maximum(ray_count, 1)
    worst = np.argsort(-share, kind="stable")[:MOST_WORST_IMAGES]
    return [str(stations.image[row]) for row in worst if share[row] > 0]
