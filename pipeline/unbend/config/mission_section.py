"""The section of a mission file with its name, and facts that the log does not contain."""

from typing import Annotated, Literal
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import AfterValidator, Field

from unbend.config.dates import StatedDate, nanoseconds_of_date
from unbend.config.section import PathText, Section, SectionError


def known_time_zone(name: str) -> str:
    """Check that the system knows a time zone, and return its name; raises SectionError if not."""
    try:
        ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise SectionError(
            f"{name!r} is not a time zone; give a name such as Europe/Zurich or UTC"
        ) from None
    return name


TimeZone = Annotated[str, Field(min_length=1, max_length=60), AfterValidator(known_time_zone)]
"""A time zone by its name in the IANA database."""

Line = Annotated[
    str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*\S[^\x00-\x1f\x7f]*$")
]
"""A line of text, in any letters."""


class MissionSection(Section):
    """Name of the mission, and facts that its log does not contain."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$",
        description="name of the mission: letters, digits, dot, dash, underscore",
        examples=["survey-2026-05"],
        json_schema_extra={
            "patternErrorMessage": "letters, digits, dots, dashes and underscores, at most 100"
        },
    )
    title: Line | None = Field(
        None,
        description="title of the report, in any letters; by default the name",
        examples=["Zürich Nord, Schrägaufnahmen"],
        json_schema_extra={"patternErrorMessage": "a line of text, at most 200 characters"},
    )
    client: Line | None = Field(
        None,
        description="client of the work, for the report",
        examples=["Amt für Geoinformation"],
        json_schema_extra={"patternErrorMessage": "a line of text, at most 200 characters"},
    )
    operator: Line | None = Field(
        None,
        description="person or company that flew or processed it, for the report",
        examples=["Luftbild GmbH, J. Muster"],
        json_schema_extra={"patternErrorMessage": "a line of text, at most 200 characters"},
    )
    remarks: str | None = Field(
        None,
        min_length=1,
        max_length=5000,
        description=(
            "free text for the first page of the report; an empty line separates paragraphs"
        ),
        examples=["Second flight: the first was broken off above clouds."],
    )
    time_zone: TimeZone | None = Field(
        None,
        description=(
            "time zone of the dates and times on the first page of the report, by its IANA name; "
            "the times of the flight are given in UTC too"
        ),
        examples=["Europe/Zurich"],
    )
    undulation_m: float | None = Field(
        None,
        ge=-120,
        le=100,
        description=(
            "ellipsoidal height minus height above mean sea level, if the log does not have both; "
            "by default the undulation of the geoid"
        ),
        examples=[47.6],
        json_schema_extra={"unit": "m"},
    )
    geoid: Literal["egm96"] | PathText = Field(
        "egm96",
        description=(
            "geoid for undulations that neither the log nor undulation_m gives: egm96 (in the "
            "package), or the path of a .gtx or a GeoTIFF with ellipsoidal minus orthometric "
            "heights [m]"
        ),
        examples=["egm96"],
    )
    date: StatedDate | None = Field(
        None,
        description=(
            "UTC day of the flight, as 2026-05-14, or day and time, if the log has no UTC or a "
            "wrong one. It is evidence on the clocks of the log. If the exposures have no UTC, it "
            "gives the season of the climatology, and the age of soundings and surface reports"
        ),
        examples=["2026-05-14"],
    )

    @property
    def date_ns(self) -> int | None:
        """The stated date [Unix ns]; a day without a time is its noon in UTC."""
        return nanoseconds_of_date(self.date)
