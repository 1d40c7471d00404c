"""The sections of a mission file on the trajectory of another program."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    Field,
    model_validator,
)

from unbend.config.section import (
    LeverArm,
    PathText,
    Section,
    SectionError,
    one_of,
)
from unbend.config.table_columns import ImportTime, PoseColumns
from unbend.tables.imports import TRAJECTORIES
from unbend.units import AngleUnit

Replaced = Literal["position", "height", "attitude"]

NO_LEVER_ARM = [0.0, 0.0, 0.0]


class TrajectoryColumns(PoseColumns):
    """Columns of a CSV; position is latitude, longitude, height, or earth-centred x, y, z [m]."""

    time: str = Field(
        "time",
        description=(
            "column of times: dates, seconds of the GPS week, or seconds since 1970 (utc) or 1980 "
            "(gpst)"
        ),
        examples=["time"],
    )
    week: str | None = Field(
        None,
        description="column of GPS weeks, together with seconds of the week",
        examples=["week"],
    )
    v_north_m_s: str | None = Field(
        None,
        description="column of the velocity to the north [m/s]",
        examples=["v_north"],
    )
    v_east_m_s: str | None = Field(
        None,
        description="column of the velocity to the east [m/s]",
        examples=["v_east"],
    )
    v_down_m_s: str | None = Field(
        None,
        description="column of the velocity downwards [m/s]",
        examples=["v_down"],
    )
    sigma_h_m: str | None = Field(
        None,
        description="column of the sigma of a horizontal axis [m]",
        examples=["sigma_h"],
    )
    sigma_v_m: str | None = Field(
        None,
        description="column of the sigma of the height [m]",
        examples=["sigma_v"],
    )

    @model_validator(mode="after")
    def _check_groups(self) -> Self:
        geodetic = self._has_all("latitude", "longitude", "height")
        cartesian = self._has_all("x", "y", "z")
        angles = self._has_all("roll", "pitch", "yaw")
        quaternion = self._has_all("q_w", "q_x", "q_y", "q_z")
        if geodetic == cartesian:  # both, or neither
            raise SectionError("give either latitude, longitude, height or x, y, z")
        if angles and quaternion:
            raise SectionError("give either roll, pitch, yaw or q_w, q_x, q_y, q_z")
        return self

    def _has_all(self, *names: str) -> bool:
        """Whether all columns of a group are named; refuses a group with only some of them."""
        named = [name for name in names if name in self.named]
        if named and len(named) < len(names):
            raise SectionError(f"{named[0]} needs {', '.join(names)}")
        return bool(named)


class TrajectorySection(Section):
    """A trajectory of another program, in place of the log's."""

    path: PathText = Field(
        description="the file of the trajectory: RTKLIB .pos, SBET or CSV",
        examples=["flight.pos"],
    )
    format: Annotated[str, one_of(TRAJECTORIES.keys)] | None = Field(
        None,
        description=(
            "format of the file; by default by the ending: .pos (rtklib), .sbet and .out (sbet), "
            ".csv and .txt (csv)"
        ),
        examples=["rtklib"],
    )
    replaces: list[Replaced] | None = Field(
        None,
        min_length=1,
        description=(
            "the values of the log that it replaces: position, height, attitude; by default all "
            "that the file has"
        ),
        examples=[["position", "height"]],
    )
    point: Literal["imu", "antenna", "camera"] = Field(
        description=(
            "the point of the positions in the file; with camera, the lever arm of the mount is "
            "not used"
        ),
        examples=["antenna"],
    )
    lever_arm_m: LeverArm | Literal["from_events"] = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description=(
            "origin of mount.<camera>.lever_arm_m minus the point of the file: forward, right, "
            "down; from_events: from the antenna to the camera, as in the .MRK of events.positions"
        ),
        examples=[[0.0, 0.0, 0.9]],
        json_schema_extra={"unit": "m"},
    )
    heights: Literal["msl", "ellipsoid"] | None = Field(
        None,
        description=(
            "reference of the heights; needed for SBET, and for a CSV without earth-centred x, y, z"
        ),
        examples=["ellipsoid"],
    )
    time: ImportTime = Field(
        ImportTime(),
        description="time system of the file, if the file does not state it",
    )
    crs: str | None = Field(
        None,
        description=(
            "projection of a CSV's x and y (z is then the height), or the datum of latitude and "
            "longitude that are not WGS 84. In a projection, attitudes and velocities are relative "
            "to grid north"
        ),
        examples=["EPSG:25832"],
    )
    accuracy: PathText | None = Field(
        None,
        description="the smrmsg file of an SBET, with its sigmas",
        examples=["smrmsg.out"],
    )
    columns: TrajectoryColumns | None = Field(
        None,
        description="names of a CSV's columns; needed for CSV",
    )
    position_unit: AngleUnit = Field(
        "deg",
        description="unit of latitude and longitude in a CSV",
        examples=["deg"],
    )
    angle_unit: AngleUnit = Field(
        "deg",
        description="unit of roll, pitch and yaw in a CSV",
        examples=["deg"],
    )
    angle_order: str = Field(
        "ZYX",
        pattern="^(?:XYZ|XZY|YXZ|YZX|ZXY|ZYX)$",
        description="order of the rotations about the body's axes: ZYX is yaw, pitch, roll",
        examples=["ZYX"],
        json_schema_extra={"patternErrorMessage": "XYZ, XZY, YXZ, YZX, ZXY or ZYX"},
    )

    @property
    def moves_stations(self) -> bool:
        """Whether stations get their positions from the trajectory, not from the log."""
        return self.replaces is None or "position" in self.replaces

    @property
    def has_angles(self) -> bool:
        """Whether attitudes come from columns of roll, pitch and yaw, not from a quaternion."""
        gives_attitude = self.replaces is None or "attitude" in self.replaces
        return gives_attitude and self.columns is not None and self.columns.yaw is not None

    @model_validator(mode="after")
    def _check_point(self) -> Self:
        if self.crs is not None and not self._is_csv:
            raise SectionError("crs is only for a CSV; the positions of other formats are WGS 84")
        if self.lever_arm_m == "from_events" and self.point != "antenna":
            raise SectionError(
                "lever_arm_m: from_events begins at the antenna: give point: antenna"
            )
        has_lever_arm = self.lever_arm_m != NO_LEVER_ARM
        if self.point == "camera" and has_lever_arm:
            raise SectionError("with point: camera there is no lever arm")
        # A lever arm moves position and height together; so does a change of the point.
        replaces_only_one = False  # of position and height
        if self.replaces is not None:
            replaces_only_one = ("position" in self.replaces) != ("height" in self.replaces)
        if replaces_only_one and (self.point == "camera" or has_lever_arm):
            raise SectionError(
                "a lever arm or point: camera needs both position and height replaced"
            )
        return self

    @property
    def _is_csv(self) -> bool:
        """Whether the file is a CSV, by its format or else its ending."""
        if self.format is not None:
            return self.format == "csv"
        _, endings = TRAJECTORIES["csv"]
        return Path(self.path).suffix.lower() in endings
