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

    pressure: Literal["log", "ambient"] | Hectopascal | None = None
    pressure_hpa: Hectopascal | None = Field(None, validate_default=True)
    temperature_c: Literal["log"] | Celsius | None = None
    relative_humidity: float | None = Field(None, ge=0, le=1)
    sigma_pressure_hpa: float | None = Field(None, ge=0, le=300)
    sigma_temperature_k: float | None = Field(None, ge=0, le=50)

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

    shape: Literal["plane", "spherical"] = "plane"
    cabin: Literal["log", "standard_schedule"] | CabinAir | None = Field(
        None, validate_default=True
    )
    frame: Literal["camera", "body"] = "camera"
    normal: Vector = Field(default_factory=lambda: [0.0, 0.0, 1.0])
    in_calibration: Literal["none", "glass"] = "none"

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

    pressure_hpa: float = Field(ge=100, le=1200)
    temperature_c: float = Field(ge=-60, le=60)


class LensSection(Section):
    """How the principal distance follows the air in the lens.

    In pixels: derivatives in millimetres are divided by the pixel pitch in millimetres."""

    reference: LensReference
    dc_dp_px_per_hpa: float = Field(ge=-10, le=10)
    dc_dt_px_per_k: float = Field(ge=-10, le=10)

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

    attitude: str | None = None
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    lever_arm_m: LeverArm = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    sigma_tilt_deg: float | None = Field(None, ge=0, le=45)
    sigma_yaw_deg: float | None = Field(None, ge=0, le=180)

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

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    k3: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0


class MetricDistortion(Section):
    """Coefficients of a calibration report, in powers of mm, about the point of symmetry."""

    sense: Sense
    k0: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    b1: float = Field(0.0, ge=-0.05, le=0.05)
    b2: float = Field(0.0, ge=-0.05, le=0.05)


class MetricTable(Section):
    """Tabulated radial distortion of a calibration report."""

    sense: Sense
    by: Literal["radius_mm", "field_angle_deg"]
    rows: list[Pair] = Field(min_length=3)

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

    focal_mm: float = Field(ge=1, le=5000)
    pixel_um: Pair
    format_mm: Pair
    origin: Literal["image_centre"] | Pair
    axes: Literal["right up", "right down", "left up", "left down", "up right", "up left",
                  "down right", "down left"]  # fmt: skip
    ppa_mm: Pair
    ppbs_mm: Pair | None = None
    radius_mm: float | None = Field(None, gt=0)
    distortion: MetricDistortion | None = None
    table: MetricTable | None = None

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

    file: PathText | None = None
    format: Literal[tuple(BLOCKS)] | None = None  # type: ignore[valid-type]
    camera: str | int | None = None
    model: Literal[tuple(MODELS)] | None = None  # type: ignore[valid-type]
    params: list[float] | None = None
    metric: MetricSection | None = None
    width_px: int | None = Field(None, gt=0, le=1_000_000, validate_default=True)
    height_px: int | None = Field(None, gt=0, le=1_000_000, validate_default=True)
    f_px: PrincipalDistance | None = None
    fx_px: PrincipalDistance | None = None
    fy_px: PrincipalDistance | None = None
    cx_px: float | None = Field(None, ge=-1e6, le=1e6, validate_default=True)
    cy_px: float | None = Field(None, ge=-1e6, le=1e6, validate_default=True)
    pixel_origin: PixelOrigin | None = None
    distortion: DistortionSection | None = None
    calibration: Literal["laboratory", "in_flight_uncorrected", "in_flight_corrected"]
    window: WindowSection | None = None
    principal_distance: LensSection | None = None

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
