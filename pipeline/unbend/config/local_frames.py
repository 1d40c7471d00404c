"""The sections of a mission file on the origin of local coordinates."""

from pydantic import (
    Field,
)

from unbend.config.section import (
    Section,
)
from unbend.flight.heights import GeodeticOrigin
from unbend.units import DEGREE


class LocalOrigin(Section):
    """Place of the origin of local (east, north, up) positions."""

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
        """The origin, in radians."""
        return GeodeticOrigin(self.lat_deg * DEGREE, self.lon_deg * DEGREE, self.h_ellipsoid_m)


class EnuFrame(Section):
    """One topocentric frame for all stations."""

    enu: LocalOrigin = Field(
        description="the place that defines east, north, up for all stations",
    )
