"""The section of a mission file on the exposures: when they were made, and of which images."""

import re
import string
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from unbend.config.cameras import PathText, Section, one_of, refuse
from unbend.config.station_sources import ClockColumns, ImportTime
from unbend.tables.imports import CAMERA_EVENTS, format_of

_NUMBER_FORMAT = re.compile(r"^0?[0-9]{0,2}d?$")


def image_pattern(value: str) -> str:
    """A pattern of the names of images, once it is one."""
    try:
        pieces = list(string.Formatter().parse(value))
    except ValueError as error:
        raise ValueError(f"is not a pattern with {{index}} or {{n}} ({error})") from None
    fields = [piece[1:] for piece in pieces if piece[1] is not None]
    for name, code, conversion in fields:
        if name not in ("index", "n") or conversion or not _NUMBER_FORMAT.match(code or ""):
            raise ValueError("is not a pattern with {index} or {n}, as in IMG_{index:05d}.tif")
    if not fields and "*" not in value:
        raise ValueError("gives every exposure the same name; put {index}, {n} or * into it")
    return value


ImagePattern = Annotated[str, AfterValidator(image_pattern)]


class LogEvents(Section):
    """Exposures of one camera from the log."""

    channel: str | None = None
    image: ImagePattern = "*"
    delay_s: Annotated[float, Field(ge=-10, le=10)] | Literal["from_feedback"] = 0.0


class CsvEventColumns(ClockColumns):
    """Columns of a table of exposures: a UTC time, or GPS week and seconds of week."""

    @model_validator(mode="after")
    def _check_time(self) -> Self:
        if self.time_utc is None and self.gps_week is None:
            raise ValueError("give time_utc, or both gps_week and gps_seconds")
        return self


class CsvEvents(Section):
    """Exposures from a CSV of image names and times."""

    path: PathText
    columns: CsvEventColumns = CsvEventColumns(time_utc="time_utc")
    camera: str | None = None
    delay_s: float = Field(0.0, ge=-86_400, le=86_400)


class PositionEvents(Section):
    """Exposures of one camera with their positions, as receivers and other programs write them."""

    path: PathText
    format: Annotated[str, one_of(CAMERA_EVENTS.keys)] | None = None
    image: ImagePattern | Literal["{name}"]
    delay_s: float = Field(0.0, ge=-10, le=10)
    times_only: bool = False
    point: Literal["antenna", "camera"] | None = None
    heights: Literal["msl", "ellipsoid"] | None = None
    grid: str | None = Field(None, pattern=r"^EPSG:\d{4,6}$")
    time: ImportTime = ImportTime()

    @property
    def format_name(self) -> str:
        return format_of(CAMERA_EVENTS, Path(self.path), self.format)

    @property
    def reference_point(self) -> str:
        """Whose positions it has: antenna or camera."""
        return self.point or ("antenna" if self.format_name == "rtklib" else "camera")

    @model_validator(mode="after")
    def _check_delay(self) -> Self:
        if self.delay_s and not self.times_only:
            raise ValueError("its positions are of its times: delay_s needs times_only: true")
        return self


class ImageFiles(Section):
    """The images that exist, beside the pulses of events.log or events.positions."""

    path: PathText
    time_zone: str = Field("", pattern=r"^(|UTC|[+-](0[0-9]|1[0-4]):[0-5][0-9])$")


class FirstImage(Section):
    """One image and its event, which fixes all others by their order."""

    image: str
    event: int = Field(1, ge=1)


class EventsSection(Section):
    """When the images were exposed: from the log, a CSV or files with positions, per camera."""

    log: dict[str, LogEvents] | None = None
    csv: CsvEvents | None = None
    positions: dict[str, PositionEvents] | None = None
    images: ImageFiles | None = None
    first_image: dict[str, str | FirstImage] = Field({})

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        given = [n for n in ("log", "csv", "positions") if getattr(self, n) is not None]
        refuse(
            (len(given) != 1, "give either log, csv or positions"),
            (given and not getattr(self, given[0]), f"{''.join(given)} needs at least one camera"),
            (self.csv is not None and (self.images or self.first_image), "images-of-csv"),
        )
        for camera in sorted(set(self.first_image) - set(self.patterns)):
            raise ValueError(f"first_image names camera {camera!r}, which has no pulses")
        for camera, pattern in self.patterns.items():
            numbered = camera in self.first_image and re.search("{index|{name", pattern)
            every = pattern == "*" and len(self.patterns) > 1
            rules = (numbered, "first-of-numbered"), (every, "pattern-of-all")
            refuse(*rules, pattern=pattern, camera=camera)
        return self

    @property
    def patterns(self) -> dict[str, str]:
        """By camera, the names of images whose events are pulses of a log or file."""
        sources = self.log or self.positions or {}
        return {camera: source.image for camera, source in sources.items()}

    @property
    def time_key(self) -> str:
        """Where the mission file says of which clock the times of the exposures are."""
        if self.csv is None:
            return "events.log" if self.log is not None else "events.positions"
        column = "gps_week" if self.csv.columns.time_utc is None else "time_utc"
        return f"events.csv.columns.{column}"

    def anchor(self, camera: str) -> FirstImage | None:
        """The image and event that are stated for a camera."""
        stated = self.first_image.get(camera)
        return FirstImage(image=stated) if isinstance(stated, str) else stated
