"""Stations from the orientation of a block: read, brought to each station's vertical, checked."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pyarrow as pa

from unbend.block import oriented_images
from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.image_rays import orientations_of, straightened
from unbend.block.intersection import intersect
from unbend.block.oriented_images import SIGMAS_OF_BLOCK, CartesianFrame, OrientedImages
from unbend.config import Mission
from unbend.config.local_frames import EnuFrame
from unbend.config.orientations import KnownPositions, OrientationSection
from unbend.errors import InputError, MissionError
from unbend.flight import heights, rotations
from unbend.flight.image_names import renamed
from unbend.flight.stations import NO_TIME, Stations, join_stations
from unbend.geodesy import GeoidGrid
from unbend.messages import Ledger, Notes
from unbend.stages.exposure_setup import camera_of_rows
from unbend.stages.inputs import FlightLog
from unbend.stages.multi_image.tie_point_checks import FEWEST_TIE_POINTS
from unbend.stages.opened_inputs import OpenedInputs
from unbend.tables.geodata.coordinate_systems import places_of
from unbend.tables.geodata.object_points import ObjectPoints
from unbend.tables.imports.user_tables import OrientationTable
from unbend.tables.observations import Observations
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import DEGREE, RADIANS, Array

_FEW_BELOW_GROUND = 0.1
_GOOD_FACTOR = 2.0  # residuals over those of an adjusted block, that another reading may have
_SIGMA_OF_LOG_M = 1.5  # positions of an autopilot that fuses a receiver without corrections
_HIGHEST_ABOVE_GROUND_M = 15_000.0  # no survey is flown higher, in the median
_KEYS_OF_READINGS = {"angles are in": "unit", "longitude": "columns (latitude, longitude)"}


def oriented_stations(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, exposed: list[Stations], *,
    observations: Observations, ties: TiePoints, ledger: Ledger,
) -> Stations:  # fmt: skip
    """The stations of `stations.orientation`; ``exposed`` are those of the events, if any.

    Refuses (ORIENTATION-READING) a table by which tie points meet far better in another reading.
    """
    section = mission.stations.orientation
    if section is None:
        raise MissionError("EVENTS-NONE", "the mission names no orientation", where="stations")
    table = ledger.take(in_wgs84(section, orientation_table(section, inputs), inputs.geoid))
    differences = mission.observations.match_names
    image = renamed(table.image, observations.images, differences, "stations.orientation")
    table = replace(table, image=ledger.take(image))
    stations = stations_of_table(
        mission, inputs, flight, section, table, exposed=exposed, ledger=ledger
    )
    stations = ledger.take(
        oriented_images.flag_far_images(stations, use=mission.stations.use_suspect)
    )
    stations = check_height_above_ground(mission, flight, stations, observations, ledger)
    rays = tie_rays(ties, stations.image, stations.camera, mission.interior_orientations)
    if np.unique(rays.point).size < FEWEST_TIE_POINTS:
        return stations
    found = {}
    for what, reading in {"as stated": table, **other_readings(section, table)}.items():
        with suppress(MissionError):
            other = stations if reading is table else stations_of_table(
                mission, inputs, flight, section, reading, exposed=exposed, ledger=Ledger()
            )  # fmt: skip
            orientations = orientations_of(other, SIGMAS_OF_BLOCK)
            straight = straightened(orientations, replace(rays, height_m=None))
            found[what] = intersect(orientations, straight)
    likely = max(found, key=lambda what: found[what].log_likelihood)
    better = found[likely].log_likelihood - found["as stated"].log_likelihood
    if better > LOG_RATIO_NEEDED and found[likely].sigma_factor < _GOOD_FACTOR:
        keys = (key for words, key in _KEYS_OF_READINGS.items() if words in likely)
        key = next(keys, "angles or columns")
        raise InputError.of(
            "ORIENTATION-READING", section.path, points=np.unique(rays.point).size, likely=likely,
            better=better, changed=key,
        )  # fmt: skip
    return stations


def orientation_table(section: OrientationSection, inputs: OpenedInputs) -> OrientationTable:
    """The table or block of orientations, with the mission's names of cameras (BLOCK-CAMERA)."""
    table = inputs.orientation
    if table is None:
        raise MissionError("EVENTS-NONE", "the mission names no orientation", where="stations")
    if not section.of_block:
        return table
    given, names = np.array(table.camera), dict(inputs.camera_names)
    own = sorted(set(given.tolist()))
    names |= {own[0]: names[""]} if len(own) == 1 and "" in names else {}
    for name in sorted({*own} - {*names}):
        image = table.image[given == name]
        raise MissionError.of(
            "BLOCK-CAMERA", section.path, total=image.size, image=image[0], name=name
        )
    return replace(table, camera=np.array([names[name] for name in given], object))


def block_points(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> ObjectPoints:
    """The object points of a block, above sea level; others take the median of their image's."""
    section, block = mission.stations.orientation, inputs.block_points
    if section is None or block is None:
        raise MissionError("EVENTS-NONE", "the mission names no orientation", where="stations")
    name, xyz = block.name, block.position
    if len(name) == 0:
        raise InputError.of("POINTS-EMPTY", section.path)
    table = orientation_table(section, inputs)
    if section.is_geodetic:
        table, _ = in_wgs84(section, replace(table, position=xyz), inputs.geoid)
        lat, lon, h = table.position.T
    else:
        frame = frame_of_block(inputs, flight, section, table, exposed=[], ledger=ledger)
        lat, lon, h = frame.geodetic(xyz)
    if not section.is_msl(table.heights):
        h = h - flight.heights.undulation(lat, lon)
    if not heights.LOWEST_GROUND_M < np.nanmedian(h) < heights.HIGHEST_GROUND_M:
        raise InputError.of("ORIENTATION-FRAME", section.path, height_m=np.nanmedian(h))
    points = ObjectPoints(name, lat, lon, h)
    image, usual, apart = [], [], [np.zeros(1)]
    for batch in block.rows():
        seen = points.heights(batch["point"], batch["image"])[0]
        seen = seen[np.isfinite(seen)]
        if seen.size:
            image.append(batch["image"][0].as_py())
            usual.append(float(np.median(seen)))
            apart.append(np.abs(seen - usual[-1]))
    ledger.note(
        "GROUND-BLOCK", where="ground.height", count=len(name), low=np.nanmin(h),
        high=np.nanmax(h), apart=np.median(np.concatenate(apart)),
    )  # fmt: skip
    of_image = pa.array(image, pa.string()), np.array([*usual, np.nanmedian(h)])
    return replace(points, of_image=of_image)


def in_wgs84(
    section: OrientationSection, table: OrientationTable, geoid: GeoidGrid | None
) -> tuple[OrientationTable, Notes]:
    """The table with its positions in WGS 84, and the convergence of its grid."""
    if section.crs is None or section.heights is None:
        return table, ()
    x, y, h = table.position.T
    if section.frame == "geographic":
        x, y = np.degrees(y), np.degrees(x)
    places, notes = places_of(
        section.crs, (x, y, h), heights=section.heights, geoid=geoid,
        where=section.path, key="stations.orientation.crs",
    )  # fmt: skip
    position = np.stack([places.lat_rad, places.lon_rad, places.h_m], axis=1)
    convergence = np.nan_to_num(places.convergence_rad)
    table = replace(table, position=position, convergence_rad=convergence, heights=places.heights)
    return table, notes


def other_readings(
    section: OrientationSection, table: OrientationTable
) -> dict[str, OrientationTable]:
    """What else a table could mean, by what it would mean then."""
    angles, position = table.angles, table.position
    other: dict[str, OrientationTable] = {}
    if section.angles.startswith("quaternion"):
        inverse = replace(table, angles=angles * [1, -1, -1, -1])
        other["if the quaternions turn the other way"] = inverse
    else:
        first, second, last = section.angle_names
        for unit, size in RADIANS.items():
            if unit != section.unit:
                as_unit = angles * (size / RADIANS[section.unit])
                other[f"if the angles are in {unit}"] = replace(table, angles=as_unit)
        for what, undone in rotations.ANGLE_MISTAKES.items():
            changed = np.stack(undone(*angles.T), axis=1)
            other[what.format(first, second, last)] = replace(table, angles=changed)
        if last == "kappa":
            order = f"{second}_{first}_kappa"
            same = rotations.opk_of_quaternion(
                rotations.quaternion_of_opk(angles[:, [1, 0, 2]], order), section.angles
            )
            other[f"if the angles are {order}"] = replace(table, angles=same)
    if section.is_geodetic:
        swapped = position[:, [1, 0, 2]]
        other["with latitude and longitude exchanged"] = replace(table, position=swapped)
        other["if the heights are in feet"] = replace(table, position=position * [1, 1, 0.3048])
    return other


def stations_of_table(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, section: OrientationSection,
    table: OrientationTable, *,
    exposed: list[Stations], ledger: Ledger,
) -> Stations:  # fmt: skip
    """The stations of a table in one reading; the events give the times it does not have."""
    of_body = section.angles == "roll_pitch_yaw"
    if of_body:
        quaternion = rotations.quaternion_of_rpy(table.angles, np.eye(3))
    elif section.angles.startswith("quaternion"):
        sense = 1.0 if section.angles == "quaternion" else -1.0
        quaternion = table.angles * [1.0, sense, sense, sense]
    else:
        quaternion = rotations.quaternion_of_opk(table.angles, section.angles)
    lat, lon, h = table.position.T
    tilt_rad = 0.0
    if section.frame in ("geographic", "projected"):
        turn = rotations.enu_from_grid(section.convergence_deg * DEGREE + table.convergence_rad)
        quaternion = rotations.in_turned_frame(quaternion, turn.swapaxes(-1, -2))
    else:
        frame = frame_of_block(inputs, flight, section, table, exposed=exposed, ledger=ledger)
        tilt_rad = frame.tilt_rad
        if not section.is_geodetic:
            lat, lon, h = frame.geodetic(table.position)
        quaternion = frame.local_attitude(quaternion, lat, lon)
    camera = camera_of_rows(mission, table.camera, section.camera, len(table.image), section.path)
    time_ns = table.time_ns
    if exposed and not section.has_clock:
        known = {n: t for part in exposed for n, t in zip(part.image, part.time_ns, strict=True)}
        time_ns = np.array([known.get(name, NO_TIME) for name in table.image], np.int64)
    images = OrientedImages(
        table.image, camera, time_ns, lat, lon, h, section.is_msl(table.heights), quaternion,
        of_body, sigmas_of_block(section, table, tilt_rad),
    )  # fmt: skip
    stations = oriented_images.stations_of_images(images, mission.mounts, flight.heights)
    stations = ledger.take(oriented_images.flag_above_horizon(stations))
    oriented_images.refuse_turned_images(stations)
    return stations


def check_height_above_ground(
    mission: Mission,
    flight: FlightLog,
    stations: Stations,
    observations: Observations,
    ledger: Ledger,
) -> Stations:
    """Stations, and a note of their heights above ground; those far too high are suspect."""
    section = mission.ground
    batch = next(observations.batches(mission.output.batch_rows))
    given = batch.ground if batch.ground is not None else np.array([section.constant_m], np.float64)
    given = given[np.isfinite(given)]
    if section.from_distance or given.size == 0 or not bool(stations.ok.any()):
        return stations
    ground = heights.ground_offsets(section.reference_of_values, stations, flight.heights)
    over = stations.h_msl_m - (ground + np.median(given))
    above, where = over[stations.ok], "stations.orientation"
    low = int((above <= 0.0).sum())
    what = f"the cameras are {np.median(above):.0f} m above the ground in the median, "
    what += f"{above.min():.0f} to {above.max():.0f} m"
    if low > _FEW_BELOW_GROUND * above.size:
        raise MissionError.of("ORIENTATION-HEIGHT", where, low=low, total=above.size, what=what)
    with np.errstate(invalid="ignore"):
        high = stations.ok & (over > _HIGHEST_ABOVE_GROUND_M)
    count, use = int(high.sum()), mission.stations.use_suspect
    if 0 < count <= _FEW_BELOW_GROUND * above.size:
        text = f"{count} stations are suspect, the first {stations.image[high][0]}: {what}"
        ledger.loss("ORIENTATION-HEIGHT", text, where=where, count=count)
        return stations.as_suspect(high, "far above the others", np.nan, use=use)
    entry = ledger.warning if low > 0 or high.any() else ledger.note
    entry("ORIENTATION-HEIGHT", what, where=where, count=above.size)
    return stations


def frame_of_block(
    inputs: OpenedInputs, flight: FlightLog, section: OrientationSection,
    table: OrientationTable, *, exposed: list[Stations], ledger: Ledger,
) -> CartesianFrame:  # fmt: skip
    """The frame of the angles, where it is not each station's own."""
    stated = section.frame.enu.build() if isinstance(section.frame, EnuFrame) else section.frame
    frame = stated or table.frame
    if frame is None:
        raise MissionError.of("ORIENTATION-FRAME/frame-of-block", section.path)
    if table.frame not in (None, frame):
        what = f"by the file its frame is {table.frame}, by the mission file {frame}, which holds"
        ledger.warning("IMPORT-CONTRADICTED", what, where=section.path)
    if isinstance(frame, heights.GeodeticOrigin):
        return oriented_images.topocentric(frame)
    if frame == "ecef":
        return oriented_images.ECEF
    known = section.known_positions
    if isinstance(known, KnownPositions) and inputs.known_positions is not None:
        sigma_m = known.sigma_m
        image, position = inputs.known_positions.image, inputs.known_positions.position.copy()
        if section.heights == "msl":
            position[:, 2] += flight.heights.undulation(position[:, 0], position[:, 1])
    else:
        of_log = join_stations(exposed)
        image = of_log.image[of_log.ok]
        geodetic = [of_log.lat_rad, of_log.lon_rad, of_log.h_ellipsoid_m]
        position = np.stack(geodetic, axis=1)[of_log.ok]
        stated = np.hypot(of_log.sigma_horizontal_m, of_log.sigma_height_m)[of_log.ok] / np.sqrt(2)
        stated = stated[np.isfinite(stated)]
        sigma_m = float(np.median(stated)) if stated.size else _SIGMA_OF_LOG_M
    return ledger.take(
        oriented_images.fitted_frame(table.image, table.position, image, position, sigma_m=sigma_m)
    )


def sigmas_of_block(
    section: OrientationSection, table: OrientationTable, tilt_rad: float
) -> dict[str, Array]:
    """Standard deviations by the names of `Stations`: a column, or a constant, or unknown."""
    stated = {
        "sigma_tilt_rad": (section.sigma_tilt_deg, DEGREE),
        "sigma_yaw_rad": (section.sigma_yaw_deg, DEGREE),
        "sigma_horizontal_m": (section.sigma_horizontal_m, 1.0),
        "sigma_height_m": (section.sigma_height_m, 1.0),
    }
    sigmas = {
        name: table.sigmas.get(
            name, np.full(len(table.image), np.nan if constant is None else constant * unit)
        )
        for name, (constant, unit) in stated.items()
    }
    if tilt_rad > 0.0:
        sigmas["sigma_tilt_rad"] = np.hypot(np.nan_to_num(sigmas["sigma_tilt_rad"]), tilt_rad)
    return sigmas
