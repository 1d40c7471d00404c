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
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.stages.exposure_setup import orientations_of_mission
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import Array

FEWEST_TIE_POINTS = 10
_FEET = 1.0 - 0.3048
# Residuals over what the stations' sigmas say, after findings that explain them in part, or not.
_PART_FACTOR, _POOR_FACTOR = 1.5, 5.0
_TO_CHANGE = {
    "TIES-HEIGHT": "ground.height (its column or unit), ground.reference, mission.undulation_m, or "
    "what the heights of the stations count from",
    "TIES-TIME": "delay_s under events, or the clock that the times are of",
    "TIES-FOCAL": "{}: fx_px and fy_px (f_px, params, metric.focal_mm)",
    "TIES-CALIBRATION": "{}: cx_px, cy_px, distortion (k1 ...; or params, file, metric)",
    "TIES-PIXELS": "{}: x_px, y_px",
    "TIES-CAMERAS": "image or channel of both under events, or their names under cameras",
}
_OF_RELIEF, _FLAT = 0.2, 0.002  # what a model leaves of it, and at least of the flying height
_PANE_RAD = 1e-4  # what a window bends, which stays in the rays
_MISSES = (
    ": the orientations are not what they should be (rows of other images or cameras, another "
    "convention, log.path of another flight), or the name of a point is not that of one point in "
    "all images"
)


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
    def offset(self) -> Array:
        """(s,) what has to be added to ground heights for those above sea level [m]."""
        reference = self.mission.ground.reference_of_values
        return ground_offsets(reference, self.stations, self.heights)

    @cached_property
    def undulation(self) -> Array:
        """(s,) of the stations [m], 0 where only one of their heights is known."""
        return np.nan_to_num(self.stations.h_ellipsoid_m - self.stations.h_msl_m)

    def orientations(self, seconds: float = 0.0) -> Orientations:
        """Of the stations, or of those that many seconds later."""
        at = self.stations if self.later is None else self.later(seconds)
        at = at.with_status(~self.stations.ok, "suspect")
        return orientations_of_mission(self.mission, at)

    def rays(self, cameras: Mapping[str, Camera], axes: Mapping[str, str]) -> ImageRays:
        """The apparent rays, with given heights of their points above the ellipsoid."""
        stations, sections = self.stations, self.mission.cameras
        rays = tie_rays(self.ties, stations.image, stations.camera, cameras, axes)
        given, constant = rays.height_m, self.mission.ground.constant_m
        if given is None or np.isnan(given).all():
            given = np.full(rays.image.size, constant, np.float64)
        pane = np.array([bool(n and sections[n].window) for n in stations.camera], np.bool_)
        sigma = np.hypot(rays.sigma_rad, _PANE_RAD * pane[rays.image])
        given = given + (self.offset + self.undulation)[rays.image]
        return replace(rays, sigma_rad=sigma, height_m=given)

    def on_terrain(self) -> tuple[TieEvidence, str]:
        """With heights of the elevation model where rays meet; and whether another order fits."""
        if self.terrain is None:
            return self, ""
        o, model = self.orientations(), self.terrain
        rays = self.rays(self.mission.interior_orientations, {})
        found = point_heights(o, straightened(o, replace(rays, height_m=None)))
        met = np.isfinite(found.h_m)
        lat, lon, h_m = geodetic_of_ecef(*found.position_m[met].T)
        row, column = model.nodes(lat, lon)
        ground = np.full(self.ties.point.max() + 1, np.nan)
        ground[np.unique(rays.point)[met]] = height = model.heights(row, column)
        evidence = replace(self, ties=replace(self.ties, ground=ground[self.ties.point]))
        left, high = scatter_of(height - h_m), self.stations.h_msl_m[self.stations.ok]
        if not np.isfinite(left) or left <= _OF_RELIEF * scatter_of(h_m):
            return evidence, ""
        if left <= _FLAT * np.nanmedian(high - np.nanmedian(height)):
            return evidence, ""
        others, size = [], np.array(model.size)[:, None]
        for exchanged, *reverse in list(product((False, True), repeat=3))[1:]:
            at = np.array([column, row] if exchanged else [row, column])
            at = np.where(np.array(reverse)[:, None], size - 1 - at, at)
            others.append(scatter_of(model.heights(*at) - h_m))
        if min(others) >= 0.5 * left:
            return evidence, ""
        what = f"the elevation model is off by {left:.0f} m or more at a tenth of the points, and "
        what += f"by {min(others):.0f} m with its rows or columns reversed or exchanged"
        return evidence, what

    def other_heights_m(self, rays: ImageRays) -> dict[str, float]:
        """What stations lie too low by, if heights are not what the mission file says."""
        undulation, offset = float(np.nanmedian(self.undulation)), float(np.nanmedian(self.offset))
        known = np.zeros(0) if rays.height_m is None else rays.height_m
        known = known[np.isfinite(known)]
        ground = float(np.median(known)) - undulation - offset if known.size else np.nan
        high = float(np.nanmedian(self.stations.h_msl_m[self.stations.ok]))
        home = self.heights.home_h_msl_m or 0.0
        return {
            "heights above the ellipsoid were taken for those above sea level": -undulation,
            "heights above sea level were taken for those above the ellipsoid": undulation,
            "heights above sea level were taken for those above the take-off": offset,
            "heights of the ground in feet were taken for metres": _FEET * ground,
            "heights of the stations in feet were taken for metres": -_FEET * high,
            "heights above the take-off were taken for those above sea level": -home,
        }


def check_tie_points(evidence: TieEvidence, ledger: Ledger) -> None:
    """A finding for each part of the mission file that tie points contradict, with its estimate.

    Where none explains what the rays miss each other by, one finding lists what comes nearest.
    """
    mission, stations = evidence.mission, evidence.stations
    cameras, oriented = mission.interior_orientations, mission.stations.orientation
    rays = evidence.rays(cameras, {})
    if np.unique(rays.point[stations.ok[rays.image]]).size < FEWEST_TIE_POINTS:
        return
    evidence, reordered = evidence.on_terrain()
    rays = evidence.rays(cameras, {})
    of_body = oriented is None or oriented.angles == "roll_pitch_yaw"
    mounts = mission.mounts if of_body else {}
    shifted = None if evidence.later is None else lru_cache(8)(evidence.orientations)
    stated, findings = diagnosis(StatedMission(
        evidence.orientations(), cameras, evidence.rays, mounts, shifted,
        sigma_heights_m=mission.ground.sigma_m or 0.0,
        other_heights_m=evidence.other_heights_m(rays),
        one_height=mission.ground.constant_m is not None,
    ))  # fmt: skip
    if reordered and not any(finding.code == "TIES-HEIGHT" for finding in findings):
        factor = stated.sigma_factor
        findings += (Finding("TIES-HEIGHT", "ground.height.dem", reordered, np.inf, factor),)
    explained = bool(findings) and findings[-1].sigma_factor < _POOR_FACTOR
    for finding in findings if explained else ():
        what = f"{described(finding)}: by {stated.point.size} tie points"
        if np.isfinite(decades := finding.log_ratio / np.log(10.0)):
            what += f" this is 10^{decades:.0f} times as likely as what is stated"
        what += f"; change {_TO_CHANGE.get(finding.code, '{}').format(finding.key)}"
        if (factor := findings[-1].sigma_factor) > _PART_FACTOR:
            what += f"; rays still miss by {factor:.1f} times what the stations' sigmas explain: "
            what += "these are too small, or there is another mistake, beside this or in its place"
        ledger.finding(finding.code, what, where=finding.key, count=stated.point.size)
    nearest = "; ".join(described(finding) + f" ({finding.key})" for finding in findings)
    code = "TIES-RESIDUALS" if oriented is None else "ORIENTATION-TIES"
    report_misses(stations, stated, rays, ledger, code=code, explained=explained, nearest=nearest)


def described(finding: Finding) -> str:
    """The mistake that is found, and others that tie points do not separate from it."""
    equally = "equally likely by the tie points: " if finding.also else ""
    return equally + "; or ".join((finding.what, *finding.also))


def report_misses(
    stations: Stations, stated: Intersection, rays: ImageRays, ledger: Ledger, *,
    code: str, explained: bool, nearest: str,
) -> None:  # fmt: skip
    """How far rays of tie points miss each other; ``nearest`` would explain a part of it."""
    at = np.searchsorted(stated.point, rays.point)
    line = stated.position_m[at] - stated.orientations.centre_m[rays.image]
    miss = np.sqrt(np.mean(stated.residual_rad**2, axis=1))
    # A point whose rays are all but parallel has no place of its own.
    judged = stated.used | (stated.angle_rad >= MINIMUM_ANGLE_RAD)
    judged[at[stated.bad]] = True
    lost = (stated.bad | np.isnan(miss)) & judged[at]
    points, size = int(stated.used.sum()), stated.point.size
    where = "stations.orientation.path" if code == "ORIENTATION-TIES" else "stations"
    what = f"no rays of {size} tie points meet at an angle that checks anything"
    if points and np.isnan(miss).all():
        what = f"the rays of {points} of {size} tie points meet nowhere"
    elif points:
        pixels = np.sqrt(np.nanmean(miss**2)) / float(np.median(rays.sigma_rad))
        what = f"the rays of {points} of {size} tie points miss each other by {pixels:.1f} px "
        what += "(rms) before adjustment, without the refraction of us1976, with that of windows"
    meets = points >= 0.5 * judged.sum() and not stated.sigma_factor > _POOR_FACTOR
    if explained or (meets and not nearest):
        ledger.note(code, what, where=where, count=size)
        return
    for camera in sorted(set(stations.camera[rays.image].tolist())):
        of = stations.camera[rays.image] == camera
        met = of & ~lost & judged[at]
        what += f"; {camera}: {lost[of].sum()} of {of.sum()} rays meet no other"
        if met.any():
            metres = np.median(miss[met] * np.linalg.norm(line[met], axis=1))
            what += f", the others miss by {np.degrees(np.median(miss[met])):.2g} deg, "
            what += f"{metres:.2g} m, in the median"
    seen = np.bincount(rays.image, minlength=stations.image.size)
    share = np.bincount(rays.image[lost], minlength=seen.size) / np.maximum(seen, 1)
    worst = [str(stations.image[k]) for k in np.argsort(-share, kind="stable")[:3] if share[k] > 0]
    what += f"; most of {', '.join(worst)}" if worst else ""
    nearest = nearest and f"; nearest comes, though rays still miss then: {nearest}"
    ledger.finding(code, f"{what}{_MISSES}{nearest}", where=where, count=size)
