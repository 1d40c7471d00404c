"""Orientations and object points of a block: names of cameras, frame, coordinate system."""

from dataclasses import replace

import numpy as np
import pyarrow as pa

from unbend.block import oriented_images
from unbend.block.known_places import KnownPlaces, frame_notes
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
from unbend.tables.geodata.coordinate_systems import kind_of_system, name_of_system, places_of
from unbend.tables.geodata.geocentric_datums import GeocentricDatum, frame_of_datum
from unbend.tables.geodata.object_points import ObjectPoints
from unbend.tables.imports.exif import ImageTimes
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array, Names

SIGMA_OF_LOG_M = 1.5  # positions of an autopilot that fuses a receiver without corrections


def orientation_table(section: OrientationSection, inputs: OpenedInputs) -> OrientationTable:
    """The table of orientations; the cameras of a block have the names of the mission file.

    Refuses (BLOCK-CAMERA) a camera of the block that the mission file does not define.
    """
    table = inputs.orientation
    if table is None:
        raise no_events(where="stations", what="orientation")
    if not section.of_block:
        return table
    camera_in_block = np.array(table.camera)  # of each image
    cameras_of_block = sorted(set(camera_in_block.tolist()))
    mission_camera_of = dict(inputs.camera_names)
    if len(cameras_of_block) == 1 and "" in mission_camera_of:
        # "" stands for the only camera of the mission, whatever the block calls it.
        (only,) = cameras_of_block
        mission_camera_of[only] = mission_camera_of[""]
    for name in cameras_of_block:
        if name not in mission_camera_of:
            images = table.image[camera_in_block == name]
            raise messages.block_camera_unknown(
                where=section.path, total=images.size, image=str(images[0]), name=str(name)
            )
    camera = np.array([mission_camera_of[name] for name in camera_in_block], object)
    return replace(table, camera=camera)


def section_of_block(mission: Mission, inputs: OpenedInputs) -> OrientationSection:
    """The section stations.orientation, with the coordinate system that a block names, if any."""
    section = mission.stations.orientation
    if section is None or inputs.orientation is None:
        raise no_events(where="stations", what="orientation")
    crs = inputs.orientation.crs
    return section if crs is None else section.in_system_of(crs, kind_of_system(crs))


def block_points(
    mission: Mission, inputs: OpenedInputs, flight: FlightLog, ledger: Ledger
) -> ObjectPoints:
    """The object points of a block, with heights above sea level.

    An image point without an object point gets the median height of the object points in its image.
    Refuses a block without object points, and a frame in which their heights are impossible.
    """
    section = section_of_block(mission, inputs)
    block = inputs.block_points
    if block is None:
        raise no_events(where="stations", what="orientation")
    if len(block.name) == 0:
        raise messages.block_without_points(where=section.path)
    table = orientation_table(section, inputs)
    if section.is_geodetic:
        # The points take the place of the images' positions, because both are converted in the same
        # way. The notes on the conversion come with the images.
        table, _ = in_wgs84(section, replace(table, position=block.position), inputs.geoid)
        latitude, longitude, h = table.position.T
    else:
        frame = frame_of_block(inputs, flight, section, table, event_stations=[], ledger=ledger)
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
    """Add the median height of the object points in each image to the points of a block.

    A note gives the median distance of the heights from these medians.
    """
    images = []
    medians = []
    from_median = []
    for batch in block.rows():  # a batch holds the rows of one image
        heights, _ = points.heights(batch["point"], batch["image"])
        heights = heights[np.isfinite(heights)]
        if heights.size:
            median = float(np.median(heights))
            images.append(batch["image"][0].as_py())
            medians.append(median)
            from_median.append(np.abs(heights - median))
    median_distance = float(np.median(np.concatenate(from_median))) if from_median else 0.0
    ledger.add(
        messages.ground_of_block(
            where="ground.height",
            count=len(points.name),
            low=float(np.nanmin(points.h_m)),
            high=float(np.nanmax(points.h_m)),
            apart=median_distance,
        )
    )
    # The last height is for images without object points.
    usual_heights = np.array([*medians, np.nanmedian(points.h_m)])
    return replace(points, of_image=(pa.array(images, pa.string()), usual_heights))


def in_wgs84(
    section: OrientationSection, table: OrientationTable, geoid: GeoidGrid | None
) -> tuple[OrientationTable, Notes]:
    """Convert the positions of a table to latitude, longitude [rad] on WGS 84 and height [m].

    The heights count from what the new table states: sea level, ellipsoid or take-off. The table
    also gets the convergence of the grid at each position, 0 if the system has none. Returned with
    notes on the conversion. The table is unchanged if no coordinate system is stated.
    """
    if section.crs is None or section.heights is None:
        return table, ()
    if section.frame == "geographic":
        latitude, longitude, h = table.position.T
        x = np.degrees(longitude)
        y = np.degrees(latitude)
    else:
        x, y, h = table.position.T
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
    event_stations: list[Stations],
    ledger: Ledger,
) -> CartesianFrame:
    """The one cartesian frame of the positions and angles of a table.

    It is the frame that the mission file states, else that of the file; a warning if they differ. A
    frame that is stated as unknown is fitted to known positions of images: those of the mission
    file, else those of the log (``event_stations``). Only for tables with angles that are not
    relative to the vertical of each station.
    """
    stated = section.frame
    stated_frame = stated.enu.build() if isinstance(stated, EnuFrame) else stated
    frame = stated_frame or table.frame
    if frame is None:
        raise messages.frame_unstated(where=section.path)
    if frame == "ecef" and isinstance(table.frame, GeocentricDatum):
        frame = table.frame  # earth-centred all the same: the file says in which datum
    if table.frame not in (None, frame):
        ledger.add(
            messages.frame_contradicted(
                where=section.path, found=frame_in_words(table.frame), stated=frame_in_words(frame)
            )
        )
    if isinstance(frame, GeodeticOrigin):
        return oriented_images.topocentric(frame)
    if isinstance(frame, GeocentricDatum):
        of_datum = frame_of_datum(
            frame,
            table.position,
            keep_heights=section.is_msl(table.heights),
            where=section.path,
            key="export the block in WGS 84",
        )
        return ledger.take(of_datum)
    if frame == "ecef":
        return oriented_images.ECEF
    # The frame is "unknown".
    known_positions = section.known_positions
    if isinstance(known_positions, KnownPositions) and inputs.known_positions is not None:
        sigma_m = known_positions.sigma_m
        image = inputs.known_positions.image
        position = inputs.known_positions.position.copy()
        if section.heights == "msl":
            position[:, 2] += flight.heights.undulation(position[:, 0], position[:, 1])
    else:
        image, position, sigma_m = positions_of_log(join_stations(event_stations))
    return ledger.take(
        oriented_images.fitted_frame(table.image, table.position, image, position, sigma_m=sigma_m)
    )


def frame_in_words(frame: object) -> str:
    """A frame as a message names it: a name, or the origin of east, north, up."""
    if isinstance(frame, GeodeticOrigin):
        latitude = np.degrees(frame.lat_rad)
        longitude = np.degrees(frame.lon_rad)
        return f"east, north, up at {latitude:.6f}, {longitude:.6f}, {frame.h_ellipsoid_m:.1f} m"
    if isinstance(frame, GeocentricDatum):
        return f"earth-centred in {frame.name}"
    return str(frame)


def check_frame(
    inputs: OpenedInputs,
    section: OrientationSection,
    table: OrientationTable,
    stations: Stations,
    *,
    frame: CartesianFrame | None,
    event_stations: list[Stations],
    has_control: bool,
    has_tested_heights: bool,
) -> Notes:
    """Compare the stations with all known positions of their images, to test the frame.

    table : the orientations, with the names that the images have in the block.
    stations : made of the rows of ``table``, with the names that the observations have.
    frame : the frame of x, y, z in ``table``; None without x, y, z.
    event_stations : the stations of the exposures by the log.
    has_control : there are control points; they show a wrong frame, which needs no test here.
    has_tested_heights : tie points test the heights above a given ground.
    """
    known_places = places_of_block(inputs, table, frame)
    files = inputs.image_times
    if files is not None and section.format != "dji":
        known_places.append(("positions in EXIF", positions_in_exif(files, stations.image)))
    if inputs.known_positions is not None and section.frame != "unknown":
        stated = inputs.known_positions
        places = KnownPlaces("known_positions", stated.image, stated.position)
        known_places.append((places.source, places.rows_of(stations.image)))
    if event_stations:
        image, position, _ = positions_of_log(join_stations(event_stations))
        places = KnownPlaces("positions of the log at the exposures", image, position)
        known_places.append((places.source, places.rows_of(stations.image)))
    needs_test = section.frame not in ("geographic", "unknown") and not has_control
    return frame_notes(
        stations,
        known_places,
        must_be_tested=needs_test,
        where=section.path,
        system="" if section.crs is None else name_of_system(section.crs),
        has_tested_heights=has_tested_heights,
    )


def places_of_block(
    inputs: OpenedInputs, table: OrientationTable, frame: CartesianFrame | None
) -> list[tuple[str, Array]]:
    """Positions of images in the files of a block, beside their orientations: source, positions.

    Positions (n, 3) are latitude, longitude [rad] and height [m] of the images of ``table``, NaN if
    unknown. Those in the frame of the block are left out if ``frame`` is None.
    """
    known_places = []
    for places in inputs.block_places:
        position = places.rows_of(table.image)
        if not places.in_frame:
            known_places.append((places.source, position))
        elif frame is not None:
            geodetic = np.stack(frame.geodetic(position), axis=1)
            known_places.append((places.source, geodetic))
    return known_places


def positions_in_exif(files: ImageTimes, images: Names) -> Array:
    """(n, 3) latitude, longitude [rad] and height [m] in the files of images, NaN if none."""
    names = images.tolist()
    row_of_image = files.rows_of(names)
    position = np.full((images.size, 3), np.nan)
    for i, name in enumerate(names):
        if name in row_of_image:
            position[i] = files.position[row_of_image[name]]
    return position


def positions_of_log(stations: Stations) -> tuple[Names, Array, float]:
    """Names of the m images with usable stations, their positions (m, 3), and a common sigma [m].

    Positions are latitude, longitude [rad] and ellipsoidal height [m]. The sigma is the median of
    the known ones, of one axis; 1.5 m if none is known.
    """
    ok = stations.ok
    position = np.stack([stations.lat_rad, stations.lon_rad, stations.h_ellipsoid_m], axis=1)
    # Root mean square of the horizontal and the vertical sigma.
    sigmas_m = np.hypot(stations.sigma_horizontal_m, stations.sigma_height_m)[ok] / np.sqrt(2)
    sigmas_m = sigmas_m[np.isfinite(sigmas_m)]
    common_sigma_m = float(np.median(sigmas_m)) if sigmas_m.size else SIGMA_OF_LOG_M
    return stations.image[ok], position[ok], common_sigma_m
