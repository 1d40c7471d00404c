"""The section of a mission file on the exposures: when they were made, and of which images."""

import re
import string
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from unbend.config.section import PathText, Section, SectionError, one_of
from unbend.config.table_columns import ClockColumns, ImportTime
from unbend.tables.imports import CAMERA_EVENTS, format_of

_NUMBER_FORMAT = re.compile(r"^0?[0-9]{0,2}d?$")


def checked_image_pattern(value: str) -> str:
    """Check a pattern of the names of images, and return it as it is.

    It must have a field {index} or {n}, with or without a format of whole numbers, or a ``*``.
    Raises SectionError for any other text, also for one with other fields.
    """
    try:
        pieces = list(string.Formatter().parse(value))
    except ValueError as error:
        raise SectionError(f"is not a pattern with {{index}} or {{n}} ({error})") from None
    fields = []
    for piece in pieces:  # a text, then name, format and conversion of the field that follows it
        field = piece[1]
        number_format = piece[2]
        conversion = piece[3]
        if field is None:  # no field follows the text
            continue
        has_number_format = _NUMBER_FORMAT.match(number_format or "")
        if field not in ("index", "n") or conversion or not has_number_format:
            raise SectionError("is not a pattern with {index} or {n}, as in IMG_{index:05d}.tif")
        fields.append(field)
    if not fields and "*" not in value:
        raise SectionError("gives every exposure the same name; put {index}, {n} or * into it")
    return value


ImagePattern = Annotated[str, AfterValidator(checked_image_pattern)]


class LogEvents(Section):
    """Exposures of one camera from the log."""

    channel: str | None = Field(
        None,
        description=(
            "channel of this camera's exposures, as `unbend inspect` prints it; by default the "
            "only event channel of the log, or the only one of the best kind"
        ),
        examples=["CAM[0]"],
    )
    image: ImagePattern = Field(
        "*",
        description=(
            "name of the image: {index} is the number in the log, {n} counts from 1; format codes "
            "as in Python, for example IMG_{index:05d}.tif. * means any characters, as in left/* "
            "or DJI_*_{n:04d}.JPG; then the names are taken from the observations and from "
            "events.images"
        ),
        examples=["IMG_{index:05d}.tif"],
    )
    delay_s: Annotated[float, Field(ge=-10, le=10)] | Literal["from_feedback"] = Field(
        0.0,
        description=(
            "shutter time minus event time; from_feedback: the median of the triggers of this "
            "camera that have a logged shutter pulse"
        ),
        examples=[0.1],
        json_schema_extra={"unit": "s"},
    )


class CsvEventColumns(ClockColumns):
    """Columns of a table of exposures: a UTC time, or GPS week and seconds of week."""

    @model_validator(mode="after")
    def _check_time(self) -> Self:
        if self.time_utc is None and self.gps_week is None:
            raise SectionError("give time_utc, or both gps_week and gps_seconds")
        return self


class CsvEvents(Section):
    """Exposures from a CSV of image names and times."""

    path: PathText = Field(
        description="table of images and their times, one row an exposure",
        examples=["events.csv"],
    )
    columns: CsvEventColumns = Field(
        CsvEventColumns(time_utc="time_utc"),
        description="names of the table's columns; by default image and time_utc",
    )
    camera: str | None = Field(
        None,
        description="camera of every row, without a column camera",
        examples=["nadir"],
    )
    delay_s: float = Field(
        0.0,
        ge=-86_400,
        le=86_400,
        description=("true time minus the table's time: positive if the camera's clock is slow"),
        examples=[0.0],
        json_schema_extra={"unit": "s"},
    )


class PositionEvents(Section):
    """Exposures of one camera with their positions, as receivers and other programs write them."""

    path: PathText = Field(
        description="file of exposures with their positions",
        examples=["flight_events.pos"],
    )
    format: Annotated[str, one_of(CAMERA_EVENTS.keys)] | None = Field(
        None,
        description=(
            "format of the file; by default by the ending: .pos (rtklib), .MRK (mrk), .txt, .eo "
            "and .dat (eo, POSPac's)"
        ),
        examples=["rtklib"],
    )
    image: ImagePattern | Literal["{name}"] = Field(
        description=(
            "name of the image: {index} the file's number, {n} counted from 1, {name} the column "
            "ID of an EO text"
        ),
        examples=["IMG_{index:05d}.tif"],
    )
    delay_s: float = Field(
        0.0,
        ge=-10,
        le=10,
        description="shutter time minus the file's; only with times_only: true",
        examples=[0.0],
        json_schema_extra={"unit": "s"},
    )
    times_only: bool = Field(
        default=False,
        description="true: positions (and attitudes) come from the log or a trajectory",
        examples=[False],
    )
    point: Literal["antenna", "camera"] | None = Field(
        None,
        description=(
            "the point of the positions in the file; by default the camera, for .pos the antenna"
        ),
        examples=["antenna"],
    )
    heights: Literal["msl", "ellipsoid"] | None = Field(
        None,
        description="reference of its heights, if the file does not state it",
        examples=["ellipsoid"],
    )
    grid: str | None = Field(
        None,
        pattern=r"^EPSG:\d{4,6}$",
        description=(
            "projection for omega, phi, kappa of an EO text, if its header names no UTM zone"
        ),
        examples=["EPSG:32632"],
        json_schema_extra={"patternErrorMessage": "a code as EPSG:32632"},
    )
    time: ImportTime = Field(
        ImportTime(),
        description="time system of the file, if the file does not state it",
    )

    @property
    def format_name(self) -> str:
        """The format of the file: the one stated, or that of its ending."""
        return format_of(CAMERA_EVENTS, Path(self.path), self.format)

    @property
    def states_attitude(self) -> bool:
        """Whether attitudes are taken from the file, which only an EO text can have."""
        return self.format_name == "eo" and not self.times_only

    @property
    def reference_point(self) -> str:
        """The point of the positions in the file: antenna or camera."""
        return self.point or ("antenna" if self.format_name == "rtklib" else "camera")

    @model_validator(mode="after")
    def _check_delay(self) -> Self:
        if self.delay_s and not self.times_only:
            raise SectionError("its positions belong to its times: delay_s needs times_only: true")
        return self


class ImageFiles(Section):
    """The existing images, in addition to the pulses of events.log or events.positions."""

    path: PathText = Field(
        description=(
            "folder of the images with their times in EXIF, or a table that exiftool -csv -r "
            "FOLDER wrote"
        ),
        examples=["images"],
    )
    time_zone: str = Field(
        "",
        pattern=r"^(|UTC|[+-](0[0-9]|1[0-4]):[0-5][0-9])$",
        description=(
            "time zone of the camera's clock, if the images do not state it: UTC, or an offset as "
            "+02:00"
        ),
        examples=["+02:00"],
        json_schema_extra={"patternErrorMessage": "UTC, or an offset as +02:00"},
    )


class FirstImage(Section):
    """One image and its event, which fixes all others by their order."""

    image: str = Field(
        description="name of the image, as the observations have it",
        examples=["IMG_00001.tif"],
    )
    event: int = Field(
        1,
        ge=1,
        description="place of the event among those of its channel, from 1",
        examples=[1],
        json_schema_extra={"unit": "1"},
    )


class EventsSection(Section):
    """When the images were exposed: from the log, a CSV or files with positions, per camera."""

    log: dict[str, LogEvents] | None = Field(
        None,
        description="from the event channels of the log, by camera",
    )
    csv: CsvEvents | None = Field(
        None,
        description="from a table of images and their times",
    )
    positions: dict[str, PositionEvents] | None = Field(
        None,
        description="from files of exposures with positions, by camera",
    )
    images: ImageFiles | None = Field(
        None,
        description=(
            "the images themselves; their EXIF times help to assign the pulses of log or positions"
        ),
    )
    first_image: dict[str, str | FirstImage] = Field(
        {},
        description=(
            "by camera, if the evidence does not decide: the image of the first event, or "
            "{image: NAME, event: 6} for the image of the sixth event"
        ),
        examples=[{"nadir": "IMG_00001.tif"}],
    )

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        stated_keys = [key for key in ("log", "csv", "positions") if getattr(self, key) is not None]
        if len(stated_keys) != 1:
            raise SectionError("give either log, csv or positions")
        source = stated_keys[0]
        if not getattr(self, source):  # a mapping without cameras
            raise SectionError(f"{source} needs at least one camera")
        if self.csv is not None and (self.images or self.first_image):
            raise SectionError(
                "images and first_image assign an image to a pulse; a csv gives each image its "
                "time, so they cannot be combined"
            )
        return self

    @model_validator(mode="after")
    def _check_patterns(self) -> Self:
        without_pulses = sorted(self.first_image.keys() - self.patterns.keys())
        if without_pulses:
            raise SectionError(
                f"first_image names camera {without_pulses[0]!r}, which has no pulses"
            )
        for camera, pattern in self.patterns.items():
            is_by_event = re.search("{index|{name", pattern)
            if camera in self.first_image and is_by_event:
                raise SectionError(
                    f"the image {pattern} of {camera} gives the event by its number or name: leave "
                    f"first_image out, or count the images by {{n}} or name them by *"
                )
            if pattern == "*" and len(self.patterns) > 1:
                raise SectionError(
                    f"the image of {camera} must state which images belong to this camera, as in "
                    "left/*"
                )
        return self

    @property
    def patterns(self) -> dict[str, str]:
        """The pattern of the names of images, by camera.

        Empty for exposures from a table, which has the names itself.
        """
        sources = self.log or self.positions or {}
        return {camera: source.image for camera, source in sources.items()}

    @property
    def time_key(self) -> str:
        """The key of the mission file that states the clock of the exposures."""
        if self.csv is None:
            return "events.log" if self.log is not None else "events.positions"
        column = "gps_week" if self.csv.columns.time_utc is None else "time_utc"
        return f"events.csv.columns.{column}"

    def stated_first_image(self, camera: str) -> FirstImage | None:
        """The image and the event that ``first_image`` states for a camera; None without."""
        first_image = self.first_image.get(camera)
        return FirstImage(image=first_image) if isinstance(first_image, str) else first_image
