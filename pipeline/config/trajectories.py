"""The keys of a mission file on trajectories of other programs, and on the times of their files."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.config.atmosphere import PathText
from pipeline.config.cameras import LeverArm, Section, one_of
from pipeline.tables.imports import TRAJECTORIES
from pipeline.units import AngleUnit

Replaced = Literal["position", "height", "attitude"]


class ImportTime(Section):
    """The time of a file of another program."""

    system: Literal["gpst", "utc"] | None = None
    week: int | None = Field(None, ge=0, le=9999)


class NamedColumns(Section):
    """What the columns of a table are called, by quantity."""

    @property
    def named(self) -> dict[str, str]:
        """Quantity -> column, for those that are named."""
        return self.model_dump(exclude_none=True)


class ClockColumns(NamedColumns):
    """Columns of images with their times: UTC, or GPS week and seconds of the week."""

    image: str = "image"
    camera: str | None = None
    time_utc: str | None = None
    gps_week: str | None = None
    gps_seconds: str | None = None

    @model_validator(mode="after")
    def _check_clock(self) -> Self:
        gps = self.gps_week is not None
        if gps != (self.gps_seconds is not None) or (gps and self.time_utc is not None):
            raise ValueError("give time_utc, or both gps_week and gps_seconds")
        return self


class PoseColumns(NamedColumns):
    """Columns of a position, latitude, longitude, height or x, y, z [m], and of an attitude."""

    latitude: str | None = None
    longitude: str | None = None
    height: str | None = None
    x: str | None = None
    y: str | None = None
    z: str | None = None
    roll: str | None = None
    pitch: str | None = None
    yaw: str | None = None
    q_w: str | None = None
    q_x: str | None = None
    q_y: str | None = None
    q_z: str | None = None


class TrajectoryColumns(PoseColumns):
    """Columns of a CSV; position is latitude, longitude, height, or earth-centred x, y, z [m]."""

    time: str = "time"
    week: str | None = None
    v_north_m_s: str | None = None
    v_east_m_s: str | None = None
    v_down_m_s: str | None = None
    sigma_h_m: str | None = None
    sigma_v_m: str | None = None

    @model_validator(mode="after")
    def _check_groups(self) -> Self:
        geodetic, cartesian, angles, quaternion = (
            self._has(*names.split())
            for names in ("latitude longitude height", "x y z", "roll pitch yaw", "q_w q_x q_y q_z")
        )
        if geodetic == cartesian:
            raise ValueError("give either latitude, longitude, height or x, y, z")
        if angles and quaternion:
            raise ValueError("give either roll, pitch, yaw or q_w, q_x, q_y, q_z")
        return self

    def _has(self, *names: str) -> bool:
        given = [name for name in names if name in self.named]
        if given and len(given) < len(names):
            raise ValueError(f"{given[0]} needs {', '.join(names)}")
        return bool(given)


class TrajectorySection(Section):
    """A trajectory of another program, in place of the log's."""

    path: PathText
    format: Annotated[str, one_of(TRAJECTORIES)] | None = None
    replaces: list[Replaced] | None = Field(None, min_length=1)
    point: Literal["imu", "antenna", "camera"]
    lever_arm_m: LeverArm | Literal["from_events"] = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    heights: Literal["msl", "ellipsoid"] | None = None
    time: ImportTime = ImportTime()
    crs: str | None = None
    accuracy: PathText | None = None
    columns: TrajectoryColumns | None = None
    position_unit: AngleUnit = "deg"
    angle_unit: AngleUnit = "deg"
    angle_order: str = Field("ZYX", pattern="^(?:XYZ|XZY|YXZ|YZX|ZXY|ZYX)$")

    @property
    def moves_stations(self) -> bool:
        """Whether positions come from it, and with them the point that they are of."""
        return self.replaces is None or "position" in self.replaces

    @model_validator(mode="after")
    def _check_point(self) -> Self:
        by_ending = Path(self.path).suffix.lower() in TRAJECTORIES["csv"][1] and not self.format
        if self.crs is not None and self.format != "csv" and not by_ending:
            raise ValueError("crs is that of a CSV; the positions of other formats are WGS 84")
        if self.lever_arm_m == "from_events" and self.point != "antenna":
            raise ValueError("lever_arm_m: from_events leads from the antenna: point: antenna")
        if self.point == "camera" and self.lever_arm_m != [0.0, 0.0, 0.0]:
            raise ValueError("point: camera has no lever arm")
        moved = {"position", "height"} & set(self.replaces or ("position", "height"))
        away = self.point == "camera" or self.lever_arm_m != [0.0, 0.0, 0.0]
        if len(moved) == 1 and away:
            raise ValueError("a lever arm or point: camera needs both position and height replaced")
        return self
