"""The inputs of a mission: their files and hashes, and whether they have changed."""

import hashlib
import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from unbend.batch import messages
from unbend.config import Mission
from unbend.config.orientations import KnownPositions
from unbend.ingest import hash_file
from unbend.tables.geodata.gdal import raster_files
from unbend.tables.imports.blocks import BLOCKS, block_reader, damage_refused
from unbend.tables.manifest.run import InputRecord

SETTLED_NS = 2_000_000_000
"""A file changed within this time may change again and keep its times: FAT has steps of 2 s."""

GDAL = "GDAL"
"""The `NamedInput.program` of a raster, with which GDAL reads other files of its folder."""

BUILT_IN_GEOID = "egm96"
"""The geoid that needs no file: it is in the package."""

_EXIF_BYTES = 1 << 18  # EXIF comes first in a JPEG, and is never longer


class NamedInput(NamedTuple):
    """An input as the mission file names it.

    role : its purpose in the mission: log, observations, events, ...
    key : the key of the mission file that names it.
    name : its path or URL in the mission file.
    program : the program that wrote a block, or `GDAL` for a raster: such an input may have several
        files. None for any other file, and for a folder of images.
    may_be_folder : whether a folder is allowed in the place of a file.
    """

    role: str
    key: str
    name: str
    program: str | None = None
    may_be_folder: bool = False


def named_inputs(mission: Mission) -> Iterator[NamedInput]:
    """The files that a mission reads, with the keys of the mission file that name them.

    The manifest lists them in this order, and the first missing one is refused.
    """
    if mission.log is not None:
        yield NamedInput("log", "log.path", mission.log.path)
    yield _observations(mission)
    yield from _heights_and_points(mission)
    yield from _orientation(mission)
    yield from _events(mission)
    yield from _camera_files(mission)
    for name, positions in mission.position_events.items():
        yield NamedInput(f"events of {name}", "events.positions", positions.path)
    yield from _trajectory(mission)
    yield from _soundings_and_model(mission)


def _observations(mission: Mission) -> NamedInput:
    """The table of observations, or the block of another program that has them."""
    section = mission.observations
    program = block_program(section.format)
    return NamedInput(
        role="observations",
        key="observations.path",
        name=section.path,
        program=program,
        may_be_folder=program is not None,
    )


def _heights_and_points(mission: Mission) -> Iterator[NamedInput]:
    """Geoid, object points, control points and the rasters of the elevation model."""
    geoid = mission.mission.geoid
    if geoid != BUILT_IN_GEOID:
        yield NamedInput("geoid", "mission.geoid", geoid, program=GDAL)
    ground = mission.ground
    if ground.points is not None:
        yield NamedInput("object points", "ground.height.points", ground.points.points)
    if mission.control is not None:
        yield NamedInput("control", "control.path", mission.control.path)
    if ground.model is not None:
        for number, path in enumerate(ground.model.paths, start=1):
            yield NamedInput(f"elevation model {number}", "ground.height.dem", path, program=GDAL)


def _orientation(mission: Mission) -> Iterator[NamedInput]:
    """The orientations of the images, and the known positions that georeference their frame."""
    section = mission.stations.orientation
    if section is None:
        return
    program = block_program(section.format)
    yield NamedInput(
        role="orientation",
        key="stations.orientation.path",
        name=section.path,
        program=program,
        may_be_folder=program is not None or section.format == "dji",
    )
    known_positions = section.known_positions
    if isinstance(known_positions, KnownPositions):
        key = "stations.orientation.known_positions.path"
        yield NamedInput("known positions", key, known_positions.path)


def _events(mission: Mission) -> Iterator[NamedInput]:
    """The table of events, and the images with the times of exposure in their EXIF."""
    section = mission.events
    if section is None:
        return
    if section.csv is not None:
        yield NamedInput("events", "events.csv.path", section.csv.path)
    if section.images is not None:
        yield NamedInput("images", "events.images.path", section.images.path, may_be_folder=True)


def _camera_files(mission: Mission) -> Iterator[NamedInput]:
    """The files of interior orientations, which may be blocks of other programs."""
    for name, camera in mission.cameras.items():
        if camera.file is None:
            continue
        program = block_program(camera.format)
        yield NamedInput(
            role=f"camera {name}",
            key=f"cameras.{name}.file",
            name=camera.file,
            program=program,
            may_be_folder=program is not None,
        )


def _trajectory(mission: Mission) -> Iterator[NamedInput]:
    """The trajectory, and the file of its accuracy."""
    section = mission.stations.trajectory
    if section is None:
        return
    yield NamedInput("trajectory", "stations.trajectory.path", section.path)
    if section.accuracy is not None:
        key = "stations.trajectory.accuracy"
        yield NamedInput("trajectory accuracy", key, section.accuracy)


def _soundings_and_model(mission: Mission) -> Iterator[NamedInput]:
    """Soundings of the air, and a weather model."""
    section = mission.atmosphere
    for number, sounding in enumerate(section.soundings):
        yield NamedInput(sounding_role(number), "atmosphere.soundings", sounding.path)
    if section.model is not None:
        yield NamedInput("weather model", "atmosphere.model.path", section.model.path)


def block_program(format_name: str | None) -> str | None:
    """The program that writes blocks of a format; None if the format is not that of a block."""
    return format_name if format_name in BLOCKS else None


def sounding_role(number: int) -> str:
    """The role of a sounding by its index, which counts from 0: "sounding 1" for 0."""
    return f"sounding {number + 1}"


def is_raster(role: str) -> bool:
    """Whether GDAL reads the input with this role, with other files of its folder."""
    return role == "geoid" or role.startswith("elevation model")


class FileState(NamedTuple):
    """Properties of a file that change when the file is written to or replaced."""

    device: int
    inode: int
    size_bytes: int
    mtime_ns: int
    ctime_ns: int

    @property
    def is_settled(self) -> bool:
        """Whether the last change is so long ago that another one changes the times."""
        return max(self.mtime_ns, self.ctime_ns) < time.time_ns() - SETTLED_NS

    @property
    def without_device(self) -> tuple[int, ...]:
        """The state without the device: machines that share a disk number devices differently."""
        return self[1:]


def state_of(path: str | Path) -> FileState | None:
    """The state of a file, or of the file that a link leads to; None if there is none."""
    try:
        stat = os.stat(path)
    except OSError:
        return None
    return FileState(stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)


States = tuple[FileState | None, ...]


def record_of(named: NamedInput, files: tuple[Path, ...], states: States) -> InputRecord:
    """The record of an input from the states of its files, without a hash of its content.

    Fields of the record:
    mtime_ns : the latest time of the files; None unless all files exist and are settled, because
        only then an equal time proves later that the input is unchanged.
    version : a hash of names, sizes and times of the files; "" for an input that is one file.
    """
    existing = [state for state in states if state is not None]
    all_exist = bool(existing) and len(existing) == len(states)
    is_settled = all_exist and all(state.is_settled for state in existing)
    has_several_files = len(files) > 1 or named.may_be_folder
    return InputRecord(
        role=named.role,
        name=named.name,
        sha256="",
        bytes=sum(state.size_bytes for state in existing),
        mtime_ns=max(state.mtime_ns for state in existing) if is_settled else None,
        version=_hash_of_listing(files, states) if has_several_files else "",
    )


def _hash_of_listing(files: tuple[Path, ...], states: States) -> str:
    """SHA-256 of the names, sizes and times of files, which serves as their common version."""
    digest = hashlib.sha256()
    for file, state in zip(files, states, strict=True):
        size_bytes = None if state is None else state.size_bytes  # None: the file is missing
        mtime_ns = None if state is None else state.mtime_ns
        digest.update(f"{file.name}\0{size_bytes}\0{mtime_ns}\0".encode())
    return digest.hexdigest()


def files_of(path: Path, program: str | None) -> tuple[Path, ...]:
    """The files of an input at ``path``; ``program`` is as in `NamedInput`.

    They are all files of a block; a raster and the files that GDAL reads with it; the images of a
    folder; or else the one file.
    """
    if program == GDAL:
        return raster_files(path)
    if program is not None:
        with damage_refused(path, program):
            return block_reader(program).block_files(path)
    if path.is_file():
        return (path,)
    from unbend.tables.imports.exif import image_files

    return tuple(image_files(path))


def hash_input(
    path: Path, program: str | None, files: tuple[Path, ...], states: States = ()
) -> str:
    """SHA-256 of an input: of one file, or of the names and hashes of several.

    ``files`` are all files of the input. Those of a block or a raster are read whole; of the images
    of a folder (``program`` None) only the EXIF is read. ``states`` are the states of ``files``: a
    file that this process has hashed in the same state is not read again. Without ``states`` all
    files are read.
    """
    state_of_each = states or (None,) * len(files)
    if files == (path,):  # the input is one file
        return hash_once(path, state_of_each[0])
    digest = hashlib.sha256()
    for file, state in zip(files, state_of_each, strict=True):
        if program is not None:
            digest.update(f"{file.name}\0{hash_once(file, state)}\0".encode())
        else:
            size = file.stat().st_size
            digest.update(f"{file.relative_to(path)}\0{size}\0{hash_of_exif(file)}\0".encode())
    return digest.hexdigest()


def hash_once(path: Path, state: FileState | None) -> str:
    """SHA-256 of a file, which is read only once in the same state by all missions of a process.

    It is read each time if ``state`` is None or not settled: then a change may leave the state.
    """
    if state is None or not state.is_settled:
        return hash_file(path)
    return _hash_in_state(path, state)


@lru_cache(maxsize=1000)
def _hash_in_state(path: Path, _: FileState) -> str:
    """SHA-256 of a file; the cache has an entry for each state of a file."""
    return hash_file(path)


def hash_of_exif(path: Path) -> str:
    """SHA-256 of the beginning of a JPEG, which contains the EXIF, or of all of another file."""
    with path.open("rb") as stream:
        start = stream.read(_EXIF_BYTES)
    if start.startswith(b"\xff\xd8"):
        return hashlib.sha256(start).hexdigest()
    return hash_file(path)


@dataclass(frozen=True)
class Input:
    """An input as a run reads it: its record, its path on this machine, and its files' states.

    ``url`` is that of an input in object storage, otherwise "": ``path`` is then the path of its
    copy, which may not be made yet. ``program`` is as in `NamedInput`.
    """

    record: InputRecord
    path: Path
    states: States = ()
    program: str | None = None
    url: str = ""

    @property
    def role(self) -> str:
        """Its purpose in the mission: log, observations, events, ..."""
        return self.record.role

    @property
    def name(self) -> str:
        """Its path or URL in the mission file."""
        return self.record.name

    @property
    def sha256(self) -> str:
        """The hash of its content, as by `hash_input`."""
        return self.record.sha256


def check_unchanged(inputs: Iterable[Input], *, folders: bool = True) -> None:
    """Refuse (INPUT-CHANGED) inputs that were written to, or replaced, since they were hashed.

    An input that was written again with the same content is refused too, because another content
    may have been read in between. ``folders`` also checks the images of folders. Inputs in object
    storage are not checked here, but by `remote.refuse_changed`.
    """
    for item in inputs:
        is_folder_of_images = item.program is None and item.path.is_dir()
        if item.url or (is_folder_of_images and not folders):
            continue
        now = [state_of(file) for file in files_of(item.path, item.program)]
        if _without_devices(now) != _without_devices(item.states):
            raise messages.input_changed(role=item.role, path=str(item.path))


def _without_devices(states: Iterable[FileState | None]) -> list[tuple[int, ...] | None]:
    """The states of files, without the numbers of their devices; None for a missing file."""
    return [None if state is None else state.without_device for state in states]
