"""What the columns of imported tables are called, and the time of their rows."""

from typing import Literal, Self

from pydantic import (
    Field,
    model_validator,
)

from unbend.config.section import (
    Section,
    SectionError,
)


class ImportTime(Section):
    """The time of a file of another program."""

    system: Literal["gpst", "utc"] | None = Field(
        None,
        description="time system of the file, if the file does not state it: SBET, EO text, CSV",
        examples=["gpst"],
    )
    week: int | None = Field(
        None,
        ge=0,
        le=9999,
        description="GPS week of the first row; by default that of the log",
        examples=[2418],
        json_schema_extra={"unit": "1"},
    )


class NamedColumns(Section):
    """Names of the columns of a table, by quantity."""

    @property
    def named(self) -> dict[str, str]:
        """Quantity -> column, for those that are named."""
        return self.model_dump(exclude_none=True)


class ClockColumns(NamedColumns):
    """Columns of images with their times: UTC, or GPS week and seconds of the week."""

    image: str = Field(
        "image",
        description="column of the names of the images",
        examples=["image"],
    )
    camera: str | None = Field(
        None,
        description="column of the camera of each row, where there are several",
        examples=["camera"],
    )
    time_utc: str | None = Field(
        None,
        description="column of UTC times: dates as 2026-05-14T10:20:00.5Z",
        examples=["time_utc"],
    )
    gps_week: str | None = Field(
        None,
        description="column of GPS weeks, with gps_seconds in place of time_utc",
        examples=["gps_week"],
    )
    gps_seconds: str | None = Field(
        None,
        description="column of seconds of the GPS week",
        examples=["gps_seconds"],
    )

    @model_validator(mode="after")
    def _check_clock(self) -> Self:
        has_week = self.gps_week is not None
        has_seconds = self.gps_seconds is not None
        if has_week != has_seconds or (has_week and self.time_utc is not None):
            raise SectionError("give time_utc, or both gps_week and gps_seconds")
        return self


class PoseColumns(NamedColumns):
    """Columns of a position, latitude, longitude, height or x, y, z [m], and of an attitude."""

    latitude: str | None = Field(
        None,
        description=(
            "column of latitudes [deg; in a trajectory position_unit]; in stations.orientation by "
            "default latitude"
        ),
        examples=["lat"],
    )
    longitude: str | None = Field(
        None,
        description=(
            "column of longitudes [deg; in a trajectory position_unit]; in stations.orientation by "
            "default longitude"
        ),
        examples=["lon"],
    )
    height: str | None = Field(
        None,
        description="column of heights [m]; in stations.orientation by default height",
        examples=["height"],
    )
    x: str | None = Field(
        None,
        description=(
            "column of x [m]: east of a projection, or earth-centred; in stations.orientation x of "
            "the frame, by default x"
        ),
        examples=["x"],
    )
    y: str | None = Field(
        None,
        description=(
            "column of y [m]: north of a projection, or earth-centred; in stations.orientation y "
            "of the frame, by default y"
        ),
        examples=["y"],
    )
    z: str | None = Field(
        None,
        description=(
            "column of z [m]: the height in a projection, or earth-centred; in "
            "stations.orientation z of the frame, by default z"
        ),
        examples=["z"],
    )
    roll: str | None = Field(
        None,
        description=(
            "column of roll, positive with the right wing down; in stations.orientation by default "
            "roll"
        ),
        examples=["roll"],
    )
    pitch: str | None = Field(
        None,
        description=(
            "column of pitch, positive with the nose up; in stations.orientation by default pitch"
        ),
        examples=["pitch"],
    )
    yaw: str | None = Field(
        None,
        description="column of yaw, clockwise from north; in stations.orientation by default yaw",
        examples=["yaw"],
    )
    q_w: str | None = Field(
        None,
        description=(
            "column of the real part of the quaternion; in stations.orientation by default q_w"
        ),
        examples=["q_w"],
    )
    q_x: str | None = Field(
        None,
        description=(
            "column of the x part of the quaternion; in stations.orientation by default q_x"
        ),
        examples=["q_x"],
    )
    q_y: str | None = Field(
        None,
        description=(
            "column of the y part of the quaternion; in stations.orientation by default q_y"
        ),
        examples=["q_y"],
    )
    q_z: str | None = Field(
        None,
        description=(
            "column of the z part of the quaternion; in stations.orientation by default q_z"
        ),
        examples=["q_z"],
    )
