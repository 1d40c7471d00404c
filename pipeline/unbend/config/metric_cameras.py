"""The sections of a mission file on the calibration report of a metric camera."""

from typing import Annotated, Literal

import numpy as np
from pydantic import (
    Field,
    ValidationInfo,
    field_validator,
)

from unbend.config.section import (
    Section,
    SectionError,
)
from unbend.refraction import Camera
from unbend.refraction.calibration import (
    DIRECTIONS,
    MetricReport,
    camera_of_report,
)
from unbend.tables.pixels import ImageFrame, PixelSystem
from unbend.units import Array

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Lengths = Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=2, max_length=2)]
Sense = Literal["correction", "distortion"]
Axes = Literal[
    "right up",
    "right down",
    "left up",
    "left down",
    "up right",
    "up left",
    "down right",
    "down left",
]

LARGEST_COEFFICIENT = 10.0
"""In powers of mm: a sensor of 2 mm needs 1 for a third of distortion; metric cameras 1e-8."""

MetricCoefficient = Annotated[float, Field(ge=-LARGEST_COEFFICIENT, le=LARGEST_COEFFICIENT)]

MILLIMETRES_PER_MICROMETRE = 1e-3
LARGEST_FIELD_ANGLE_DEG = 80.0  # of a frame camera; beyond it tan grows out of any format


class MetricDistortion(Section):
    """Coefficients of a calibration report, in powers of mm, about the point of symmetry."""

    sense: Sense = Field(
        description=(
            "correction: the coefficients describe the correction that is added to measured "
            "coordinates (reports of the USGS); distortion: they describe the displacement of "
            "ideal coordinates by the lens"
        ),
        examples=["correction"],
    )
    k0: MetricCoefficient = Field(
        0.0,
        description="radial coefficient of r: dr = r (k0 + k1 r^2 + ...)",
        examples=[2.616e-05],
        json_schema_extra={"unit": "1"},
    )
    k1: MetricCoefficient = Field(
        0.0,
        description="radial coefficient of r^3",
        examples=[-2.295e-09],
        json_schema_extra={"unit": "mm^-2"},
    )
    k2: MetricCoefficient = Field(
        0.0,
        description="radial coefficient of r^5",
        examples=[1.454e-14],
        json_schema_extra={"unit": "mm^-4"},
    )
    k3: MetricCoefficient = Field(
        0.0,
        description="radial coefficient of r^7",
        examples=[0.0],
        json_schema_extra={"unit": "mm^-6"},
    )
    k4: MetricCoefficient = Field(
        0.0,
        description="radial coefficient of r^9",
        examples=[0.0],
        json_schema_extra={"unit": "mm^-8"},
    )
    p1: MetricCoefficient = Field(
        0.0,
        description="decentring: dx = p1 (r^2 + 2 x^2) + 2 p2 x y (not OpenCV's order)",
        examples=[0.0],
        json_schema_extra={"unit": "mm^-1"},
    )
    p2: MetricCoefficient = Field(
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
            "distortion: the rows are the displacement by the lens, positive away from the point "
            "of symmetry; correction: the correction that is added to measured coordinates"
        ),
        examples=["distortion"],
    )
    by: Literal["radius_mm", "field_angle_deg"] = Field(
        description="the meaning of the first number of each row",
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
        radii = [row[0] for row in rows]  # or field angles
        largest = LARGEST_FIELD_ANGLE_DEG if info.data.get("by") == "field_angle_deg" else np.inf
        does_grow = np.all(np.diff(radii) > 0.0)
        if radii[0] < 0.0 or not does_grow or radii[-1] > largest:
            raise SectionError("radii, or angles of up to 80 degrees, grow from row to row")
        return rows

    def in_mm(self, focal_mm: float) -> tuple[Array, Sense]:
        """The rows as radius and distortion, (n, 2) [mm], and the sense of the distortion."""
        rows = np.array(self.rows)
        rows[:, 1] *= MILLIMETRES_PER_MICROMETRE
        if self.by == "field_angle_deg":
            rows[:, 0] = focal_mm * np.tan(np.radians(rows[:, 0]))
        return rows, self.sense


class MetricSection(Section):
    """The calibration report of a metric frame camera, in millimetres."""

    focal_mm: float = Field(
        ge=1,
        le=5000,
        description="calibrated principal distance",
        examples=[153.743],
        json_schema_extra={"unit": "mm"},
    )
    pixel_um: Lengths = Field(
        description="size of a pixel, [across, down]",
        examples=[[20.0, 20.0]],
        json_schema_extra={"unit": "um"},
    )
    format_mm: Lengths = Field(
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
    axes: Axes = Field(
        description="directions of the report's x and y axes in the image",
        examples=["right up"],
    )
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
        description=(
            "largest calibrated radius; the last row of the table limits it too. Without both "
            "there is no limit"
        ),
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
            "tabulated radial distortion of the report. Without radial coefficients it becomes a "
            "polynomial; with them it checks them"
        ),
    )

    def origin_px(self, size_px: tuple[int, int], pixels: PixelSystem) -> Array:
        """(2,) the origin of the report's coordinates in COLMAP's pixels."""
        if isinstance(self.origin, str):
            return np.array(size_px) / 2.0
        return np.asarray(pixels.to_colmap(np.array(self.origin)))

    def image_frame(
        self, size_px: tuple[int, int], pixels: PixelSystem, unit_mm: float
    ) -> ImageFrame:
        """The frame of image coordinates in a unit of ``unit_mm`` millimetres.

        It has the origin and the axes of the report.
        """
        pixel_mm = np.array(self.pixel_um) * MILLIMETRES_PER_MICROMETRE
        x_axis, y_axis = (
            np.array(DIRECTIONS[direction]) * unit_mm / pixel_mm for direction in self.axes.split()
        )
        return ImageFrame(
            origin_px=tuple(self.origin_px(size_px, pixels).tolist()),
            px_of_x=tuple(x_axis.tolist()),
            px_of_y=tuple(y_axis.tolist()),
        )

    def build(self, size_px: tuple[int, int], pixels: PixelSystem) -> Camera:
        """The camera of the report, for an image size in pixels; refuses as `camera_of_report`."""
        coefficients: dict[str, float] = {}
        sense: Sense = "distortion"  # of coefficients, if there are none
        if self.distortion is not None:
            coefficients = self.distortion.model_dump(exclude={"sense"})
            sense = self.distortion.sense
        origin_px = self.origin_px(size_px, pixels)
        report = MetricReport(
            self.focal_mm,
            pixel_mm=np.array(self.pixel_um) * MILLIMETRES_PER_MICROMETRE,
            format_mm=self.format_mm,
            axes=self.axes,
            origin_px=origin_px,
            ppa_mm=self.ppa_mm,
            ppbs_mm=self.ppbs_mm or self.ppa_mm,
            sense=sense,
            coefficients=coefficients,
            table=None if self.table is None else self.table.in_mm(self.focal_mm),
            radius_mm=self.radius_mm or np.inf,
        )
        return camera_of_report(report, size_px)
