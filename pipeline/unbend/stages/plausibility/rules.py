"""The rules of plausibility: each yields a finding where the facts of a mission look mistaken.

A finding states what is expected, what there is instead, and the likely mistake.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np

from unbend.flight.ground_times import Takeoff
from unbend.geodesy import wrapped
from unbend.messages import Message
from unbend.refraction.calibration import is_fisheye
from unbend.refraction.camera.camera import Camera
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.air_limits import air_of_flight
from unbend.stages.plausibility.cabin_windows import windows_of_compartments
from unbend.stages.plausibility.causes import EARTH_RADIUS_M, causes_of_statuses
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.lens_references import lens_references
from unbend.units import Array

Findings = Iterator[Message]
"""Messages whose ``where`` is the key of the mission file to change."""

TAKEOFF_NEAR_KM = 30.0  # farther away the take-off says nothing about the ground
GROUND_ALLOWED_M = 300.0  # difference of the heights of ground and take-off, at the take-off
GROUND_ALLOWED_M_PER_KM = 20.0  # to be added for each kilometre from the take-off
TERRAIN_ALLOWED_M = 50.0  # between the heights of ground and terrain at the same place
SEES_STATION_RAD = 0.5  # rays within so much of the nadir see the ground near their station
LIKELY_SHARE = 0.5  # of a difference: a likely mistake leaves no more unexplained
NARROWEST_VIEW_DEG = 3.0
WIDEST_VIEW_DEG = 130.0
NARROWEST_FISHEYE_DEG = 60.0
WIDEST_FISHEYE_DEG = 300.0
LARGEST_PIXEL_RATIO = 0.02  # of the sides of a pixel, minus 1
LARGEST_OFF_CENTRE = 0.1  # of a principal point, in sizes of the image
NEAR_MIDDLE = 0.05  # the same, of a principal point that states where the middle is
SMALLEST_DISTORTION = 1e-6  # at the corners of the image, as a share of the radius
LARGEST_DISTORTION = 0.3  # the same, for views under 90 deg
LARGEST_WIDE_DISTORTION = 1.0  # the same, for wider views
LARGEST_TANGENTIAL = 1e-3  # of p1 and p2: a larger one is another coefficient in their place
TANGENTIAL_OVER_RADIAL = 3.0  # p1 or p2 over k3: larger ones are in another order
MOST_OUTSIDE = 0.01  # share of the observations outside the image
FILLED = 0.7  # share of the image that many observations reach
MANY_ROWS = 100  # that fill an image
BEHIND_CENTRE = -0.2  # in sizes of the image: pixels that count from its centre are lower
LARGEST_TILT_DEG = 30.0  # of a camera that is called nadir
SMALLEST_OBLIQUE_DEG = 10.0  # of a camera that is called oblique
ANGLE_STEP_DEG = 15.0  # angles of mounts are often multiples of it
LARGEST_STEP_ERROR = 2e-3  # in steps, of an angle that was rounded in radians
HIGHEST_CAMERA_M = 0.25  # above an antenna, which has the sky above it, or an inertial sensor
LOOKS_DOWN = 0.5  # least cosine of the nadir angle of an axis
LONGEST_LEVER_ARM_M = 10.0
LARGEST_GROUND_SIGMA_M = 50.0
LONGEST_DELAY_S = 1.0
MOST_WINDOW_TILT_DEG = 35.0
LARGEST_NADIR_RAD = 1.4  # nadir angle; beyond it the slant range depends too much on the angle
SMALLEST_RANGE_RATIO = 0.7  # slant range over that of the heights
LARGEST_RANGE_RATIO = 1.4
MOST_FLAGGED = 0.2  # share of the rows, for one cause
METRES_OF_A_FOOT = 0.3048
STATION_AT_GROUND_M = 100.0  # a weather station in feet, converted: difference from the ground
STATION_OFF_GROUND_M = 300.0  # and the same height read in metres


def ground_against_takeoff(facts: Facts) -> Findings:
    """A finding if the ground is too far above or below the take-off.

    Allowed are 300 m, and 20 m more for each km between take-off and stations. Beyond 30 km nothing
    is compared.
    """
    takeoff = facts.takeoff
    ground_m = facts.rows.h_g_m
    if takeoff is None or not np.isfinite(ground_m).any() or not facts.stations.ok.any():
        return
    distance_km = median_distance_km(facts, takeoff)
    if distance_km > TAKEOFF_NEAR_KM:
        return
    column = facts.mission.ground.column
    key = "ground.height"
    if column:
        key += f", column {column}"
    height_m = float(np.nanmedian(ground_m))
    off_m = height_m - takeoff.h_msl_m
    allowed_m = GROUND_ALLOWED_M + GROUND_ALLOWED_M_PER_KM * distance_km
    if abs(off_m) > allowed_m:
        yield messages.ground_off(
            where=key,
            height_m=height_m,
            off_m=off_m,
            reference=f"the take-off, {distance_km:.0f} km away",
            allowed_m=allowed_m,
            likely=likely_reading(off_m, height_m, takeoff.h_msl_m),
        )


def median_distance_km(facts: Facts, takeoff: Takeoff) -> float:
    """How far the stations are from the take-off, in the median [km]."""
    ok = facts.stations.ok
    north_m = (facts.stations.lat_rad[ok] - takeoff.lat_rad) * EARTH_RADIUS_M
    parallel_m = math.cos(takeoff.lat_rad) * EARTH_RADIUS_M
    east_m = wrapped(facts.stations.lon_rad[ok] - takeoff.lon_rad) * parallel_m
    return float(np.median(np.hypot(north_m, east_m))) / 1000.0


def ground_against_terrain(facts: Facts) -> Findings:
    """A finding if the ground is too far above or below the terrain that the autopilot logged.

    Allowed are 50 m and the scatter of the differences. Only rows within 29 deg of the nadir count,
    because these see the ground near their station, where the terrain was logged.
    """
    # The last element is for rows without a station, whose number is -1.
    terrain_m = np.append(facts.logged_terrain_m, np.nan)[facts.rows.station]
    is_near = facts.nadir_angle_rad < SEES_STATION_RAD
    above_terrain_m = np.where(is_near, facts.rows.h_g_m, np.nan) - terrain_m
    is_known = np.isfinite(above_terrain_m)
    if not is_known.any():
        return
    low_m, median_m, high_m = np.percentile(above_terrain_m[is_known], [16.0, 50.0, 84.0]).tolist()
    scatter_m = (high_m - low_m) / 2.0  # one sigma of normally distributed differences
    allowed_m = TERRAIN_ALLOWED_M + scatter_m
    if abs(median_m) > allowed_m:
        height_m = float(np.median(terrain_m[is_known])) + median_m
        yield messages.terrain_off(
            where=key_of_ground(facts),
            height_m=height_m,
            off_m=median_m,
            reference=f"the terrain that the autopilot logged, in {is_known.sum()} rows",
            allowed_m=allowed_m,
            likely=likely_reading(median_m, height_m, takeoff_height_m(facts)),
        )


def model_against_takeoff(facts: Facts) -> Findings:
    """A finding if the elevation model is more than 50 m above or below the take-off.

    Compared only if the aircraft is at rest on the ground when the log begins.
    """
    takeoff = facts.takeoff
    model_m = facts.model_at_takeoff_m
    if takeoff is None or not takeoff.stands or not np.isfinite(model_m):
        return
    off_m = model_m - takeoff.h_msl_m
    if abs(off_m) > TERRAIN_ALLOWED_M:
        yield messages.terrain_off(
            where=key_of_ground(facts),
            height_m=model_m,
            off_m=off_m,
            reference="the take-off, by the elevation model where the log begins",
            allowed_m=TERRAIN_ALLOWED_M,
            likely=likely_reading(off_m, model_m, takeoff.h_msl_m),
        )


def key_of_ground(facts: Facts) -> str:
    """The keys of the mission file that state ground heights and their zero."""
    column = facts.mission.ground.column
    column_text = f", column {column}" if column else ""
    return f"ground.height{column_text}; ground.reference"


def takeoff_height_m(facts: Facts) -> float:
    """The height of the take-off above sea level [m]; 0 if unknown."""
    return 0.0 if facts.takeoff is None else facts.takeoff.h_msl_m


def likely_reading(off_m: float, ground_m: float, takeoff_m: float) -> str:
    """What ground heights likely are, in words, if they seem too high by ``off_m`` (or too low).

    ``ground_m`` is the stated height of the ground, ``takeoff_m`` that of the take-off above sea
    level. Each reading makes heights too high by a known amount if they are taken for metres above
    sea level. The reading whose amount is nearest to ``off_m`` is likely if it explains at least
    half of ``off_m``.
    """
    too_high_m = {
        "feet": ground_m - ground_m * METRES_OF_A_FOOT,
        "km": ground_m - ground_m * 1000.0,
        "heights above the take-off (ground.reference: relative)": -takeoff_m,
        "heights above sea level, not relative ones (ground.reference)": takeoff_m,
    }
    best = min(too_high_m, key=lambda reading: abs(too_high_m[reading] - off_m))
    unexplained_m = abs(too_high_m[best] - off_m)
    if ground_m == 0.0 or unexplained_m > LIKELY_SHARE * abs(off_m):
        return "a wrong height, datum or unit in ground.height"
    return best


def heights_of_weather_stations(facts: Facts) -> Findings:
    """A warning for a weather station with a height that fits the ground only in feet.

    The ground is that of the observations, or the take-off. In metres the station is more than
    300 m from both, in feet within 100 m of one of them.
    """
    grounds_m = []
    ground_m = facts.rows.h_g_m
    if np.isfinite(ground_m).any():
        grounds_m.append(float(np.nanmedian(ground_m)))
    if facts.takeoff is not None:
        grounds_m.append(facts.takeoff.h_msl_m)
    if not grounds_m:
        return
    for number, station in enumerate(facts.mission.atmosphere.surface):
        stated_m = station.h_msl_m
        converted_m = stated_m * METRES_OF_A_FOOT
        nearest_m = min(grounds_m, key=lambda height_m: abs(height_m - converted_m))
        fits_in_feet = abs(nearest_m - converted_m) < STATION_AT_GROUND_M
        fits_in_metres = any(
            abs(height_m - stated_m) < STATION_OFF_GROUND_M for height_m in grounds_m
        )
        if fits_in_feet and not fits_in_metres:
            yield messages.station_height_in_feet(
                where=f"atmosphere.surface[{number}].h_msl_m",
                stated_m=stated_m,
                ground_m=nearest_m,
                converted_m=converted_m,
            )


def field_of_view(facts: Facts) -> Findings:
    """A finding if a field of view is implausible, or pixels are not square within 2 %.

    Expected are 3 to 130 deg over the diagonal, 60 to 300 deg for fisheyes.
    """
    for name, camera in facts.cameras.items():
        view = facts.view_deg(name)
        key = facts.key_of(name, pixel_key="fx_px", metric_key="focal_mm")
        least = NARROWEST_VIEW_DEG
        most = WIDEST_VIEW_DEG
        if is_fisheye(camera):
            least = NARROWEST_FISHEYE_DEG
            most = WIDEST_FISHEYE_DEG
        if not least <= view <= most:
            yield messages.field_of_view(
                where=key,
                name=name,
                view=view,
                width_px=camera.width_px,
                height_px=camera.height_px,
                fx_px=camera.fx_px,
                least=least,
                most=most,
            )
        if abs(camera.fx_px / camera.fy_px - 1.0) > LARGEST_PIXEL_RATIO:
            yield messages.pixels_not_square(
                where=key, name=name, fx_px=camera.fx_px, fy_px=camera.fy_px
            )


def principal_point(facts: Facts) -> Findings:
    """A finding if a principal point is more than a tenth of the image from its centre.

    It says so if width and height of the image seem exchanged.
    """
    for name, camera in facts.cameras.items():
        off_x = abs(camera.cx_px / camera.width_px - 0.5)
        off_y = abs(camera.cy_px / camera.height_px - 0.5)
        off = max(off_x, off_y)
        if off > LARGEST_OFF_CENTRE and are_sides_exchanged(camera):
            yield messages.sides_exchanged(
                where=facts.key_of(name, pixel_key="width_px", metric_key="format_mm"),
                name=name,
                camera=camera,
            )
        elif off > LARGEST_OFF_CENTRE:
            yield messages.principal_point_off(
                where=facts.key_of(name, pixel_key="cx_px", metric_key="origin"),
                name=name,
                cx_px=camera.cx_px,
                cy_px=camera.cy_px,
                percent=100.0 * off,
            )


def are_sides_exchanged(camera: Camera) -> bool:
    """Whether the principal point is in the middle only if width and height are exchanged."""
    fits_exchanged_x = abs(camera.cx_px / camera.height_px - 0.5) < NEAR_MIDDLE
    fits_exchanged_y = abs(camera.cy_px / camera.width_px - 0.5) < NEAR_MIDDLE
    fits_stated = abs(camera.cx_px / camera.width_px - 0.5) < NEAR_MIDDLE
    return fits_exchanged_x and fits_exchanged_y and not fits_stated


def distortion(facts: Facts) -> Findings:
    """A finding if distortion is too small or too large, or its coefficients in another order.

    Expected at the corners are 1e-6 to 0.3 of their radius (up to 1 in views of 90 deg and more),
    and p1 and p2 up to 0.001, or three times k3. Fisheyes and views over 130 deg are not judged.
    """
    for name, camera in facts.cameras.items():
        coefficients = camera.distortion._asdict()
        view_deg = facts.view_deg(name)
        if not any(coefficients.values()) or view_deg > WIDEST_VIEW_DEG or is_fisheye(camera):
            continue
        share = distortion_at_corners(camera)
        largest = LARGEST_DISTORTION if view_deg < 90.0 else LARGEST_WIDE_DISTORTION
        if share != 0.0 and not SMALLEST_DISTORTION <= share <= largest:
            key = facts.key_of(name, pixel_key="distortion", metric_key="distortion")
            yield messages.distortion_size(where=key, name=name, share=share)
        tangential = max(abs(coefficients.get("p1", 0.0)), abs(coefficients.get("p2", 0.0)))
        over_radial = tangential > TANGENTIAL_OVER_RADIAL * abs(coefficients.get("k3", 0.0))
        if tangential > LARGEST_TANGENTIAL and over_radial:
            key = facts.key_of(name, pixel_key="distortion.k3", metric_key="distortion")
            yield messages.distortion_order(where=key, name=name, most=tangential)


def distortion_at_corners(camera: Camera) -> float:
    """The largest distortion at a corner of the image, as a share of the radius there."""
    u = np.array([0.5, 0.5, -0.5, -0.5]) * camera.width_px / camera.fx_px
    v = np.array([0.5, -0.5, 0.5, -0.5]) * camera.height_px / camera.fy_px
    u_d, v_d = camera.distort(u, v)
    return float(np.max(np.hypot(u_d - u, v_d - v) / np.hypot(u, v)))


def extent_of_observations(facts: Facts) -> Findings:
    """A finding if more than 1 % of the observations are outside the image, or none near its edges.

    The latter is judged from 100 observations on: they should reach 70 % of the image's width or
    height.
    """
    for name, camera in facts.cameras.items():
        rows = (facts.camera == name) & np.isfinite(facts.rows.x_px + facts.rows.y_px)
        x = facts.rows.x_px[rows]
        y = facts.rows.y_px[rows]
        if x.size == 0:
            continue
        width = camera.width_px
        height = camera.height_px
        outside = float(np.mean((x < 0) | (x > width) | (y < 0) | (y > height)))
        if outside > MOST_OUTSIDE:
            expected = "none outside"
            mistake = likely_cause_of_pixels_outside(x, y, width, height)
        else:
            filled = max(x.max() / width, y.max() / height)
            if x.size < MANY_ROWS or filled >= FILLED:
                continue
            expected = "to fill it"
            mistake = "measured in reduced images"
        yield messages.extent_of_observations(
            where=f"cameras.{name}.width_px",
            name=name,
            width_px=width,
            height_px=height,
            x=f"{x.min():.6g} to {x.max():.6g}",
            y=f"{y.min():.6g} to {y.max():.6g}",
            outside=100.0 * outside,
            expected=expected,
            mistake=mistake,
        )


def likely_cause_of_pixels_outside(x: Array, y: Array, width: int, height: int) -> str:
    """What pixels x, y (n,) likely are, in words, if many are outside an image.

    ``width`` and ``height`` are those of the image [px].
    """
    if x.min() < BEHIND_CENTRE * width and y.min() < BEHIND_CENTRE * height:
        return "measured from the centre of the image, not from its upper left corner"
    if x.max() <= height and y.max() <= width:
        return "width and height, or x and y, exchanged"
    return "millimetres, or images of another size"


def direction_of_cameras(facts: Facts) -> Findings:
    """A finding if a camera looks to the horizon or above, or not where its name suggests."""
    for name in facts.cameras:
        axis = facts.axis_deg(name)
        half_view = facts.view_deg(name) / 2.0
        named_nadir = any(word in name.lower() for word in ("nadir", "down", "vertical"))
        expected = ""
        # The horizon is within half the field of view of the axis, or within 10 deg.
        if axis > 90.0 - min(half_view, 10.0):
            expected = "down: likely 0 for a camera that looks down, not -90"
        elif axis > LARGEST_TILT_DEG and named_nadir:
            expected = f"within 30 deg of the nadir by the name of {name}"
        elif axis < SMALLEST_OBLIQUE_DEG and "oblique" in name.lower():
            expected = (
                f"more than 10 deg from the nadir, because of the name of {name}: likely radians, "
                "or exchanged"
            )
        if expected:
            key = facts.mission.attitude_key(name)
            yield messages.camera_direction(where=key, name=name, axis=axis, expected=expected)


def angles_of_mounts(facts: Facts) -> Findings:
    """A finding if an angle of a mount is a multiple of 15 deg when it is read in radians."""
    for name, mount in facts.mission.mount.items():
        for key in ("roll_deg", "pitch_deg", "yaw_deg"):
            value = getattr(mount, key)
            degrees_if_radians = math.degrees(value)
            steps = degrees_if_radians / ANGLE_STEP_DEG
            whole_steps = round(steps)
            # None (0) for a small (boresight) angle, which may have either unit.
            is_multiple = whole_steps != 0 and abs(steps - whole_steps) < LARGEST_STEP_ERROR
            if is_multiple and abs(value) <= math.tau:
                yield messages.angle_in_radians(
                    where=f"mount.{name}.{key}",
                    name=name,
                    angle=key,
                    value=value,
                    deg=degrees_if_radians,
                )


def lever_arms(facts: Facts) -> Findings:
    """A finding if a lever arm is longer than 10 m, or puts a camera above the antenna.

    The latter only for cameras that look down; up to 0.25 m above are allowed.
    """
    for name, mount in facts.mission.mount.items():
        key = f"mount.{name}.lever_arm_m"
        length = math.hypot(*mount.lever_arm_m)
        if length > LONGEST_LEVER_ARM_M:
            yield messages.lever_arm_long(where=key, name=name, length=length)
        up = -mount.lever_arm_m[2]
        looks_down = facts.mission.mounts[name].camera_from_body[2, 2] > LOOKS_DOWN
        if up > HIGHEST_CAMERA_M and looks_down:
            yield messages.lever_arm_above(where=key, name=name, up=up, most=HIGHEST_CAMERA_M)


def sigmas_and_delays(facts: Facts) -> Findings:
    """A finding if the sigma of the ground is over 50 m, or a delay of events over a second."""
    mission = facts.mission
    sigma = mission.ground.sigma_m or 0.0
    if sigma > LARGEST_GROUND_SIGMA_M:
        yield messages.ground_sigma_large(where="ground.sigma_m", sigma=sigma)
    if mission.events is None or mission.events.log is None:
        return
    for name, source in mission.events.log.items():
        if isinstance(source.delay_s, float) and abs(source.delay_s) > LONGEST_DELAY_S:
            key = f"events.log.{name}.delay_s"
            yield messages.delay_large(where=key, name=name, delay=source.delay_s)


def windows(facts: Facts) -> Findings:
    """A finding if the log has a cabin but no camera a window, or if a window is tilted too far.

    Allowed are 35 deg between the normal of the window and the optical axis, if the normal is
    stated in the frame of the camera.
    """
    mission = facts.mission
    channel = None if mission.log is None else mission.log.channels.cabin_pressure
    if channel is not None and not mission.windows:
        first = next(iter(mission.cameras))
        yield messages.window_missing(where=f"cameras.{first}.window")
    for name, window in mission.windows.items():
        if window.frame != "camera":
            continue
        tilt = math.degrees(math.acos(window.normal[2]))
        if tilt > MOST_WINDOW_TILT_DEG:
            where = f"cameras.{name}.{window.section}.frame"
            yield messages.window_leans(where=where, name=name, tilt=tilt)


def slant_ranges(facts: Facts) -> Findings:
    """A finding if measured slant ranges do not fit the heights of camera and ground.

    Their median may be 0.7 to 1.4 times that of straight rays over a flat earth. Rays more than 80
    deg from the nadir do not count.
    """
    straight_m = (facts.camera_height_m - facts.rows.h_g_m) / np.cos(facts.nadir_angle_rad)
    ratio = facts.rows.distance_m / straight_m
    ratio = ratio[np.isfinite(ratio) & (facts.nadir_angle_rad < LARGEST_NADIR_RAD)]
    if not ratio.size:
        return
    median = float(np.median(ratio))
    if not SMALLEST_RANGE_RATIO < median < LARGEST_RANGE_RATIO:
        yield messages.slant_ranges_off(where="observations.columns.distance_m", ratio=median)


def flagged_rows(facts: Facts) -> Findings:
    """A finding for each status that flags more than a fifth of the rows."""
    weight = facts.rows.weight
    for name, cause in causes_of_statuses(facts).items():
        flagged = facts.rows.status == STATUS_NAMES.index(name)
        share = float(np.sum(weight[flagged]) / np.sum(weight))
        if share > MOST_FLAGGED:
            yield messages.many_flagged(
                where="observations",
                percent=100.0 * share,
                name=name,
                most=100.0 * MOST_FLAGGED,
                cause=cause,
            )


def measured_observations(facts: Facts) -> Findings:
    """A finding if refraction is applied to observations of a flight with a log, not removed."""
    mission = facts.mission
    if mission.refraction.direction == "apply" and mission.stations.orientation is None:
        yield messages.refraction_applied_twice(where="refraction.direction")


RULES: tuple[Callable[[Facts], Findings], ...] = (
    ground_against_takeoff,
    ground_against_terrain,
    model_against_takeoff,
    heights_of_weather_stations,
    field_of_view,
    principal_point,
    distortion,
    extent_of_observations,
    direction_of_cameras,
    angles_of_mounts,
    lever_arms,
    sigmas_and_delays,
    windows,
    windows_of_compartments,
    lens_references,
    slant_ranges,
    flagged_rows,
    air_of_flight,
    measured_observations,
)
