"""The inputs of a mission are opened: paths become the tables and readers that the stages take."""

from collections.abc import Callable, Mapping, Set
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from unbend.batch import remote
from unbend.batch.input_files import block_program, named_inputs
from unbend.batch.plan import located, refuse_missing, with_camera_files
from unbend.batch.remote import Place
from unbend.block.known_places import KnownPlaces
from unbend.config import Mission
from unbend.config.image_frames import image_frame_of
from unbend.config.orientations import KnownPositions, OrientationSection
from unbend.flight.channels import Channel
from unbend.ingest import Log, open_log
from unbend.messages import Ledger
from unbend.stages import opened_inputs
from unbend.stages.opened_inputs import ChannelReader, OpenedInputs
from unbend.tables.geodata.elevation import open_elevation
from unbend.tables.geodata.geoid import read_geoid
from unbend.tables.geodata.object_points import read_object_points
from unbend.tables.imports import CAMERA_EVENTS, ORIENTATIONS, TRAJECTORIES, blocks, reader_of
from unbend.tables.imports.exif import ImageTimes, read_image_times
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import (
    EventTable,
    OrientationTable,
    read_events,
    read_known_positions,
)
from unbend.tables.model_fields import read_model_field
from unbend.tables.observations import Observations, open_observations
from unbend.tables.soundings import read_sounding

Paths = Mapping[str, Path]
"""Where each input is, by its role."""

KNOWN_POSITIONS = "known positions"
"""The role of the table of known positions."""

_NOT_IN_FILES = ("log", "observations", "orientation")
"""Roles of inputs that a mission with tables in memory does not read from files."""


def open_inputs(
    mission: Mission,
    paths: Paths,
    observations: Observations,
    log: Log | None,
    ledger: Ledger,
    *,
    camera_names: Mapping[str, str] | None = None,
) -> OpenedInputs:
    """Open all inputs of a mission except its observations and its log, which are given.

    Tables are read here; readers are functions that the stages call later. ``paths`` are those of
    the inputs by their roles. ``camera_names`` has the mission's name of each camera, by the name
    in the block.
    """
    return OpenedInputs(
        observations=observations,
        log=log,
        geoid=read_geoid(paths["geoid"]) if "geoid" in paths else None,
        trajectory=_trajectory(mission, paths),
        camera_events=_camera_events(mission, paths),
        events=_events(mission, paths, ledger),
        image_times=_image_times(mission, paths, ledger),
        orientation=_orientation(mission, paths, ledger),
        camera_names=camera_names or {},
        known_positions=_known_positions(mission, paths),
        block_places=_block_places(mission, paths),
        block_points=_block_points(mission, paths),
        object_points=_object_points(mission, paths),
        control=_control(mission, paths),
        elevation=_elevation(mission, paths),
        soundings=_soundings(mission, paths),
        weather_model=_weather_model(mission, paths),
    )


def open_table(
    mission: Mission,
    path: Path,
    ledger: Ledger,
    most_rows: int | None = None,
    table: pa.Table | None = None,
) -> Observations:
    """Open the table of observations, and check its columns.

    ``most_rows`` rows are drawn as its sample, None for no sample. A ``table`` in memory takes the
    place of the file; ``path`` is then its name in messages.
    """
    section = mission.observations
    ground = mission.ground
    return open_observations(
        path,
        section.columns.model_dump(),
        ground.column,
        ledger,
        ground_is_msl=ground.reference == "msl",
        sigma_column=ground.sigma_column,
        direction=mission.refraction.direction,
        pixels=section.pixels,
        frame=image_frame_of(section, mission.cameras),
        most_rows=most_rows,
        file_format=section.format,
        table=table,
    )


def decode_log(mission: Mission, paths: Paths, sha256: str | None) -> Log | None:
    """The log of a mission, decoded; None for a mission without a log.

    ``sha256`` is the hash of the log's file; None if it was not taken.
    """
    if mission.log is None:
        return None
    return open_log(paths["log"], sha256, date_ns=mission.mission.date_ns)


def paths_of_other_inputs(
    mission: Mission, folder: Path, *, in_memory: Set[str] = frozenset()
) -> tuple[Mission, dict[str, Path]]:
    """Find the other inputs of a mission that has its observations and orientations in memory.

    ``folder`` is the folder from which relative paths resolve, ``in_memory`` are the roles of
    further inputs that are tables in memory. Such a mission has no log. An input in object storage
    is copied. Refuses an input that is missing (INPUT-MISSING), and a folder in the place of a file
    (INPUT-FOLDER).

    Returns the mission, completed by the files of its cameras, and the paths of the inputs by role.
    """
    paths = {}
    for named in named_inputs(mission):
        if named.role in _NOT_IN_FILES or named.role in in_memory:
            continue
        place = located(named.name, folder)
        if isinstance(place, Place):
            paths[named.role] = remote.fetch(remote.look_up(place))
        else:
            refuse_missing(named, place)
            paths[named.role] = place
    return with_camera_files(mission, paths), paths


def _trajectory(mission: Mission, paths: Paths) -> ChannelReader | None:
    """The reader of the trajectory, by its format; None for a mission without one."""
    section = mission.stations.trajectory
    if section is None:
        return None
    path = paths["trajectory"]
    reader: Callable[[Path, Stated, Ledger], Channel]
    reader = reader_of(TRAJECTORIES, path, section.format)
    accuracy = paths["trajectory accuracy"] if section.accuracy else None

    def read(stated: Stated, ledger: Ledger) -> Channel:
        return reader(path, replace(stated, accuracy=accuracy), ledger)

    return read


def _camera_events(mission: Mission, paths: Paths) -> dict[str, ChannelReader]:
    """The reader of the events of each camera that has a file of events with positions."""
    readers: dict[str, ChannelReader] = {}
    for camera, source in mission.position_events.items():
        path = paths[f"events of {camera}"]
        readers[camera] = partial(reader_of(CAMERA_EVENTS, path, source.format), path)
    return readers


def _events(mission: Mission, paths: Paths, ledger: Ledger) -> EventTable | None:
    """The table of events; None for a mission without one."""
    section = mission.events
    if section is None or section.csv is None:
        return None
    return read_events(paths["events"], section.csv.columns.named, ledger)


def _image_times(mission: Mission, paths: Paths, ledger: Ledger) -> ImageTimes | None:
    """The times in the images' EXIF; None without images, or if a table gives the events."""
    section = mission.events
    if section is None or section.images is None or section.csv is not None:
        return None
    return read_image_times(paths["images"], section.images.time_zone, ledger)


def _orientation(mission: Mission, paths: Paths, ledger: Ledger) -> OrientationTable | None:
    """The table of orientations, or those of a block; None without one, or if it is in memory."""
    section = mission.stations.orientation
    if section is None or "orientation" not in paths:
        return None
    path = paths["orientation"]
    if section.of_block:
        return blocks.read_block_images(path, section.format)
    reader: Callable[[Path, Stated, Ledger], OrientationTable]
    reader = reader_of(ORIENTATIONS, path, section.format)
    return reader(path, stated_orientation(section), ledger)


def stated_orientation(section: OrientationSection) -> Stated:
    """What the mission file states of a table of orientations."""
    return Stated(
        columns=section.column_names,
        unstated=section.unstated,
        angle_unit=section.unit,
        heights=section.heights,
    )


def _known_positions(mission: Mission, paths: Paths) -> opened_inputs.KnownImagePositions | None:
    """The table of known positions of images; None without one, or if it is in memory."""
    section = mission.stations.orientation
    known_positions = None if section is None else section.known_positions
    if not isinstance(known_positions, KnownPositions) or KNOWN_POSITIONS not in paths:
        return None
    columns = columns_of_positions(known_positions)
    position_table = read_known_positions(paths[KNOWN_POSITIONS], columns)
    return opened_inputs.KnownImagePositions(*position_table)


def columns_of_positions(section: KnownPositions) -> dict[str, str]:
    """Quantity -> name of its column in a table of known positions."""
    return section.model_dump(exclude={"path", "sigma_m"})


def _block_places(mission: Mission, paths: Paths) -> tuple[KnownPlaces, ...]:
    """Positions of the images in the blocks that have the orientations and the observations.

    They are those that a block has in addition to its orientations, for example from EXIF.
    """
    section = mission.stations.orientation
    if section is None:
        return ()
    programs = {}  # by path, so that a block with both is read once
    if section.of_block and "orientation" in paths:
        programs[paths["orientation"]] = section.format
    observations_format = block_program(mission.observations.format)
    if observations_format is not None and "observations" in paths:
        programs[paths["observations"]] = observations_format
    places: tuple[KnownPlaces, ...] = ()
    for path, program in programs.items():
        places += blocks.read_block_places(path, program)
    return places


def geographic_places(frame: pd.DataFrame, section: OrientationSection) -> tuple[KnownPlaces, ...]:
    """Latitudes and longitudes of a table of stations that takes its positions from other columns.

    ``frame`` is the table, ``section`` names the columns of its positions. The result is compared
    with the stations; it is () if the table has no latitudes and longitudes, or if its positions
    are these.
    """
    is_position = "latitude" in section.column_names
    if is_position or not {"latitude", "longitude"} <= {*frame.columns}:
        return ()
    degrees = frame[["latitude", "longitude"]].apply(pd.to_numeric, errors="coerce")
    position = np.full((len(frame), 3), np.nan)  # latitude, longitude [rad], unknown height
    position[:, :2] = np.radians(degrees.to_numpy(np.float64))
    image = frame[section.column_names["image"]].map(str).to_numpy(object)
    return (KnownPlaces("latitude and longitude in the table of stations", image, position),)


def _block_points(mission: Mission, paths: Paths) -> opened_inputs.BlockPoints | None:
    """The object points of the block with the orientations; None unless they are the ground."""
    section = mission.stations.orientation
    if mission.ground.height != "block" or section is None:
        return None
    path = paths["orientation"]
    name, position = blocks.read_block_points(path, section.format)
    rows = partial(blocks.block_rows, path, section.format)
    return opened_inputs.BlockPoints(name, position, rows)


def _object_points(mission: Mission, paths: Paths) -> opened_inputs.ObjectPointTable | None:
    """The table of object points that are the ground; None without one."""
    section = mission.ground.points
    if section is None:
        return None
    return _points(paths["object points"], section.columns.named, "ground.height.columns")


def _control(mission: Mission, paths: Paths) -> opened_inputs.ObjectPointTable | None:
    """The table of control points; None without one."""
    section = mission.control
    if section is None:
        return None
    return _points(paths["control"], section.columns.named, "control.columns")


def _points(path: Path, names: Mapping[str, str], key: str) -> opened_inputs.ObjectPointTable:
    """Read a table of points: ``names`` of columns by quantity; ``key`` states them in the file."""
    name, columns = read_object_points(path, names, key=key)
    return opened_inputs.ObjectPointTable(name, columns, str(path))


def _elevation(mission: Mission, paths: Paths) -> opened_inputs.ElevationReader | None:
    """The reader of the elevation model; None without one."""
    section = mission.ground.model
    if section is None:
        return None
    rasters = [paths[f"elevation model {number + 1}"] for number in range(len(section.paths))]
    return partial(open_elevation, rasters, section.crs, reference=mission.ground.reference)


def _soundings(mission: Mission, paths: Paths) -> tuple[opened_inputs.SoundingReader, ...]:
    """A reader for each sounding."""
    readers = []
    for number, section in enumerate(mission.atmosphere.soundings, 1):
        readers.append(
            partial(read_sounding, paths[f"sounding {number}"], format_name=section.format)
        )
    return tuple(readers)


def _weather_model(mission: Mission, paths: Paths) -> opened_inputs.WeatherModel | None:
    """The weather model with its reader; None without one."""
    section = mission.atmosphere.model
    if section is None:
        return None
    path = paths["weather model"]
    return opened_inputs.WeatherModel(
        path.name, partial(read_model_field, path, member=section.member)
    )
