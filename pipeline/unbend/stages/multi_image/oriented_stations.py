"""Stations from a table of orientations: converted to each station's vertical, and checked."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from unbend.block import oriented_images
from unbend.block.angle_unit import are_radians
from unbend.block.oriented_images import CartesianFrame, OrientedImages
from unbend.config import Mission
from unbend.config.orientations import OrientationSection
from unbend.flight import heights, rotations
from unbend.flight.heights import GeodeticOrigin
from unbend.flight.image_names import renamed_like_images
from unbend.flight.stations import NO_TIME, Stations
from unbend.messages import Kind, Ledger, Message
from unbend.stages.exposure_events import camera_of_rows
from unbend.stages.flight_log import FlightLog
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.block_frames import (
    check_frame,
    frame_of_block,
    in_wgs84,
    orientation_table,
    section_of_block,
)
from unbend.stages.multi_image.misplaced_images import misplaced_images
from unbend.stages.multi_image.other_readings import (
    UNSTATED,
    StationsReading,
    intersected,
    readings_of_angles,
    refuse_other_reading,
)
from unbend.stages.multi_image.tie_point_checks import FEWEST_TIE_POINTS
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.imports.exif import gimbal_of_rpy, rpy_of_gimbal
from unbend.tables.imports.user_tables import OrientationTable
from unbend.tables.observations import Observations
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import DEGREE, METRES_OF_A_FOOT, RADIANS, Array, Integers

FEW_WRONG = 0.1  # share of the stations: more below the ground, or too high, are one mistake
HIGHEST_ABOVE_GROUND_M = 15_000.0  # no survey is flown higher, in the median
SECTION = "stations.orientation"
HEIGHTS_TO_METRES = "the heights in the file to metres (times 0.3048)"  # no key states their unit


def oriented_stations(
    mission: Mission,
    inputs: OpenedInputs,
    flight: FlightLog,
    event_stations: list[Stations],
    *,
    ties: TiePoints,
    ledger: Ledger,
) -> Stations:
    """The stations of the table under stations.orientation, checked by all that is known.

    ``event_stations`` are the stations by the log, camera by camera; empty without events. Refuses
    (ORIENTATION-READING) a table if tie points meet far better by another reading of it.
    """
    section = section_of_block(mission, inputs)
    observations = inputs.observations
    table = orientation_table(section, inputs)
    if isinstance(table.frame, GeodeticOrigin) and section.frame == "geographic":
        latitude_deg = table.frame.lat_rad / DEGREE
        raise messages.angles_of_one_frame(
            where=section.path, stated=section.frame, latitude_deg=latitude_deg
        )
    table = ledger.take(in_wgs84(section, table, inputs.geoid))
    ledger.extend(table.notes)
    named_as_in_block = table
    renamed_images = renamed_like_images(
        table.image, observations.images, mission.observations.match_names, SECTION
    )
    table = replace(table, image=ledger.take(renamed_images))
    reader = OrientationReader(mission, inputs, flight, section, event_stations)
    stations = reader.stations(table, ledger)
    frame = None
    if not section.is_level:
        frame = reader.frame(table, Ledger())  # its notes were added with the stations
    rays = tie_rays(ties, stations.image, stations.camera, mission.interior_orientations)
    tie_point_count = np.unique(rays.point).size
    has_tie_points = tie_point_count >= FEWEST_TIE_POINTS
    ledger.extend(
        check_frame(
            inputs,
            section,
            named_as_in_block,
            stations,
            frame=frame,
            event_stations=event_stations,
            has_control=mission.control is not None,
            has_tested_heights=has_tie_points and has_ground_heights(mission, ties),
        )
    )
    use_suspect = mission.stations.use_suspect
    stations = ledger.take(oriented_images.flag_far_images(stations, use=use_suspect))
    stations = check_height_above_ground(mission, flight, stations, observations, ledger)
    if not has_tie_points:
        ledger.add(
            messages.orientation_unchecked(
                where=str(section.path), count=tie_point_count, needed=FEWEST_TIE_POINTS
            )
        )
        ledger.extend(unit_of_angles(section, table, stations))
        return stations
    readings = other_readings(section, table, reader)
    as_stated = intersected(stations, rays)
    refuse_other_reading(as_stated, readings, rays, where=section.path)
    ledger.extend(misplaced_images(as_stated, stations, rays, where=str(section.path)))
    return stations


def unit_of_angles(
    section: OrientationSection, table: OrientationTable, stations: Stations
) -> Iterator[Message]:
    """A finding (ORIENTATION-RADIANS) for each camera with angles that are likely radians.

    That is if its headings follow the flight lines as radians, and not in the stated unit.
    ``stations`` are those of the table, in its order.
    """
    if section.unit == "rad" or section.angles.startswith("quaternion"):
        return
    as_in_file = table.angles / RADIANS[section.unit]
    heading_sign = 1.0 if section.angles == "roll_pitch_yaw" else -1.0
    for camera in dict.fromkeys(stations.camera):
        rows = stations.camera == camera
        radians = are_radians(
            as_in_file[rows],
            heading_sign,
            stations.lat_rad[rows],
            stations.lon_rad[rows],
            usable=stations.ok[rows],
        )
        if radians:
            yield messages.orientation_in_radians(
                where=f"{SECTION}.unit",
                camera=camera or "the camera",
                unit=section.unit,
            )


def has_ground_heights(mission: Mission, ties: TiePoints) -> bool:
    """Whether the mission has heights of the ground to compare tie points with."""
    ground = mission.ground
    if not ground.is_given:
        return False
    is_for_all = ground.constant_m is not None or ground.model is not None
    return is_for_all or bool(np.isfinite(ties.ground).any())


def other_readings(
    section: OrientationSection, table: OrientationTable, reader: "OrientationReader"
) -> Iterator[StationsReading]:
    """Other readings of angles and positions of a table than the mission file states.

    ``reader`` makes stations of a changed table, when they are needed.
    """

    def reading(words: str, key: str, changed: OrientationTable) -> StationsReading:
        """A reading by a ``changed`` table; ``key`` of the section is to be changed then."""
        stations = partial(reader.stations, changed, Ledger())
        return StationsReading(words, f"{SECTION}.{key}", stations)

    if section.angles.startswith("quaternion"):
        inverse = replace(table, angles=table.angles * [1, -1, -1, -1])
        yield reading("if the quaternions turn the other way", UNSTATED, inverse)
    else:
        order = section.angles if section.angles.endswith("kappa") else None
        first, second, last = section.angle_names
        readings = readings_of_angles((first, second, last), section.unit, order, unit_key="unit")
        for words, key, change in readings:
            if section.format == "dji":  # its file has the angles of the gimbal
                angles = rpy_of_gimbal(change(gimbal_of_rpy(table.angles)))
            else:
                angles = change(table.angles)
            yield reading(words, key, replace(table, angles=angles))
    if section.is_geodetic:
        swapped = replace(table, position=table.position[:, [1, 0, 2]])
        key = "columns (latitude, longitude)"
        yield reading("with latitude and longitude exchanged", key, swapped)
        in_feet = replace(table, position=table.position * [1, 1, METRES_OF_A_FOOT])
        stations = partial(reader.stations, in_feet, Ledger())
        yield StationsReading("if the heights are in feet", HEIGHTS_TO_METRES, stations)


class OrientationReader:
    """Makes stations of a table of orientations, as stated or with changed numbers.

    ``event_stations`` are the stations by the log: they give times if the table has none.
    """

    def __init__(
        self,
        mission: Mission,
        inputs: OpenedInputs,
        flight: FlightLog,
        section: OrientationSection,
        event_stations: list[Stations],
    ) -> None:
        self.mission = mission
        self.inputs = inputs
        self.flight = flight
        self.section = section
        self.event_stations = event_stations

    def stations(self, table: OrientationTable, ledger: Ledger) -> Stations:
        """The stations of a table, with attitudes relative to the vertical of each station."""
        section = self.section
        quaternion = quaternions_of_table(section, table)
        latitude, longitude, height_m = table.position.T
        tilt_rad = 0.0
        if section.is_level:
            convergence_rad = section.convergence_deg * DEGREE + table.convergence_rad
            enu_from_grid = rotations.enu_from_grid(convergence_rad)
            grid_from_enu = enu_from_grid.swapaxes(-1, -2)
            quaternion = rotations.in_turned_frame(quaternion, grid_from_enu)
        else:
            frame = self.frame(table, ledger)
            tilt_rad = frame.tilt_rad
            if not section.is_geodetic:
                latitude, longitude, height_m = frame.geodetic(table.position)
            quaternion = frame.local_attitude(quaternion, latitude, longitude)
        camera = camera_of_rows(
            self.mission, table.camera, section.camera, len(table.image), where=section.path
        )
        images = OrientedImages(
            image=table.image,
            camera=camera,
            time_ns=self.times(table),
            lat_rad=latitude,
            lon_rad=longitude,
            h_m=height_m,
            is_msl=section.is_msl(table.heights),
            quaternion=quaternion,
            of_body=section.angles == "roll_pitch_yaw",
            sigmas=sigmas_of_block(section, table, tilt_rad),
        )
        stations = oriented_images.stations_of_images(
            images, self.mission.mounts, self.flight.heights
        )
        stations = ledger.take(oriented_images.flag_above_horizon(stations))
        oriented_images.refuse_turned_images(stations)
        return stations

    def frame(self, table: OrientationTable, ledger: Ledger) -> CartesianFrame:
        """The frame of a table with angles that are not relative to each station's vertical."""
        return frame_of_block(
            self.inputs,
            self.flight,
            self.section,
            table,
            event_stations=self.event_stations,
            ledger=ledger,
        )

    def times(self, table: OrientationTable) -> Integers:
        """(n,) times of the images [Unix ns].

        They are the times of the table, if it has any or if there are no events. Else they are the
        times of the events, and `NO_TIME` for an image without an event.
        """
        table_has_times = self.section.has_clock or bool((table.time_ns != NO_TIME).any())
        if table_has_times or not self.event_stations:
            return table.time_ns
        time_of_image: dict[str, int] = {}
        for stations in self.event_stations:
            time_of_image.update(zip(stations.image, stations.time_ns, strict=True))
        return np.array([time_of_image.get(name, NO_TIME) for name in table.image], np.int64)


def quaternions_of_table(section: OrientationSection, table: OrientationTable) -> Array:
    """(n, 4) attitudes relative to the frame of a table, of the cameras.

    Roll, pitch and yaw give attitudes of the aircraft instead.
    """
    if section.angles == "roll_pitch_yaw":
        return rotations.quaternion_of_rpy(table.angles, np.eye(3))
    if section.angles == "quaternion":
        return table.angles
    if section.angles == "quaternion_to_frame":
        return table.angles * [1.0, -1.0, -1.0, -1.0]
    return rotations.quaternion_of_opk(table.angles, section.angles)


def check_height_above_ground(
    mission: Mission,
    flight: FlightLog,
    stations: Stations,
    observations: Observations,
    ledger: Ledger,
) -> Stations:
    """Compare the heights of stations with the stated ground.

    In this order:

    * refuses (ORIENTATION-HEIGHT) stations of which more than a tenth are below the ground;
    * a loss if up to a tenth are more than 15 km above the ground: these are returned as suspect;
    * else a note of the heights above ground, or a warning if some are below it or too high.

    Nothing is compared if no height of the ground is stated, or slant ranges give it.
    """
    section = mission.ground
    batch = next(observations.batches(mission.output.batch_rows))
    ground_m = batch.ground
    if ground_m is None:
        ground_m = np.array([section.constant_m], np.float64)
    ground_m = ground_m[np.isfinite(ground_m)]
    if section.from_distance or ground_m.size == 0 or not bool(stations.ok.any()):
        return stations
    offset_m = heights.ground_offsets(section.reference_of_values, stations, flight.heights)
    above_m = stations.h_msl_m - (offset_m + np.median(ground_m))
    above_of_usable_m = above_m[stations.ok]
    median = float(np.median(above_of_usable_m))
    lowest = float(above_of_usable_m.min())
    highest = float(above_of_usable_m.max())
    count_below = int((above_of_usable_m <= 0.0).sum())
    if count_below > FEW_WRONG * above_of_usable_m.size:
        raise messages.stations_below_ground(
            where=SECTION,
            count=count_below,
            total=above_of_usable_m.size,
            median=median,
            low=lowest,
            high=highest,
        )
    with np.errstate(invalid="ignore"):
        too_high = stations.ok & (above_m > HIGHEST_ABOVE_GROUND_M)
    count_too_high = int(too_high.sum())
    if 0 < count_too_high <= FEW_WRONG * above_of_usable_m.size:
        ledger.add(
            messages.stations_too_high(
                where=SECTION,
                count=count_too_high,
                first=str(stations.image[too_high][0]),
                median=median,
                low=lowest,
                high=highest,
            )
        )
        use = mission.stations.use_suspect
        return stations.as_suspect(too_high, "far above the others", np.nan, use=use)
    is_odd = count_below > 0 or count_too_high > 0
    ledger.add(
        messages.heights_above_ground(
            kind=Kind.WARNING if is_odd else Kind.NOTE,
            where=SECTION,
            count=above_of_usable_m.size,
            median=median,
            low=lowest,
            high=highest,
        )
    )
    return stations


def sigmas_of_block(
    section: OrientationSection, table: OrientationTable, tilt_rad: float
) -> dict[str, Array]:
    """Standard deviations of images, (n,) each, by their field of `Stations`; NaN if unknown.

    Each is a column of the table, else the constant of the mission file. ``tilt_rad`` is the
    standard deviation of the vertical of the frame; it enlarges the sigma of the tilt.
    """
    stated_sigmas = {
        "sigma_tilt_rad": value_in_si(section.sigma_tilt_deg, DEGREE),
        "sigma_yaw_rad": value_in_si(section.sigma_yaw_deg, DEGREE),
        "sigma_horizontal_m": value_in_si(section.sigma_horizontal_m, 1.0),
        "sigma_height_m": value_in_si(section.sigma_height_m, 1.0),
    }
    sigmas = {}
    for name, constant in stated_sigmas.items():
        sigmas[name] = table.sigmas.get(name, np.full(len(table.image), constant))
    if tilt_rad > 0.0:
        sigmas["sigma_tilt_rad"] = np.hypot(np.nan_to_num(sigmas["sigma_tilt_rad"]), tilt_rad)
    return sigmas


def value_in_si(value: float | None, unit_size: float) -> float:
    """A number times the size of its unit; NaN for None."""
    return np.nan if value is None else value * unit_size
