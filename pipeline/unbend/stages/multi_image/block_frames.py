"""Orientations and points of a block: names of its cameras, its frame, its coordinate system."""

from dataclasses import replace

import numpy as np
import pyarrow as pa

from unbend.block import oriented_images
from unbend.block.oriented_images import CartesianFrame
from unbend.config import Mission
from unbend.config.local_frames import EnuFrame
from unbend.config.orientations import KnownPositions, OrientationSection
from unbend.flight.heights import HIGHEST_GROUND_M, LOWEST_GROUND_M, GeodeticOrigin
from unbend.flight.stations import Stations, join_stations
from unbend.geodesy import GeoidGrid
from unbend.messages import Ledger, Notes
from unbend.stages.flight_log import FlightLog
from unbend.stages.messages import no_events
from unbend.stages.multi_image import messages
from unbend.stages.opened_inputs import BlockPoints, OpenedInputs
from unbend.tables.geodata.coordinate_systems import places_of
from unbend.tables.geodata.object_points import ObjectPoints
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array, Names

SIGMA_OF_LOG_M = 1.5  # positions of an autopilot that fuses a receiver without corrections


def orientation_table(section: OrientationSection, inputs: OpenedInputs) -> OrientationTable:
    """The table or block of orientations, with the mission's names of cameras (BLOCK-CAMERA)."""
    table = inputs.orientation
    if table is None:
        raise no_events(where="stations", what="orientation")
    if not section.of_block:
        return table
    given = np.array(table.camera)
    own = sorted(set(given.tolist()))
    names = dict(inputs.camera_names)
    if len(own) == 1 and "" in names:
        names[own[0]] = names[""]
    for name in own:
        if name not in names:
            images = table.image[given == name]
            raise messages.block_camera_unknown(
                where=section.path, total=images.size, image=str(images[0]), name=str(name)
            )
    return replace(table, camera=np.array([names[name] for name in given], object))


def block_points(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> ObjectPoints:
    """The object points of a block, above sea level; others take the median of their image's."""
    section = mission.stations.orientation
    block = inputs.block_points
    if section is None or block is None:
        raise no_events(where="stations", what="orientation")
    if len(block.name) == 0:
        raise messages.block_without_points(where=section.path)
    table = orientation_table(section, inputs)
    if section.is_geodetic:
        table, _ = in_wgs84(section, replace(table, position=block.position), inputs.geoid)
        latitude, longitude, h = table.position.T
    else:
        frame = frame_of_block(inputs, flight, section, table, exposed=[], ledger=ledger)
        latitude, longitude, h = frame.geodetic(block.position)
    if not section.is_msl(table.heights):
        h = h - flight.heights.undulation(latitude, longitude)
    median_m = float(np.nanmedian(h))
    if not LOWEST_GROUND_M < median_m < HIGHEST_GROUND_M:
        raise messages.frame_impossible(where=section.path, height_m=median_m)
    points = ObjectPoints(block.name, latitude, longitude, h)
    return with_medians_of_images(points, block, ledger)


def with_medians_of_images(
    points: ObjectPoints, block: BlockPoints, ledger: Ledger
) -> ObjectPoints:
    """The points of a block, and for image points of none the median of their image's."""
    image = []
    medians = []
    apart = [np.zeros(1)]
    for batch in block.rows():
        heights, _ = points.heights(batch["point"], batch["image"])
        heights = heights[np.isfinite(heights)]
        if heights.size:
            image.append(batch["image"][0].as_py())
            medians.append(float(np.median(heights)))
            apart.append(np.abs(heights - medians[-1]))
    ledger.add(
        messages.ground_of_block(
            where="ground.height",
            count=len(points.name),
            low=float(np.nanmin(points.h_m)),
            high=float(np.nanmax(points.h_m)),
            apart=float(np.median(np.concatenate(apart))),
        )
    )
    usual = np.array([*medians, np.nanmedian(points.h_m)])
    return replace(points, of_image=(pa.array(image, pa.string()), usual))


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
        section.crs,
        (x, y, h),
        heights=section.heights,
        geoid=geoid,
        where=section.path,
        key="stations.orientation.crs",
    )
    table = replace(
        table,
        position=np.stack([places.lat_rad, places.lon_rad, places.h_m], axis=1),
        convergence_rad=np.nan_to_num(places.convergence_rad),
        heights=places.heights,
    )
    return table, notes


def frame_of_block(
    inputs: OpenedInputs,
    flight: FlightLog,
    section: OrientationSection,
    table: OrientationTable,
    *,
    exposed: list[Stations],
    ledger: Ledger,
) -> CartesianFrame:
    """The frame of the angles, where it is not each station's own."""
    named = section.frame
    stated = named.enu.build() if isinstance(named, EnuFrame) else named
    frame = stated or table.frame
    if frame is None:
        raise messages.frame_unstated(where=section.path)
    if table.frame not in (None, frame):
        ledger.add(
            messages.frame_contradicted(
                where=section.path, found=str(table.frame), stated=str(frame)
            )
        )
    if isinstance(frame, GeodeticOrigin):
        return oriented_images.topocentric(frame)
    if frame == "ecef":
        return oriented_images.ECEF
    known = section.known_positions
    if isinstance(known, KnownPositions) and inputs.known_positions is not None:
        sigma_m = known.sigma_m
        image = inputs.known_positions.image
        position = inputs.known_positions.position.copy()
        if section.heights == "msl":
            position[:, 2] += flight.heights.undulation(position[:, 0], position[:, 1])
    else:
        image, position, sigma_m = positions_of_log(join_stations(exposed))
    return ledger.take(
        oriented_images.fitted_frame(table.image, table.position, image, position, sigma_m=sigma_m)
    )


def positions_of_log(stations: Stations) -> tuple[Names, Array, float]:
    """Images, their positions (m, 3) and the usual sigma of one axis [m] by the log."""
    ok = stations.ok
    position = np.stack([stations.lat_rad, stations.lon_rad, stations.h_ellipsoid_m], axis=1)
    sigma = np.hypot(stations.sigma_horizontal_m, stations.sigma_height_m)[ok] / np.sqrt(2)
    sigma = sigma[np.isfinite(sigma)]
    sigma_m = float(np.median(sigma)) if sigma.size else SIGMA_OF_LOG_M
    return stations.image[ok], position[ok], sigma_m
