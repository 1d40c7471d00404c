"""The user's own tie points against stations, cameras, mounts, times and heights of a mission."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from unbend.block.diagnosis import Finding, StatedMission, diagnosis, scatter_of
from unbend.block.image_rays import MINIMUM_ANGLE_RAD, ImageRays, Orientations, straightened
from unbend.block.intersection import Intersection, point_heights
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
from unbend.units import Array, Mask

FEWEST_TIE_POINTS = 10
FEET_IN_METRES_TOO_MUCH = 1.0 - 0.3048  # of heights in feet that were taken for metres
PART_FACTOR = 1.5  # residuals over sigmas, after findings that explain them in part
POOR_FACTOR = 5.0  # and where they do not explain them
TERRAIN_FITS = 0.2  # of the relief: the scatter about a model that belongs to the points
FLAT = 0.002  # of the flying height: the scatter that is judged at all
FAR_BETTER = 0.5  # of the scatter: a model reversed that fits so much better
PANE_RAD = 1e-4  # what a window bends, which stays in the rays

TO_CHANGE = {
    "TIES-HEIGHT": "ground.height (its column or unit), ground.reference, mission.undulation_m, or "
    "what the heights of the stations count from",
    "TIES-TIME": "delay_s under events, or the clock that the times are of",
    "TIES-FOCAL": "{}: fx_px and fy_px (f_px, params, metric.focal_mm)",
    "TIES-CALIBRATION": "{}: cx_px, cy_px, distortion (k1 ...; or params, file, metric)",
    "TIES-PIXELS": "{}: x_px, y_px",
    "TIES-CAMERAS": "image or channel of both under events, or their names under cameras",
}
"""What to change by the code of a finding; its key for others."""


@dataclass(frozen=True, eq=False)
class TieEvidence:
    """Tie points beside the stations of a mission, and the heights that it gives them.

    ``later`` gives the stations that many seconds later, where they are those of events.
    """

    mission: Mission
    heights: HeightSystem
    stations: Stations
    ties: TiePoints
    terrain: ElevationModel | None = None
    later: Callable[[float], Stations] | None = None

    @cached_property
    def offset_m(self) -> Array:
        """(s,) what has to be added to ground heights for those above sea level [m]."""
        reference = self.mission.ground.reference_of_values
        return ground_offsets(reference, self.stations, self.heights)

    @cached_property
    def undulation_m(self) -> Array:
        """(s,) of the stations [m], 0 where only one of their heights is known."""
        return np.nan_to_num(self.stations.h_ellipsoid_m - self.stations.h_msl_m)

    def orientations(self, seconds: float = 0.0) -> Orientations:
        """Of the stations, or of those that many seconds later."""
        at = self.stations if self.later is None else self.later(seconds)
        at = at.with_status(~self.stations.ok, "suspect")
        return orientations_of_mission(self.mission, at)

    def rays(self, cameras: Mapping[str, Camera], axes: Mapping[str, str]) -> ImageRays:
        """The apparent rays, with given heights of their points above the ellipsoid."""
        stations = self.stations
        sections = self.mission.cameras
        rays = tie_rays(self.ties, stations.image, stations.camera, cameras, axes)
        given_m = rays.height_m
        if given_m is None or np.isnan(given_m).all():
            given_m = np.full(rays.image.size, self.mission.ground.constant_m, np.float64)
        behind_pane = [bool(name and sections[name].window) for name in stations.camera]
        pane_rad = PANE_RAD * np.array(behind_pane, np.bool_)
        return replace(
            rays,
            sigma_rad=np.hypot(rays.sigma_rad, pane_rad[rays.image]),
            height_m=given_m + (self.offset_m + self.undulation_m)[rays.image],
        )

    def on_terrain(self) -> tuple[TieEvidence, str]:
        """With heights of the elevation model where rays meet; and whether another order fits."""
        if self.terrain is None:
            return self, ""
        model = self.terrain
        orientations = self.orientations()
        rays = self.rays(self.mission.interior_orientations, {})
        found = point_heights(
            orientations, straightened(orientations, replace(rays, height_m=None))
        )
        met = np.isfinite(found.h_m)
        latitude, longitude, h_m = geodetic_of_ecef(*found.position_m[met].T)
        row, column = model.nodes(latitude, longitude)
        height_m = model.heights(row, column)
        ground_m = np.full(self.ties.point.max() + 1, np.nan)
        ground_m[np.unique(rays.point)[met]] = height_m
        ties = replace(self.ties, ground=ground_m[self.ties.point])
        station_m = self.stations.h_msl_m[self.stations.ok]
        reordered = model_in_other_order(model, row, column, h_m, height_m, station_m)
        return replace(self, ties=ties), reordered

    def other_heights_m(self, rays: ImageRays) -> dict[str, float]:
        """What stations lie too low by, if heights are not what the mission file says."""
        undulation = float(np.nanmedian(self.undulation_m))
        offset = float(np.nanmedian(self.offset_m))
        known = np.zeros(0) if rays.height_m is None else rays.height_m
        known = known[np.isfinite(known)]
        ground = np.nan
        if known.size:
            ground = float(np.median(known)) - undulation - offset
        station = float(np.nanmedian(self.stations.h_msl_m[self.stations.ok]))
        home = self.heights.home_h_msl_m or 0.0
        too_much = FEET_IN_METRES_TOO_MUCH
        return {
            "heights above the ellipsoid were taken for those above sea level": -undulation,
            "heights above sea level were taken for those above the ellipsoid": undulation,
            "heights above sea level were taken for those above the take-off": offset,
            "heights of the ground in feet were taken for metres": too_much * ground,
            "heights of the stations in feet were taken for metres": -too_much * station,
            "heights above the take-off were taken for those above sea level": -home,
        }


def model_in_other_order(
    model: ElevationModel, row: Array, column: Array, h_m: Array, height_m: Array, station_m: Array
) -> str:
    """Whether a model fits points far better with its rows or columns reversed or exchanged.

    Heights ``h_m`` of points in cells (row, column), those of the model there, and those of the
    stations. Empty where it fits as it is.
    """
    left_m = scatter_of(height_m - h_m)
    if not np.isfinite(left_m) or left_m <= TERRAIN_FITS * scatter_of(h_m):
        return ""
    above_m = np.nanmedian(station_m - np.nanmedian(height_m))
    if left_m <= FLAT * above_m:
        return ""
    size = np.array(model.size)[:, None]
    others = []
    for exchanged, *reverse in list(product((False, True), repeat=3))[1:]:
        at = np.array([column, row] if exchanged else [row, column])
        at = np.where(np.array(reverse)[:, None], size - 1 - at, at)
        others.append(scatter_of(model.heights(*at) - h_m))
    if min(others) >= FAR_BETTER * left_m:
        return ""
    return (
        f"the elevation model is off by {left_m:.0f} m or more at a tenth of the points, and "
        f"by {min(others):.0f} m with its rows or columns reversed or exchanged"
    )


def check_tie_points(evidence: TieEvidence, ledger: Ledger) -> None:
    """A finding for each part of the mission file that tie points contradict, with its estimate.

    Where none explains what the rays miss each other by, one finding lists what comes nearest.
    """
    mission = evidence.mission
    stations = evidence.stations
    cameras = mission.interior_orientations
    rays = evidence.rays(cameras, {})
    if np.unique(rays.point[stations.ok[rays.image]]).size < FEWEST_TIE_POINTS:
        return
    evidence, reordered = evidence.on_terrain()
    rays = evidence.rays(cameras, {})
    stated, findings = diagnosis(stated_mission(evidence, rays))
    if reordered and not any(found.code == "TIES-HEIGHT" for found in findings):
        key = "ground.height.dem"
        of_model = Finding("TIES-HEIGHT", key, reordered, np.inf, stated.sigma_factor)
        findings = (*findings, of_model)
    explained = bool(findings) and findings[-1].sigma_factor < POOR_FACTOR
    if explained:
        left = findings[-1].sigma_factor
        for found in findings:
            ledger.add(message_of_finding(found, left, count=stated.point.size))
    nearest = "; ".join(f"{described(found)} ({found.key})" for found in findings)
    report_misses(
        stations,
        stated,
        rays,
        ledger,
        oriented=mission.stations.orientation is not None,
        explained=explained,
        nearest=nearest,
    )


def stated_mission(evidence: TieEvidence, rays: ImageRays) -> StatedMission:
    """What the mission file states of all that tie points may contradict."""
    mission = evidence.mission
    oriented = mission.stations.orientation
    turned_by_mounts = oriented is None or oriented.angles == "roll_pitch_yaw"
    later = None if evidence.later is None else lru_cache(8)(evidence.orientations)
    return StatedMission(
        evidence.orientations(),
        mission.interior_orientations,
        evidence.rays,
        mission.mounts if turned_by_mounts else {},
        later,
        sigma_heights_m=mission.ground.sigma_m or 0.0,
        other_heights_m=evidence.other_heights_m(rays),
        one_height=mission.ground.constant_m is not None,
    )


def message_of_finding(found: Finding, sigma_factor: float, *, count: int) -> Message:
    """The message of what tie points contradict; ``sigma_factor`` is left after all findings."""
    change = TO_CHANGE.get(found.code, "{}").format(found.key)
    return messages.ties_contradict(
        code=found.code,
        where=found.key,
        count=count,
        mistake=described(found),
        decades=float(found.log_ratio / np.log(10.0)),
        change=change,
        residual=float(sigma_factor) if sigma_factor > PART_FACTOR else None,
    )


def described(finding: Finding) -> str:
    """The mistake that is found, and others that tie points do not separate from it."""
    mistakes = "; or ".join((finding.what, *finding.also))
    if finding.also:
        return f"equally likely by the tie points: {mistakes}"
    return mistakes


def report_misses(
    stations: Stations,
    stated: Intersection,
    rays: ImageRays,
    ledger: Ledger,
    *,
    oriented: bool,
    explained: bool,
    nearest: str,
) -> None:
    """How far rays of tie points miss each other; ``nearest`` would explain a part of it."""
    at = np.searchsorted(stated.point, rays.point)
    miss_rad = np.sqrt(np.mean(stated.residual_rad**2, axis=1))
    # A point whose rays are all but parallel has no place of its own.
    judged = stated.used | (stated.angle_rad >= MINIMUM_ANGLE_RAD)
    judged[at[stated.bad]] = True
    where = "stations.orientation.path" if oriented else "stations"
    count = stated.point.size
    misses = describe_misses(stated, rays, miss_rad)
    meets = stated.used.sum() >= 0.5 * judged.sum() and not stated.sigma_factor > POOR_FACTOR
    if explained or (meets and not nearest):
        ledger.add(messages.ties_miss(oriented=oriented, where=where, count=count, misses=misses))
        return
    lost = (stated.bad | np.isnan(miss_rad)) & judged[at]
    line_m = stated.position_m[at] - stated.orientations.centre_m[rays.image]
    distance_m = np.linalg.norm(line_m, axis=1)
    for camera in sorted(set(stations.camera[rays.image].tolist())):
        of_camera = stations.camera[rays.image] == camera
        met = of_camera & ~lost & judged[at]
        misses += f"; {camera}: {lost[of_camera].sum()} of {of_camera.sum()} rays meet no other"
        if met.any():
            metres = np.median(miss_rad[met] * distance_m[met])
            degrees = np.degrees(np.median(miss_rad[met]))
            misses += f", the others miss by {degrees:.2g} deg, {metres:.2g} m, in the median"
    worst = worst_images(stations, rays, lost)
    if worst:
        misses += f"; most of {', '.join(worst)}"
    ledger.add(
        messages.ties_do_not_meet(
            oriented=oriented, where=where, count=count, misses=misses, nearest=nearest
        )
    )


def describe_misses(stated: Intersection, rays: ImageRays, miss_rad: Array) -> str:
    """How far the rays of tie points miss each other, in words."""
    points = int(stated.used.sum())
    count = stated.point.size
    if not points:
        return f"no rays of {count} tie points meet at an angle that checks anything"
    if np.isnan(miss_rad).all():
        return f"the rays of {points} of {count} tie points meet nowhere"
    pixels = np.sqrt(np.nanmean(miss_rad**2)) / float(np.median(rays.sigma_rad))
    return (
        f"the rays of {points} of {count} tie points miss each other by {pixels:.1f} px "
        "(rms) before adjustment, without the refraction of us1976, with that of windows"
    )


def worst_images(stations: Stations, rays: ImageRays, lost: Mask) -> list[str]:
    """At most three images whose rays meet no others, the worst first."""
    seen = np.bincount(rays.image, minlength=stations.image.size)
    share = np.bincount(rays.image[lost], minlength=seen.size) / np.maximum(seen, 1)
    worst = np.argsort(-share, kind="stable")[:3]
    return [str(stations.image[row]) for row in worst if share[row] > 0]
