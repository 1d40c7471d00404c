"""The inputs of a mission: which they are, what they hold, and whether they are as they were."""

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
from unbend.ingest import hash_file
from unbend.tables.geodata.gdal import raster_files
from unbend.tables.imports.blocks import BLOCKS, block_reader, damage_refused
from unbend.tables.manifest.run import InputRecord

SETTLED_NS = 2_000_000_000
"""A file changed within this time may change again with the same times: FAT counts 2 s."""

GDAL = "GDAL"
"""Stands for the program of a raster, beside which GDAL reads other files."""

_EXIF_BYTES = 1 << 18  # EXIF comes first in a JPEG, and is never longer


class NamedInput(NamedTuple):
    """An input as the mission file names it.

    ``program`` is that of a block, or GDAL: such an input has several files.
    """

    role: str
    key: str
    name: str
    program: str | None = None
    may_be_folder: bool = False


def named_inputs(mission: Mission) -> Iterator[NamedInput]:
    """The files that a mission reads, with the keys of the mission file that name them."""
    stations = mission.stations
    events = mission.events
    orientation = stations.orientation
    if mission.log is not None:
        yield NamedInput("log", "log.path", mission.log.path)
    observations = mission.observations
    program = block_program(observations.format)
    yield NamedInput(
        "observations", "observations.path", observations.path, program, program is not None
    )
    if mission.mission.geoid != "egm96":
        yield NamedInput("geoid", "mission.geoid", mission.mission.geoid, GDAL)
    if mission.ground.points is not None:
        yield NamedInput("object points", "ground.height.points", mission.ground.points.points)
    if mission.control is not None:
        yield NamedInput("control", "control.path", mission.control.path)
    if mission.ground.model is not None:
        for number, path in enumerate(mission.ground.model.paths, 1):
            yield NamedInput(f"elevation model {number}", "ground.height.dem", path, GDAL)
    if orientation is not None:
        program = block_program(orientation.format)
        yield NamedInput(
            "orientation",
            "stations.orientation.path",
            orientation.path,
            program,
            may_be_folder=program is not None or orientation.format == "dji",
        )
        known = orientation.known_positions
        if known is not None and not isinstance(known, str):
            key = "stations.orientation.known_positions.path"
            yield NamedInput("known positions", key, known.path)
    if events is not None and events.csv is not None:
        yield NamedInput("events", "events.csv.path", events.csv.path)
    if events is not None and events.images is not None:
        yield NamedInput("images", "events.images.path", events.images.path, may_be_folder=True)
    for name, camera in mission.cameras.items():
        if camera.file is not None:
            program = block_program(camera.format)
            role = f"camera {name}"
            yield NamedInput(
                role, f"cameras.{name}.file", camera.file, program, program is not None
            )
    for name, positions in mission.position_events.items():
        yield NamedInput(f"events of {name}", "events.positions", positions.path)
    if stations.trajectory is not None:
        trajectory = stations.trajectory
        yield NamedInput("trajectory", "stations.trajectory.path", trajectory.path)
        if trajectory.accuracy is not None:
            key = "stations.trajectory.accuracy"
            yield NamedInput("trajectory accuracy", key, trajectory.accuracy)
    for number, sounding in enumerate(mission.atmosphere.soundings):
        yield NamedInput(sounding_role(number), "atmosphere.soundings", sounding.path)
    if mission.atmosphere.model is not None:
        yield NamedInput("weather model", "atmosphere.model.path", mission.atmosphere.model.path)


def block_program(program: str | None) -> str | None:
    """The program of an input that is a block; None where its format is another one."""
    return program if program in BLOCKS else None


def sounding_role(number: int) -> str:
    """The role of a sounding among the inputs, counted from 0."""
    return f"sounding {number + 1}"


def is_raster(role: str) -> bool:
    """Whether an input is read by GDAL, with the files beside it."""
    return role == "geoid" or role.startswith("elevation model")


class FileState(NamedTuple):
    """What changes when a file is written to, or replaced."""

    device: int
    inode: int
    size_bytes: int
    mtime_ns: int
    ctime_ns: int

    @property
    def is_settled(self) -> bool:
        """Whether the last change is so long ago that the next one will show."""
        return max(self.mtime_ns, self.ctime_ns) < time.time_ns() - SETTLED_NS

    @property
    def elsewhere(self) -> tuple[int, ...]:
        """The state as all machines that share a disk see it: each numbers devices by itself."""
        return self[1:]


def state_of(path: str | Path) -> FileState | None:
    """The state of a file, links followed; None where it is not there."""
    try:
        stat = os.stat(path)
    except OSError:
        return None
    return FileState(stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)


States = tuple[FileState | None, ...]


def record_of(named: NamedInput, files: tuple[Path, ...], states: States) -> InputRecord:
    """The record of an input by the states of its files, without a hash."""
    there = [state for state in states if state is not None]
    settled = bool(there) and len(there) == len(states) and all(s.is_settled for s in there)
    listed = ""
    if len(files) > 1 or named.may_be_folder:
        digest = hashlib.sha256()
        for file, state in zip(files, states, strict=True):
            size = state and state.size_bytes
            mtime = state and state.mtime_ns
            digest.update(f"{file.name}\0{size}\0{mtime}\0".encode())
        listed = digest.hexdigest()
    return InputRecord(
        role=named.role,
        name=named.name,
        sha256="",
        bytes=sum(state.size_bytes for state in there),
        mtime_ns=max(state.mtime_ns for state in there) if settled else None,
        version=listed,
    )


def files_of(path: Path, program: str | None) -> tuple[Path, ...]:
    """The files of an input: of a block all, of a raster those beside it too, or images."""
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
    """SHA-256 of a file, or of names and hashes of a block's, a raster's or a folder's files.

    Of the images of a folder only EXIF is read. Without ``states`` of its files all are read.
    """
    states = states or (None,) * len(files)
    if files == (path,):
        return hash_once(path, states[0])
    digest = hashlib.sha256()
    for file, state in zip(files, states, strict=True):
        if program is not None:
            digest.update(f"{file.name}\0{hash_once(file, state)}\0".encode())
        else:
            size = file.stat().st_size
            digest.update(f"{file.relative_to(path)}\0{size}\0{hash_of_exif(file)}\0".encode())
    return digest.hexdigest()


def hash_once(path: Path, state: FileState | None) -> str:
    """SHA-256 of a file in a state; missions of one process that share it read it once."""
    if state is None or not state.is_settled:
        return hash_file(path)
    return _hash_in_state(path, state)


@lru_cache(maxsize=1000)
def _hash_in_state(path: Path, _: FileState) -> str:
    return hash_file(path)


def hash_of_exif(path: Path) -> str:
    """SHA-256 of the beginning of a JPEG, where its EXIF is; of another file, of all of it."""
    with path.open("rb") as stream:
        start = stream.read(_EXIF_BYTES)
    if start.startswith(b"\xff\xd8"):
        return hashlib.sha256(start).hexdigest()
    return hash_file(path)


@dataclass(frozen=True)
class Input:
    """An input as a run reads it: its record, where it is here, and the states of its files.

    ``url`` is that of an input in object storage: ``path`` is then the place of its copy, which
    may not be made yet.
    """

    record: InputRecord
    path: Path
    states: States = ()
    program: str | None = None
    url: str = ""

    @property
    def role(self) -> str:
        """What it is to the mission: log, observations, events, ..."""
        return self.record.role

    @property
    def name(self) -> str:
        """What the mission file calls it."""
        return self.record.name

    @property
    def sha256(self) -> str:
        """The hash of its content."""
        return self.record.sha256


def check_unchanged(inputs: Iterable[Input], *, folders: bool = True) -> None:
    """Refuse results whose inputs were written to, or replaced, while they were made.

    By the same content too: another one may have been there in between, and read. Without
    ``folders`` those of images are not looked at. Objects in storage are compared by `remote`.
    """
    for item in inputs:
        if item.url or not (folders or item.program is not None or item.path.is_file()):
            continue
        now = [state_of(file) for file in files_of(item.path, item.program)]
        if _as_shared(now) != _as_shared(item.states):
            raise messages.input_changed(role=item.role, path=str(item.path))


def _as_shared(states: Iterable[FileState | None]) -> list[tuple[int, ...] | None]:
    return [None if state is None else state.elsewhere for state in states]
