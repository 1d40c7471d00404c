"""The section of a mission file with the name of the mission, and what its log does not hold."""

from typing import Literal

from pydantic import Field

from unbend.config.dates import StatedDate, nanoseconds_of_date
from unbend.config.section import PathText, Section


class MissionSection(Section):
    """Name of the mission, and what its log does not hold."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$",
        description="name of the mission: letters, digits, dot, dash, underscore",
        examples=["survey-2026-05"],
        json_schema_extra={
            "patternErrorMessage": "letters, digits, dots, dashes and underscores, at most 100"
        },
    )
    undulation_m: float | None = Field(
        None,
        ge=-120,
        le=100,
        description=(
            "ellipsoidal height minus height above mean sea level, where the log does not carry "
            "both; by default that of the geoid"
        ),
        examples=[47.6],
        json_schema_extra={"unit": "m"},
    )
    geoid: Literal["egm96"] | PathText = Field(
        "egm96",
        description=(
            "geoid of the undulations that neither the log nor undulation_m gives: egm96 (in the "
            "package), or the path of a .gtx or a GeoTIFF of ellipsoidal minus orthometric heights "
            "[m]"
        ),
        examples=["egm96"],
    )
    date: StatedDate | None = Field(
        None,
        description=(
            "UTC day of the flight, as 2026-05-14, or day and time, where the log has no UTC or a "
            "wrong one: season of the climatology, how far soundings and surface reports are away, "
            "and evidence on the clocks of the log"
        ),
        examples=["2026-05-14"],
    )

    @property
    def date_ns(self) -> int | None:
        """The stated date [Unix ns]; a day without a time is its noon in UTC."""
        return nanoseconds_of_date(self.date)
