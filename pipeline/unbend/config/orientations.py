"""The sections of a mission file on the position and attitude of every image."""

from typing import Annotated, Literal, Self

from pydantic import (
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from unbend.config.dates import StatedDate, nanoseconds_of_date
from unbend.config.local_frames import EnuFrame
from unbend.config.section import (
    PathText,
    Section,
    SectionError,
    is_block,
    one_of,
)
from unbend.config.table_columns import ClockColumns, PoseColumns
from unbend.tables.imports import ORIENTATIONS
from unbend.tables.imports.blocks import BLOCKS
from unbend.units import AngleUnit

_QUANTITIES_OF_ANGLES = {
    "omega_phi_kappa": ("omega", "phi", "kappa"),
    "phi_omega_kappa": ("phi", "omega", "kappa"),
    "roll_pitch_yaw": ("roll", "pitch", "yaw"),
    "quaternion": ("q_w", "q_x", "q_y", "q_z"),
    "quaternion_to_frame": ("q_w", "q_x", "q_y", "q_z"),
}
_FORMATS_WITH_FRAME = ("opensfm", "metashape", "pix4d", "blocksexchange")
_GEODETIC = ("latitude", "longitude", "height")
_CARTESIAN = ("x", "y", "z")
_SIGMAS = ("sigma_horizontal_m", "sigma_height_m", "sigma_tilt", "sigma_yaw")
_CLOCK = ("time_utc", "gps_week", "gps_seconds")


class OrientationColumns(ClockColumns, PoseColumns):
    """Names of the columns; columns of the position and the angles have these names by default."""

    omega: str | None = Field(
        None,
        description="column of omega, about x; by default omega",
        examples=["omega"],
    )
    phi: str | None = Field(
        None,
        description="column of phi, about y; by default phi",
        examples=["phi"],
    )
    kappa: str | None = Field(
        None,
        description="column of kappa, about z; by default kappa",
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
    """Positions of three images or more. A frame is fitted to them, or compared with them."""

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
        description=(
            "column of heights [m]; for an unknown frame their reference is that of "
            "stations.orientation.heights"
        ),
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
            "omega, phi and kappa of the camera, the primary rotation first: M = Rx(omega) "
            "Ry(phi) Rz(kappa), or with phi_omega_kappa Ry(phi) Rx(omega) Rz(kappa), turns "
            "vectors of the photo (x right, y up, z backward) to the frame; roll, pitch and yaw "
            "of the aircraft, with the camera mounted as under mount; or the quaternion q_w to "
            "q_z from the frame to the camera (x right, y down, z forward), or with "
            "quaternion_to_frame the inverse"
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
            "north, east, down) at each station; projected: x, y of crs, with angles from its grid "
            "north, and z, the height; ecef: earth-centred; {enu: "
            "{lat_deg, lon_deg, h_ellipsoid_m}}: east, north, up at this one place; unknown: "
            "fitted to known_positions. By default the frame that the block states: OpenSfM's "
            "reference_lla, the coordinate system of Metashape, Pix4D or BlocksExchange"
        ),
        examples=["geographic"],
    )
    heights: Literal["msl", "ellipsoid"] | None = Field(
        None,
        description=(
            "reference of the height column: mean sea level or the ellipsoid (if the frame is "
            "unknown: reference of known_positions; if a block states its frame: reference of the "
            "altitudes that its program was given)"
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
            "convergence of the grid, if kappa or yaw is relative to grid north: true minus grid "
            "azimuth, positive if grid north is east of true north. For frame: geographic; with "
            "projected PROJ computes it"
        ),
        examples=[1.2],
        json_schema_extra={"unit": "deg"},
    )
    columns: OrientationColumns = Field(
        OrientationColumns(),
        description=(
            "names of the table's columns, if they differ from the default. Usual names of images, "
            "positions and angles are detected too; those of camera, time and sigmas only in "
            "tables that unbend wrote"
        ),
    )
    camera: str | None = Field(
        None,
        description="camera of every row, without a column camera",
        examples=["nadir"],
    )
    date: StatedDate | None = Field(
        None,
        description=(
            "UTC day, as 2026-05-14, or day and time in the middle of the flight, as "
            "2026-05-14T09:50:00Z, if no column has the time. It gives the season of the "
            "climatology, and the age of soundings and surface reports"
        ),
        examples=["2026-05-14T09:50:00Z"],
    )
    known_positions: KnownPositions | Literal["log"] | None = Field(
        None,
        description=(
            "positions of at least three images. An unknown frame is fitted to them; another frame "
            "is compared with them: a CSV, or log: the exposures of the log"
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
    def _angles_of_block(cls, values: object) -> object:
        if isinstance(values, dict) and is_block(values.get("format")):
            return {"angles": "quaternion"} | values
        return values

    @field_validator("frame")
    @classmethod
    def _require_frame(cls, value: object, info: ValidationInfo) -> object:
        if value is None and info.data.get("format") not in _FORMATS_WITH_FRAME:
            raise SectionError("is missing (geographic | projected | ecef | {enu: ...} | unknown)")
        return value

    @property
    def of_block(self) -> bool:
        """Whether the file is the block of another program."""
        return is_block(self.format)

    @property
    def is_geodetic(self) -> bool:
        """Whether positions are latitude, longitude and height, or x, y of a projection."""
        return self.is_level or self.columns.latitude is not None

    def in_system_of(self, crs: str | None, kind: str | None) -> Self:
        """The section with the coordinate system of its block as frame, if no frame is stated.

        ``crs`` and ``kind`` (a word of ``frame``) are None if the block names no system.
        """
        if self.frame is not None or crs is None or kind is None:
            return self
        return self.model_copy(update={"frame": kind, "crs": crs})

    def is_msl(self, reference_of_crs: str | None) -> bool:
        """Whether the heights are above mean sea level.

        ``reference_of_crs`` is the reference that the vertical part of a coordinate system gives,
        which counts before the stated one; None without such a part.
        """
        has_heights = self.is_geodetic or self.frame is None
        return has_heights and (reference_of_crs or self.heights) == "msl"

    @property
    def column_names(self) -> dict[str, str]:
        """The name of the column of each quantity that is read, by quantity."""
        has_latitudes = self.is_geodetic and self.frame != "projected"
        position = _GEODETIC if has_latitudes else _CARTESIAN
        named = self.columns.named
        columns = {}
        for quantity in ("image", "camera", *_CLOCK, *_SIGMAS):
            if quantity in named:
                columns[quantity] = named[quantity]
        # Every table has these, by default under the name of the quantity.
        for quantity in (*position, *self.angle_names):
            columns[quantity] = named.get(quantity, quantity)
        return columns

    @property
    def unstated(self) -> tuple[str, ...]:
        """Which of camera, time and sigmas neither a column nor a constant of the section gives."""
        constants = {
            "camera": self.camera,
            "time_utc": self.date,
            "sigma_horizontal_m": self.sigma_horizontal_m,
            "sigma_height_m": self.sigma_height_m,
            "sigma_tilt": self.sigma_tilt_deg,
            "sigma_yaw": self.sigma_yaw_deg,
        }
        return tuple(
            quantity
            for quantity, constant in constants.items()
            if constant is None and quantity not in self.columns.named
        )

    @property
    def angle_names(self) -> tuple[str, ...]:
        """The quantities of the attitude, in the order that the key ``angles`` names."""
        return _QUANTITIES_OF_ANGLES[self.angles]

    @property
    def has_clock(self) -> bool:
        """Whether columns give the time of each image."""
        return self.format == "dji" or not self.columns.named.keys().isdisjoint(_CLOCK)

    @property
    def date_ns(self) -> int | None:
        """The stated date [Unix ns], None without; a day without a time is its noon in UTC."""
        return nanoseconds_of_date(self.date)

    @property
    def is_level(self) -> bool:
        """Whether the angles are relative to the horizontal plane at each station."""
        return self.frame in ("geographic", "projected")

    @model_validator(mode="after")
    def _check_angles(self) -> Self:
        are_of_body = self.angles == "roll_pitch_yaw"
        if self.format == "dji" and not are_of_body:
            raise SectionError("format: dji has angles: roll_pitch_yaw, of the gimbal")
        if are_of_body and not self.is_level:
            raise SectionError(
                "roll, pitch and yaw are relative to north, east and down at the station: frame "
                "must be geographic or projected"
            )
        return self

    @model_validator(mode="after")
    def _check_frame(self) -> Self:
        if self.frame == "projected" and self.crs is None:
            raise SectionError("frame: projected needs crs, as EPSG:25832")
        if self.crs and not self.is_level:
            raise SectionError("crs is only for frame: projected or geographic")
        if self.frame == "unknown":
            self._check_unknown_frame()
        return self

    def _check_unknown_frame(self) -> None:
        """Refuse an unknown frame without known positions, or with latitudes."""
        if self.is_geodetic:
            raise SectionError("an unknown frame has x, y and z, not columns.latitude")
        if self.known_positions is None:
            raise SectionError(
                "an unknown frame has no vertical, no north and no scale: give known_positions of "
                "at least three images that are not on one line"
            )

    @model_validator(mode="after")
    def _check_heights(self) -> Self:
        """``heights`` is stated if the file or known_positions has heights, and only then."""
        is_fitted = self.frame == "unknown" and isinstance(self.known_positions, KnownPositions)
        has_heights = self.is_geodetic or self.frame is None or is_fitted
        states_heights = self.heights is not None
        if has_heights == states_heights:
            return self
        if states_heights:
            raise SectionError(
                "heights is stated, but in this frame x, y and z are the position, without a "
                "column of heights: remove heights"
            )
        mistake = "heights is missing: what the heights count from, msl or ellipsoid"
        if self.of_block:
            mistake += (
                " (for a block without frame: the reference of the heights that its program was "
                "given)"
            )
        raise SectionError(mistake)

    @model_validator(mode="after")
    def _check_block(self) -> Self:
        if not self.of_block:
            return self
        states_columns = self.camera is not None or self.columns != OrientationColumns()
        if states_columns or self.frame == "geographic" or self.angles != "quaternion":
            raise SectionError(
                f"format: {self.format} has its own angles, columns and cameras, and a frame of x, "
                "y, z: projected, ecef, enu or unknown"
            )
        return self

    @model_validator(mode="after")
    def _check_convergence_and_date(self) -> Self:
        if self.convergence_deg and self.frame != "geographic":
            raise SectionError("convergence_deg is for frame: geographic")
        if self.has_clock and self.date is not None:
            raise SectionError("give either date, or the columns of time")
        return self

    @model_validator(mode="after")
    def _check_columns(self) -> Self:
        """Every column that is named is read, so that none is a mistake in frame or angles."""
        unread = sorted(self.columns.named.keys() - self.column_names.keys())
        if unread:
            raise SectionError(
                f"columns has {', '.join(unread)}, which this frame and these angles do not take: "
                f"they take {', '.join(self.column_names)}"
            )
        return self
