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

    system: Literal["gpst", "utc"] | None = Field(
        None,
        description="time system of the file, where the file does not say it: SBET, EO text, CSV",
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
    """What the columns of a table are called, by quantity."""

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
        gps = self.gps_week is not None
        if gps != (self.gps_seconds is not None) or (gps and self.time_utc is not None):
            raise ValueError("give time_utc, or both gps_week and gps_seconds")
        return self


class PoseColumns(NamedColumns):
    """Columns of a position, latitude, longitude, height or x, y, z [m], and of an attitude."""

    latitude: str | None = Field(
        None,
        description="column of latitudes [deg, or position_unit]",
        examples=["lat"],
    )
    longitude: str | None = Field(
        None,
        description="column of longitudes [deg, or position_unit]",
        examples=["lon"],
    )
    height: str | None = Field(
        None,
        description="column of heights [m]",
        examples=["height"],
    )
    x: str | None = Field(
        None,
        description="column of x [m]: east of a projection, or earth-centred",
        examples=["x"],
    )
    y: str | None = Field(
        None,
        description="column of y [m]: north of a projection, or earth-centred",
        examples=["y"],
    )
    z: str | None = Field(
        None,
        description="column of z [m]: the height in a projection, or earth-centred",
        examples=["z"],
    )
    roll: str | None = Field(
        None,
        description="column of roll, positive with the right wing down",
        examples=["roll"],
    )
    pitch: str | None = Field(
        None,
        description="column of pitch, positive with the nose up",
        examples=["pitch"],
    )
    yaw: str | None = Field(
        None,
        description="column of yaw, clockwise from north",
        examples=["yaw"],
    )
    q_w: str | None = Field(
        None,
        description="column of the real part of the quaternion",
        examples=["q_w"],
    )
    q_x: str | None = Field(
        None,
        description="column of the x part of the quaternion",
        examples=["q_x"],
    )
    q_y: str | None = Field(
        None,
        description="column of the y part of the quaternion",
        examples=["q_y"],
    )
    q_z: str | None = Field(
        None,
        description="column of the z part of the quaternion",
        examples=["q_z"],
    )


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
        description="column of GPS weeks, beside seconds of the week",
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
            "what it replaces of the log: position, height, attitude; by default all that the file "
            "has"
        ),
        examples=[["position", "height"]],
    )
    point: Literal["imu", "antenna", "camera"] = Field(
        description="point whose positions the file has; with camera, the mount has no lever arm",
        examples=["antenna"],
    )
    lever_arm_m: LeverArm | Literal["from_events"] = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description=(
            "point from which mount.<camera>.lever_arm_m counts, minus the file's point: forward, "
            "right, down; from_events: from the antenna to the camera as in the .MRK of "
            "events.positions"
        ),
        examples=[[0.0, 0.0, 0.9]],
        json_schema_extra={"unit": "m"},
    )
    heights: Literal["msl", "ellipsoid"] | None = Field(
        None,
        description="what the heights count from; needed for SBET and for latitudes in a CSV",
        examples=["ellipsoid"],
    )
    time: ImportTime = Field(
        ImportTime(),
        description="the time system of the file, where the file does not say it",
    )
    crs: str | None = Field(
        None,
        description=(
            "projection of a CSV's x and y (z is then the height), or the datum of latitude and "
            "longitude that are not WGS 84. In a projection attitudes and velocities count from "
            "grid north"
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

    omega: str | None = Field(
        None,
        description="column of omega, about x",
        examples=["omega"],
    )
    phi: str | None = Field(
        None,
        description="column of phi, about y",
        examples=["phi"],
    )
    kappa: str | None = Field(
        None,
        description="column of kappa, about z",
        examples=["kappa"],
    )
    sigma_horizontal_m: str | None = Field(
        None,
        description="column of the sigma of a horizontal axis [m]",
        examples=["sigma_h_m"],
    )
    sigma_height_m: str | None = Field(
        None,
        description="column of the sigma of the height [m]",
        examples=["sigma_v_m"],
    )
    sigma_tilt: str | None = Field(
        None,
        description="column of the sigma about a level axis, in the unit of the angles",
        examples=["sigma_tilt"],
    )
    sigma_yaw: str | None = Field(
        None,
        description="column of the sigma about the vertical, in the unit of the angles",
        examples=["sigma_yaw"],
    )


class KnownPositions(Section):
    """Positions of at least three images, for a frame that is unknown."""

    path: PathText = Field(
        description="a CSV of images with latitude and longitude [deg] and height [m]",
        examples=["positions.csv"],
    )
    image: str = Field(
        "image",
        description="column of the names of the images",
        examples=["image"],
    )
    latitude: str = Field(
        "latitude",
        description="column of latitudes [deg], WGS 84",
        examples=["latitude"],
    )
    longitude: str = Field(
        "longitude",
        description="column of longitudes [deg], WGS 84",
        examples=["longitude"],
    )
    height: str = Field(
        "height",
        description="column of heights [m], above what stations.orientation.heights says",
        examples=["height"],
    )
    sigma_m: float = Field(
        default=1.0,
        gt=0,
        le=1000,
        description="standard deviation of each coordinate",
        examples=[1.0],
        json_schema_extra={"unit": "m"},
    )


class LocalOrigin(Section):
    """Where the origin of local (east, north, up) positions lies."""

    lat_deg: float = Field(
        ge=-90,
        le=90,
        description="latitude of the origin, WGS 84",
        examples=[47.0],
        json_schema_extra={"unit": "deg"},
    )
    lon_deg: float = Field(
        ge=-180,
        le=360,
        description="longitude of the origin, WGS 84",
        examples=[8.5],
        json_schema_extra={"unit": "deg"},
    )
    h_ellipsoid_m: float = Field(
        ge=-500,
        le=50_000,
        description="height of the origin above the ellipsoid",
        examples=[500.0],
        json_schema_extra={"unit": "m"},
    )

    def build(self) -> GeodeticOrigin:
        """In radians."""
        return GeodeticOrigin(self.lat_deg * DEGREE, self.lon_deg * DEGREE, self.h_ellipsoid_m)


class EnuFrame(Section):
    """One topocentric frame for all stations."""

    enu: LocalOrigin = Field(
        description="the place whose east, north, up is the frame of all stations",
    )


class OrientationSection(Section):
    """Position and attitude of every image from a CSV, or from DJI's images themselves."""

    path: PathText = Field(
        description=(
            "table of the oriented images: a CSV, a folder of DJI's images, or the block of "
            "another program"
        ),
        examples=["opk.csv"],
    )
    format: Annotated[str, one_of(lambda: [*ORIENTATIONS, *BLOCKS])] = Field(
        "csv",
        description=(
            "csv; dji: positions and gimbal angles in the images of a folder, or of a table that "
            "exiftool -csv -r FOLDER wrote; or the block of another program as under "
            "observations.format, which has angles, columns and cameras itself"
        ),
        examples=["csv"],
    )
    angles: Literal[
        "omega_phi_kappa", "phi_omega_kappa", "roll_pitch_yaw", "quaternion", "quaternion_to_frame"
    ] = Field(
        description=(
            "omega, phi and kappa of the camera, the primary rotation first; roll, pitch and yaw "
            "of the aircraft, to which the camera is mounted as under mount; or the quaternion q_w "
            "to q_z, which turns from the frame to the camera (x right, y down, z forward), or "
            "back"
        ),
        examples=["omega_phi_kappa"],
    )
    unit: AngleUnit = Field(
        "deg",
        description="unit of the angles; latitude and longitude are in degrees",
        examples=["deg"],
    )
    frame: Literal["geographic", "projected", "ecef", "unknown"] | EnuFrame | None = Field(
        None,
        validate_default=True,
        description=(
            "frame of the angles, and of x, y, z. geographic: east, north, up (roll_pitch_yaw: "
            "north, east, down) at each station; projected: x, y of crs, whose grid north the "
            "angles count from, and z, the height; ecef: earth-centred; {enu: {lat_deg, lon_deg, "
            "h_ellipsoid_m}}: east, north, up at this one place; unknown: fitted to "
            "known_positions. By default what the block says: OpenSfM's reference_lla, Metashape's "
            "coordinate system"
        ),
        examples=["geographic"],
    )
    heights: Literal["msl", "ellipsoid"] | None = Field(
        None,
        description=(
            "what the height column counts from: mean sea level or the ellipsoid (in a frame that "
            "is unknown, that of known_positions; of a block that says its frame, the altitudes "
            "that its program was given)"
        ),
        examples=["ellipsoid"],
    )
    crs: str | None = Field(
        None,
        description=(
            "coordinate system of x and y, as EPSG:25832, or of latitude and longitude that are "
            "not WGS 84"
        ),
        examples=["EPSG:25832"],
    )
    convergence_deg: float = Field(
        0.0,
        ge=-30,
        le=30,
        description=(
            "convergence of the grid from whose north kappa or yaw is counted: true minus grid "
            "azimuth, positive where grid north lies east of true north"
        ),
        examples=[1.2],
        json_schema_extra={"unit": "deg"},
    )
    columns: OrientationColumns = Field(
        OrientationColumns(),
        description="names of the table's columns, where they are called otherwise",
    )
    camera: str | None = Field(
        None,
        description="camera of every row, without a column camera",
        examples=["nadir"],
    )
    date: str | None = Field(
        None,
        description=(
            "UTC day, as 2026-05-14, or day and time, where no column has the time: season of the "
            "climatology, and how far soundings and surface reports are away"
        ),
        examples=["2026-05-14"],
    )
    known_positions: KnownPositions | Literal["log"] | None = Field(
        None,
        description=(
            "positions of at least three images, for an unknown frame: a CSV, or log: the "
            "exposures of the log"
        ),
        examples=["log"],
    )
    sigma_horizontal_m: float | None = Field(
        None,
        ge=0,
        le=10_000,
        description="standard deviation of the positions of all images, per axis",
        examples=[0.05],
        json_schema_extra={"unit": "m"},
    )
    sigma_height_m: float | None = Field(
        None,
        ge=0,
        le=10_000,
        description="standard deviation of the heights of all images",
        examples=[0.05],
        json_schema_extra={"unit": "m"},
    )
    sigma_tilt_deg: float | None = Field(
        None,
        ge=0,
        le=45,
        description="standard deviation of the attitude about each level axis, of all images",
        examples=[0.01],
        json_schema_extra={"unit": "deg"},
    )
    sigma_yaw_deg: float | None = Field(
        None,
        ge=0,
        le=180,
        description="standard deviation of the attitude about the vertical, of all images",
        examples=[0.02],
        json_schema_extra={"unit": "deg"},
    )

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

    orientation: OrientationSection | None = Field(
        None,
        description="position and attitude of every image, from another program",
    )
    trajectory: TrajectorySection | None = Field(
        None,
        description=(
            "a trajectory of another program, in place of the log's positions, heights or attitudes"
        ),
    )
    use_suspect: bool = Field(
        False,
        description=(
            "true corrects the observations of stations that contradict other evidence of the log "
            "(status suspect) too; the run ends with code 3 all the same"
        ),
        examples=[False],
    )
    max_sigma_horizontal_m: float | None = Field(
        None,
        gt=0,
        description="largest sigma of a position, per axis, that serves the mission",
        examples=[0.5],
        json_schema_extra={"unit": "m"},
    )
    max_sigma_height_m: float | None = Field(
        None,
        gt=0,
        description="largest sigma of a height that serves the mission",
        examples=[0.5],
        json_schema_extra={"unit": "m"},
    )
    max_sigma_tilt_deg: float | None = Field(
        None,
        gt=0,
        le=45,
        description="largest sigma of the attitude about a level axis that serves the mission",
        examples=[0.1],
        json_schema_extra={"unit": "deg"},
    )
