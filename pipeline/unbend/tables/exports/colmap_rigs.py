"""Rigs and frames of a COLMAP database: those of the database that a run read, or none.

A rig is several cameras that do not move against each other, a frame the images that it takes at a
time. Rows are those of the tables ``rigs``, ``rig_sensors``, ``frames`` and ``frame_data``, with
the numbers that cameras and images have in the exported block. A camera that is in no rig is a rig
of its own, and an image in no frame a frame of its own.
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


@dataclass
class RigTables:
    """Rows of the four tables, as they come together."""

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
        """A rig of a reference camera and other cameras with their poses; its number."""
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
        """A frame of a rig, with numbers of images and their cameras."""
        number = len(self.frames) + 1
        self.frames.append((number, rig))
        for image, camera in images:
            self.frame_data.append((number, image, camera, CAMERA_SENSOR))

    def rows(self) -> dict[str, Rows]:
        """Rows by the name of their table, without tables that have none."""
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
    """Rows of the tables of rigs and frames, by their names.

    ``source`` is the database that the run read. Adds a note on the rigs of several cameras that
    are kept, and a warning (EXPORT-RIGS) on those that cannot be.
    """
    tables = RigTables()
    camera_of_image = dict(enumerate((block.camera + 1).tolist(), 1))
    in_frames: set[int] = set()
    if source is not None:
        with damage_refused(source, "colmap"), closing(open_database(source)) as database:
            if is_with_rigs(database):
                in_frames = copy_rigs(block, database, tables, ledger)
    for camera in range(1, len(block.cameras) + 1):
        if camera not in tables.rig_of_camera:
            tables.add_rig(camera)
    for image, camera in camera_of_image.items():
        if image not in in_frames:
            tables.add_frame(tables.rig_of_camera[camera], [(image, camera)])
    return tables.rows()


def is_with_rigs(database: sqlite3.Connection) -> bool:
    """Whether a database has the tables of rigs, which COLMAP 3.12 brought."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table'"
    names = {name for (name,) in database.execute(query)}
    return names >= {"rigs", "rig_sensors", "frames", "frame_data"}


def copy_rigs(
    block: ExportedBlock,
    database: sqlite3.Connection,
    tables: RigTables,
    ledger: Ledger,
) -> set[int]:
    """Copy the rigs of several cameras and their frames; the images that are in these frames."""
    image_numbers, cameras = numbers_here(block, database)
    sensors = sensors_of_rigs(database)
    camera_numbers = only_partners(cameras)
    new_rigs = {}
    lost = 0
    query = "SELECT rig_id, ref_sensor_id, ref_sensor_type FROM rigs ORDER BY rig_id"
    for rig, reference, kind in database.execute(query).fetchall():
        other_sensors = sensors.get(rig, [])
        if not other_sensors:
            continue
        there = [(camera_numbers[c], pose) for c, pose in other_sensors if c in camera_numbers]
        if kind != CAMERA_SENSOR or reference not in camera_numbers or not there:
            lost += 1
            continue
        new_rigs[rig] = tables.add_rig(camera_numbers[reference], there)
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


def numbers_here(
    block: ExportedBlock,
    database: sqlite3.Connection,
) -> tuple[dict[int, int], dict[int, set[int]]]:
    """The numbers in the block of a database's images, and of its cameras all that they have."""
    numbers = {name: number for number, name in enumerate(block.image.tolist(), 1)}
    image_numbers = {}
    cameras: dict[int, set[int]] = {}
    for image, name, camera in database.execute("SELECT image_id, name, camera_id FROM images"):
        if name not in numbers:
            continue
        number = numbers[name]
        image_numbers[image] = number
        cameras.setdefault(camera, set()).add(int(block.camera[number - 1]) + 1)
    return image_numbers, cameras


def sensors_of_rigs(database: sqlite3.Connection) -> dict[int, list[tuple[int, bytes | None]]]:
    """The cameras of each rig beside its reference, with their poses."""
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
    """Copy the frames of the rigs that are kept; the images that are in them."""
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


def only_partners(cameras: Mapping[int, set[int]]) -> dict[int, int]:
    """The number here of each camera of a database that is one here, and no other's."""
    users: dict[int, int] = {}
    for numbers in cameras.values():
        for number in numbers:
            users[number] = users.get(number, 0) + 1
    partners = {}
    for camera, numbers in cameras.items():
        (first, *other_numbers) = numbers
        if not other_numbers and users[first] == 1:
            partners[camera] = first
    return partners
