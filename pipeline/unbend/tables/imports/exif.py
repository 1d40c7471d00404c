"""Times, positions and gimbal angles of the images of a flight: EXIF, DJI's XMP, exiftool's CSV."""

import logging
import re
import struct
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import exifread
import numpy as np
import pandas as pd
from exifread.core.exceptions import ExifError
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.flight import rotations
from unbend.flight.clock import SECONDS_PER_WEEK, utc_of_gps
from unbend.flight.image_names import composed
from unbend.flight.stations import NO_TIME
from unbend.flight.survey_dates import can_be_flown
from unbend.messages import Ledger
from unbend.tables.imports import messages
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import OrientationTable
from unbend.tables.imports.xmp import dji_tags
from unbend.tables.text_columns import FIRST_WEEK_OF_SURVEYS, whole_table
from unbend.units import LARGEST_HEIGHT_M, Integers, Names
from unbend.written_numbers import LETTERS_OF_AXIS, angle_of, height_of

ENDINGS = ".3fr .arw .cr2 .cr3 .dng .heic .iiq .jpeg .jpg .nef .orf .raf .rw2 .tif .tiff"

_MOST_EXAMPLES = 3  # of images that a message names
LARGEST_WEEK = 9_999  # of GPS, in 2171: a larger number is no week, and would not fit into 64 bits
_STAMP = re.compile(
    r"(\d{4})[:/-](\d\d)[:/-](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:[.,](\d+))?\s*(Z|[+-]\d\d:?\d\d)?"
)
_UNIX = re.compile(r"(\d{9,10})(?:\.(\d+))?")
_OF_DAMAGE = (
    ExifError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError, RuntimeError,
    EOFError, OSError, MemoryError, struct.error,
)  # fmt: skip
"""What exifread raises on damaged files, by 41,000 of them, and what it reads them with."""

# A receiver's stamp may be some seconds old; the zones of the world are quarters of an hour apart.
_RECEIVER_SIGMA_S, _QUARTER_S, _ZONE_PROOF_S, _FARTHEST_ZONE_S = 2.0, 900, 120.0, 14 * 3600


class Stamp(NamedTuple):
    """A moment [ns], the step in which it counts [s]; whether it is UTC, and a receiver's."""

    time_ns: int
    step_s: float
    is_utc: bool
    by_gps: bool = False


def parse_time(text: str, zone: str = "") -> Stamp | None:
    """A time as EXIF, ISO 8601 or Unix seconds write it; None where it is none of them.

    None also where no survey can have it: in the future, or of a clock that was never set.

    ``zone`` is a UTC offset stated elsewhere, such as OffsetTimeOriginal. Without one the time is
    local, and counted as though it were UTC.

    >>> parse_time("2026:05:01 10:20:30.25", "+02:00")
    Stamp(time_ns=1777623630250000000, step_s=0.01, is_utc=True, by_gps=False)
    >>> parse_time("1777623630.5").is_utc, parse_time("0000:00:00 00:00:00")
    (True, None)
    """
    text = text.strip()
    if unix := _UNIX.fullmatch(text):
        seconds, decimals, offset = int(unix[1]), unix[2] or "", "Z"
    elif stamp := _STAMP.fullmatch(text):
        year, month, day, hour, minute, second = (int(stamp[i]) for i in range(1, 7))
        try:
            moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        except ValueError:  # a 30th of February
            return None
        seconds, decimals = int(moment.timestamp()), stamp[7] or ""
        offset = stamp[8] or zone.strip()
    else:
        return None
    ahead_s = _seconds_of_zone(offset)
    if ahead_s is None and _ZONE.fullmatch(offset):
        return None
    seconds -= ahead_s or 0
    decimals = decimals[:9]
    time_ns = seconds * 10**9 + int(decimals.ljust(9, "0"))
    if not bool(can_be_flown(np.array([time_ns]))[0]):
        return None
    is_utc = ahead_s is not None or offset in ("Z", "UTC")
    return Stamp(time_ns, 10.0 ** -len(decimals), is_utc)


_ZONE = re.compile(r"(?P<sign>[+-])(?P<hours>\d\d):?(?P<minutes>\d\d)")


def _seconds_of_zone(offset: str) -> int | None:
    """How far a zone written as +05:30 is ahead of UTC [s]; None for what no zone on earth is.

    >>> _seconds_of_zone("-0330"), _seconds_of_zone("+14:00"), _seconds_of_zone("+23:59")
    (-12600, 50400, None)
    """
    zone = _ZONE.fullmatch(offset)
    if zone is None:
        return None
    minutes = int(zone["minutes"])
    ahead_s = int(zone["hours"]) * 3600 + minutes * 60
    if ahead_s > _FARTHEST_ZONE_S or minutes >= 60:
        return None
    return -ahead_s if zone["sign"] == "-" else ahead_s


@dataclass(frozen=True, eq=False)
class ImageTimes:
    """Images that exist, (m,): paths with slashes, and the times of their camera's clock.

    ``time_ns`` counts local time as though it were UTC where ``is_utc`` is False; `NO_TIME` where
    an image has none. ``sigma_s`` is half of the step in which the clock counts; ``clock_sigma_s``
    that of the clock itself, infinite but for times of a GPS receiver. ``position`` (m, 3) is
    latitude, longitude [rad] and the height as written [m], NaN where an image has none.
    """

    file: Names
    time_ns: Integers
    sigma_s: NDArray[np.float64]
    is_utc: bool
    position: NDArray[np.float64]
    clock_sigma_s: float = np.inf

    def rows_of(self, images: Iterable[str]) -> dict[str, int]:
        """The row of each image that has one, whatever the ending of its file.

        An image is known by its name, and by its folders as far as both state them. Refuses
        (InputError IMAGES-DUPLICATE) a name that stands in two folders.
        """
        parts = [_parts(str(file)) for file in self.file]
        rows: dict[str, list[int]] = defaultdict(list)
        for row, own in enumerate(parts):
            rows[own[-1]].append(row)
        found = {}
        for image in images:
            wanted = _parts(image)[::-1]
            same = [
                row
                for row in rows.get(wanted[0], ())
                if all(a == b for a, b in zip(parts[row][::-1], wanted, strict=False))
            ]
            if len(same) > 1:
                first, second = self.file[same[:2]]
                raise messages.images_duplicate(
                    where="events.images", image=image, first=str(first), second=str(second)
                )
            if same:
                found[image] = same[0]
        return found


def _parts(path: str) -> tuple[str, ...]:
    """Folders and name without ending, in one case, of composed characters."""
    pure = PurePosixPath(composed(path).replace("\\", "/").casefold())
    return tuple(part for part in pure.with_suffix("").parts if part not in ("/", "."))


def read_image_times(path: Path, zone: str, ledger: Ledger) -> ImageTimes:
    """Times of the images in a folder and those below it, or of the rows of exiftool's CSV.

    ``zone`` is the UTC offset of the camera's clock, such as +02:00 or UTC; "" if not stated.

    A time is taken from, in this order: drone-dji:UTCAtExposure; GPS week and seconds; a Unix or
    ISO time (time_utc); DateTimeOriginal with its SubSecTime and OffsetTime; DateTimeDigitized; the
    GPS stamp. The date of a file's last change is no time of an exposure. A time zone is inferred
    only where the GPS stamps of the same images prove it. Images without a time are losses.
    """
    tags = read_tags(path, ledger)
    stamps = {file: stamp for file, of in tags.items() if (stamp := _time_of(of, zone)) is not None}
    local = [file for file, stamp in stamps.items() if not stamp.is_utc]
    fixes = {file: fix for file in local if (fix := _gps_stamp(tags[file])) is not None}
    if fixes:
        ahead = np.array([stamps[file].time_ns - fix.time_ns for file, fix in fixes.items()]) / 1e9
        zone_s = int(np.round(np.median(ahead) / _QUARTER_S)) * _QUARTER_S
        proved = float(np.mean(np.abs(ahead - zone_s) < _ZONE_PROOF_S)) > 0.9
        if proved and abs(zone_s) <= _FARTHEST_ZONE_S:
            hours = zone_s / 3600
            ledger.add(messages.zone_of_camera(where=path.name, count=len(fixes), hours=hours))
            for file in local:
                utc_ns = stamps[file].time_ns - zone_s * 10**9
                stamps[file] = stamps[file]._replace(time_ns=utc_ns, is_utc=True)
    # A local time among times in UTC would be hours off: it is no time of the same clock.
    is_utc = 2 * sum(stamp.is_utc for stamp in stamps.values()) > len(stamps)
    files = sorted(tags)
    rows = [s if (s := stamps.get(f)) is not None and s.is_utc == is_utc else None for f in files]
    without = [file for file, stamp in zip(files, rows, strict=True) if stamp is None]
    if without:
        examples = ", ".join(without[:_MOST_EXAMPLES])
        if len(without) > _MOST_EXAMPLES:
            examples += " ..."
        lost = messages.images_without_time(
            where=path.name, count=len(without), total=len(tags), examples=examples
        )
        ledger.add(lost)
    time_ns = np.array([NO_TIME if stamp is None else stamp.time_ns for stamp in rows], np.int64)
    step = np.array([np.nan if stamp is None else stamp.step_s for stamp in rows])
    known = time_ns != NO_TIME
    # Some cameras write 00 for the fraction of every second.
    if np.count_nonzero(known) > 4 and np.ptp(time_ns[known] % 10**9) == 0:
        step = np.where(known, 1.0, step)
    if bool((step >= 1.0).any()):
        count = int((step >= 1.0).sum())
        ledger.add(messages.clock_of_whole_seconds(where=path.name, count=count))
    by_gps = all(stamp.by_gps for stamp in rows if stamp is not None)
    clock_sigma_s = _RECEIVER_SIGMA_S if by_gps else np.inf
    sigma_s = np.maximum(step / 2.0, 1e-3)
    position = positions_of_tags({file: tags[file] for file in files}, path, ledger)
    return ImageTimes(np.array(files, object), time_ns, sigma_s, is_utc, position, clock_sigma_s)


_NAMES_OF_FILES = ("SourceFile", "FileName", "image")  # columns that are no numbers


def read_tags(path: Path, ledger: Ledger) -> dict[str, dict[str, str]]:
    """By image, its tags without their groups; refuses (InputError IMAGES-NONE) no images."""
    if path.is_dir():
        tags = _tags_of_folder(path, ledger)
    else:
        table = whole_table(path, messages.IMAGES_CSV, _NAMES_OF_FILES)
        table.columns = pd.Index([_key(str(name)) for name in table.columns])
        table = table.loc[:, ~table.columns.duplicated()]
        column = next((c for c in ("sourcefile", "filename", "image") if c in table), None)
        rows = table.to_dict("records") if column is not None else []
        tags = {row[column]: {str(k): v for k, v in row.items()} for row in rows if row[column]}
    if not tags:
        raise messages.images_none(where=path, endings=ENDINGS)
    return tags


@dataclass
class TagReader:
    """Reads numbers and angles of the tags of images, and keeps what cannot be read.

    unread : by tag, the first image and text that is neither, and how many there are.
    """

    read: int = 0
    unread: dict[str, tuple[str, str, int]] = field(default_factory=dict)

    def value(
        self, file: str, tags: Mapping[str, str], key: str, reader: Callable[[str], float]
    ) -> float:
        """The value of a tag by a reader that raises ValueError; NaN where none can be read."""
        text = tags.get(key, "")
        try:
            value = reader(text)
        except ValueError:
            first_file, first_text, count = self.unread.get(key, (file, text, 0))
            self.unread[key] = (first_file, first_text, count + 1)
            return np.nan
        self.read += bool(np.isfinite(value))
        return value

    def report(self, where: Path, ledger: Ledger) -> None:
        """A loss for each tag that could not be read; refuses (IMAGES-TAG) if nothing could."""
        for key, (file, text, count) in self.unread.items():
            if self.read == 0:
                raise messages.no_tag_readable(where=where, tag=key, image=file, value=text)
            lost = messages.tags_unreadable(
                where=where.name, tag=key, count=count, image=file, value=text
            )
            ledger.add(lost)


def positions_of_tags(
    tags: Mapping[str, Mapping[str, str]], where: Path, ledger: Ledger
) -> NDArray[np.float64]:
    """(m, 3) latitude, longitude [rad] and height as written [m]; a place of 0, 0 is none.

    A tag that can be read in no way is a loss.
    """
    reader = TagReader()
    rows = []
    for file, of in tags.items():
        degrees = {}
        for axis in ("latitude", "longitude"):
            stated = of.get(f"gps{axis}ref", "")
            angle = partial(angle_of, hemisphere=stated, letters=LETTERS_OF_AXIS[axis])
            degrees[axis] = reader.value(file, of, f"gps{axis}", angle)
        lat, lon = degrees["latitude"], degrees["longitude"]
        if np.isnan(lon):
            lon = reader.value(file, of, "gpslongtitude", angle_of)  # as DJI spelt it
        height = _height_of_tags(reader, file, of)
        on_earth = abs(lat) <= 90.0 and abs(lon) <= 360.0 and (lat, lon) != (0.0, 0.0)
        rows.append((*np.radians([lat, lon]), height) if on_earth else (np.nan,) * 3)
    reader.report(where, ledger)
    return np.array(rows).reshape(-1, 3)


def read_gimbal_orientations(path: Path, stated: Stated, ledger: Ledger) -> OrientationTable:
    """Positions and attitudes that DJI writes into its images: the gimbal's roll, pitch and yaw.

    They are those of the payload against north, east and down, its forward axis the optical one.
    In the table they become those of a body on which the camera looks down, its top forward, so
    that a mount has nothing but the boresight. What an image lacks is unknown. Refuses (InputError
    IMAGES-NO-GIMBAL) images none of which has angles.
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
    given = np.radians(degrees)
    if not np.isfinite(given).all(axis=1).any():
        raise messages.images_no_gimbal(where=path, files=len(files))
    angles = rpy_of_gimbal(given)
    stamps = [_time_of(tags[file], "") for file in files]
    utc = [s.time_ns if s is not None and s.is_utc else NO_TIME for s in stamps]
    position = positions_of_tags({file: tags[file] for file in files}, path, ledger)
    names = np.array(files, object)
    return OrientationTable(names, None, np.array(utc, np.int64), position, angles, {})


_QUARTER = Rotation.from_euler("y", 90.0, degrees=True).as_matrix()


def rpy_of_gimbal(given: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) roll, pitch, yaw [rad] of a body in which the camera looks down, of a gimbal's."""
    turned = rotations.ned_from_body(given) @ _QUARTER
    body = rotations.quaternions_of(rotations.CAMERA_AT_REST @ turned.transpose(0, 2, 1))
    return rotations.rpy_of_quaternion(rotations.in_turned_frame(body, rotations.NED_FROM_ENU))


def gimbal_of_rpy(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) roll, pitch, yaw [rad] of a gimbal; inverse of `rpy_of_gimbal`."""
    turned = rotations.ned_from_body(angles) @ _QUARTER.T
    body = rotations.quaternions_of(rotations.CAMERA_AT_REST @ turned.transpose(0, 2, 1))
    return rotations.rpy_of_quaternion(rotations.in_turned_frame(body, rotations.NED_FROM_ENU))


def image_files(folder: Path) -> list[Path]:
    """The images in a folder and those below it, by their ending, sorted."""
    known = ENDINGS.split()
    return sorted(p for p in folder.rglob("*") if p.suffix.lower() in known and p.is_file())


def _tags_of_folder(folder: Path, ledger: Ledger) -> dict[str, dict[str, str]]:
    """Tags of each image by its path in the folder; of a raw image and its JPEG only one."""
    logging.getLogger("exifread").setLevel(logging.CRITICAL)  # what it finds is a loss below
    tags: dict[str, dict[str, str]] = {}
    unreadable, seen = [], set()
    for path in image_files(folder):
        name = path.relative_to(folder).as_posix()
        if _parts(name) in seen:
            continue
        seen.add(_parts(name))
        tags[name] = {}
        try:
            with path.open("rb") as file:
                read = exifread.process_file(file, details=False, extract_thumbnail=False)
        except _OF_DAMAGE as error:
            unreadable.append(f"{name} ({type(error).__name__}: {error})")
            continue
        tags[name] = {_key(key): str(value) for key, value in read.items()}
        if "GPS GPSTimeStamp" in read:
            tags[name]["gpstimestamp"] = _time_of_day(read["GPS GPSTimeStamp"].values)
        try:
            tags[name] |= {_key(key): text for key, text in dji_tags(path).items()}
        except (ValueError, OSError) as error:
            unreadable.append(f"{name} ({error})")
    if unreadable:
        examples = ", ".join(unreadable[:_MOST_EXAMPLES])
        lost = messages.exif_unreadable(where=folder.name, count=len(unreadable), examples=examples)
        ledger.add(lost)
    return tags


def _time_of_day(rationals: Sequence[object]) -> str:
    """Hours, minutes and seconds of a GPSTimeStamp as text; empty where one is undefined, 0/0.

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
    return text.rstrip("0").rstrip(".") if second % 1 else text[:8]


def _key(name: str) -> str:
    """A tag's name without its group: of EXIF:DateTimeOriginal, GPS GPSDate or time_utc."""
    return re.sub(r"[^a-z0-9]", "", re.split(r"[: ]", name)[-1].lower())


def _height_of_tags(reader: TagReader, file: str, tags: Mapping[str, str]) -> float:
    """The height of an image as its tags state it [m]; NaN where it is unknown."""
    if tags.get("absolutealtitude"):  # DJI's has a sign of its own
        height = reader.value(file, tags, "absolutealtitude", height_of)
    else:
        height = reader.value(file, tags, "gpsaltitude", height_of)
        reference = tags.get("gpsaltituderef", "0").lower()
        if reference.startswith(("1", "below")):
            height = -abs(height)
    return np.nan if abs(height) > LARGEST_HEIGHT_M else height


def _stamp_of_week(week: str, seconds: str) -> Stamp | None:
    """The time of a GPS week and its seconds; None where no survey can have it."""
    is_week = re.fullmatch(r"\d{1,5}", week) is not None
    is_seconds = re.fullmatch(r"\d{1,6}(\.\d*)?", seconds) is not None
    if not (is_week and is_seconds):
        return None
    if int(week) < FIRST_WEEK_OF_SURVEYS or float(seconds) > SECONDS_PER_WEEK:
        return None
    step_s = 10.0 ** -len(seconds.partition(".")[2])
    time_ns = utc_of_gps(min(int(week), LARGEST_WEEK), float(seconds)).reshape(1)
    if not bool(can_be_flown(time_ns)[0]):
        return None
    return Stamp(int(time_ns[0]), step_s, True, True)


def _time_of(tags: Mapping[str, str], zone: str) -> Stamp | None:
    """The time of an exposure, from the best of the tags that state one."""
    if (dji := parse_time(tags.get("utcatexposure", ""), "UTC")) is not None:
        return dji._replace(by_gps=True)
    week = tags.get("gpsweek", "").strip()
    seconds = tags.get("gpsseconds", "").strip().replace(",", ".")
    by_week = _stamp_of_week(week, seconds)
    if by_week is not None:
        return by_week
    texts = [
        (tags.get("timeutc", ""), "UTC"),
        *((tags.get(n, ""), zone) for n in ("unixtime", "timestamp", "subsecdatetimeoriginal")),
    ]
    for kind in ("original", "digitized"):
        date = tags.get(f"datetime{kind}", "") or tags.get("createdate", "") * (kind != "original")
        fraction = tags.get(f"subsectime{kind}", "").strip()
        if fraction.isdigit():
            date = re.sub(r"^(\S+[ T]\d\d:\d\d:\d\d)(?!\.)", rf"\g<1>.{fraction}", date.strip())
        offset = tags.get(f"offsettime{kind}", "").strip() or tags.get("offsettime", "").strip()
        texts.append((date, offset or zone))
    stamps = (parse_time(text, offset) for text, offset in texts)
    return next((stamp for stamp in stamps if stamp is not None), None) or _gps_stamp(tags)


def _gps_stamp(tags: Mapping[str, str]) -> Stamp | None:
    """The time of the receiver's fix, in UTC."""
    date = tags.get("gpsdatestamp", "") or tags.get("gpsdate", "")
    stamp = parse_time(f"{date} {tags.get('gpstimestamp', '')}", "UTC")
    return None if stamp is None else stamp._replace(by_gps=True)
