"""The sections of a mission file on the table of image measurements."""

from typing import Literal, Self

from pydantic import (
    Field,
    field_validator,
    model_validator,
)

from unbend.config.section import (
    PathText,
    Section,
    SectionError,
    is_block,
)
from unbend.flight.image_names import Difference
from unbend.tables.imports.blocks import BLOCKS
from unbend.tables.pixels import PixelOrigin, PixelSystem

MILLIMETRES_OF_UNIT = {"mm": 1.0, "um": 1e-3}


class ObservationColumnNames(Section):
    """Names of the columns of the table."""

    image: str = Field(
        "image",
        description="column of the names of the images",
        examples=["image"],
    )
    point: str = Field(
        "point",
        description="column of the names of the points",
        examples=["point"],
    )
    x_px: str = Field(
        "x_px",
        description="column of the measured x, in pixels to the right, or as stated by unit",
        examples=["x_px"],
    )
    y_px: str = Field(
        "y_px",
        description="column of the measured y, in pixels down, or as stated by unit",
        examples=["y_px"],
    )
    distance_m: str | None = Field(
        None,
        description=(
            "column of slant ranges to the points [m], if they are known. If a ray crosses the "
            "height of the point twice, they decide between the near and the far crossing"
        ),
        examples=["distance_m"],
    )


class ObservationsSection(Section):
    """The table of image measurements."""

    path: PathText = Field(
        description=(
            "the table, a file or a URL of object storage: CSV or Parquet, or a block in the "
            "format that format names"
        ),
        examples=["observations.csv"],
    )
    format: Literal["csv", "parquet", *BLOCKS] | None = Field(  # type: ignore[valid-type]
        None,
        description=(
            "csv or parquet, if the ending does not show it; or the block of another program, "
            "with its cameras and orientations: colmap, a model's folder or a database; opensfm, a "
            "project's folder; metashape, a .psz, .psx or .xml; pix4d, a folder params; "
            "blocksexchange, an .xml; dbat, a script"
        ),
        examples=["csv"],
    )
    columns: ObservationColumnNames = Field(
        ObservationColumnNames(),
        description="names of the table's columns, if they differ from the default",
    )
    pixel_origin: PixelOrigin = Field(
        "corner",
        description=(
            "pixel origin of the table. corner: the centre of the upper left pixel is "
            "(0.5, 0.5), as in COLMAP; centre: it is (0, 0), as in OpenCV"
        ),
        examples=["corner"],
    )
    unit: Literal["px", "mm", "um"] = Field(
        "px",
        description=(
            "unit of x and y. mm, um: coordinates in the frame of the image, as BINGO and PATB "
            "have them, from the origin and along the axes that cameras.<name>.metric states; the "
            "results have pixels, and these columns pass through"
        ),
        examples=["px"],
    )
    match_names: list[Difference] = Field(
        [],
        description=(
            "allowed differences between the names of images and exposures: case, extension, "
            "folder, digits (DSC1 for DSC_0001)"
        ),
        examples=[["case", "digits"]],
    )
    refraction: Literal["none", "removed_by_other"] = Field(
        "none",
        description=(
            "earlier processing of the observations: none, as measured; removed_by_other: another "
            "program has removed refraction, and they are refused"
        ),
        examples=["none"],
    )

    @field_validator("refraction")
    @classmethod
    def _check_not_twice(cls, value: str) -> str:
        if value != "none":
            raise SectionError(
                "another program has removed refraction from these observations, and removing it "
                "again would count it twice: give them as measured, or adjust them as they are"
            )
        return value

    @model_validator(mode="after")
    def _check_block(self) -> Self:
        if not is_block(self.format):
            return self
        if self.columns != ObservationColumnNames():
            raise SectionError(f"format: {self.format} names its columns itself; leave columns out")
        if self.pixel_origin != "corner":
            raise SectionError(
                f"format: {self.format} states the pixel origin itself, and the results are "
                "written with pixel_origin: corner; leave it out"
            )
        if self.unit != "px":
            raise SectionError(f"format: {self.format} has pixels; leave unit out")
        return self

    @property
    def unit_mm(self) -> float | None:
        """The unit of coordinates in the frame of the image [mm]; None where they are pixels."""
        return MILLIMETRES_OF_UNIT.get(self.unit)

    @property
    def pixels(self) -> PixelSystem:
        """The pixel system of the table, and of cameras that name none."""
        return PixelSystem(self.pixel_origin)
