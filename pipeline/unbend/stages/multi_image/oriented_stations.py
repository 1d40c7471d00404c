"""Stations from the orientation of a block: read, brought to each station's vertical, checked."""

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
from unbend.stages.multi_image.other_readings import (
    UNSTATED,
    StationsReading,
    readings_of_angles,
    refuse_other_reading,
)
from unbend.stages.multi_image.tie_point_checks import FEWEST_TIE_POINTS
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.imports.exif import gimbal_of_rpy, rpy_of_gimbal
from unbend.tables.imports.user_tables import OrientationTable
from unbend.tables.observations import Observations
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import DEGREE, RADIANS, Array, Integers

FEW_WRONG = 0.1  # share of the stations: so many may be wrong alone, below ground or too high
HIGHEST_ABOVE_GROUND_M = 15_000.0  # no survey is flown higher, in the median
METRES_OF_A_FOOT = 0.3048
SECTION = "stations.orientation"
HEIGHTS_TO_METRES = "the heights in the file to metres (times 0.3048)"  # they have no key of a unit


def oriented_stations(
    mission: Mission,
    inputs: OpenedInputs,
    flight: FlightLog,
    exposed: list[Stations],
    *,
    ties: TiePoints,
    ledger: Ledger,
) -> Stations:
    """The stations of `stations.orientation`; ``exposed`` are those of the events, if any.

    Refuses (ORIENTATION-READING) a table by which tie points meet far better in another reading.
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
    reader = Reader(mission, inputs, flight, section, exposed)
    stations = reader.stations(table, ledger)
    frame = None
    if not section.is_level:
        frame = reader.frame(table, Ledger())  # its notes were added with the stations
    rays = tie_rays(ties, stations.image, stations.camera, mission.interior_orientations)
    tie_points = np.unique(rays.point).size
    has_tie_points = tie_points >= FEWEST_TIE_POINTS
    ledger.extend(
        check_frame(
            inputs,
            section,
            named_as_in_block,
            stations,
            frame=frame,
            exposed=exposed,
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
                where=str(section.path), count=tie_points, needed=FEWEST_TIE_POINTS
            )
        )
        ledger.extend(unit_of_angles(section, table, stations))
        return stations
    readings = other_readings(section, table, reader)
    refuse_other_reading(stations, readings, rays, where=section.path)
    return stations


def unit_of_angles(
    section: OrientationSection, table: OrientationTable, stations: Stations
) -> Iterator[Message]:
    """A finding (ORIENTATION-UNIT) for each camera whose angles follow the flight only as radians.

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
            yield messages.orientation_unit(
                where=f"{SECTION}.unit",
                camera=camera or "the camera",
                count=int(rows.sum()),
                unit=section.unit,
            )


def has_ground_heights(mission: Mission, ties: TiePoints) -> bool:
    """Whether heights of the ground are given that tie points can be compared with."""
    ground = mission.ground
    if not ground.is_given:
        return False
    is_for_all = ground.constant_m is not None or ground.model is not None
    return is_for_all or bool(np.isfinite(ties.ground).any())


def other_readings(
    section: OrientationSection, table: OrientationTable, reader: "Reader"
) -> Iterator[StationsReading]:
    """What the table could mean instead of what the mission file states: angles and positions."""

    def reading(words: str, key: str, changed: OrientationTable) -> StationsReading:
        stations = partial(reader.stations, changed, Ledger())
        return StationsReading(words, f"{SECTION}.{key}", stations)

    if section.angles.startswith("quaternion"):
        inverse = replace(table, angles=table.angles * [1, -1, -1, -1])
        yield reading("if the quaternions turn the other way", UNSTATED, inverse)
    else:
        order = section.angles if section.angles.endswith("kappa") else None
        first, second, last = section.angle_names
        for words, key, change in readings_of_angles((first, second, last), section.unit, order):
            if section.format == "dji":  # the mistake would be one about the gimbal's angles
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


class Reader:
    """Makes stations of a table of orientations, in any reading of it.

    ``exposed`` are the stations of the events: they give the times that the table does not have.
    """

    def __init__(
        self,
        mission: Mission,
        inputs: OpenedInputs,
        flight: FlightLog,
        section: OrientationSection,
        exposed: list[Stations],
    ) -> None:
        self.mission = mission
        self.inputs = inputs
        self.flight = flight
        self.section = section
        self.exposed = exposed

    def stations(self, table: OrientationTable, ledger: Ledger) -> Stations:
        """The stations of a table, with each attitude against the station's own vertical."""
        section = self.section
        quaternion = quaternions_of_table(section, table)
        latitude, longitude, height_m = table.position.T
        tilt_rad = 0.0
        if section.is_level:
            convergence_rad = section.convergence_deg * DEGREE + table.convergence_rad
            turn = rotations.enu_from_grid(convergence_rad)
            quaternion = rotations.in_turned_frame(quaternion, turn.swapaxes(-1, -2))
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
        """The frame of the angles of a table that are not against each station's vertical."""
        return frame_of_block(
            self.inputs, self.flight, self.section, table, exposed=self.exposed, ledger=ledger
        )

    def times(self, table: OrientationTable) -> Integers:
        """(n,) times of the images [Unix ns].

        They are the table's, if it has times or there are no events; else those of the events,
        `NO_TIME` for an image without an event.
        """
        table_has_times = self.section.has_clock or bool((table.time_ns != NO_TIME).any())
        if table_has_times or not self.exposed:
            return table.time_ns
        time_of_image: dict[str, int] = {}
        for stations in self.exposed:
            time_of_image.update(zip(stations.image, stations.time_ns, strict=True))
        return np.array([time_of_image.get(name, NO_TIME) for name in table.image], np.int64)


def quaternions_of_table(section: OrientationSection, table: OrientationTable) -> Array:
    """(n, 4) attitudes of a table in its frame: of cameras; of the aircraft by its angles."""
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
    """Compare the stations with the given ground; returns them, some perhaps suspect.

    In this order:

    * refused (ORIENTATION-HEIGHT) if more than a tenth of the stations are below the ground;
    * if a few, at most a tenth, are far too high, these become suspect, with a loss;
    * else a note of the heights above ground; a warning if some are below it or too high.

    Nothing is compared where no height of the ground is given.
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
    above_ok = above_m[stations.ok]
    median = float(np.median(above_ok))
    lowest = float(above_ok.min())
    highest = float(above_ok.max())
    below = int((above_ok <= 0.0).sum())
    if below > FEW_WRONG * above_ok.size:
        raise messages.stations_below_ground(
            where=SECTION,
            count=below,
            total=above_ok.size,
            median=median,
            low=lowest,
            high=highest,
        )
    with np.errstate(invalid="ignore"):
        too_high = stations.ok & (above_m > HIGHEST_ABOVE_GROUND_M)
    count = int(too_high.sum())
    if 0 < count <= FEW_WRONG * above_ok.size:
        ledger.add(
            messages.stations_too_high(
                where=SECTION,
                count=count,
                first=str(stations.image[too_high][0]),
                median=median,
                low=lowest,
                high=highest,
            )
        )
        use = mission.stations.use_suspect
        return stations.as_suspect(too_high, "far above the others", np.nan, use=use)
    is_odd = below > 0 or count > 0
    ledger.add(
        messages.heights_above_ground(
            kind=Kind.WARNING if is_odd else Kind.NOTE,
            where=SECTION,
            count=above_ok.size,
            median=median,
            low=lowest,
            high=highest,
        )
    )
    return stations


def sigmas_of_block(
    section: OrientationSection, table: OrientationTable, tilt_rad: float
) -> dict[str, Array]:
    """Standard deviations of images by their names in `Stations`, (n,) each; NaN where unknown.

    Each is a column of the table, or the constant of the mission file. ``tilt_rad`` is how far the
    vertical of the frame may lean; it adds to the sigma of the tilt.
    """
    stated_sigmas = {
        "sigma_tilt_rad": in_units(section.sigma_tilt_deg, DEGREE),
        "sigma_yaw_rad": in_units(section.sigma_yaw_deg, DEGREE),
        "sigma_horizontal_m": in_units(section.sigma_horizontal_m, 1.0),
        "sigma_height_m": in_units(section.sigma_height_m, 1.0),
    }
    sigmas = {}
    for name, constant in stated_sigmas.items():
        sigmas[name] = table.sigmas.get(name, np.full(len(table.image), constant))
    if tilt_rad > 0.0:
        sigmas["sigma_tilt_rad"] = np.hypot(np.nan_to_num(sigmas["sigma_tilt_rad"]), tilt_rad)
    return sigmas


def in_units(value: float | None, size: float) -> float:
    """A number times the size of its unit; NaN for None."""
    return np.nan if value is None else value * size
