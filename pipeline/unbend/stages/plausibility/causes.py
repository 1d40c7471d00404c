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

KEYS_OF_STATIONS = {
    "unmatched": "image under events, observations.columns.image",
    "outside_log": "log.path; time_utc, gps_week or gps_seconds of events.csv.columns; delay_s",
}
"""Keys to look at by the status of stations; the log's for others."""

MOUNT = "angles of mount"
NOTHING_KNOWN: Mapping[str, str] = MappingProxyType({})
SAME_ROWS = ("PLAUSIBLE-EXTENT", "PLAUSIBLE-SENSORS")
"""Codes of findings of which all rows of a status follow: they are one message then, not two."""


def causes_of_statuses(facts: Facts, known: Mapping[str, str] = NOTHING_KNOWN) -> dict[str, str]:
    """A likely cause of each status that flags rows, with the keys to look at.

    Two statuses, whose causes have to be computed, have an entry only if a sampled row has them.
    ``known`` : by status the code of a finding that is probably its cause, instead of the keys.
    """
    columns = facts.mission.observations.columns
    height = "no height is known"
    if facts.mission.ground.column is not None:
        height = f"column {facts.mission.ground.column} is empty or not a height there"
    causes = {
        "no_station": cause_of_missing_stations(facts),
        "no_ground": f"{height} (ground.height)",
        "bad_measurement": (
            f"{columns.x_px} or {columns.y_px} is empty or not a number (observations.columns)"
        ),
        "outside_profile": "their rays leave the profile of the air (ground.height)",
        "beyond_grazing": f"their rays graze the ground ({hint('beyond_grazing', MOUNT, known)})",
    }
    if bool((facts.rows.status == MISSES_GROUND).any()):
        keys = f"{MOUNT}, f_px of the camera"
        causes["misses_ground"] = cause_of_misses(facts, hint("misses_ground", keys, known))
    outside = facts.rows.status == OUTSIDE_CAMERA
    if bool(outside.any()):
        causes["outside_camera"] = cause_of_outside(facts, outside)
    return causes


def hint(status: str, keys: str, known: Mapping[str, str]) -> str:
    """What to look at for a status: the finding that is its known cause, else the keys."""
    if status in known:
        return f"probably because of {known[status]}"
    return keys


def statuses_explained(
    facts: Facts, ledger: Ledger, known: Mapping[str, str] = NOTHING_KNOWN
) -> frozenset[str]:
    """Statuses of rows that follow from losses or findings which the ledger has already.

    Rows without a station do, if there is a loss for each reason why images have no station. They
    are one loss then, not two. So do those whose ``known`` cause is a finding about the very same
    rows, as that of pixels outside the image.
    """
    by_findings = {status for status, code in known.items() if code in SAME_ROWS}
    needed = set()
    for status in facts.stations.status[~facts.stations.ok]:
        needed.add("IMAGES-UNMATCHED" if status == UNMATCHED else "STATIONS-FLAGGED")
    losses = {entry.code for entry in ledger if entry.kind is Kind.LOSS}
    if needed and needed <= losses:
        by_findings.add("no_station")
    return frozenset(by_findings)


def cause_of_missing_stations(facts: Facts) -> str:
    """How many stations have each status but ok, with the keys to look at.

    Where all stations are ok, rows without one have no name of an image.
    """
    counts = Counter(facts.stations.status[~facts.stations.ok].tolist())
    if not counts:
        return "the name of the image is missing (observations.columns.image)"
    listed = []
    for status, count in counts.items():
        keys = KEYS_OF_STATIONS.get(status, "log")
        listed.append(f"{count} {status} ({keys})")
    return f"their stations: {', '.join(listed)}"


def cause_of_misses(facts: Facts, of_rays: str) -> str:
    """Why rays miss the ground: the ground lies above the camera, or rays pass the horizon.

    ``of_rays`` : what to look at in the second case.
    """
    rows = facts.rows.status == MISSES_GROUND
    ground_above_camera_m = (facts.rows.h_g_m - facts.camera_height_m)[rows]
    nadir_angle_rad = facts.nadir_angle_rad[rows]
    ground_is_below = ground_above_camera_m < 0.0
    causes = []
    if not ground_is_below.all():
        too_high_m = ground_above_camera_m[~ground_is_below]
        most_m = np.max(too_high_m)
        causes.append(
            f"the ground is up to {most_m:.0f} m above the camera (ground.height, ground.reference)"
        )
    if ground_is_below.any():
        # From the centre of a sphere through the ground.
        camera_radius_m = EARTH_RADIUS_M - ground_above_camera_m[ground_is_below]
        dip_of_horizon_rad = np.arccos(EARTH_RADIUS_M / camera_radius_m)
        beyond_deg = np.degrees(nadir_angle_rad[ground_is_below] + dip_of_horizon_rad) - 90.0
        causes.append(
            f"rays point up to {np.nanmax(beyond_deg):.1f} deg above the horizon ({of_rays})"
        )
    return "; ".join(causes)


def cause_of_outside(facts: Facts, outside: Mask) -> str:
    """Why pixels are outside a camera.

    They are beyond the image or beyond what the distortion allows, their rays do not pass the
    window, or refraction, where it is applied, displaces them out of the image. Every cause that
    explains a pixel is named, camera by camera. ``outside`` (n,) is True for such pixels.
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
        is_displaced = np.zeros(rows.size, dtype=bool)
        if facts.mission.refraction.direction == "apply":
            is_displaced = is_covered & ~is_blocked
        if beyond_format.any():
            size = facts.key_of(name, of_numbers="width_px", of_metric="format_mm")
            causes.append(
                f"outside {camera.width_px} x {camera.height_px} px ({size}; observations.columns)"
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
            key = facts.key_of(name, of_numbers="distortion", of_metric="distortion")
            causes.append(
                f"beyond the radius at which the distortion of {name} can be inverted ({key})"
            )
    return "; ".join(causes)


def passes_window(exposures: Exposures, station: Integers, u: Array, v: Array) -> Mask:
    """Whether rays (n,) go out through the plane window of their exposures, if there is one.

    ``station`` are rows of ``exposures``, ``u`` and ``v`` ideal image coordinates. A window
    reflects a ray that meets it too flat, and a ray against its normal does not meet it: neither
    has a refracted angle r_cc. Equal refractivities on both sides mean that no window bends rays.
    """
    direction = np.stack([u, v, np.ones(u.size)], axis=1)
    direction = direction / np.linalg.norm(direction, axis=1)[:, None]
    inside = exposures.refractivity_cabin[station]
    outside = exposures.refractivity_outside[station]
    _, r_cc = refract_at_window(direction, inside, outside, exposures.normals[station])
    return np.asarray((inside == outside) | np.isfinite(r_cc))
