"""The section of a mission file on stations, or trajectories, from elsewhere than the log."""

from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from unbend.config.cameras import LeverArm, PathText, Section, one_of, refuse
from unbend.flight.heights import GeodeticOrigin
from unbend.tables.imports import ORIENTATIONS, TRAJECTORIES
from unbend.tables.imports.blocks import BLOCKS
from unbend.units import DEGREE, AngleUnit

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
        complete = []
        for names in ("latitude longitude height", "x y z", "roll pitch yaw", "q_w q_x q_y q_z"):
            given = [name for name in names.split() if name in self.named]
            if given and len(given) < len(names.split()):
                raise ValueError(f"{given[0]} needs {', '.join(names.split())}")
            complete.append(bool(given))
        geodetic, cartesian, angles, quaternion = complete
        if geodetic == cartesian:
            raise ValueError("give either latitude, longitude, height or x, y, z")
        if angles and quaternion:
            raise ValueError("give either roll, pitch, yaw or q_w, q_x, q_y, q_z")
        return self


class TrajectorySection(Section):
    """A trajectory of another program, in place of the log's."""

    path: PathText
    format: Annotated[str, one_of(TRAJECTORIES.keys)] | None = None
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
        of_csv, of_camera = self.format == "csv" or by_ending, self.point == "camera"
        arm, of_events = self.lever_arm_m != [0.0, 0.0, 0.0], self.lever_arm_m == "from_events"
        moved = {"position", "height"} & set(self.replaces or ("position", "height"))
        refuse(
            (self.crs is not None and not of_csv, "crs-of-csv"),
            (of_events and self.point != "antenna", "lever-from-antenna"),
            (of_camera and arm, "point: camera has no lever arm"),
            (len(moved) == 1 and (of_camera or arm), "lever-both"),
        )
        return self


_OF_ANGLES = {
    "omega_phi_kappa": ("omega", "phi", "kappa"),
    "phi_omega_kappa": ("phi", "omega", "kappa"),
    "roll_pitch_yaw": ("roll", "pitch", "yaw"),
    "quaternion": ("q_w", "q_x", "q_y", "q_z"),
    "quaternion_to_frame": ("q_w", "q_x", "q_y", "q_z"),
}
_SAY_FRAME = ("opensfm", "metashape")
_GEODETIC, _CARTESIAN = ("latitude", "longitude", "height"), ("x", "y", "z")
_SIGMAS = ("sigma_horizontal_m", "sigma_height_m", "sigma_tilt", "sigma_yaw")
_CLOCK = ("time_utc", "gps_week", "gps_seconds")


class OrientationColumns(ClockColumns, PoseColumns):
    """What the columns are called; those of the position and the angles by default as here."""

    omega: str | None = None
    phi: str | None = None
    kappa: str | None = None
    sigma_horizontal_m: str | None = None
    sigma_height_m: str | None = None
    sigma_tilt: str | None = None
    sigma_yaw: str | None = None


class KnownPositions(Section):
    """Positions of at least three images, for a frame that is unknown."""

    path: PathText
    image: str = "image"
    latitude: str = "latitude"
    longitude: str = "longitude"
    height: str = "height"
    sigma_m: float = Field(default=1.0, gt=0, le=1000)


class LocalOrigin(Section):
    """Where the origin of local (east, north, up) positions lies."""

    lat_deg: float = Field(ge=-90, le=90)
    lon_deg: float = Field(ge=-180, le=360)
    h_ellipsoid_m: float = Field(ge=-500, le=50_000)

    def build(self) -> GeodeticOrigin:
        """In radians."""
        return GeodeticOrigin(self.lat_deg * DEGREE, self.lon_deg * DEGREE, self.h_ellipsoid_m)


class EnuFrame(Section):
    """One topocentric frame for all stations."""

    enu: LocalOrigin


class OrientationSection(Section):
    """Position and attitude of every image from a CSV, or from DJI's images themselves."""

    path: PathText
    format: Annotated[str, one_of(lambda: [*ORIENTATIONS, *BLOCKS])] = "csv"
    angles: Literal[
        "omega_phi_kappa", "phi_omega_kappa", "roll_pitch_yaw", "quaternion", "quaternion_to_frame"
    ]
    unit: AngleUnit = "deg"
    frame: Literal["geographic", "projected", "ecef", "unknown"] | EnuFrame | None = Field(
        None, validate_default=True
    )
    heights: Literal["msl", "ellipsoid"] | None = None
    crs: str | None = None
    convergence_deg: float = Field(0.0, ge=-30, le=30)
    columns: OrientationColumns = OrientationColumns()
    camera: str | None = None
    date: str | None = None
    known_positions: KnownPositions | Literal["log"] | None = None
    sigma_horizontal_m: float | None = Field(None, ge=0, le=10_000)
    sigma_height_m: float | None = Field(None, ge=0, le=10_000)
    sigma_tilt_deg: float | None = Field(None, ge=0, le=45)
    sigma_yaw_deg: float | None = Field(None, ge=0, le=180)

    @model_validator(mode="before")
    @classmethod
    def _angles_of_block(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("format") in BLOCKS:
            return {"angles": "quaternion"} | values
        return values

    @field_validator("frame")
    @classmethod
    def _require_frame(cls, value: object, info: ValidationInfo) -> object:
        if value is None and info.data.get("format") not in _SAY_FRAME:
            raise ValueError("is missing (geographic | projected | ecef | {enu: ...} | unknown)")
        return value

    @property
    def of_block(self) -> bool:
        """Whether the file is the block of another program."""
        return self.format in BLOCKS

    @property
    def is_geodetic(self) -> bool:
        """Whether the positions are latitude, longitude and height, or become them by the crs."""
        level = self.frame in ("geographic", "projected")
        return level or self.columns.latitude is not None

    def is_msl(self, found: str | None) -> bool:
        """Whether heights are above the sea; ``found`` is what a coordinate system says of them."""
        has_heights = self.is_geodetic or self.frame is None
        return has_heights and (found or self.heights) == "msl"

    @property
    def column_names(self) -> dict[str, str]:
        """Quantity -> name of its column, for all that are to be read."""
        geodetic = self.is_geodetic and self.frame != "projected"
        needed = (*(_GEODETIC if geodetic else _CARTESIAN), *self.angle_names)
        named = self.columns.named
        given = {name: named[name] for name in ("image", "camera", *_CLOCK, *_SIGMAS)
                 if name in named}  # fmt: skip
        return given | {name: named.get(name, name) for name in needed}

    @property
    def angle_names(self) -> tuple[str, ...]:
        """The quantities of the attitude, in the order of their names."""
        return _OF_ANGLES[self.angles]

    @property
    def has_clock(self) -> bool:
        """Whether columns give the time of each image."""
        return self.format == "dji" or not self.columns.named.keys().isdisjoint(_CLOCK)

    @property
    def date_ns(self) -> int | None:
        """The stated date [Unix ns]; a day without a time is its noon in UTC."""
        if self.date is None:
            return None
        time = datetime.fromisoformat(self.date)
        time = time.replace(hour=12) if len(self.date) == len("2026-05-14") else time
        return round(time.replace(tzinfo=time.tzinfo or UTC).timestamp()) * 1_000_000_000

    @field_validator("date")
    @classmethod
    def _check_date(cls, value: str | None) -> str | None:
        try:
            if value is not None and datetime.fromisoformat(value).date() < date(1900, 1, 1):
                raise ValueError
        except ValueError:
            raise ValueError("is no date like 2026-05-14 or 2026-05-14T10:20") from None
        return value

    @model_validator(mode="after")
    def _check_combinations(self) -> Self:
        unknown, level = self.frame == "unknown", self.frame in ("geographic", "projected")
        known, of_body = self.known_positions, self.angles == "roll_pitch_yaw"
        has_heights = self.is_geodetic or self.frame is None or isinstance(known, KnownPositions)
        stated = self.camera is not None or self.columns != OrientationColumns()
        refuse(
            (self.format == "dji" and not of_body, "dji-angles"),
            (of_body and not level, "angles-level"),
            ((self.frame == "projected") > (self.crs is not None), "frame-crs"),
            (self.crs and not level, "frame-crs"),
            (unknown and self.is_geodetic, "unknown-geodetic"),
            (unknown and known is None, "frame-unknown"),
            (not unknown and known is not None, "known_positions are for frame: unknown"),
            (self.of_block and has_heights != (self.heights is not None), "heights-of-block"),
            (has_heights != (self.heights is not None), "heights-stated"),
            (self.of_block and (stated or self.frame == "geographic"), "block-says"),
            (self.of_block and self.angles != "quaternion", "block-says"),
            (self.convergence_deg and self.frame != "geographic", "convergence-frame"),
            (self.has_clock and self.date is not None, "date-twice"),
            format=self.format,
        )  # fmt: skip
        return self


class StationsSection(Section):
    """Stations from elsewhere, and which stations may be used."""

    orientation: OrientationSection | None = None
    trajectory: TrajectorySection | None = None
    use_suspect: bool = False
    max_sigma_horizontal_m: float | None = Field(None, gt=0)
    max_sigma_height_m: float | None = Field(None, gt=0)
    max_sigma_tilt_deg: float | None = Field(None, gt=0, le=45)
