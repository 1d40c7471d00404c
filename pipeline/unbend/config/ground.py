"""The sections of a mission file on the heights of the observed points, and on control points."""

from typing import Annotated, Literal, Self

from pydantic import (
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from unbend.config.section import (
    PathText,
    Section,
    SectionError,
)
from unbend.config.table_columns import NamedColumns
from unbend.flight.heights import HIGHEST_GROUND_M, LOWEST_GROUND_M


class GroundColumn(Section):
    """Ground heights in a column of the observations."""

    column: str = Field(
        description="column of the observations with the height of each point [m]",
        examples=["h_g_m"],
    )


class PointColumns(NamedColumns):
    """Columns of a table of object points: latitude and longitude [deg], or x and y of its crs."""

    point: str = Field(
        "point",
        description="column of the names of the points",
        examples=["point"],
    )
    latitude: str | None = Field(
        None,
        description="column of latitudes [deg]",
        examples=["lat_deg"],
    )
    longitude: str | None = Field(
        None,
        description="column of longitudes [deg]",
        examples=["lon_deg"],
    )
    x: str | None = Field(
        None,
        description="column of x [m], to the east",
        examples=["east"],
    )
    y: str | None = Field(
        None,
        description="column of y [m], to the north",
        examples=["north"],
    )
    height: str = Field(
        "height",
        description="column of heights [m]",
        examples=["height"],
    )

    @model_validator(mode="after")
    def _check_places(self) -> Self:
        given = self.named.keys() - {"point", "height"}
        if given not in ({"latitude", "longitude"}, {"x", "y"}):
            raise SectionError("give either latitude and longitude, or x and y")
        return self


class PointTable(Section):
    """Ground heights by the names of points, in a separate table."""

    points: PathText = Field(
        description="the table: CSV or Parquet, one row a point",
        examples=["points.csv"],
    )
    columns: PointColumns = Field(
        description="names of the table's columns",
    )
    crs: str = Field(
        description=(
            "coordinate system of the places, as EPSG:4326 or EPSG:25832; with a vertical part, as "
            "EPSG:25832+5773, of the heights too"
        ),
        examples=["EPSG:25832"],
    )


class ControlSection(Section):
    """Control points that are measured in the images, to compare them before and after.

    Columns, crs and reference go together; without them the table has point, lat_deg, lon_deg
    (WGS 84) and h_ellipsoid_m."""

    path: PathText = Field(
        description="the table: CSV or Parquet, one row a point, named as in the observations",
        examples=["control.csv"],
    )
    columns: PointColumns = Field(
        PointColumns(latitude="lat_deg", longitude="lon_deg", height="h_ellipsoid_m"),
        description=(
            "names of the table's columns; by default point, lat_deg, lon_deg and h_ellipsoid_m; "
            "columns, crs and reference are stated together"
        ),
    )
    crs: str = Field(
        "EPSG:4326",
        description="coordinate system of the places; with a vertical part of the heights too",
        examples=["EPSG:4326"],
    )
    reference: Literal["msl", "ellipsoid", "relative"] = Field(
        "ellipsoid",
        description="reference of the heights, as under ground",
        examples=["ellipsoid"],
    )

    @model_validator(mode="after")
    def _check_stated(self) -> Self:
        together = {"columns", "crs", "reference"}
        stated_keys = together & self.model_fields_set
        if stated_keys and stated_keys != together:
            raise SectionError("give columns, crs and reference together")
        return self


class GroundModel(Section):
    """A digital elevation model that the rays are followed to."""

    dem: PathText | list[PathText] = Field(
        description=(
            "raster of heights, or its tiles, in a format that GDAL reads, for example GeoTIFF; "
            "one path or several"
        ),
        examples=["dem.tif"],
    )
    crs: str | None = Field(
        None,
        description="coordinate system of the raster, if the file has none",
        examples=["EPSG:25832"],
    )

    @property
    def paths(self) -> tuple[str, ...]:
        """The raster, or its tiles."""
        return (self.dem,) if isinstance(self.dem, str) else tuple(self.dem)


def _kind_of_height(value: object) -> str:
    """The tag of the kind of `GroundHeight` that a value of a mission file is meant to be.

    pydantic then checks the value as this kind alone, and reports only its errors.
    """
    match value:
        case str():
            return "name"
        case Section():
            return type(value).__name__
        case {"points": _}:
            return "PointTable"
        case {"dem": _}:
            return "GroundModel"
        case dict():
            return "GroundColumn"
    return "number"


_HEIGHTS_FROM_CAMERAS = ("from_distance", "intersected", "block")
"""Words for heights that follow from those of the cameras, which are above mean sea level."""

GroundHeight = Annotated[
    Annotated[float, Tag("number")]
    | Annotated[GroundColumn, Tag("GroundColumn")]
    | Annotated[PointTable, Tag("PointTable")]
    | Annotated[GroundModel, Tag("GroundModel")]
    | Annotated[Literal["from_distance", "intersected", "block"], Tag("name")],
    Discriminator(_kind_of_height),
]


class GroundSection(Section):
    """Heights of the observed points. There is no default."""

    height: GroundHeight = Field(
        description=(
            "heights of the points: metres, or {column: NAME}; {points: PATH, columns, crs}: a "
            "table of object points; {dem: PATH}: where the rays meet an elevation model; "
            "from_distance: at the end of the slant range; intersected: where the rays of the "
            "point intersect, with fixed stations; block: heights of the points of "
            "stations.orientation, and their median in the image for other points"
        ),
        examples=[412.5],
        json_schema_extra={"unit": "m"},
    )
    reference: Literal["msl", "ellipsoid", "relative"] = Field(
        description=(
            "reference of the heights: msl, mean sea level; ellipsoid; relative, the take-off point"
        ),
        examples=["msl"],
    )
    home_h_msl_m: float | None = Field(
        None,
        ge=LOWEST_GROUND_M,
        le=HIGHEST_GROUND_M,
        description=(
            "height of the take-off point, if the log does not contain it or has a wrong one"
        ),
        examples=[405.0],
        json_schema_extra={"unit": "m"},
    )
    sigma_m: float | None = Field(
        None,
        ge=0,
        le=10_000,
        description="standard deviation of the heights of all points",
        examples=[2.0],
        json_schema_extra={"unit": "m"},
    )
    sigma_column: str | None = Field(
        None,
        description="column of the observations with the standard deviation of each height [m]",
        examples=["sigma_h_m"],
    )

    @property
    def constant_m(self) -> float | None:
        """The height of all points [m], if it is a number; None for other kinds of height."""
        return self.height if isinstance(self.height, float) else None

    @property
    def column(self) -> str | None:
        """The column of the observations with the height of each point; None for other kinds."""
        return self.height.column if isinstance(self.height, GroundColumn) else None

    @property
    def points(self) -> PointTable | None:
        """The table of object points; None for other kinds of height."""
        return self.height if isinstance(self.height, PointTable) else None

    @property
    def model(self) -> GroundModel | None:
        """The elevation model; None for other kinds of height."""
        return self.height if isinstance(self.height, GroundModel) else None

    @property
    def reference_of_values(self) -> Literal["msl", "ellipsoid", "relative"]:
        """The reference of the ground heights once they are in the table of observations.

        Those of a table of points and of an elevation model are then above mean sea level.
        """
        is_reduced = self.points is not None or self.model is not None
        return "msl" if is_reduced else self.reference

    @property
    def is_given(self) -> bool:
        """Whether heights are given; False if they follow from those of the cameras."""
        return self.height not in _HEIGHTS_FROM_CAMERAS

    @property
    def from_distance(self) -> bool:
        """Whether the heights are those where the slant ranges end."""
        return self.height == "from_distance"

    @model_validator(mode="before")
    @classmethod
    def _default_reference(cls, values: object) -> object:
        """Fill in ``reference: msl`` for heights that follow from those of the cameras."""
        if not isinstance(values, dict):
            return values
        if values.get("height") in _HEIGHTS_FROM_CAMERAS:
            return {"reference": "msl"} | values
        return values

    @field_validator("height")
    @classmethod
    def _check_height_range(cls, value: GroundHeight) -> GroundHeight:
        if isinstance(value, float) and not LOWEST_GROUND_M <= value <= HIGHEST_GROUND_M:
            raise SectionError("is not a ground height in metres (-600 to 10000)")
        return value

    @model_validator(mode="after")
    def _check_combinations(self) -> Self:
        if self.sigma_m is not None and self.sigma_column is not None:
            raise SectionError("give either sigma_m or sigma_column")
        states_home = self.home_h_msl_m is not None
        follows_from_cameras = isinstance(self.height, str)  # a word of `_HEIGHTS_FROM_CAMERAS`
        if follows_from_cameras and (self.reference != "msl" or states_home):
            raise SectionError(
                f"height: {self.height} gives heights above mean sea level; leave reference and "
                "home_h_msl_m out"
            )
        if self.model is not None and (self.reference == "relative" or states_home):
            raise SectionError(
                "the heights of a dem are above mean sea level (reference: msl) or the ellipsoid; "
                "leave home_h_msl_m out"
            )
        states_sigma = self.sigma_m is not None or self.sigma_column is not None
        if self.height == "intersected" and states_sigma:
            raise SectionError(
                "height: intersected computes its own sigmas; leave sigma_m and sigma_column out"
            )
        return self
