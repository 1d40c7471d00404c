"""Stations that were likely stated in the wrong UTM zone, found by their soundings."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from unbend.atmosphere.estimate.external_readings import WARN_SOUNDING_M, TimeAndPlace
from unbend.atmosphere.soundings import Sounding
from unbend.config import Mission
from unbend.messages import Ledger, Message
from unbend.stages import messages
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.map_grids import utm_zone_of

ZONES = 60  # round the earth
ZONE_WIDTH_RAD = 2.0 * math.pi / ZONES
NEAR_M = 150e3  # a far sounding is hardly so near in the neighbouring zone by chance
NEAR_SHARE = 0.45  # of the distance in the stated zone: in the north the zones are narrow


def system_of_stations(mission: Mission, inputs: OpenedInputs) -> tuple[str, str]:
    """The key that states the coordinate system of the stations, and the system itself.

    Both are empty if the positions come from a log, the system if none is stated.
    """
    orientation = mission.stations.orientation
    if orientation is not None:
        of_block = None if inputs.orientation is None else inputs.orientation.crs
        return "stations.orientation.crs", orientation.crs or of_block or ""
    trajectory = mission.stations.trajectory
    has_log = mission.log is not None  # its positions show a wrong zone of the trajectory
    if trajectory is not None and trajectory.moves_stations and not has_log:
        return "stations.trajectory.crs", trajectory.crs or ""
    return "", ""


def zone_findings(
    crs: str, where: str, soundings: Sequence[Sounding], flight: TimeAndPlace, ledger: Ledger
) -> Iterator[Message]:
    """A finding if all soundings are far, but one is near in a neighbouring UTM zone.

    There the same x and y are 6 degrees of longitude away. ``crs`` is the stated coordinate system,
    ``where`` its key. No finding if the positions of the images are confirmed (FRAME-CONFIRMED in
    the ledger).
    """
    zone = utm_zone_of(crs) if crs else None
    if zone is None or any(entry.code == "FRAME-CONFIRMED" for entry in ledger):
        return
    number, hemisphere = zone
    nearest_sounding_m = nearest_m(soundings, flight)
    if not WARN_SOUNDING_M < nearest_sounding_m < math.inf:
        return
    for step in (-1, 1):
        longitude_rad = flight.longitude_rad + step * ZONE_WIDTH_RAD
        longitude_rad = math.remainder(longitude_rad, 2.0 * math.pi)
        in_neighbour = replace(flight, longitude_rad=longitude_rad)
        neighbour_m = nearest_m(soundings, in_neighbour)
        if neighbour_m < min(NEAR_M, NEAR_SHARE * nearest_sounding_m):
            neighbour = (number + step - 1) % ZONES + 1  # zones count from 1 to 60
            yield messages.neighbouring_zone(
                where=where,
                zone=f"{number}{hemisphere}",
                neighbour=f"{neighbour}{hemisphere}",
                latitude_deg=math.degrees(flight.latitude_rad),
                longitude_deg=math.degrees(flight.longitude_rad),
                away_km=nearest_sounding_m / 1e3,
                neighbour_deg=math.degrees(longitude_rad),
                neighbour_km=neighbour_m / 1e3,
            )


def nearest_m(soundings: Sequence[Sounding], place: TimeAndPlace) -> float:
    """How far the nearest sounding is from a place [m]; infinite if none has a known place."""
    distances_m = []
    for sounding in soundings:
        distance_m = place.metres_from(sounding.latitude_rad, sounding.longitude_rad)
        if math.isfinite(distance_m):
            distances_m.append(distance_m)
    return min(distances_m, default=math.inf)
