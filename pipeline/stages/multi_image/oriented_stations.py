"""Stations from the orientation of a block: read, brought to each station's vertical, checked."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from pipeline.batch.plan import Plan
from pipeline.block.image_rays import MINIMUM_ANGLE_RAD, ImageRays, orientations_of
from pipeline.block.intersection import Intersection, intersect
from pipeline.block.oriented_block import (
    ECEF,
    SIGMAS_OF_BLOCK,
    CartesianFrame,
    OrientedImages,
    fitted_frame,
    flag_above_horizon,
    flag_far_images,
    refuse_turned_images,
    stations_of_images,
    topocentric,
)
from pipeline.config.station_sources import EnuFrame, KnownPositions, OrientationSection
from pipeline.errors import InputError, MissionError
from pipeline.flight.channels import Array
from pipeline.flight.heights import ground_offsets
from pipeline.flight.image_names import renamed
from pipeline.flight.rotations import (
    enu_from_grid,
    in_turned_frame,
    opk_of_quaternion,
    quaternion_of_opk,
    quaternion_of_rpy,
)
from pipeline.flight.stations import NO_TIME, Stations, join_stations
from pipeline.ledger import Ledger, Notes
from pipeline.stages.exposure_setup import camera_of_rows, cameras_of_mission
from pipeline.stages.inputs import FlightLog, user_geoid
from pipeline.tables.geodata.coordinate_systems import places_of
from pipeline.tables.imports import ORIENTATIONS, Stated, reader_of
from pipeline.tables.imports.orientation import OrientationTable, read_known_positions
from pipeline.tables.observations import Observations
from pipeline.tables.tie_points import draw_tie_points, tie_rays
from pipeline.units import DEGREE, RADIANS

_FEW_BELOW_GROUND = 0.1
_MOST_TIE_POINTS, _FEWEST_TIE_POINTS = 300, 10

_FAR_MORE_LIKELY = np.log(1000.0)
"""Of two readings, the log likelihood by which one is believed against what is stated."""

_GOOD_FACTOR, _POOR_FACTOR = 2.0, 5.0
"""Residuals over those of an adjusted block: what another reading may have, and what is told."""

_GROUND_SIGMAS, _GROUND_SHARE = 5.0, 0.01
"""How far intersected heights may be from given ones: sigmas, and part of the flying height."""

_SIGMA_OF_LOG_M = 1.5
"""Positions of an autopilot that fuses a receiver without corrections."""

_HIGHEST_ABOVE_GROUND_M = 15_000.0
"""No survey is flown higher, in the median, than that above its ground."""


def oriented_stations(
    plan: Plan,
    flight: FlightLog,
    exposed: list[Stations],
    observations: Observations,
    ledger: Ledger,
) -> Stations:
    """The stations of `stations.orientation`; ``exposed`` are those of the events, if any.

    Refuses (MissionError ORIENTATION-READING) a table whose angles or positions make the rays of
    the user's tie points meet far better in another reading.
    """
    section = plan.mission.stations.orientation
    if section is None:
        raise MissionError("EVENTS-NONE", "the mission names no orientation", where="stations")
    source = plan.input("orientation").path
    _, reader = reader_of(ORIENTATIONS, source, section.format)
    table = reader(source, Stated(columns=section.column_names, angle_unit=section.unit), ledger)
    table = ledger.take(in_wgs84(plan, section, table))
    differences = plan.mission.observations.match_names
    image = renamed(table.image, observations.images, differences, "stations.orientation")
    table = replace(table, image=ledger.take(image))
    stations = stations_of_table(plan, flight, section, table, exposed=exposed, ledger=ledger)
    stations = ledger.take(flag_far_images(stations, use=plan.mission.stations.use_suspect))
    stations = check_height_above_ground(plan, flight, stations, observations, ledger)
    ties = draw_tie_points(observations, _MOST_TIE_POINTS)
    rays = tie_rays(ties, stations.image, stations.camera, cameras_of_mission(plan.mission))
    if np.unique(rays.point).size < _FEWEST_TIE_POINTS:
        return stations
    first = np.unique(rays.point, return_index=True)[1]
    given = np.full(first.size, np.nan) if rays.height_m is None else rays.height_m[first]
    rays = replace(rays, height_m=None)
    stated = intersect(orientations_of(stations, SIGMAS_OF_BLOCK), rays)
    found = {"as stated": stated}
    for what, changed in other_readings(section, table).items():
        with suppress(MissionError):
            other = stations_of_table(
                plan, flight, section, changed, exposed=exposed, ledger=Ledger()
            )
            found[what] = intersect(orientations_of(other, SIGMAS_OF_BLOCK), rays)
    likely = max(found, key=lambda what: found[what].log_likelihood)
    better = found[likely].log_likelihood - stated.log_likelihood
    if better > _FAR_MORE_LIKELY and found[likely].sigma_factor < _GOOD_FACTOR:
        raise InputError(
            "ORIENTATION-READING",
            f"the rays of {stated.point.size} tie points meet far better {likely}: the log "
            f"likelihood is {better:.0f} higher",
            where=section.path,
            remedy="state under stations.orientation what the table holds, or mend it",
        )
    judge_tie_points(stations, stated, rays, ledger)
    if np.isfinite(given).any() and not plan.mission.ground.from_distance:
        compare_with_ground(plan, flight, stations, stated, given=given, ledger=ledger)
    return stations


def in_wgs84(
    plan: Plan, section: OrientationSection, table: OrientationTable
) -> tuple[OrientationTable, Notes]:
    """The table with its positions in WGS 84, and the convergence of its grid."""
    if section.crs is None or section.heights is None:
        return table, ()
    x, y, h = table.position.T
    if section.frame == "geographic":
        x, y = np.degrees(y), np.degrees(x)
    places, notes = places_of(
        section.crs, (x, y, h), heights=section.heights, geoid=user_geoid(plan),
        where=section.path, key="stations.orientation.crs",
    )  # fmt: skip
    position = np.stack([places.lat_rad, places.lon_rad, places.h_m], axis=1)
    convergence = np.nan_to_num(places.convergence_rad)
    table = replace(table, position=position, convergence_rad=convergence, heights=places.heights)
    return table, notes


def judge_tie_points(
    stations: Stations, stated: Intersection, rays: ImageRays, ledger: Ledger
) -> None:
    """Tell how far the rays of tie points miss each other; a loss where no station explains it."""
    at = np.searchsorted(stated.point, rays.point)
    line = stated.position_m[at] - stated.orientations.centre_m[rays.image]
    miss = np.sqrt(np.mean(stated.residual_rad**2, axis=1))
    # A point whose rays are all but parallel tells nothing.
    judged = stated.used | (stated.angle_rad >= MINIMUM_ANGLE_RAD)
    judged[at[stated.bad]] = True
    lost = (stated.bad | np.isnan(miss)) & judged[at]
    points = int(stated.used.sum())
    size, where = stated.point.size, "stations.orientation"
    what = f"no rays of {size} tie points meet at an angle that checks anything"
    if points:
        pixels = np.sqrt(np.nanmean(miss**2)) / float(np.median(rays.sigma_rad))
        what = f"the rays of {points} of {size} tie points miss each other by {pixels:.1f} px "
        what += "(rms), refraction included"
    if points >= 0.5 * judged.sum() and not stated.sigma_factor > _POOR_FACTOR:
        ledger.note("ORIENTATION-TIES", what, where=where, count=size)
        return
    for camera in sorted(set(stations.camera[rays.image].tolist())):
        of = stations.camera[rays.image] == camera
        met = of & ~lost & judged[at]
        what += f"; {camera}: {lost[of].sum()} of {of.sum()} rays meet no other"
        if met.any():
            metres = np.median(miss[met] * np.linalg.norm(line[met], axis=1))
            what += f", the others miss by {np.degrees(np.median(miss[met])):.2g} deg, "
            what += f"{metres:.2g} m, in the median"
    seen = np.bincount(rays.image, minlength=stations.image.size)
    share = np.bincount(rays.image[lost], minlength=seen.size) / np.maximum(seen, 1)
    worst = [str(stations.image[k]) for k in np.argsort(-share, kind="stable")[:3] if share[k] > 0]
    what += f"; most of {', '.join(worst)}" if worst else ""
    what += (
        ": the orientation is not what it should be (rows of other images or cameras, another "
        "convention), or the name of a point is not that of one point in all images"
    )
    ledger.loss("ORIENTATION-TIES", what, where=where, count=size)


def compare_with_ground(
    plan: Plan,
    flight: FlightLog,
    stations: Stations,
    stated: Intersection,
    *,
    given: Array,
    ledger: Ledger,
) -> None:
    """Tell where intersected points lie at other heights than those given, (p,) each."""
    to_msl = np.nanmedian(
        ground_offsets(plan.mission.ground.reference_of_values, stations, flight.heights)
    )
    undulation = stations.h_ellipsoid_m - stations.h_msl_m
    known = undulation[np.isfinite(undulation)]
    h = stated.geodetic[2] - (np.median(known) if known.size else 0.0)
    off = h - (given + to_msl)
    usable = stated.used & np.isfinite(off)
    if usable.sum() < _FEWEST_TIE_POINTS:
        return
    count, median = int(usable.sum()), float(np.median(off[usable]))
    sigma = float(np.median(stated.sigma_height_m[usable])) * max(1.0, stated.sigma_factor)
    above = float(np.median(stations.h_msl_m[stations.ok]) - np.median(h[usable]))
    if abs(median) <= max(_GROUND_SIGMAS * sigma, _GROUND_SHARE * abs(above)):
        return
    ledger.loss(
        "ORIENTATION-GROUND",
        f"{count} intersected tie points lie {median:+.0f} m from their given heights "
        f"in the median, where {sigma:.1f} m of one point are expected: the height column, its "
        "unit or stations.orientation.heights (msl, ellipsoid), mission.undulation_m or "
        "ground.reference is another one",
        where="stations.orientation",
        count=count,
    )


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
        for names, signs in {last: [1, 1, -1], f"{first} and {second}": [-1, -1, 1]}.items():
            other[f"with the other sign of {names}"] = replace(table, angles=angles * signs)
        swapped = angles[:, [1, 0, 2]]
        other[f"with {first} and {second} exchanged"] = replace(table, angles=swapped)
        if last == "kappa":
            order = f"{second}_{first}_kappa"
            same = opk_of_quaternion(quaternion_of_opk(swapped, order), section.angles)
            other[f"if the angles are {order}"] = replace(table, angles=same)
    if section.is_geodetic:
        swapped = position[:, [1, 0, 2]]
        other["with latitude and longitude exchanged"] = replace(table, position=swapped)
        other["if the heights are in feet"] = replace(table, position=position * [1, 1, 0.3048])
    return other


def stations_of_table(
    plan: Plan,
    flight: FlightLog,
    section: OrientationSection,
    table: OrientationTable,
    *,
    exposed: list[Stations],
    ledger: Ledger,
) -> Stations:
    """The stations of a table in one reading; the events give the times it does not have."""
    mission = plan.mission
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
    if section.frame in ("geographic", "projected"):
        turn = enu_from_grid(section.convergence_deg * DEGREE + table.convergence_rad)
        quaternion = in_turned_frame(quaternion, turn.swapaxes(-1, -2))
    else:
        frame = frame_of_block(plan, flight, section, table, exposed=exposed, ledger=ledger)
        tilt_rad = frame.tilt_rad
        if not section.is_geodetic:
            lat, lon, h = frame.geodetic(table.position)
        quaternion = frame.local_attitude(quaternion, lat, lon)
    camera = camera_of_rows(mission, table.camera, section.camera, len(table.image), section.path)
    time_ns = table.time_ns
    if exposed and not section.has_clock:
        known = {n: t for part in exposed for n, t in zip(part.image, part.time_ns, strict=True)}
        time_ns = np.array([known.get(name, NO_TIME) for name in table.image], np.int64)
    is_msl = section.is_geodetic and (table.heights or section.heights) == "msl"
    images = OrientedImages(
        table.image, camera, time_ns, lat, lon, h, is_msl, quaternion, of_body,
        sigmas_of_block(section, table, tilt_rad),
    )  # fmt: skip
    mounts = {name: mount.build() for name, mount in mission.mount.items()}
    stations = stations_of_images(images, mounts, flight.heights)
    stations = ledger.take(flag_above_horizon(stations))
    refuse_turned_images(stations)
    return stations


def check_height_above_ground(
    plan: Plan, flight: FlightLog, stations: Stations, observations: Observations, ledger: Ledger
) -> Stations:
    """Tell how high the cameras are above the ground; refuses those that are in it.

    Single ones that are far too high are suspect. The ground is that of the mission file, or of
    the first observations.
    """
    section = plan.mission.ground
    batch = next(observations.batches(plan.mission.output.batch_rows))
    given = batch.ground if batch.ground is not None else np.array([section.constant_m], np.float64)
    given = given[np.isfinite(given)]
    if section.from_distance or given.size == 0 or not bool(stations.ok.any()):
        return stations
    ground = ground_offsets(section.reference_of_values, stations, flight.heights) + np.median(
        given
    )
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
    with np.errstate(invalid="ignore"):
        high = stations.ok & (stations.h_msl_m - ground > _HIGHEST_ABOVE_GROUND_M)
    if 0 < high.sum() <= _FEW_BELOW_GROUND * above.size:
        ledger.loss(
            "ORIENTATION-HEIGHT",
            f"{int(high.sum())} stations are suspect, the first {stations.image[high][0]}: {what}",
            where=where,
            count=int(high.sum()),
        )
        use = plan.mission.stations.use_suspect
        return stations.as_suspect(high, "far above the others", np.nan, use=use)
    tell = ledger.warning if low > 0 or high.any() else ledger.note
    tell("ORIENTATION-HEIGHT", what, where=where, count=above.size)
    return stations


def frame_of_block(
    plan: Plan,
    flight: FlightLog,
    section: OrientationSection,
    table: OrientationTable,
    *,
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
        names, sigma_m = known.model_dump(exclude={"path", "sigma_m"}), known.sigma_m
        image, position = read_known_positions(plan.input("known positions").path, names)
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
    return ledger.take(fitted_frame(table.image, table.position, image, position, sigma_m=sigma_m))


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
    sigmas: dict[str, Array] = {}
    for name, (constant, unit) in stated.items():
        value = np.nan if constant is None else constant * unit
        sigmas[name] = table.sigmas.get(name, np.full(len(table.image), value))
    if tilt_rad > 0.0:
        sigmas["sigma_tilt_rad"] = np.hypot(np.nan_to_num(sigmas["sigma_tilt_rad"]), tilt_rad)
    return sigmas
