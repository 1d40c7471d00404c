"""Likely causes of the statuses that flag observations, with the keys to look at."""

from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from unbend.flight.stations import UNMATCHED
from unbend.messages import Kind, Ledger
from unbend.refraction.image import Exposures
from unbend.refraction.status_codes import MISSES_GROUND, OUTSIDE_CAMERA
from unbend.refraction.window import refract_at_window
from unbend.stages.plausibility.facts import Facts
from unbend.units import Array, Integers, Mask

EARTH_RADIUS_M = 6.371e6
BELOW_HORIZON_RAD = np.radians(86.0)
"""Rays with a smaller nadir angle point below the horizon, whose dip is 3.9 deg from 15 km."""

KEYS_OF_STATIONS = {
    "unmatched": "image under events, observations.columns.image",
    "outside_log": "log.path; time_utc, gps_week or gps_seconds of events.csv.columns; delay_s",
}
"""Keys to look at, by the status of stations; for other statuses they are those under log."""

MOUNT = "angles of mount"
NO_FINDINGS: Mapping[str, str] = MappingProxyType({})
FINDINGS_OF_SAME_ROWS = ("PLAUSIBLE-EXTENT", "PLAUSIBLE-SENSORS")
"""Codes of findings about all rows of the status that they cause: it needs no second message."""


def causes_of_statuses(
    facts: Facts, causing_findings: Mapping[str, str] = NO_FINDINGS
) -> dict[str, str]:
    """A likely cause of each status that flags rows, in words, with the keys to look at.

    ``causing_findings`` : by status the code of a finding that is probably its cause; the text
    names it instead of the keys. The statuses misses_ground and outside_camera have an entry only
    if a sampled row has them, because their causes are computed from such rows.
    """
    columns = facts.mission.observations.columns
    height_text = "no height is known"
    if facts.mission.ground.column is not None:
        height_text = f"column {facts.mission.ground.column} is empty or not a height there"
    grazing_hint = what_to_check("beyond_grazing", MOUNT, causing_findings)
    causes = {
        "no_station": cause_of_missing_stations(facts),
        "no_ground": f"{height_text} (ground.height)",
        "bad_measurement": (
            f"{columns.x_px} or {columns.y_px} is empty or not a number (observations.columns)"
        ),
        "outside_profile": "their rays leave the profile of the air (ground.height)",
        "beyond_grazing": f"their rays graze the ground ({grazing_hint})",
    }
    if bool((facts.rows.status == MISSES_GROUND).any()):
        keys = f"{MOUNT}, f_px of the camera"
        ray_hint = what_to_check("misses_ground", keys, causing_findings)
        causes["misses_ground"] = cause_of_misses(facts, ray_hint)
    outside = facts.rows.status == OUTSIDE_CAMERA
    if bool(outside.any()):
        causes["outside_camera"] = cause_of_outside(facts, outside)
    return causes


def what_to_check(status: str, keys: str, causing_findings: Mapping[str, str]) -> str:
    """What to look at for a status: the code of the finding that causes it, else ``keys``."""
    if status in causing_findings:
        return f"probably because of {causing_findings[status]}"
    return keys


def statuses_explained(
    facts: Facts, ledger: Ledger, causing_findings: Mapping[str, str] = NO_FINDINGS
) -> frozenset[str]:
    """Statuses of rows that need no loss of their own, because the ledger has their cause.

    * Statuses with a finding about the very same rows among the ``causing_findings`` (by status),
      as that of pixels outside the image.
    * no_station, if the ledger has a loss for each reason for which images have no station.
    """
    explained = set()
    for status, code in causing_findings.items():
        if code in FINDINGS_OF_SAME_ROWS:
            explained.add(status)
    needed_losses = set()
    for status in facts.stations.status[~facts.stations.ok]:
        needed_losses.add("IMAGES-UNMATCHED" if status == UNMATCHED else "STATIONS-FLAGGED")
    losses = {entry.code for entry in ledger if entry.kind is Kind.LOSS}
    if needed_losses and needed_losses <= losses:
        explained.add("no_station")
    return frozenset(explained)


def cause_of_missing_stations(facts: Facts) -> str:
    """Why rows have no station: the count of each status of stations that are not ok, with keys.

    If all stations are ok, the name of the image is missing in these rows.
    """
    counts = Counter(facts.stations.status[~facts.stations.ok].tolist())
    if not counts:
        return "the name of the image is missing (observations.columns.image)"
    counts_in_words = []
    for status, count in counts.items():
        keys = KEYS_OF_STATIONS.get(status, "log")
        counts_in_words.append(f"{count} {status} ({keys})")
    return f"their stations: {', '.join(counts_in_words)}"


def cause_of_misses(facts: Facts, ray_hint: str) -> str:
    """Why rays miss the ground: it is above the camera, or the rays point above the horizon.

    ``ray_hint`` : what to check for rays above the horizon.
    """
    rows = facts.rows.status == MISSES_GROUND
    camera_height_m = facts.camera_height_m[rows]
    ground_above_camera_m = facts.rows.h_g_m[rows] - camera_height_m
    nadir_angle_rad = facts.nadir_angle_rad[rows]
    # An elevation model gives no height of the ground for a ray that misses it. A ray below the
    # horizon can miss only ground that is above the camera.
    is_unknown = np.isnan(ground_above_camera_m)
    ground_is_above = ground_above_camera_m >= 0.0
    ground_is_above |= is_unknown & (nadir_angle_rad < BELOW_HORIZON_RAD)
    causes = []
    if ground_is_above.any():
        known_m = ground_above_camera_m[ground_is_above & ~is_unknown]
        by_how_much = f"up to {known_m.max():.0f} m " if known_m.size else ""
        causes.append(
            f"the ground is {by_how_much}above the camera (ground.height, ground.reference)"
        )
    if not ground_is_above.all():
        # Distance of the camera from the centre of a sphere through the ground, or the sea where
        # the height of the ground is unknown.
        above_ground_m = -ground_above_camera_m
        above_ground_m[is_unknown] = np.maximum(camera_height_m[is_unknown], 0.0)
        camera_radius_m = EARTH_RADIUS_M + above_ground_m[~ground_is_above]
        dip_of_horizon_rad = np.arccos(EARTH_RADIUS_M / camera_radius_m)
        horizon_rad = np.pi / 2.0 - dip_of_horizon_rad
        above_horizon_deg = np.degrees(nadir_angle_rad[~ground_is_above] - horizon_rad)
        highest_deg = np.nanmax(above_horizon_deg)
        causes.append(f"rays point up to {highest_deg:.1f} deg above the horizon ({ray_hint})")
    return "; ".join(causes)


def cause_of_outside(facts: Facts, outside: Mask) -> str:
    """Why rows (n,) have the status outside_camera, where ``outside`` is True.

    Their pixels are beyond the image, or beyond the radius at which the distortion can be inverted;
    their rays do not pass the window; or refraction, where it is applied, moves them out of the
    image. Each cause that explains a row is named, camera by camera.
    """
    causes = []
    for name in np.unique(facts.camera[outside]).tolist():
        camera = facts.cameras[name]
        rows = np.flatnonzero(outside & (facts.camera == name))
        x = facts.rows.x_px[rows]
        y = facts.rows.y_px[rows]
        # Pixels are COLMAP's: the outer corner of the image is 0, 0.
        beyond_format = (x < 0) | (y < 0) | (x > camera.width_px) | (y > camera.height_px)
        u, v, is_covered = camera.rays(x, y)
        is_blocked = is_covered & ~passes_window(facts.exposures, facts.rows.station[rows], u, v)
        # No other cause remains for a ray that the camera covers and the window lets through.
        is_displaced = np.zeros(rows.size, dtype=bool)
        if facts.mission.refraction.direction == "apply":
            is_displaced = is_covered & ~is_blocked
        if beyond_format.any():
            key = facts.key_of(name, pixel_key="width_px", metric_key="format_mm")
            causes.append(
                f"outside {camera.width_px} x {camera.height_px} px ({key}; observations.columns)"
            )
        if is_blocked.any():
            section = facts.mission.windows[name].section
            causes.append(
                f"their rays do not pass the {section} of {name} (cameras.{name}.{section}.normal)"
            )
        if is_displaced.any():
            causes.append(
                f"refraction moves them out of the image of {name} (refraction.direction)"
            )
        if not (beyond_format | is_blocked | is_displaced).all():
            key = facts.key_of(name, pixel_key="distortion", metric_key="distortion")
            causes.append(
                f"beyond the radius at which the distortion of {name} can be inverted ({key})"
            )
    return "; ".join(causes)


def passes_window(exposures: Exposures, station: Integers, u: Array, v: Array) -> Mask:
    """Whether rays (n,) pass the plane window of their exposure; True if there is no window.

    ``station`` (n,) are rows of ``exposures``, ``u`` and ``v`` (n,) ideal image coordinates. The
    refracted angle r_cc is NaN for a ray that meets the window too flat (total reflection), and for
    a ray against its normal, which does not meet it. Equal refractivities on both sides mean that
    no window bends the ray.
    """
    direction = np.stack([u, v, np.ones(u.size)], axis=1)
    direction = direction / np.linalg.norm(direction, axis=1)[:, None]
    inside = exposures.refractivity_cabin[station]
    outside = exposures.refractivity_outside[station]
    _, r_cc = refract_at_window(direction, inside, outside, exposures.normals[station])
    return np.asarray((inside == outside) | np.isfinite(r_cc))
