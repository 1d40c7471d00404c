"""The UTM zone of a coordinate system, by PROJ."""

import re


def utm_zone_of(crs: str) -> tuple[int, str] | None:
    """The number of the UTM zone of a system, and its hemisphere (N or S); None for another one.

    Also for a system whose x begins with the zone, as EPSG:4647.

    >>> utm_zone_of("EPSG:25833"), utm_zone_of("EPSG:32756")
    ((33, 'N'), (56, 'S'))
    >>> utm_zone_of("EPSG:2056"), utm_zone_of("EPSG:4647")
    (None, None)
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        zone = CRS.from_user_input(crs).utm_zone  # "32N", or "32N WITH PREFIX"
    except CRSError:
        return None
    zone_and_hemisphere = re.fullmatch(r"(\d{1,2})([NS])", zone or "")
    if zone_and_hemisphere is None:
        return None
    number, hemisphere = zone_and_hemisphere.groups()
    return int(number), hemisphere
