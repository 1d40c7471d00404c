"""The sections of a mission file on a camera: interior orientation, window, lens, and mount."""

import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from unbend.errors import InputError, PhysicsError
from unbend.flight.mount import Mount
from unbend.refraction import BrownConrady, Cabin, Camera, LensInAir, Window
from unbend.refraction.calibration import (
    MODELS,
    MetricReport,
    camera_of_model,
    camera_of_report,
    model_of_camera,
    refuse_impossible,
)  # fmt: skip
from unbend.refraction.window import UNKNOWN
from unbend.tables.imports.blocks import BLOCKS, read_camera
from unbend.tables.pixels import PixelOrigin, PixelSystem
from unbend.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K

PathText = Annotated[str, Field(min_length=1, pattern=r"^[^\x00]+$")]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
LeverArm = Annotated[
    list[Annotated[float, Field(ge=-100, le=100)]], Field(min_length=3, max_length=3)
]


def one_of(names: Callable[[], Collection[str]]) -> AfterValidator:
    """The check that a value is one of those that are registered when it is read."""

    def check(value: str) -> str:
        if value not in names():
            raise ValueError(f"is none of {', '.join(names())}")
        return value

    return AfterValidator(check)


@cache
def mistakes() -> Mapping[str, Any]:
    return tomllib.loads(files(__package__).joinpath("mistakes.toml").read_text("utf-8"))


def mistake(key: str, **values: object) -> ValueError:
    """What a model raises where values do not go together, with the text of a key, filled in."""
    return ValueError(mistakes()[key].format_map(values))


def refuse(*rules: tuple[object, str], **values: object) -> None:
    """Raise the text of the first rule that holds, or what `mistake` has under it: a key."""
    for text in (text for holds, text in rules if holds):
        raise ValueError(text) if " " in text else mistake(text, **values)


class Section(BaseModel):
    """A part of the mission file: strict types, no unknown keys, no NaN."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True
    )

    def __copy__(self) -> Self:
        """A copy of the keys: what was computed of them may be another one of changed keys."""
        copied = super().__copy__()
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied


Hectopascal = Annotated[float, Field(ge=100, le=1200)]
Celsius = Annotated[float, Field(ge=-60, le=60)]


class CabinAir(Section):
    """The air in the compartment, quantity by quantity."""

    pressure: Literal["log", "ambient"] | Hectopascal | None = Field(
        None,
        description=(
            "pressure in the compartment: log, as logged; ambient, not pressurised, as outside; or "
            "a constant"
        ),
        examples=["log"],
        json_schema_extra={"unit": "hPa"},
    )
    pressure_hpa: Hectopascal | None = Field(
        None,
        validate_default=True,
        description="constant pressure in the compartment; the same as a number under pressure",
        examples=[800.0],
        json_schema_extra={"unit": "hPa"},
    )
    temperature_c: Literal["log"] | Celsius | None = Field(
        None,
        description=(
            "temperature in the compartment: log, or a constant. Without it the log's, where it "
            "has one, else 21 degC: +- 5 K where the cabin is pressurised, +- 10 K where it is not"
        ),
        examples=[21.0],
        json_schema_extra={"unit": "degC"},
    )
    relative_humidity: float | None = Field(
        None,
        ge=0,
        le=1,
        description=(
            "relative humidity in the compartment, 0 to 1; without it the log's, else dry air "
            "(ambient: as outside)"
        ),
        examples=[0.3],
        json_schema_extra={"unit": "1"},
    )
    sigma_pressure_hpa: float | None = Field(
        None,
        ge=0,
        le=300,
        description=(
            "standard deviation of the cabin's pressure; without it 3 hPa where it is logged or "
            "ambient"
        ),
        examples=[3.0],
        json_schema_extra={"unit": "hPa"},
    )
    sigma_temperature_k: float | None = Field(
        None,
        ge=0,
        le=50,
        description=(
            "standard deviation of the cabin's temperature; without it 1 K where a thermometer is "
            "logged"
        ),
        examples=[1.0],
        json_schema_extra={"unit": "K"},
    )

    @field_validator("pressure_hpa")
    @classmethod
    def _one_pressure(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is None and info.data.get("pressure") is None:
            raise ValueError("is missing: give it, or pressure: log or ambient")
        if value is not None and info.data.get("pressure") is not None:
            raise ValueError("is the same as pressure: give one of them")
        return value

    def build(self) -> Cabin:
        """In SI."""
        given = self.pressure if self.pressure_hpa is None else self.pressure_hpa
        celsius = self.temperature_c
        logged = celsius == "log"

        def si(value: float | None, unit: float = 1.0) -> float:
            return UNKNOWN if value is None else value * unit

        return Cabin(
            given if isinstance(given, str) else "constant",
            UNKNOWN if isinstance(given, str) else si(given, HECTOPASCAL),
            UNKNOWN if isinstance(celsius, str) else si(celsius) + ZERO_CELSIUS_K,
            si(self.relative_humidity),
            si(self.sigma_pressure_hpa, HECTOPASCAL),
            si(self.sigma_temperature_k),
            temperature_logged=logged,
        )


def _checked_window(*given: Any) -> Window:
    """A window, its refusal as pydantic expects it."""
    try:
        return Window(*given)
    except PhysicsError as error:
        raise ValueError(f"{error.what}; {error.remedy}") from None


class WindowSection(Section):
    """The window of a pressurised compartment."""

    shape: Literal["plane", "spherical"] = Field(
        "plane",
        description="plane; or spherical: a dome about the projection centre, which bends nothing",
        examples=["plane"],
    )
    cabin: Literal["log", "standard_schedule"] | CabinAir | None = Field(
        None,
        validate_default=True,
        description=(
            "air behind the window. log: from the cabin channels of the log; standard_schedule: as "
            "outside up to 3 km, then 701.2 hPa, 21.1 degC (Gyer's Table 7); or {pressure, "
            "temperature_c}"
        ),
        examples=["log"],
    )
    frame: Literal["camera", "body"] = Field(
        "camera",
        description=(
            "frame of the normal: camera (x right, y down, z forward), or body, the aircraft's (x "
            "forward, y right, z down), for a camera that moves behind a fixed window"
        ),
        examples=["camera"],
    )
    normal: Vector = Field(
        default_factory=lambda: [0.0, 0.0, 1.0],
        description=(
            "direction out of the window; [0, 0, 1] is square to the optical axis in the camera "
            "frame, a window in the belly in the body frame"
        ),
        examples=[[0.0, 0.0, 1.0]],
        json_schema_extra={"unit": "1"},
    )
    in_calibration: Literal["none", "glass"] = Field(
        "none",
        description=(
            "glass: the camera was calibrated through the window. The glass displaces rays, which "
            "is never modelled"
        ),
        examples=["none"],
    )

    @cached_property
    def window(self) -> Window:
        """The window, with cabin air in SI."""
        x, y, z = self.normal
        cabin = self.cabin.build() if isinstance(self.cabin, CabinAir) else self.cabin
        cabin = Cabin(cabin) if isinstance(cabin, str) else cabin
        return Window(cabin, (x, y, z), self.frame, self.shape, self.in_calibration)

    @field_validator("cabin")
    @classmethod
    def _require_cabin(cls, value: object, info: ValidationInfo) -> object:
        if value is None:
            _checked_window(None, (0.0, 0.0, 1.0), "camera", info.data.get("shape", "plane"))
        return value

    @field_validator("normal")
    @classmethod
    def _unit_normal(cls, value: list[float], info: ValidationInfo) -> list[float]:
        length = float(np.linalg.norm(value))
        unit = [component / length for component in value] if length > 1e-6 else [0.0, 0.0, 0.0]
        _checked_window(None, tuple(unit), info.data.get("frame", "camera"), "spherical")
        return unit

    @model_validator(mode="after")
    def _check_spherical(self) -> Self:
        # By their values: the manifest of a run states the defaults too.
        given = ["frame"] * (self.frame != "camera") + ["normal"] * (self.normal[2] != 1.0)
        if self.shape == "spherical" and given:
            raise ValueError(f"a spherical window has no {' and no '.join(given)}")
        return self


class LensReference(Section):
    """The air in the lens when the camera was calibrated."""

    pressure_hpa: float = Field(
        ge=100,
        le=1200,
        description="air pressure during the calibration",
        examples=[1013.25],
        json_schema_extra={"unit": "hPa"},
    )
    temperature_c: float = Field(
        ge=-60,
        le=60,
        description="temperature during the calibration",
        examples=[20.0],
        json_schema_extra={"unit": "degC"},
    )


class LensSection(Section):
    """How the principal distance follows the air in the lens.

    In pixels: derivatives in millimetres are divided by the pixel pitch in millimetres."""

    reference: LensReference = Field(
        description="{pressure_hpa, temperature_c} of the air in the lens during the calibration",
    )
    dc_dp_px_per_hpa: float = Field(
        ge=-10,
        le=10,
        description="change of the principal distance with the pressure of the air in the lens",
        examples=[0.0084],
        json_schema_extra={"unit": "px/hPa"},
    )
    dc_dt_px_per_k: float = Field(
        ge=-10,
        le=10,
        description="change of the principal distance with the temperature of the lens",
        examples=[0.004],
        json_schema_extra={"unit": "px/K"},
    )

    def build(self, principal_distance_px: float) -> LensInAir:
        """In Pa and K."""
        return LensInAir(
            principal_distance_px,
            self.reference.pressure_hpa * HECTOPASCAL,
            self.reference.temperature_c + ZERO_CELSIUS_K,
            self.dc_dp_px_per_hpa / HECTOPASCAL,
            self.dc_dt_px_per_k,
        )


class MountSection(Section):
    """How a camera sits in the aircraft (body frame: x forward, y right, z down).

    With all angles zero it looks straight down, the top of the image towards the nose; yaw, pitch
    and roll then turn it about the body's axes, in that order (intrinsic z-y-x). Composed are the
    attitude of the aircraft, the angles of a gimbal that plays the attitude, and these (boresight):
    v_ned = R(aircraft) R(gimbal) R(mount) v_camera, where a gimbal that is level to the horizon
    takes of the aircraft its yaw alone, and one whose yaw counts from north takes nothing."""

    attitude: str | None = Field(
        None,
        description=(
            "channel of the camera's own gimbal or head, where each camera has one; by default "
            "log.channels.attitude"
        ),
        examples=["MNT[0]"],
    )
    roll_deg: float = Field(
        0.0,
        description=(
            "turn about the body's forward axis: positive lowers the right wing, and a camera that "
            "looked down looks to the left; -45 looks to the right"
        ),
        examples=[-45.0],
        json_schema_extra={"unit": "deg"},
    )
    pitch_deg: float = Field(
        0.0,
        description=(
            "turn about the body's right axis: positive raises the nose, and a camera that looked "
            "down looks forward"
        ),
        examples=[0.0],
        json_schema_extra={"unit": "deg"},
    )
    yaw_deg: float = Field(
        0.0,
        description="turn about the body's vertical axis, clockwise seen from above",
        examples=[0.0],
        json_schema_extra={"unit": "deg"},
    )
    lever_arm_m: LeverArm = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description=(
            "projection centre minus the point whose position the log gives (horizontally the "
            "filter's, in height the GNSS antenna's), in the body frame"
        ),
        examples=[[0.2, 0.28, 0.55]],
        json_schema_extra={"unit": "m"},
    )
    sigma_tilt_deg: float | None = Field(
        None,
        ge=0,
        le=45,
        description=(
            "standard deviation of the attitude about each of the body's two level axes, in place "
            "of what the log gives; what the time between samples adds is added to it"
        ),
        examples=[0.1],
        json_schema_extra={"unit": "deg"},
    )
    sigma_yaw_deg: float | None = Field(
        None,
        ge=0,
        le=180,
        description=(
            "standard deviation of the attitude about the body's vertical axis; by default "
            "sigma_tilt_deg"
        ),
        examples=[0.4],
        json_schema_extra={"unit": "deg"},
    )

    @model_validator(mode="after")
    def _check_sigmas(self) -> Self:
        if self.sigma_yaw_deg is not None and self.sigma_tilt_deg is None:
            raise ValueError("sigma_yaw_deg needs sigma_tilt_deg beside it")
        return self

    @cached_property
    def mount(self) -> Mount:
        """In radians."""
        x, y, z = self.lever_arm_m
        tilt = self.sigma_tilt_deg
        yaw = tilt if self.sigma_yaw_deg is None else self.sigma_yaw_deg
        return Mount(
            self.roll_deg * DEGREE,
            self.pitch_deg * DEGREE,
            self.yaw_deg * DEGREE,
            (x, y, z),
            sigma_tilt_rad=None if tilt is None else tilt * DEGREE,
            sigma_yaw_rad=None if yaw is None else yaw * DEGREE,
        )


PrincipalDistance = Annotated[float, Field(ge=10, le=1e6)]
Coefficient = Annotated[float, Field(ge=-10, le=10)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Sense = Literal["correction", "distortion"]


class DistortionSection(Section):
    """Brown-Conrady coefficients as OpenCV defines them."""

    k1: Coefficient = Field(
        0.0,
        description="radial coefficient of r^2, r in units of the principal distance",
        examples=[0.0],
        json_schema_extra={"unit": "1"},
    )
    k2: Coefficient = Field(
        0.0,
        description="radial coefficient of r^4, r in units of the principal distance",
        examples=[0.0],
        json_schema_extra={"unit": "1"},
    )
    k3: Coefficient = Field(
        0.0,
        description="radial coefficient of r^6, r in units of the principal distance",
        examples=[0.0],
        json_schema_extra={"unit": "1"},
    )
    p1: Coefficient = Field(
        0.0,
        description="decentring coefficient of OpenCV: x' = ... + 2 p1 x y",
        examples=[0.0],
        json_schema_extra={"unit": "1"},
    )
    p2: Coefficient = Field(
        0.0,
        description="decentring coefficient of OpenCV: x' = ... + p2 (r^2 + 2 x^2)",
        examples=[0.0],
        json_schema_extra={"unit": "1"},
    )


class MetricDistortion(Section):
    """Coefficients of a calibration report, in powers of mm, about the point of symmetry."""

    sense: Sense = Field(
        description=(
            "correction: the coefficients are what is added to measured coordinates (reports of "
            "the USGS); distortion: what the lens does to ideal ones"
        ),
        examples=["correction"],
    )
    k0: float = Field(
        0.0,
        description="radial coefficient of r: dr = r (k0 + k1 r^2 + ...)",
        examples=[2.616e-05],
        json_schema_extra={"unit": "1"},
    )
    k1: float = Field(
        0.0,
        description="radial coefficient of r^3",
        examples=[-2.295e-09],
        json_schema_extra={"unit": "mm^-2"},
    )
    k2: float = Field(
        0.0,
        description="radial coefficient of r^5",
        examples=[1.454e-14],
        json_schema_extra={"unit": "mm^-4"},
    )
    k3: float = Field(
        0.0,
        description="radial coefficient of r^7",
        examples=[0.0],
        json_schema_extra={"unit": "mm^-6"},
    )
    k4: float = Field(
        0.0,
        description="radial coefficient of r^9",
        examples=[0.0],
        json_schema_extra={"unit": "mm^-8"},
    )
    p1: float = Field(
        0.0,
        description="decentring: dx = p1 (r^2 + 2 x^2) + 2 p2 x y (not OpenCV's order)",
        examples=[0.0],
        json_schema_extra={"unit": "mm^-1"},
    )
    p2: float = Field(
        0.0,
        description="decentring: dy = p2 (r^2 + 2 y^2) + 2 p1 x y",
        examples=[0.0],
        json_schema_extra={"unit": "mm^-1"},
    )
    b1: float = Field(
        0.0,
        ge=-0.05,
        le=0.05,
        description="affinity, dx = b1 x + b2 y",
        examples=[0.0],
        json_schema_extra={"unit": "1"},
    )
    b2: float = Field(
        0.0,
        ge=-0.05,
        le=0.05,
        description="affinity, dx = b1 x + b2 y",
        examples=[0.0],
        json_schema_extra={"unit": "1"},
    )


class MetricTable(Section):
    """Tabulated radial distortion of a calibration report."""

    sense: Sense = Field(
        description=(
            "distortion: the rows are what the lens does, positive away from the point of "
            "symmetry; correction: what is added to measured coordinates"
        ),
        examples=["distortion"],
    )
    by: Literal["radius_mm", "field_angle_deg"] = Field(
        description="what the first number of each row is",
        examples=["field_angle_deg"],
    )
    rows: list[Pair] = Field(
        min_length=3,
        description="rows of [radius or field angle, distortion in micrometres]",
        examples=[[[7.5, -1.0], [15.0, -1.0], [30.0, -1.0]]],
        json_schema_extra={"unit": "um"},
    )

    @field_validator("rows")
    @classmethod
    def _check_order(cls, rows: list[list[float]], info: ValidationInfo) -> list[list[float]]:
        first = [row[0] for row in rows]
        last = 80.0 if info.data.get("by") == "field_angle_deg" else np.inf
        if first[0] < 0.0 or np.any(np.diff(first) <= 0.0) or first[-1] > last:
            raise ValueError("radii, or angles of up to 80 degrees, grow from row to row")
        return rows


class MetricSection(Section):
    """The calibration report of a metric frame camera, in millimetres."""

    focal_mm: float = Field(
        ge=1,
        le=5000,
        description="calibrated principal distance",
        examples=[153.743],
        json_schema_extra={"unit": "mm"},
    )
    pixel_um: Pair = Field(
        description="size of a pixel, [across, down]",
        examples=[[20.0, 20.0]],
        json_schema_extra={"unit": "um"},
    )
    format_mm: Pair = Field(
        description="width and height of the image, to check pixel_um",
        examples=[[230.0, 230.0]],
        json_schema_extra={"unit": "mm"},
    )
    origin: Literal["image_centre"] | Pair = Field(
        description=(
            "origin of the report's coordinates: image_centre, or its pixel (the centre of the "
            "fiducials)"
        ),
        examples=["image_centre"],
        json_schema_extra={"unit": "px"},
    )
    axes: Literal["right up", "right down", "left up", "left down", "up right", "up left",
                  "down right", "down left"] = Field(
        description="directions of the report's x and y axes in the image",
        examples=['right up'],
    )  # fmt: skip
    ppa_mm: Pair = Field(
        description="principal point of autocollimation, origin of projection",
        examples=[[0.004, -0.012]],
        json_schema_extra={"unit": "mm"},
    )
    ppbs_mm: Pair | None = Field(
        None,
        description="point of best symmetry, origin of distortion; by default ppa_mm",
        examples=[[-0.009, 0.002]],
        json_schema_extra={"unit": "mm"},
    )
    radius_mm: float | None = Field(
        None,
        gt=0,
        description="largest calibrated radius; by default the last row of the table",
        examples=[150.0],
        json_schema_extra={"unit": "mm"},
    )
    distortion: MetricDistortion | None = Field(
        None,
        description="coefficients of the report",
    )
    table: MetricTable | None = Field(
        None,
        description=(
            "tabulated radial distortion of the report; alone it becomes a polynomial, beside "
            "coefficients it checks them"
        ),
    )

    def build(self, size_px: tuple[int, int], pixels: PixelSystem) -> Camera:
        """The camera; refuses as `camera_of_report`."""
        centre, table = np.array(size_px) / 2.0, None
        known = {} if self.distortion is None else self.distortion.model_dump()
        if self.table is not None:
            rows = np.array(self.table.rows) * [1.0, 1e-3]
            if self.table.by == "field_angle_deg":
                rows[:, 0] = self.focal_mm * np.tan(np.radians(rows[:, 0]))
            table = rows, self.table.sense
        report = MetricReport(
            self.focal_mm, pixel_mm=np.array(self.pixel_um) * 1e-3,
            format_mm=self.format_mm, axes=self.axes, ppa_mm=self.ppa_mm,
            origin_px=centre if isinstance(self.origin, str)
            else pixels.to_colmap(np.array(self.origin)),
            ppbs_mm=self.ppbs_mm or self.ppa_mm, sense=known.pop("sense", "distortion"),
            coefficients=known, table=table, radius_mm=self.radius_mm or np.inf,
        )  # fmt: skip
        return camera_of_report(report, size_px)


_OTHER_WAYS = ["file", "model", "params", "metric"]
OWN_ORIENTATION = {*_OTHER_WAYS, "f_px", "fx_px", "fy_px", "cx_px", "cy_px", "distortion"}
"""Keys of which a camera has one, unless its orientation is that of the observations' block."""


class CameraSection(Section):
    """Interior orientation of one camera, in one of four ways."""

    file: PathText | None = Field(
        None,
        description=(
            "calibration file of COLMAP, OpenSfM or ODM, Metashape or DBAT; then no numbers stand "
            "here. By default the block of the observations, where that is one"
        ),
        examples=["cameras.txt"],
    )
    format: Literal[tuple(BLOCKS)] | None = Field(
        None,
        description="program that wrote file, where its ending does not say it",
        examples=["colmap"],
    )  # type: ignore[valid-type]
    camera: str | int | None = Field(
        None,
        description="name or number of the camera in file or in the block, where that has several",
        examples=["1"],
    )
    model: Literal[tuple(MODELS)] | None = Field(
        None,
        description="COLMAP's name of the camera model",
        examples=["OPENCV"],
    )  # type: ignore[valid-type]
    params: list[float] | None = Field(
        None,
        description=(
            "parameters of model in COLMAP's order, as in cameras.txt, in COLMAP's pixels; its "
            "coefficients have no unit"
        ),
        examples=[[20000.0, 7000.0, 5300.0, -0.01]],
        json_schema_extra={"unit": "px"},
    )
    metric: MetricSection | None = Field(
        None,
        description="calibration report of a metric frame camera, in millimetres",
    )
    width_px: int | None = Field(
        None,
        gt=0,
        le=1_000_000,
        validate_default=True,
        description="width of the image",
        examples=[14000],
        json_schema_extra={"unit": "px"},
    )
    height_px: int | None = Field(
        None,
        gt=0,
        le=1_000_000,
        validate_default=True,
        description="height of the image",
        examples=[10600],
        json_schema_extra={"unit": "px"},
    )
    f_px: PrincipalDistance | None = Field(
        None,
        description="principal distance, where it is the same along x and y",
        examples=[20000.0],
        json_schema_extra={"unit": "px"},
    )
    fx_px: PrincipalDistance | None = Field(
        None,
        description="principal distance along x",
        examples=[20000.0],
        json_schema_extra={"unit": "px"},
    )
    fy_px: PrincipalDistance | None = Field(
        None,
        description="principal distance along y",
        examples=[20000.0],
        json_schema_extra={"unit": "px"},
    )
    cx_px: float | None = Field(
        None,
        ge=-1e6,
        le=1e6,
        validate_default=True,
        description="x of the principal point, from the left",
        examples=[7012.4],
        json_schema_extra={"unit": "px"},
    )
    cy_px: float | None = Field(
        None,
        ge=-1e6,
        le=1e6,
        validate_default=True,
        description="y of the principal point, from the top",
        examples=[5291.7],
        json_schema_extra={"unit": "px"},
    )
    pixel_origin: PixelOrigin | None = Field(
        None,
        description=(
            "where the principal point counts its pixels from; by default as the observations do, "
            "and corner for params"
        ),
        examples=["corner"],
    )
    distortion: DistortionSection | None = Field(
        None,
        description=(
            "coefficients of the lens as OpenCV defines them; without them the lens has none"
        ),
    )
    calibration: Literal["laboratory", "in_flight_uncorrected", "in_flight_corrected"] = Field(
        description=(
            "how the camera was calibrated. A calibration estimated in flight on uncorrected "
            "images already contains the nadir refraction of that height"
        ),
        examples=["laboratory"],
    )
    window: WindowSection | None = Field(
        None,
        description="the window that the camera looks through; leave it out where there is none",
    )
    principal_distance: LensSection | None = Field(
        None,
        description=(
            "how the principal distance follows the air in the lens; without it that change is not "
            "removed"
        ),
    )

    @field_validator("width_px", "height_px", "cx_px", "cy_px")
    @classmethod
    def _require(cls, value: float | None, info: ValidationInfo) -> float | None:
        others = ["file"] if info.field_name in ("width_px", "height_px") else _OTHER_WAYS
        if value is None and all(info.data.get(name) is None for name in others):
            raise ValueError(f"is missing, and there is no {' or '.join(others)}")
        return value

    @model_validator(mode="after")
    def _check_orientation(self) -> Self:
        """One way to give the interior orientation, and a camera that can be one."""
        single = tuple(f is not None for f in (self.f_px, self.fx_px, self.fy_px))
        others = (self.cx_px, self.cy_px, self.distortion)
        numbers = any(single) or any(value is not None for value in others)
        given = [name for name in _OTHER_WAYS if getattr(self, name) is not None]
        given += ["f_px, cx_px, distortion"] * numbers
        of_file = any((self.format, self.file and self.pixel_origin))
        refuse(
            ((self.model is None) != (self.params is None), "model-params"),
            (len(given) > 1 + (self.model is not None), "orientation-twice"),
            (of_file and (self.file is None or self.pixel_origin is not None), "format-file"),
            given=", ".join(given),
        )
        if self.file is not None:
            return self
        if numbers and single not in ((True, False, False), (False, True, True)):
            raise ValueError("give f_px, or both fx_px and fy_px")
        try:
            camera = self.interior_orientation
            if not all(10.0 <= f <= 1e6 for f in (camera.fx_px, camera.fy_px)):
                raise ValueError("the principal distance is 10 to 1000000 pixels")
            refuse_impossible(camera)
        except PhysicsError as error:
            raise ValueError(f"{error.code}: {error.what}; {error.remedy}") from None
        return self

    @model_validator(mode="after")
    def _check_lens_air(self) -> Self:
        if self.principal_distance and self.window and self.window.cabin is None:
            raise mistake("lens-air")
        return self

    @property
    def needs_cabin(self) -> bool:
        """Whether a number depends on the cabin's air: behind a spherical window only the lens."""
        if self.window is None or self.window.cabin is None:
            return False
        return self.window.shape == "plane" or self.principal_distance is not None

    @property
    def needs_cabin_from_log(self) -> bool:
        """Whether a number depends on the cabin's air, and that is to come from the log."""
        cabin = None if self.window is None else self.window.window.cabin
        of_log = cabin is not None and (cabin.source == "log" or cabin.temperature_logged)
        return of_log and self.needs_cabin

    @cached_property
    def lens(self) -> LensInAir | None:
        """How the principal distance follows the air; None where the file does not state it."""
        if self.principal_distance is None:
            return None
        camera = self.interior_orientation
        # The smaller of two, to which a change is the larger part.
        return self.principal_distance.build(min(camera.fx_px, camera.fy_px))

    @cached_property
    def interior_orientation(self) -> Camera:
        """The camera in COLMAP's pixels, when its file is read; pixels count from the corner."""
        return self._camera("corner")

    def interior_orientation_by(self, pixel_origin: PixelOrigin) -> Camera:
        """The camera in COLMAP's pixels; its own count from ``pixel_origin`` if it says nothing."""
        if self.pixel_origin is not None or pixel_origin == "corner":
            return self.interior_orientation
        return self._camera(pixel_origin)

    def _camera(self, pixel_origin: PixelOrigin) -> Camera:
        width, height = self.width_px or 0, self.height_px or 0
        pixels = PixelSystem(self.pixel_origin or pixel_origin)
        if self.metric is not None:
            return self.metric.build((width, height), pixels)
        if self.model is not None and self.params is not None:
            camera = camera_of_model(self.model, width, height, self.params)
            pixels = PixelSystem(self.pixel_origin or "corner")
            cx, cy = pixels.to_colmap(camera.cx_px), pixels.to_colmap(camera.cy_px)
            return replace(camera, cx_px=cx, cy_px=cy)
        if self.cx_px is None or self.cy_px is None:
            raise ValueError(f"{self.file} has not been read")
        fx, fy = self.f_px or self.fx_px or 0.0, self.f_px or self.fy_px or 0.0
        cx, cy = pixels.to_colmap(self.cx_px), pixels.to_colmap(self.cy_px)
        known = BrownConrady(**(self.distortion or DistortionSection()).model_dump())
        return Camera(width, height, fx, fy, cx, cy, known)

    def with_file(self, path: Path) -> Self:
        """The section with model and parameters of its file, which is at ``path``.

        Refuses as `read_camera`, and a file whose images have another size (CAMERA-SIZE).
        """
        camera = read_camera(path, self.format, None if self.camera is None else str(self.camera))
        width, height = self.width_px or camera.width_px, self.height_px or camera.height_px
        if (width, height) != (camera.width_px, camera.height_px):
            raise InputError.of("CAMERA-SIZE", path, camera=camera, width=width, height=height)
        model, params = model_of_camera(camera)
        known = {"model": model, "params": params, "width_px": width, "height_px": height}
        kept = self.model_dump(exclude={"file", "format", "camera"}, exclude_unset=True)
        try:
            return type(self).model_validate(kept | known)
        except ValidationError as error:
            first = error.errors()[0]
            if first["type"] == "value_error":
                what = first["msg"].removeprefix("Value error, ")
            else:
                what = f"its {first['loc'][0]} is none that a camera can have"
            raise InputError(
                "CAMERA-FILE", what, where=str(path), remedy="check the file, or give another one"
            ) from None
