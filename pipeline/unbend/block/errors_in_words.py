"""Estimated mistakes of a mission file in words: one sentence with number and sigma.

The sentence is empty if the stated sigmas explain the amount, or if it is too small to matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.block.image_rays import Orientations
from unbend.block.intersection import Intersection
from unbend.block.possible_mistakes import (
    EXPLAINED_SIGMAS,
    PossibleMistake,
    StatedMission,
    first_coefficients,
)
from unbend.flight.rotations import CAMERA_AT_REST
from unbend.units import Array

# Smaller errors do not matter.
SMALLEST_TURN_RAD = np.radians(0.3)
SMALLEST_FOCAL = 0.01  # as a share
SMALLEST_HEIGHT = 0.01  # as a share of the flying height
SMALLEST_TIME_S = 0.1
SMALLEST_DISTORTION = 0.0015  # as a share, in the corners of the image

# Least uncertainty of an estimated principal distance, as a share. The sigma of its likelihood is
# too small: small errors of principal points, distortions and mounts move the estimate more.
CERTAIN_FOCAL = 0.005

SLOWEST_M_S = 0.1  # lower limit of the speed, so that hovering gives a finite sigma of time
SAME_HEIGHT = 0.05  # share of an error of height: a known cause within it explains the error
LARGEST_DATUM_M = 120.0  # largest difference of two height datums: undulations reach 107 m
LEAP_SECONDS = (17.0, 19.0)  # range of a delay that is GPS time minus UTC


def error_in_words(
    mission: StatedMission, hypothesis: PossibleMistake, intersection: Intersection, sigma: float
) -> str:
    """The sentence on a hypothesis at its estimated amount; empty if the error does not matter.

    ``intersection`` is that of its reading, ``sigma`` the standard deviation of its amount.
    """
    code = hypothesis.code
    if code == "TIES-MOUNT":
        return turn_in_words(mission, hypothesis, intersection)
    if code == "TIES-FOCAL":
        return focal_in_words(mission, hypothesis, intersection, sigma)
    if code == "TIES-CALIBRATION":
        return distortion_in_words(mission, hypothesis, sigma)
    if code == "TIES-HEIGHT":
        return height_in_words(mission, hypothesis, intersection, sigma)
    if code == "TIES-TIME" and mission.shifted is not None:
        return time_in_words(mission.shifted, hypothesis, intersection, sigma)
    if code == "TIES-PIXELS":
        axes = "x and y are exchanged" if hypothesis.label == "exchanged" else "y counts upward"
        return f"in the pixels of {' and '.join(hypothesis.cameras)} {axes}"
    return f"the images of {hypothesis.label} are exchanged"


def turn_in_words(
    mission: StatedMission, hypothesis: PossibleMistake, intersection: Intersection
) -> str:
    """The sentence on a turned mount; empty within the sigmas of attitudes and of the estimate."""
    camera = hypothesis.camera
    _, covariance = intersection.camera_rotation(camera)
    covariance = max(1.0, intersection.sigma_factor) ** 2 * covariance
    explained = stated_covariance(intersection.orientations, camera) + covariance
    turn = hypothesis.reading.turns[camera]
    vector = Rotation.from_matrix(turn).as_rotvec()
    angle_rad = float(np.linalg.norm(vector))
    chi_square = vector @ np.linalg.solve(explained, vector)
    if angle_rad < SMALLEST_TURN_RAD or chi_square < EXPLAINED_SIGMAS**2:
        return ""
    angle_deg = np.degrees(angle_rad)
    sigma_deg = float(np.degrees(np.sqrt(np.diag(covariance).max())))
    text = f"{camera} is turned by {angle_deg:.2f} deg +- {sigma_deg:.2g} against the stated angles"
    if mission.mounts:
        body = (CAMERA_AT_REST.T @ turn @ mission.camera_from_body(camera)).T
        yaw, pitch, roll = Rotation.from_matrix(body).as_euler("ZYX", degrees=True)
        text += f": its mount is roll_deg {roll:.2f}, pitch_deg {pitch:.2f}, yaw_deg {yaw:.2f}"
    if hypothesis.label:
        text += f", as {hypothesis.label.format('roll', 'pitch', 'yaw')}"
    return text


def stated_covariance(orientations: Orientations, camera: str) -> Array:
    """(3, 3) mean covariance [rad^2] of the attitudes of a camera's images, in the camera.

    From the stated sigmas, as if all images had the same error.
    """
    of_camera = (orientations.camera == camera) & np.isfinite(orientations.centre_m[:, 0])
    ecef_from_enu = np.swapaxes(orientations.enu_from_ecef[of_camera], 1, 2)
    camera_from_enu = orientations.camera_from_ecef[of_camera] @ ecef_from_enu
    spread = camera_from_enu * orientations.sigma[of_camera, None, 3:]
    return np.asarray(np.mean(spread @ np.swapaxes(spread, 1, 2), axis=0))


def focal_in_words(
    mission: StatedMission, hypothesis: PossibleMistake, intersection: Intersection, sigma: float
) -> str:
    """The sentence on principal distances; empty within their sigmas and those of heights."""
    cameras = hypothesis.reading.cameras
    stated_px = np.array([mission.cameras[name].fx_px for name in hypothesis.cameras])
    estimated_px = np.array([cameras[name].fx_px for name in hypothesis.cameras])
    sigma_of_heights = shared_height_sigma_m(mission, intersection) / intersection.flying_height_m
    explained = EXPLAINED_SIGMAS * float(np.hypot(sigma, sigma_of_heights))
    change = np.abs(np.log(estimated_px / stated_px)).max()
    if not change > max(SMALLEST_FOCAL, explained):
        return ""
    certain_share = max(CERTAIN_FOCAL, sigma)
    rounded_px = [rounded(f_px, certain_share * f_px) for f_px in estimated_px]
    text = (
        f"the principal distance of {' and '.join(hypothesis.cameras)} is about "
        f"{listed(rounded_px, '.0f')} px, not {listed(stated_px, 'g')}"
    )
    return f"{text}: it is {hypothesis.label}" if hypothesis.label else text


def rounded(value: float, uncertainty: float) -> float:
    """A number rounded to the largest power of ten that is not above its uncertainty (> 0).

    >>> rounded(20063.2, 100.3)
    20100.0
    >>> rounded(3657.9, 18.3)
    3660.0
    """
    decimals = -math.floor(math.log10(uncertainty))
    return round(float(value), decimals)


def distortion_in_words(mission: StatedMission, hypothesis: PossibleMistake, sigma: float) -> str:
    """The sentence on radial distortions; empty if they do not matter in the image corners."""
    names = hypothesis.cameras
    stated_k1 = first_coefficients(mission.cameras, names)
    estimated_k1 = first_coefficients(hypothesis.reading.cameras, names)
    diagonals = []  # of the images, in units of the principal distance
    for name in names:
        camera = mission.cameras[name]
        diagonals.append(np.hypot(camera.width_px / camera.fx_px, camera.height_px / camera.fy_px))
    corner = 0.5 * max(diagonals)
    change = np.abs(estimated_k1 - stated_k1).max()
    if not change > max(SMALLEST_DISTORTION / corner**2, EXPLAINED_SIGMAS * sigma):
        return ""
    return (
        f"the radial distortion k1 of {' and '.join(names)} is "
        f"{listed(estimated_k1, '.4f')} +- {sigma:.2g}, not {listed(stated_k1, 'g')}"
    )


def height_in_words(
    mission: StatedMission, hypothesis: PossibleMistake, intersection: Intersection, sigma: float
) -> str:
    """The sentence on stations that are too low or too high, with a known cause if there is one."""
    up_m = hypothesis.reading.up_m
    explained_m = explained_height_m(mission, intersection, sigma)
    if not abs(up_m) > max(SMALLEST_HEIGHT * intersection.flying_height_m, explained_m):
        return ""
    direction = "low" if up_m > 0 else "high"
    text = (
        f"the stations are {abs(up_m):.1f} m +- {sigma:.2g} too {direction} above the given "
        "heights of the ground"
    )
    cause = cause_of_height(mission, up_m, explained_m)
    if cause:
        text += f", as if {cause}"
    elif is_beyond_datums(mission, hypothesis, intersection, sigma):
        text += ", by more than a datum explains"
    return text


def explained_height_m(mission: StatedMission, intersection: Intersection, sigma: float) -> float:
    """Error of all heights [m] that the sigmas of ground, stations and estimate explain."""
    shared_sigma_m = shared_height_sigma_m(mission, intersection)
    return EXPLAINED_SIGMAS * float(np.hypot(sigma, shared_sigma_m))


def cause_of_height(mission: StatedMission, up_m: float, explained_m: float) -> str:
    """The known cause in words that is nearest to an error of heights; empty if none is near."""
    apart_m = {name: abs(named_m - up_m) for name, named_m in mission.other_heights_m.items()}
    nearest = min(apart_m, key=lambda name: apart_m[name], default="")
    if nearest and apart_m[nearest] < max(SAME_HEIGHT * abs(up_m), explained_m):
        return nearest
    return ""


def is_beyond_datums(
    mission: StatedMission, hypothesis: PossibleMistake, intersection: Intersection, sigma: float
) -> bool:
    """Whether stations are off in height by more than another datum or feet explain."""
    if hypothesis.code != "TIES-HEIGHT":
        return False
    up_m = hypothesis.reading.up_m
    explained_m = explained_height_m(mission, intersection, sigma)
    has_cause = cause_of_height(mission, up_m, explained_m) != ""
    return not has_cause and abs(up_m) - explained_m > LARGEST_DATUM_M


def time_in_words(
    shifted: Callable[[float], Orientations],
    hypothesis: PossibleMistake,
    intersection: Intersection,
    sigma: float,
) -> str:
    """The sentence on exposures at other times; empty within the sigmas along the flight.

    ``shifted`` : as in `StatedMission`.
    """
    moved_m = shifted(0.5).centre_m - shifted(-0.5).centre_m  # in one second
    speed_m_s = max(float(np.nanmedian(np.linalg.norm(moved_m, axis=1))), SLOWEST_M_S)
    position_sigma_m = float(np.nanmedian(intersection.orientations.sigma[:, 0]))
    explained_s = EXPLAINED_SIGMAS * float(np.hypot(sigma, position_sigma_m / speed_m_s))
    time_s = hypothesis.reading.time_s
    if not abs(time_s) > max(SMALLEST_TIME_S, explained_s):
        return ""
    direction = "later" if time_s > 0 else "earlier"
    text = f"the exposures are {abs(time_s):.2f} s +- {sigma:.2g} {direction} than stated"
    shortest_s, longest_s = LEAP_SECONDS
    if shortest_s < abs(time_s) < longest_s:
        text += ", the difference between GPS time and UTC"
    return text


def shared_height_sigma_m(mission: StatedMission, intersection: Intersection) -> float:
    """Standard deviation [m] of an error that all heights of ground and stations share."""
    station_sigma_m = np.nanmedian(intersection.orientations.sigma[:, 2])
    return float(np.hypot(mission.sigma_heights_m, station_sigma_m))


def listed(values: Iterable[float], form: str) -> str:
    """Numbers in one form, joined by "and"."""
    return " and ".join(format(value, form) for value in values)
