"""Times, positions and gimbal angles of the images of a flight: EXIF, DJI's XMP, exiftool's CSV."""

import logging
import re
import struct
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import exifread
import numpy as np
import pandas as pd
from exifread.core.exceptions import ExifError
from scipy.spatial.transform import Rotation

from unbend.flight import rotations
from unbend.flight.image_names import composed
from unbend.flight.stations import NO_TIME
from unbend.messages import Ledger
from unbend.tables.imports import messages
from unbend.tables.imports.image_stamps import FARTHEST_ZONE_S, Stamp, gps_stamp, time_of_tags
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import OrientationTable
from unbend.tables.imports.xmp import dji_tags
from unbend.tables.text_columns import whole_table
from unbend.units import LARGEST_HEIGHT_M, Array, Integers, Names
from unbend.written_numbers import LETTERS_OF_AXIS, angle_of, height_of

ENDINGS = ".3fr .arw .cr2 .cr3 .dng .heic .iiq .jpeg .jpg .nef .orf .raf .rw2 .tif .tiff"

_MOST_EXAMPLES = 3  # of images that a message names
_ERRORS_OF_DAMAGE = (
    ExifError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    EOFError,
    OSError,
    MemoryError,
    struct.error,
)
"""Errors that exifread and its libraries raised on 41,000 damaged files."""

_RECEIVER_SIGMA_S = 2.0  # a receiver's stamp may be some seconds old
_ZONE_STEP_S = 900  # the zones of the world differ by quarters of an hour
_ZONE_PROOF_S = 120.0  # a difference this near to a step of zones may be that of a zone
_ZONE_PROOF_PART = 0.9  # part of the images that must agree


@dataclass(frozen=True, eq=False)
class ImageTimes:
    """Images that exist, (m,): paths with slashes, and the times of their camera's clock.

    ``time_ns`` is local time counted as though it were UTC where ``is_utc`` is False; `NO_TIME` if
    unknown. ``sigma_s`` (m,) is half of the step in which the clock counts; ``clock_sigma_s`` is
    that of the clock itself, infinite except for times of a GPS receiver. ``position`` (m, 3) is
    latitude, longitude [rad] and the height as written [m], NaN if unknown.
    """

    file: Names
    time_ns: Integers
    sigma_s: Array
    is_utc: bool
    position: Array
    clock_sigma_s: float = np.inf

    def rows_of(self, images: Iterable[str]) -> dict[str, int]:
        """The row of each image that is among the files; images without a file are left out.

        Name and file may differ in their ending, and in folders that only one of the two states.
        Refuses (InputError IMAGES-DUPLICATE) an image that may be one of two files.
        """
        paths = [_folders_and_name(str(file)) for file in self.file]
        rows_of_name: dict[str, list[int]] = defaultdict(list)
        for row, path in enumerate(paths):
            rows_of_name[path[-1]].append(row)
        row_of_image = {}
        for image in images:
            image_path = _folders_and_name(image)
            same_name = rows_of_name.get(image_path[-1], ())
            rows = [row for row in same_name if _may_be_same_file(paths[row], image_path)]
            if len(rows) > 1:
                first, second = self.file[rows[:2]]
                raise messages.images_duplicate(
                    where="events.images",
                    image=image,
                    first=str(first),
                    second=str(second),
                )
            if rows:
                row_of_image[image] = rows[0]
        return row_of_image


def _may_be_same_file(path: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether two paths end alike: the same name, and the same folders as far as both have any."""
    from_name = zip(reversed(path), reversed(other), strict=False)
    return all(part == other_part for part, other_part in from_name)


def _folders_and_name(path: str) -> tuple[str, ...]:
    """A path as folders and name, without ending, in lower case and with composed characters."""
    pure = PurePosixPath(composed(path).replace("\\", "/").casefold())
    return tuple(part for part in pure.with_suffix("").parts if part not in ("/", "."))


def read_image_times(path: Path, zone: str, ledger: Ledger) -> ImageTimes:
    """Read the times of the images in a folder and its subfolders, or in a CSV of exiftool.

    ``zone`` is the UTC offset of the camera's clock, such as +02:00 or UTC; "" if not stated.

    A time is taken from, in this order: drone-dji:UTCAtExposure; GPS week and seconds; a Unix or
    ISO time (time_utc); DateTimeOriginal with its SubSecTime and OffsetTime; DateTimeDigitized; the
    GPS stamp. The date of a file's last change is not used. A time zone is inferred only where the
    GPS stamps of the same images prove it. Images without a time are losses.
    """
    tags = read_tags(path, ledger)
    files = sorted(tags)
    stamps = {}
    for file in tags:
        stamp = time_of_tags(tags[file], zone)
        if stamp is not None:
            stamps[file] = stamp
    stamps |= _stamps_in_utc(path, tags, stamps, ledger)
    # The majority decides: a local time among times in UTC would be hours off.
    count_utc = sum(stamp.is_utc for stamp in stamps.values())
    is_utc = 2 * count_utc > len(stamps)
    time_ns = np.full(len(files), NO_TIME, np.int64)
    step_s = np.full(len(files), np.nan)
    all_by_gps = True
    without_time = []
    for row, file in enumerate(files):
        stamp = stamps.get(file)
        if stamp is None or stamp.is_utc != is_utc:
            without_time.append(file)
            continue
        time_ns[row] = stamp.time_ns
        step_s[row] = stamp.step_s
        all_by_gps = all_by_gps and stamp.by_gps
    _report_without_time(path, without_time, len(files), ledger)
    step_s = _steps_of_clock(path, time_ns, step_s, ledger)
    return ImageTimes(
        file=np.array(files, object),
        time_ns=time_ns,
        sigma_s=np.maximum(step_s / 2.0, 1e-3),
        is_utc=is_utc,
        position=positions_of_tags({file: tags[file] for file in files}, path, ledger),
        clock_sigma_s=_RECEIVER_SIGMA_S if all_by_gps else np.inf,
    )


def _stamps_in_utc(
    path: Path,
    tags: Mapping[str, Mapping[str, str]],
    stamps: Mapping[str, Stamp],
    ledger: Ledger,
) -> dict[str, Stamp]:
    """The local ``stamps`` converted to UTC, by image; empty if their zone is not proved.

    The zone is the median difference from the GPS receiver's stamps of the same images. It is
    proved if nearly all differences are near it. ``tags`` and ``stamps`` are by image.
    """
    local = {file: stamp for file, stamp in stamps.items() if not stamp.is_utc}
    ahead_ns = []
    for file, stamp in local.items():
        fix = gps_stamp(tags[file])
        if fix is not None:
            ahead_ns.append(stamp.time_ns - fix.time_ns)
    if not ahead_ns:
        return {}
    ahead_s = np.array(ahead_ns) / 1e9
    steps = int(np.round(np.median(ahead_s) / _ZONE_STEP_S))
    zone_s = steps * _ZONE_STEP_S
    part_agreeing = float(np.mean(np.abs(ahead_s - zone_s) < _ZONE_PROOF_S))
    if part_agreeing <= _ZONE_PROOF_PART or abs(zone_s) > FARTHEST_ZONE_S:
        return {}
    hours = zone_s / 3600
    ledger.add(messages.zone_of_camera(where=path.name, count=len(ahead_ns), hours=hours))
    in_utc = {}
    for file, stamp in local.items():
        time_ns = stamp.time_ns - zone_s * 10**9
        in_utc[file] = stamp._replace(time_ns=time_ns, is_utc=True)
    return in_utc


def _report_without_time(
    path: Path,
    files: Sequence[str],
    total: int,
    ledger: Ledger,
) -> None:
    """Report a loss for images (``files``) without a time, of ``total`` images."""
    if not files:
        return
    examples = ", ".join(files[:_MOST_EXAMPLES])
    if len(files) > _MOST_EXAMPLES:
        examples += " ..."
    lost = messages.images_without_time(
        where=path.name,
        count=len(files),
        total=total,
        examples=examples,
    )
    ledger.add(lost)


def _steps_of_clock(path: Path, time_ns: Integers, step_s: Array, ledger: Ledger) -> Array:
    """(m,) the steps [s] in which the camera's clock counts; whole seconds are reported.

    They are ``step_s``, the steps of the texts, or 1 s where the fraction of a second is the same
    in all images: some cameras always write 00.
    """
    has_time = time_ns != NO_TIME
    fraction_ns = time_ns[has_time] % 10**9
    if fraction_ns.size > 4 and np.ptp(fraction_ns) == 0:
        step_s = np.where(has_time, 1.0, step_s)
    whole_seconds = int((step_s >= 1.0).sum())
    if whole_seconds:
        ledger.add(messages.clock_of_whole_seconds(where=path.name, count=whole_seconds))
    return step_s


_NAMES_OF_FILES = ("SourceFile", "FileName", "image")  # columns that may name the image


def read_tags(path: Path, ledger: Ledger) -> dict[str, dict[str, str]]:
    """Image -> tag -> text, of the images in a folder or in a CSV of exiftool.

    The tags have the names of `_tag_key`. Refuses (InputError IMAGES-NONE) a path without images.
    """
    tags = _tags_of_folder(path, ledger) if path.is_dir() else _tags_of_csv(path)
    if not tags:
        raise messages.images_none(where=path, endings=ENDINGS)
    return tags


def _tags_of_csv(path: Path) -> dict[str, dict[str, str]]:
    """Image -> tag -> text, of exiftool's CSV; empty without a column that names the images."""
    table = whole_table(path, messages.IMAGES_CSV, _NAMES_OF_FILES)
    table.columns = pd.Index([_tag_key(str(name)) for name in table.columns])
    table = table.loc[:, ~table.columns.duplicated()]
    keys = [_tag_key(name) for name in _NAMES_OF_FILES]
    file_column = next((key for key in keys if key in table), None)
    if file_column is None:
        return {}
    tags = {}
    for row in table.to_dict("records"):
        file = row[file_column]
        if file:
            tags[file] = {str(key): text for key, text in row.items()}
    return tags


@dataclass
class TagReader:
    """Reads numbers and angles of the tags of images, and counts texts that cannot be read.

    count_read : number of values that were read.
    unread : tag -> first image and its text that cannot be read, and the number of such images.
    """

    count_read: int = 0
    unread: dict[str, tuple[str, str, int]] = field(default_factory=dict)

    def value(
        self,
        file: str,
        tags: Mapping[str, str],
        key: str,
        reader: Callable[[str], float],
    ) -> float:
        """The value of the tag ``key`` of the image ``file``; NaN if it cannot be read.

        ``reader`` converts the text ("" without the tag), and raises ValueError if it cannot.
        """
        text = tags.get(key, "")
        try:
            value = reader(text)
        except ValueError:
            first_file, first_text, count = self.unread.get(key, (file, text, 0))
            self.unread[key] = (first_file, first_text, count + 1)
            return np.nan
        self.count_read += bool(np.isfinite(value))
        return value

    def report(self, where: Path, ledger: Ledger) -> None:
        """Report each tag with unreadable texts; refuses (IMAGES-TAG) if no value was read."""
        for key, (file, text, count) in self.unread.items():
            if self.count_read == 0:
                raise messages.no_tag_readable(where=where, tag=key, image=file, value=text)
            lost = messages.tags_unreadable(
                where=where.name, tag=key, count=count, image=file, value=text
            )
            ledger.add(lost)


def positions_of_tags(tags: Mapping[str, Mapping[str, str]], where: Path, ledger: Ledger) -> Array:
    """(m, 3) latitude, longitude [rad] and height as written [m] of the images, in their order.

    ``tags`` are texts by image and tag, ``where`` is their source in messages. A row without a
    place, at 0, 0, or with impossible angles is NaN, its height too. Tags that cannot be read are
    reported.
    """
    reader = TagReader()
    positions = np.full((len(tags), 3), np.nan)
    for row, (file, tags_of_file) in enumerate(tags.items()):
        lat_deg = _angle_of_tags(reader, file, tags_of_file, "latitude")
        lon_deg = _angle_of_tags(reader, file, tags_of_file, "longitude")
        if np.isnan(lon_deg):
            lon_deg = reader.value(file, tags_of_file, "gpslongtitude", angle_of)  # as DJI spelt it
        height = _height_of_tags(reader, file, tags_of_file)
        is_on_earth = abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0
        if is_on_earth and (lat_deg, lon_deg) != (0.0, 0.0):
            positions[row] = (np.radians(lat_deg), np.radians(lon_deg), height)
    reader.report(where, ledger)
    return positions


def _angle_of_tags(reader: TagReader, file: str, tags: Mapping[str, str], axis: str) -> float:
    """The ``latitude`` or ``longitude`` of an image as its tags state it [deg]; NaN if unknown."""
    angle = partial(
        angle_of,
        hemisphere=tags.get(f"gps{axis}ref", ""),
        letters=LETTERS_OF_AXIS[axis],
    )
    return reader.value(file, tags, f"gps{axis}", angle)


def read_gimbal_orientations(path: Path, stated: Stated, ledger: Ledger) -> OrientationTable:
    """Read positions and attitudes that DJI writes into its images: the gimbal's roll, pitch, yaw.

    DJI's angles turn from north, east and down to the payload, with its forward axis along the
    optical axis. In the table they become angles of a body on which the camera looks down, with the
    top of the image forward, so that a mount has only the boresight. Missing tags are unknown.
    Refuses (InputError IMAGES-NO-GIMBAL) images without any gimbal angles.
    """
    tags = read_tags(path, ledger)
    files = sorted(tags)
    reader = TagReader()
    degrees = np.full((len(files), 3), np.nan)
    for row, file in enumerate(files):
        for column, name in enumerate(("roll", "pitch", "yaw")):
            key = f"gimbal{name}degree"
            degrees[row, column] = reader.value(file, tags[file], key, angle_of)
    reader.report(path, ledger)
    gimbal = np.radians(degrees)
    if not np.isfinite(gimbal).all(axis=1).any():
        raise messages.images_no_gimbal(where=path, files=len(files))
    time_ns = np.full(len(files), NO_TIME, np.int64)
    for row, file in enumerate(files):
        stamp = time_of_tags(tags[file], "")
        if stamp is not None and stamp.is_utc:
            time_ns[row] = stamp.time_ns
    return OrientationTable(
        image=np.array(files, object),
        camera=None,
        time_ns=time_ns,
        position=positions_of_tags({file: tags[file] for file in files}, path, ledger),
        angles=rpy_of_gimbal(gimbal),
        sigmas={},
    )


_QUARTER_TURN = Rotation.from_euler("y", 90.0, degrees=True).as_matrix()


def rpy_of_gimbal(gimbal: Array) -> Array:
    """(n, 3) roll, pitch, yaw [rad] of a body on which the camera looks down, from a gimbal's."""
    return _rpy_turned_by(_QUARTER_TURN, gimbal)


def gimbal_of_rpy(angles: Array) -> Array:
    """(n, 3) roll, pitch, yaw [rad] of a gimbal; inverse of `rpy_of_gimbal`."""
    return _rpy_turned_by(_QUARTER_TURN.T, angles)


def _rpy_turned_by(rotation: Array, angles: Array) -> Array:
    """(n, 3) roll, pitch, yaw [rad] of bodies with ``angles`` (n, 3) after a further rotation.

    ``rotation`` (3, 3) leads from the axes of the turned body to those of the body.
    """
    ned_from_turned = rotations.ned_from_body(angles) @ rotation
    camera_from_ned = rotations.CAMERA_AT_REST @ ned_from_turned.transpose(0, 2, 1)
    camera = rotations.quaternions_of(camera_from_ned)
    against_enu = rotations.in_turned_frame(camera, rotations.NED_FROM_ENU)
    return rotations.rpy_of_quaternion(against_enu)


def image_files(folder: Path) -> list[Path]:
    """The images in a folder and its subfolders, recognised by their ending, sorted."""
    endings = ENDINGS.split()
    files = [path for path in folder.rglob("*") if path.suffix.lower() in endings]
    return sorted(path for path in files if path.is_file())


def _tags_of_folder(folder: Path, ledger: Ledger) -> dict[str, dict[str, str]]:
    """Image -> tag -> text; images are paths in the folder, with slashes.

    Of files with the same name and different endings, such as raw image and JPEG, only the first is
    read. Files that cannot be read have no tags, and are reported.
    """
    logging.getLogger("exifread").setLevel(logging.CRITICAL)  # its warnings are reported below
    tags: dict[str, dict[str, str]] = {}
    unreadable = []
    names_without_ending = set()
    for path in image_files(folder):
        name = path.relative_to(folder).as_posix()
        if _folders_and_name(name) in names_without_ending:
            continue
        names_without_ending.add(_folders_and_name(name))
        tags[name] = {}
        try:
            exif_tags = _read_exif(path)
        except _ERRORS_OF_DAMAGE as error:
            unreadable.append(f"{name} ({type(error).__name__}: {error})")
            continue
        tags[name] = _texts_of_exif(exif_tags)
        try:
            tags[name] |= {_tag_key(key): text for key, text in dji_tags(path).items()}
        except (ValueError, OSError) as error:
            unreadable.append(f"{name} ({error})")
    if unreadable:
        lost = messages.exif_unreadable(
            where=folder.name,
            count=len(unreadable),
            examples=", ".join(unreadable[:_MOST_EXAMPLES]),
        )
        ledger.add(lost)
    return tags


def _read_exif(path: Path) -> dict[str, Any]:
    """The tags of an image's EXIF; raises one of `_ERRORS_OF_DAMAGE` for a damaged file."""
    with path.open("rb") as file:
        tags: dict[str, Any] = exifread.process_file(
            file,
            details=False,
            extract_thumbnail=False,
        )
    return tags


def _texts_of_exif(tags: Mapping[str, Any]) -> dict[str, str]:
    """The texts of the tags of an EXIF, by the names of `_tag_key`."""
    texts = {_tag_key(key): str(value) for key, value in tags.items()}
    if "GPS GPSTimeStamp" in tags:
        texts["gpstimestamp"] = _time_of_day(tags["GPS GPSTimeStamp"].values)
    return texts


def _time_of_day(rationals: Sequence[object]) -> str:
    """Hours, minutes and seconds of a GPSTimeStamp as text; empty if one of them is undefined, 0/0.

    >>> from exifread.utils import Ratio
    >>> _time_of_day([Ratio(10, 1), Ratio(5, 1), Ratio(61, 2)]), _time_of_day([Ratio(0, 0)] * 3)
    ('10:05:30.5', '')
    """
    parts = []
    for rational in rationals:
        numerator = getattr(rational, "numerator", rational)
        denominator = getattr(rational, "denominator", 1)
        if not isinstance(numerator, int | float) or not denominator:
            return ""
        parts.append(float(numerator) / float(denominator))
    is_time = len(parts) == 3 and bool(np.isfinite(parts).all())
    if not is_time:
        return ""
    hour, minute, second = parts
    text = f"{int(hour):02d}:{int(minute):02d}:{second:09.6f}"
    if second % 1:
        return text.rstrip("0").rstrip(".")
    return text[:8]  # whole seconds


def _tag_key(name: str) -> str:
    """A tag's name without its group, in lower case, with letters and digits alone.

    >>> _tag_key("EXIF:DateTimeOriginal"), _tag_key("GPS GPSDate"), _tag_key("time_utc")
    ('datetimeoriginal', 'gpsdate', 'timeutc')
    """
    without_group = re.split(r"[: ]", name)[-1]
    return re.sub(r"[^a-z0-9]", "", without_group.lower())


def _height_of_tags(reader: TagReader, file: str, tags: Mapping[str, str]) -> float:
    """The height of an image as its tags state it [m]; NaN if unknown or impossible."""
    if tags.get("absolutealtitude"):  # DJI's has a sign
        height = reader.value(file, tags, "absolutealtitude", height_of)
    else:
        height = reader.value(file, tags, "gpsaltitude", height_of)
        reference = tags.get("gpsaltituderef", "0").lower()  # 1: below sea level
        if reference.startswith(("1", "below")):
            height = -abs(height)
    return np.nan if abs(height) > LARGEST_HEIGHT_M else height
