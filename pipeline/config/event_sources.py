"""The section of a mission file on the exposures: when they were made, and of which images."""

from __future__ import annotations

import re
import string

from pydantic import Field, field_validator, model_validator

from pipeline.config.atmosphere import PathText
from pipeline.config.cameras import Section

_NUMBER_FORMAT = re.compile(r"^0?[0-9]{0,2}d?$")


class LogEvents(Section):
    """Exposures of one camera from the log."""

    channel: str | None = Field(None, description="by default the only event channel of the log")
    image: str = Field(
        description="name of the image: {index} the log's number, {n} counted from 1; format "
        "codes as in Python, for example IMG_{index:05d}.tif"
    )
    delay_s: float = Field(0.0, ge=-10, le=10, description="shutter time minus event time")

    @field_validator("image")
    @classmethod
    def _check_pattern(cls, value: str) -> str:
        try:
            pieces = list(string.Formatter().parse(value))
        except ValueError as error:
            raise ValueError(f"is not a pattern with {{index}} or {{n}} ({error})") from None
        fields = [piece[1:] for piece in pieces if piece[1] is not None]
        for name, code, conversion in fields:
            if name not in ("index", "n") or conversion or not _NUMBER_FORMAT.match(code or ""):
                raise ValueError("is not a pattern with {index} or {n}, as in IMG_{index:05d}.tif")
        if not fields:
            raise ValueError("gives every exposure the same name; put {index} or {n} into it")
        return value


class CsvEventColumns(Section):
    """Columns of a table of exposures: a UTC time, or GPS week and seconds of week."""

    image: str = "image"
    time_utc: str | None = None
    gps_week: str | None = None
    gps_seconds: str | None = None
    camera: str | None = None

    @model_validator(mode="after")
    def _check_clock(self) -> CsvEventColumns:
        gps = (self.gps_week is not None, self.gps_seconds is not None)
        if (self.time_utc is None) != all(gps) or gps[0] != gps[1]:
            raise ValueError("give time_utc, or both gps_week and gps_seconds")
        return self


class CsvEvents(Section):
    """Exposures from a CSV of image names and times."""

    path: PathText
    columns: CsvEventColumns = CsvEventColumns(time_utc="time_utc")
    camera: str | None = Field(None, description="the camera of every row without a camera column")
    delay_s: float = Field(
        0.0, ge=-86_400, le=86_400, description="true time minus the table's (the camera's clock)"
    )


class EventsSection(Section):
    """When the images were exposed: from the log, per camera, or from a CSV."""

    log: dict[str, LogEvents] | None = None
    csv: CsvEvents | None = None

    @model_validator(mode="after")
    def _check_source(self) -> EventsSection:
        if (self.log is None) == (self.csv is None):
            raise ValueError("give either log or csv")
        if self.log is not None and not self.log:
            raise ValueError("log needs at least one camera")
        return self
