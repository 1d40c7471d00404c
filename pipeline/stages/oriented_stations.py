"""Stations from the orientation of a block: read, brought to each station's vertical, checked."""

from __future__ import annotations

import numpy as np

from pipeline.batch.plan import Plan
from pipeline.block.oriented_block import (
    ECEF,
    CartesianFrame,
    OrientedImages,
    fitted_frame,
    flag_above_horizon,
    stations_of_images,
    topocentric,
    turn_notes,
)
from pipeline.config.station_sources import EnuFrame, KnownPositions, OrientationSection
from pipeline.errors import MissionError
from pipeline.flight.channels import Array
from pipeline.flight.heights import ground_offsets
from pipeline.flight.rotations import (
    enu_from_grid,
    in_turned_frame,
    quaternion_of_opk,
    quaternion_of_rpy,
)
from pipeline.flight.stations import NO_TIME, Stations, join_stations
from pipeline.ledger import Ledger
from pipeline.stages.inputs import FlightLog
from pipeline.tables.imports.orientation import (
    OrientationTable,
    read_known_positions,
    read_orientation,
)
from pipeline.tables.observations import Observations
from pipeline.units import DEGREE

_FEW_BELOW_GROUND = 0.1
_SIGMA_OF_LOG_M = 1.5
"""Positions of an autopilot that fuses a receiver without corrections."""

_HIGHEST_ABOVE_GROUND_M = 15_000.0
"""No survey is flown higher, in the median, than that above its ground."""


def oriented_stations(
    plan: Plan, flight: FlightLog, exposed: list[Stations], ledger: Ledger
) -> Stations:
    """The stations of `stations.orientation`; ``exposed`` are those of the events, if any.

    The events give the times of images for which the table has none.
    """
    mission, section = plan.mission, plan.mission.stations.orientation
    if section is None:
        raise MissionError("EVENTS-NONE", "the mission names no orientation", where="stations")
    source = plan.input("orientation").path
    names, angle_names = section.column_names, section.angle_names
    table = ledger.take(read_orientation(source, names, angle_names, unit=section.unit))
    of_body = section.angles == "roll_pitch_yaw"
    if of_body:
        quaternion = quaternion_of_rpy(table.angles, np.eye(3))
    elif section.angles.startswith("quaternion"):
        sense = 1.0 if section.angles == "quaternion" else -1.0
        quaternion = table.angles * [1.0, sense, sense, sense]
    else:
        quaternion = quaternion_of_opk(table.angles, section.angles)
    lat, lon, h = table.position.T
    tilt_rad = 0.0
    if section.frame == "geographic":
        quaternion = in_turned_frame(quaternion, enu_from_grid(section.convergence_deg * DEGREE).T)
    else:
        frame = frame_of_block(plan, section, table, exposed, ledger)
        tilt_rad = frame.tilt_rad
        if not section.is_geodetic:
            lat, lon, h = frame.geodetic(table.position)
        quaternion = frame.local_attitude(quaternion, lat, lon)
    only = np.full(len(table.image), section.camera or next(iter(mission.cameras)), dtype=object)
    camera = only if table.camera is None else table.camera
    for name in sorted(set(camera.tolist()) - set(mission.cameras)):
        raise MissionError(
            "EVENTS-CAMERA",
            f"the orientation names camera {name!r}, which the mission file does not define",
            where=section.path,
            remedy=f"cameras are {', '.join(mission.cameras)}",
        )
    time_ns = table.time_ns
    if exposed and not section.has_clock:
        known = {n: t for part in exposed for n, t in zip(part.image, part.time_ns, strict=True)}
        time_ns = np.array([known.get(name, NO_TIME) for name in table.image], np.int64)
    is_msl = section.is_geodetic and section.heights == "msl"
    images = OrientedImages(
        table.image, camera, time_ns, lat, lon, h, is_msl, quaternion, of_body,
        sigmas_of_block(section, table, tilt_rad),
    )  # fmt: skip
    mounts = {name: mount.build() for name, mount in mission.mount.items()}
    stations = stations_of_images(images, mounts, flight.heights)
    stations = ledger.take(flag_above_horizon(stations))
    ledger.extend(turn_notes(stations))
    return stations


def report_height_above_ground(
    plan: Plan, flight: FlightLog, stations: Stations, observations: Observations, ledger: Ledger
) -> None:
    """Tell how high the cameras are above the ground; refuses those that are in it.

    The ground is that of the mission file, or of the first observations.
    """
    section = plan.mission.ground
    batch = next(observations.batches(plan.mission.output.batch_rows))
    given = batch.ground if batch.ground is not None else np.array([section.constant_m], np.float64)
    given = given[np.isfinite(given)]
    if section.from_distance or given.size == 0 or not bool(stations.ok.any()):
        return
    ground = ground_offsets(section.reference, stations, flight.heights) + np.median(given)
    above = (stations.h_msl_m - ground)[stations.ok]
    low = int((above <= 0.0).sum())
    what = (
        f"the cameras are {np.median(above):.0f} m above the ground in the median, "
        f"{above.min():.0f} to {above.max():.0f} m"
    )
    where = "stations.orientation"
    if low > _FEW_BELOW_GROUND * above.size:
        raise MissionError(
            "ORIENTATION-HEIGHT",
            f"{low} of {above.size} stations lie below the ground: {what}",
            where=where,
            remedy="check the column of heights, their unit (metres), heights (msl or ellipsoid), "
            "and the ground's",
        )
    strange = low > 0 or np.median(above) > _HIGHEST_ABOVE_GROUND_M
    tell = ledger.warning if strange else ledger.note
    tell("ORIENTATION-HEIGHT", what, where=where, count=above.size)


def frame_of_block(
    plan: Plan,
    section: OrientationSection,
    table: OrientationTable,
    exposed: list[Stations],
    ledger: Ledger,
) -> CartesianFrame:
    """The frame of the angles, where it is not each station's own."""
    if isinstance(section.frame, EnuFrame):
        return topocentric(section.frame.enu.build())
    if section.frame == "ecef":
        return ECEF
    known = section.known_positions
    if isinstance(known, KnownPositions):
        names = known.model_dump(exclude={"path"})
        image, position = read_known_positions(plan.input("known positions").path, names)
        if section.heights == "msl":
            undulation = plan.mission.mission.undulation_m
            if undulation is None:
                raise MissionError(
                    "HEIGHT-REFERENCE",
                    "the known positions are above mean sea level, and nothing says how high that "
                    "is above the ellipsoid",
                    where="stations.orientation.known_positions",
                    remedy="give mission.undulation_m (ellipsoidal minus mean sea level)",
                )
            position[:, 2] += undulation
    else:
        of_log = join_stations(exposed)
        image = of_log.image[of_log.ok]
        geodetic = [of_log.lat_rad, of_log.lon_rad, of_log.h_ellipsoid_m]
        position = np.stack(geodetic, axis=1)[of_log.ok]
    sigma_m = _SIGMA_OF_LOG_M if section.known_positions == "log" else 0.0
    return ledger.take(fitted_frame(table.image, table.position, image, position, sigma_m=sigma_m))


def sigmas_of_block(
    section: OrientationSection, table: OrientationTable, tilt_rad: float
) -> dict[str, Array]:
    """Standard deviations by the names of `Stations`: a column, or a constant, or unknown."""
    degrees = {"sigma_tilt_rad": section.sigma_tilt_deg, "sigma_yaw_rad": section.sigma_yaw_deg}
    stated = {name: None if value is None else value * DEGREE for name, value in degrees.items()}
    stated |= {name: getattr(section, name) for name in ("sigma_horizontal_m", "sigma_height_m")}
    sigmas: dict[str, Array] = {}
    for name, constant in stated.items():
        value = np.nan if constant is None else constant
        sigmas[name] = table.sigmas.get(name, np.full(len(table.image), value))
    if tilt_rad > 0.0:
        sigmas["sigma_tilt_rad"] = np.hypot(np.nan_to_num(sigmas["sigma_tilt_rad"]), tilt_rad)
    return sigmas
