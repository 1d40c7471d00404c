"""Rules of plausibility on heights: of the ground, the terrain, the model and weather stations."""

import math
from collections.abc import Iterator

import numpy as np

from unbend.flight.ground_times import Takeoff
from unbend.geodesy import wrapped
from unbend.messages import Message
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.causes import EARTH_RADIUS_M
from unbend.stages.plausibility.facts import Facts
from unbend.units import METRES_OF_A_FOOT

TAKEOFF_NEAR_KM = 30.0  # farther away the take-off says nothing about the ground
GROUND_ALLOWED_M = 300.0  # difference of the heights of ground and take-off, at the take-off
GROUND_ALLOWED_M_PER_KM = 20.0  # to be added for each kilometre from the take-off
TERRAIN_ALLOWED_M = 50.0  # between the heights of ground and terrain at the same place
SEES_STATION_RAD = 0.5  # rays within so much of the nadir see the ground near their station
LIKELY_SHARE = 0.5  # of a difference: a likely mistake leaves no more unexplained
STATION_AT_GROUND_M = 100.0  # a weather station in feet, converted: difference from the ground
STATION_OFF_GROUND_M = 300.0  # and the same height read in metres


def ground_against_takeoff(facts: Facts) -> Iterator[Message]:
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


def ground_against_terrain(facts: Facts) -> Iterator[Message]:
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


def model_against_takeoff(facts: Facts) -> Iterator[Message]:
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


def heights_of_weather_stations(facts: Facts) -> Iterator[Message]:
    """A warning for a weather station with a height that fits the ground only in feet.

    The ground is that of the observations, or the take-off. In metres the station is more than
    300 m from both, in feet within 100 m of one of them. So heights below 430 ft are not noticed.
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
