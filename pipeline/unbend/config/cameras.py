"""The section of a mission file on a camera: interior orientation, window and lens."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from unbend.config import messages
from unbend.config.lens_in_air import LensSection
from unbend.config.metric_cameras import MetricSection
from unbend.config.section import (
    PathText,
    Section,
    SectionError,
)
from unbend.config.windows import OpeningSection, WindowSection
from unbend.errors import PhysicsError
from unbend.refraction import BrownConrady, Camera, Window
from unbend.refraction.calibration import (
    LARGEST_PARAMETER,
    LONGEST_DISTANCE_PX,
    MODELS,
    SHORTEST_DISTANCE_PX,
    camera_of_model,
    model_of_camera,
    refuse_impossible,
)
from unbend.refraction.lens_air import AnyLens
from unbend.tables.imports.blocks import BLOCKS, read_camera
from unbend.tables.pixels import ImageFrame, PixelOrigin, PixelSystem

PrincipalDistance = Annotated[float, Field(ge=SHORTEST_DISTANCE_PX, le=LONGEST_DISTANCE_PX)]
Wavelength = Annotated[float, Field(ge=0.3e-6, le=1.7e-6)]
Coefficient = Annotated[float, Field(ge=-LARGEST_PARAMETER, le=LARGEST_PARAMETER)]


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


KEYS_INSTEAD_OF_NUMBERS = ("file", "model", "params", "metric")
"""Keys that give the interior orientation instead of f_px, cx_px and so on."""


class CameraSection(Section):
    """Interior orientation of one camera, in one of four ways."""

    file: PathText | None = Field(
        None,
        description=(
            "calibration file of COLMAP, OpenSfM or ODM, Metashape, Pix4D, BlocksExchange or DBAT; "
            "then this section has no other interior orientation. By default the block of the "
            "observations, if they are a block"
        ),
        examples=["cameras.txt"],
    )
    format: Literal[tuple(BLOCKS)] | None = Field(  # type: ignore[valid-type]
        None,
        description="program that wrote file, if its ending does not show it",
        examples=["colmap"],
    )
    camera: str | int | None = Field(
        None,
        description=(
            "name or number of the camera in file or in the block, if it has several cameras"
        ),
        examples=["1"],
    )
    model: Literal[tuple(MODELS)] | None = Field(  # type: ignore[valid-type]
        None,
        description=(
            "name of the camera model, as COLMAP has it; BROWN and GENERAL_FRAME are not COLMAP's"
        ),
        examples=["OPENCV"],
    )
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
        description="principal distance, if it is the same along x and y",
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
            "what the principal point (with metric: the origin) counts from, the corner or the "
            "centre of the first pixel; by default the same as the observations, but the corner "
            "with params"
        ),
        examples=["corner"],
    )
    distortion: DistortionSection | None = Field(
        None,
        description=("coefficients of the lens as OpenCV defines them; by default no distortion"),
    )
    calibration: Literal["laboratory", "in_flight_uncorrected", "in_flight_corrected"] = Field(
        description=(
            "how the camera was calibrated. A calibration estimated in flight on uncorrected "
            "images already contains the nadir refraction of that height"
        ),
        examples=["laboratory"],
    )
    wavelength_m: Wavelength | None = Field(
        None,
        description=(
            "wavelength in vacuum of the light that this camera records; by default "
            "atmosphere.wavelength_m. A multispectral rig has one camera for each band"
        ),
        examples=[8.5e-07],
        json_schema_extra={"unit": "m"},
    )
    window: WindowSection | None = Field(
        None,
        description=(
            "the window that the camera looks through; leave it out if there is no window, or "
            "state null if the log has a barometer in a closed compartment"
        ),
    )
    opening: OpeningSection | None = Field(
        None,
        description=(
            "an open hatch, or a lens in the skin: the difference of the air in front of the lens "
            "from the air outside; leave it out if there is no difference"
        ),
    )
    principal_distance: LensSection | None = Field(
        None,
        description=(
            "the air in the lens during the calibration; the principal distance in flight is "
            "computed from it. Without it, that change is not removed"
        ),
    )

    @field_validator("width_px", "height_px")
    @classmethod
    def _require_size(cls, value: int | None, info: ValidationInfo) -> int | None:
        if value is None and info.data.get("file") is None:
            raise SectionError("is missing, and there is no file")
        return value

    @field_validator("cx_px", "cy_px")
    @classmethod
    def _require_principal_point(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is None and all(info.data.get(name) is None for name in KEYS_INSTEAD_OF_NUMBERS):
            raise SectionError(
                f"is missing, and there is no {' or '.join(KEYS_INSTEAD_OF_NUMBERS)}"
            )
        return value

    @property
    def _states_numbers(self) -> bool:
        """Whether the section has a number of the interior orientation, as f_px or cx_px."""
        numbers = (self.f_px, self.fx_px, self.fy_px, self.cx_px, self.cy_px, self.distortion)
        return any(number is not None for number in numbers)

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        """The interior orientation is given in one way only, and completely.

        ``format`` is only for a file, ``pixel_origin`` only for a camera without a file.
        """
        if (self.model is None) != (self.params is None):
            raise SectionError("give model and params together, as they are in cameras.txt")
        ways = []
        if self.file is not None:
            ways.append("file")
        if self.model is not None:
            ways.append("model, params")
        if self.metric is not None:
            ways.append("metric")
        if self._states_numbers:
            ways.append("f_px, cx_px, distortion")
        if len(ways) > 1:
            stated_ways = ", ".join(ways)
            raise SectionError(
                f"{stated_ways}: each of them gives the interior orientation; keep only one"
            )
        if self.file is None and self.format is not None:
            raise SectionError("format needs file")
        if self.file is not None and self.pixel_origin is not None:
            raise SectionError("pixel_origin cannot be combined with file")
        if self.file is None and self._states_numbers:
            self._check_principal_distances()
        return self

    def _check_principal_distances(self) -> None:
        """Either f_px is given, or both fx_px and fy_px."""
        has_f = self.f_px is not None
        has_fx = self.fx_px is not None
        has_fy = self.fy_px is not None
        if has_fx != has_fy or has_f == has_fx:
            raise SectionError("give f_px, or both fx_px and fy_px")

    @model_validator(mode="after")
    def _check_camera(self) -> Self:
        """The numbers are possible for a camera; those of a file are checked when it is read."""
        if self.file is not None:
            return self
        try:
            camera = self.interior_orientation
            shorter, longer = sorted((camera.fx_px, camera.fy_px))
            if shorter < SHORTEST_DISTANCE_PX or longer > LONGEST_DISTANCE_PX:
                raise SectionError("the principal distance must be 10 to 1000000 pixels")
            refuse_impossible(camera)
        except PhysicsError as error:
            raise SectionError(f"{error.code}: {error.what}; {error.remedy}") from None
        return self

    @model_validator(mode="after")
    def _check_lens_air(self) -> Self:
        if self.opening is not None and self.window is not None:
            raise SectionError(
                "window and opening: the camera looks through only one of them; remove the other"
            )
        if self.principal_distance is None or self.window is None:
            return self
        if self.window.cabin is None:
            raise SectionError(
                "principal_distance needs the air in the lens; behind a window this is the air of "
                "the cabin: give window.cabin"
            )
        return self

    @property
    def pane(self) -> Window | None:
        """The window or the opening that the camera looks through; None without one."""
        if self.opening is not None:
            return self.opening.opening
        return None if self.window is None else self.window.window

    @property
    def needs_cabin(self) -> bool:
        """Whether the correction depends on the cabin's air.

        Behind a plane window it does; behind a spherical one only the principal distance does.
        """
        if self.window is None or self.window.cabin is None:
            return False
        return self.window.shape == "plane" or self.principal_distance is not None

    @property
    def needs_cabin_from_log(self) -> bool:
        """Whether the correction depends on the cabin's air (`needs_cabin`) from the log."""
        if self.window is None:
            return False
        cabin = self.window.window.cabin
        if cabin is None:
            return False
        is_from_log = cabin.source == "log" or cabin.temperature_logged
        return is_from_log and self.needs_cabin

    @cached_property
    def lens(self) -> AnyLens | None:
        """How the principal distance changes with the air; None if that is not stated."""
        if self.principal_distance is None:
            return None
        camera = self.interior_orientation
        # The smaller of two: a change in pixels is the larger share of it.
        return self.principal_distance.build(min(camera.fx_px, camera.fy_px))

    @cached_property
    def interior_orientation(self) -> Camera:
        """The camera in COLMAP's pixels; ValueError before its file is read.

        A principal point without a ``pixel_origin`` of its own counts from the corner.
        """
        return self._camera("corner")

    def interior_orientation_by(self, pixel_origin: PixelOrigin) -> Camera:
        """As `interior_orientation`, but a principal point counts from this origin by default."""
        if self.pixel_origin is not None or pixel_origin == "corner":
            return self.interior_orientation
        return self._camera(pixel_origin)

    def image_frame(self, pixel_origin: PixelOrigin, unit_mm: float) -> ImageFrame | None:
        """The frame of image coordinates in a unit of ``unit_mm`` millimetres.

        None for a camera without a metric report.
        """
        if self.metric is None:
            return None
        size_px = (self.width_px or 0, self.height_px or 0)
        return self.metric.image_frame(
            size_px, PixelSystem(self.pixel_origin or pixel_origin), unit_mm
        )

    def _camera(self, pixel_origin: PixelOrigin) -> Camera:
        """The camera in COLMAP's pixels; ``pixel_origin`` counts if the section has none."""
        width = self.width_px or 0
        height = self.height_px or 0
        pixels = PixelSystem(self.pixel_origin or pixel_origin)
        if self.metric is not None:
            return self.metric.build((width, height), pixels)
        if self.model is not None and self.params is not None:
            camera = camera_of_model(self.model, width, height, self.params)
            pixels_of_params = PixelSystem(self.pixel_origin or "corner")
            return replace(
                camera,
                cx_px=pixels_of_params.to_colmap(camera.cx_px),
                cy_px=pixels_of_params.to_colmap(camera.cy_px),
            )
        if self.cx_px is None or self.cy_px is None:
            raise ValueError(f"{self.file} has not been read")
        distortion = self.distortion or DistortionSection()
        return Camera(
            width,
            height,
            fx_px=self.f_px or self.fx_px or 0.0,
            fy_px=self.f_px or self.fy_px or 0.0,
            cx_px=pixels.to_colmap(self.cx_px),
            cy_px=pixels.to_colmap(self.cy_px),
            distortion=BrownConrady(**distortion.model_dump()),
        )

    def with_file(self, path: Path) -> Self:
        """The section with ``model`` and ``params`` of its file, which is at ``path``.

        Refuses as `read_camera`; and images of another size (CAMERA-SIZE), and an impossible
        camera (CAMERA-FILE).
        """
        name = None if self.camera is None else str(self.camera)
        camera = read_camera(path, self.format, name)
        width = self.width_px or camera.width_px
        height = self.height_px or camera.height_px
        if (width, height) != (camera.width_px, camera.height_px):
            raise messages.camera_size(
                path=path,
                width=camera.width_px,
                height=camera.height_px,
                stated_width=width,
                stated_height=height,
            )
        model, params = model_of_camera(camera)
        values_of_file = {"model": model, "params": params, "width_px": width, "height_px": height}
        other_keys = self.model_dump(exclude={"file", "format", "camera"}, exclude_unset=True)
        try:
            return type(self).model_validate(other_keys | values_of_file)
        except ValidationError as error:
            raise messages.camera_file(path=path, problem=_problem_of_file(error)) from None


def _problem_of_file(error: ValidationError) -> str:
    """The first error of pydantic about the camera of a file, in words."""
    first = error.errors()[0]
    if first["type"] == "value_error":
        return str(first["ctx"]["error"])
    return f"its {first['loc'][0]} is impossible for a camera"
