"""The user's own tie points against stations, cameras, mounts, times and heights of a mission."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pipeline.batch.plan import Plan
from pipeline.block.diagnosis import StatedMission, diagnosis
from pipeline.block.image_rays import (
    MINIMUM_ANGLE_RAD,
    UNKNOWN_SIGMAS,
    ImageRays,
    Orientations,
    orientations_of,
)
from pipeline.block.intersection import Intersection
from pipeline.block.oriented_images import SIGMAS_OF_BLOCK
from pipeline.flight.heights import ground_offsets
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger
from pipeline.refraction.camera.camera import Camera
from pipeline.stages.exposure_setup import cameras_of_mission
from pipeline.stages.inputs import FlightLog
from pipeline.tables.tie_points import TiePoints, tie_rays

FEWEST_TIE_POINTS = 10
_FEET = 1.0 - 0.3048
_GOOD_FACTOR, _POOR_FACTOR = 2.0, 5.0  # residuals over what the stations' sigmas say
_TO_CHANGE = {
    "TIES-HEIGHT": "ground.height or its unit, ground.reference, mission.undulation_m, or what the "
    "heights of the stations count from",
    "TIES-TIME": "delay_s under events, or the clock that the times are of",
}
_PANE_RAD = 1e-4  # what a window bends, which stays in the rays


def check_tie_points(
    plan: Plan,
    flight: FlightLog,
    stations: Stations,
    ties: TiePoints,
    *,
    shifted: Callable[[float], Stations] | None,
    ledger: Ledger,
) -> None:
    """A finding for each part of the mission file that tie points contradict, with its estimate.

    ``shifted`` gives the stations that many seconds later, in their order.
    """
    mission, cameras = plan.mission, cameras_of_mission(plan.mission)
    oriented = mission.stations.orientation
    unknown = UNKNOWN_SIGMAS if oriented is None else SIGMAS_OF_BLOCK
    offset = ground_offsets(mission.ground.reference_of_values, stations, flight.heights)
    undulation = np.nan_to_num(stations.h_ellipsoid_m - stations.h_msl_m)
    pane = np.array([bool(n and mission.cameras[n].window) for n in stations.camera], np.bool_)

    def rays_of(by: Mapping[str, Camera], axes: Mapping[str, str]) -> ImageRays:
        rays = tie_rays(ties, stations.image, stations.camera, by, axes)
        given = np.full(rays.image.size, mission.ground.constant_m, np.float64)
        given = rays.height_m if rays.height_m is not None and np.isnan(given).all() else given
        return replace(
            rays,
            sigma_rad=np.hypot(rays.sigma_rad, _PANE_RAD * pane[rays.image]),
            height_m=given + (offset + undulation)[rays.image],
        )

    rays = rays_of(cameras, {})
    usable = stations.ok[rays.image]
    if np.unique(rays.point[usable]).size < FEWEST_TIE_POINTS:
        return
    mounts = {} if oriented is not None and oriented.angles != "roll_pitch_yaw" else mission.mount

    def later(seconds: float) -> Orientations:
        at = stations if shifted is None else shifted(seconds)
        return orientations_of(at.with_status(~stations.ok, "suspect"), unknown)

    zero = float(np.nanmedian(undulation)), float(np.nanmedian(offset))
    known = rays.height_m[np.isfinite(rays.height_m)] if rays.height_m is not None else np.zeros(0)
    ground = float(np.median(known)) - sum(zero) if known.size else np.nan
    high = float(np.nanmedian(stations.h_msl_m[stations.ok]))
    stated, findings = diagnosis(
        StatedMission(
            orientations_of(stations, unknown),
            cameras,
            rays_of,
            {name: mount.build() for name, mount in mounts.items()},
            None if shifted is None else later,
            sigma_heights_m=mission.ground.sigma_m or 0.0,
            other_heights_m={
                "heights above the ellipsoid were taken for those above sea level": -zero[0],
                "heights above sea level were taken for those above the ellipsoid": zero[0],
                "heights above sea level were taken for those above the take-off": zero[1],
                "heights of the ground in feet were taken for metres": _FEET * ground,
                "heights of the stations in feet were taken for metres": -_FEET * high,
                "heights above the take-off were taken for those above sea level": -(
                    flight.heights.home_h_msl_m or 0.0
                ),
            },
        )
    )
    for finding in findings:
        also = f"; {', '.join(finding.also)} would be as likely" if finding.also else ""
        if finding.sigma_factor > _GOOD_FACTOR:
            also += f"; rays still miss by {finding.sigma_factor:.2g} sigmas: more is wrong"
        ledger.finding(
            finding.code,
            f"{finding.what}: by {stated.point.size} tie points this is "
            f"10^{finding.log_ratio / np.log(10.0):.0f} times as likely as what is stated{also}; "
            f"change {_TO_CHANGE.get(finding.code, finding.key)}",
            where=finding.key,
            count=stated.point.size,
        )
    explained = bool(findings) and findings[-1].sigma_factor < _GOOD_FACTOR
    code = "TIES-RESIDUALS" if oriented is None else "ORIENTATION-TIES"
    report_misses(stations, stated, rays, ledger, code=code, explained=explained)


def report_misses(
    stations: Stations,
    stated: Intersection,
    rays: ImageRays,
    ledger: Ledger,
    *,
    code: str,
    explained: bool,
) -> None:
    """How far the rays of tie points miss each other; a finding where no station explains it."""
    at = np.searchsorted(stated.point, rays.point)
    line = stated.position_m[at] - stated.orientations.centre_m[rays.image]
    miss = np.sqrt(np.mean(stated.residual_rad**2, axis=1))
    # A point whose rays are all but parallel tells nothing.
    judged = stated.used | (stated.angle_rad >= MINIMUM_ANGLE_RAD)
    judged[at[stated.bad]] = True
    lost = (stated.bad | np.isnan(miss)) & judged[at]
    points = int(stated.used.sum())
    size, where = stated.point.size, "stations"
    what = f"no rays of {size} tie points meet at an angle that checks anything"
    if points:
        pixels = np.sqrt(np.nanmean(miss**2)) / float(np.median(rays.sigma_rad))
        what = f"the rays of {points} of {size} tie points miss each other by {pixels:.1f} px "
        what += "(rms), without refraction"
    meets = points >= 0.5 * judged.sum() and not stated.sigma_factor > _POOR_FACTOR
    if explained or meets:
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
    what += (
        ": the orientations are not what they should be (rows of other images or cameras, another "
        "convention), or the name of a point is not that of one point in all images"
    )
    ledger.finding(code, what, where=where, count=size)
