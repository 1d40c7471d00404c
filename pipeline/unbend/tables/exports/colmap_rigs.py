"""Rigs and frames of a COLMAP database: those of the database that a run read, or none.

A rig is several cameras that do not move against each other, a frame the images that it takes at a
time. Rows are those of the tables ``rigs``, ``rig_sensors``, ``frames`` and ``frame_data``, with
the numbers, from 1, that cameras and images have in the exported block. Each other camera becomes a
rig alone, each other image a frame alone.
"""

import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from unbend.messages import Ledger
from unbend.tables.exports import messages
from unbend.tables.exports.exported_block import ExportedBlock
from unbend.tables.imports.blocks import damage_refused
from unbend.tables.imports.blocks.colmap import open_database

CAMERA_SENSOR = 0  # other sensors of a rig are inertial

Rows = list[tuple[Any, ...]]
"""Rows of a table of the database."""


@dataclass
class RigTables:
    """The rows of the four tables, collected rig by rig; ``rig_of_camera`` by numbers."""

    rigs: Rows = field(default_factory=list)
    rig_sensors: Rows = field(default_factory=list)
    frames: Rows = field(default_factory=list)
    frame_data: Rows = field(default_factory=list)
    rig_of_camera: dict[int, int] = field(default_factory=dict)

    def add_rig(
        self,
        reference: int,
        others: Iterable[tuple[int, bytes | None]] = (),
    ) -> int:
        """Add a rig of a reference camera, and other cameras with poses; returns its number.

        The poses are COLMAP's blobs ``sensor_from_rig``, None for an unknown one.
        """
        number = len(self.rigs) + 1
        self.rigs.append((number, reference, CAMERA_SENSOR))
        self.rig_of_camera[reference] = number
        for camera, pose in others:
            self.rig_sensors.append((number, camera, CAMERA_SENSOR, pose))
            self.rig_of_camera[camera] = number
        return number

    def add_frame(
        self,
        rig: int,
        images: Iterable[tuple[int, int]],
    ) -> None:
        """Add a frame of a rig; ``images`` are numbers of images and of their cameras."""
        number = len(self.frames) + 1
        self.frames.append((number, rig))
        for image, camera in images:
            self.frame_data.append((number, image, camera, CAMERA_SENSOR))

    def rows(self) -> dict[str, Rows]:
        """The rows by the name of their table, without empty tables."""
        tables = {
            "rigs": self.rigs,
            "rig_sensors": self.rig_sensors,
            "frames": self.frames,
            "frame_data": self.frame_data,
        }
        return {name: rows for name, rows in tables.items() if rows}


def rig_tables(
    block: ExportedBlock,
    source: Path | None,
    ledger: Ledger,
) -> dict[str, Rows]:
    """Rows of the tables of rigs and frames, by the name of the table.

    Rigs of several cameras are copied from ``source``, the database that the run read, None without
    one. Adds (EXPORT-RIGS) a note on those that are kept, and a warning on those that are not.
    """
    tables = RigTables()
    camera_of_image = dict(enumerate((block.camera + 1).tolist(), 1))
    in_frames: set[int] = set()
    if source is not None:
        with damage_refused(source, "colmap"), closing(open_database(source)) as database:
            if has_rig_tables(database):
                in_frames = copy_rigs(block, database, tables, ledger)
    for camera in range(1, len(block.cameras) + 1):
        if camera not in tables.rig_of_camera:
            tables.add_rig(camera)
    for image, camera in camera_of_image.items():
        if image not in in_frames:
            tables.add_frame(tables.rig_of_camera[camera], [(image, camera)])
    return tables.rows()


def has_rig_tables(database: sqlite3.Connection) -> bool:
    """Whether a database has the tables of rigs, as since COLMAP 3.12."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table'"
    names = {name for (name,) in database.execute(query)}
    return names >= {"rigs", "rig_sensors", "frames", "frame_data"}


def copy_rigs(
    block: ExportedBlock,
    database: sqlite3.Connection,
    tables: RigTables,
    ledger: Ledger,
) -> set[int]:
    """Add the rigs of several cameras of ``database``, and their frames, to ``tables``.

    Returns the numbers in the block of the images in these frames. A rig is lost if its reference
    is not exactly one camera of the block, or none of its other cameras is.
    """
    image_numbers, numbers_of_camera = numbers_in_block(block, database)
    camera_numbers = unique_camera_numbers(numbers_of_camera)
    sensors = sensors_of_rigs(database)
    new_rigs = {}
    lost = 0
    query = "SELECT rig_id, ref_sensor_id, ref_sensor_type FROM rigs ORDER BY rig_id"
    for rig, reference, kind in database.execute(query).fetchall():
        other_sensors = sensors.get(rig, [])
        if not other_sensors:
            continue
        kept = [(camera_numbers[c], pose) for c, pose in other_sensors if c in camera_numbers]
        if kind != CAMERA_SENSOR or reference not in camera_numbers or not kept:
            lost += 1
            continue
        new_rigs[rig] = tables.add_rig(camera_numbers[reference], kept)
    if lost:
        ledger.add(
            messages.rigs_lost(
                where="rigs",
                count=lost,
            )
        )
    in_frames = copy_frames(database, tables, new_rigs, image_numbers, camera_numbers)
    if new_rigs:
        ledger.add(
            messages.rigs_kept(
                where="rigs",
                count=len(new_rigs),
                frames=len(tables.frames),
            )
        )
    return in_frames


def numbers_in_block(
    block: ExportedBlock,
    database: sqlite3.Connection,
) -> tuple[dict[int, int], dict[int, set[int]]]:
    """Numbers in the block, from 1, by the database's ids: of each image, and of each camera.

    A camera of the database has several numbers if the mission divides its images among cameras.
    Images that the block does not have are left out.
    """
    number_of_name = {name: number for number, name in enumerate(block.image.tolist(), 1)}
    image_numbers = {}
    numbers_of_camera: dict[int, set[int]] = {}
    for image, name, camera in database.execute("SELECT image_id, name, camera_id FROM images"):
        if name not in number_of_name:
            continue
        number = number_of_name[name]
        image_numbers[image] = number
        camera_number = int(block.camera[number - 1]) + 1
        numbers_of_camera.setdefault(camera, set()).add(camera_number)
    return image_numbers, numbers_of_camera


def sensors_of_rigs(database: sqlite3.Connection) -> dict[int, list[tuple[int, bytes | None]]]:
    """The cameras of each rig without its reference, with their poses, by the database's ids."""
    sensors: dict[int, list[tuple[int, bytes | None]]] = {}
    query = "SELECT rig_id, sensor_id, sensor_from_rig FROM rig_sensors WHERE sensor_type = ?"
    for rig, camera, pose in database.execute(query, (CAMERA_SENSOR,)):
        sensors.setdefault(rig, []).append((camera, pose))
    return sensors


def copy_frames(
    database: sqlite3.Connection,
    tables: RigTables,
    new_rigs: Mapping[int, int],
    image_numbers: Mapping[int, int],
    camera_numbers: Mapping[int, int],
) -> set[int]:
    """Add the frames of the kept rigs to ``tables``; returns the numbers of the images in them.

    The mappings are from ids in the database to numbers in ``tables`` (``new_rigs``) or the block.
    """
    images_of_frame: dict[int, list[tuple[int, int]]] = {}
    query = "SELECT frame_id, data_id, sensor_id FROM frame_data WHERE sensor_type = ?"
    for frame, image, camera in database.execute(query, (CAMERA_SENSOR,)):
        if image in image_numbers and camera in camera_numbers:
            pair = (image_numbers[image], camera_numbers[camera])
            images_of_frame.setdefault(frame, []).append(pair)
    in_frames: set[int] = set()
    query = "SELECT frame_id, rig_id FROM frames ORDER BY frame_id"
    for frame, rig in database.execute(query).fetchall():
        images = sorted(images_of_frame.get(frame, []))
        if rig in new_rigs and images:
            tables.add_frame(new_rigs[rig], images)
            in_frames.update(image for image, _ in images)
    return in_frames


def unique_camera_numbers(numbers_of_camera: Mapping[int, set[int]]) -> dict[int, int]:
    """The number in the block of each camera of a database that is exactly one camera there.

    ``numbers_of_camera`` is that of `numbers_in_block`. Left out are cameras with several numbers,
    and those with a number that another camera of the database has too.

    >>> unique_camera_numbers({10: {1}, 11: {2, 3}, 12: {4}, 13: {4}})
    {10: 1}
    """
    cameras_of_number: dict[int, int] = {}
    for numbers in numbers_of_camera.values():
        for number in numbers:
            cameras_of_number[number] = cameras_of_number.get(number, 0) + 1
    camera_numbers = {}
    for camera, numbers in numbers_of_camera.items():
        (first, *other_numbers) = numbers
        if not other_numbers and cameras_of_number[first] == 1:
            camera_numbers[camera] = first
    return camera_numbers
