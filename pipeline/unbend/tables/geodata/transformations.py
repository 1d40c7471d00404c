"""The best transformation between two coordinate systems, by PROJ with its installed grids."""

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

from unbend.tables.geodata import messages
from unbend.units import Array

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

_GOOD_M = 1.0  # a transformation with a worse accuracy is a warning


@dataclass(frozen=True, eq=False)
class BestOperation:
    """The best transformation between two systems that PROJ can do with its installed grids.

    ``description`` : in words, with its accuracy, and the grid that a better one needs.
    ``is_good`` : its known accuracy is 1 m or better.
    """

    transformer: "Transformer"
    description: str
    is_good: bool


def best_operation(
    source: "CRS | str", lon_lat: Array, target: "CRS | str"
) -> BestOperation | None:
    """The best transformation from ``source`` to ``target`` in the extent of (2, n) places [deg].

    ``lon_lat`` : longitudes and latitudes. The transformation gives no values beyond its grid: no
    other replaces it there. None if PROJ has only a ballpark transformation.
    """
    from pyproj.aoi import AreaOfInterest
    from pyproj.network import set_network_enabled
    from pyproj.transformer import TransformerGroup

    set_network_enabled(False)  # whatever PROJ_NETWORK and proj.ini say
    corners = (*lon_lat.min(axis=1).tolist(), *lon_lat.max(axis=1).tolist())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a missing grid: it is in the description
        group = TransformerGroup(
            source,
            target,
            always_xy=True,
            allow_ballpark=False,
            area_of_interest=AreaOfInterest(*corners),
        )
    if not group.transformers:
        return None
    best = group.transformers[0]
    has_accuracy = best.accuracy >= 0.0  # PROJ has -1 for an unknown accuracy
    description = f"{best.description or 'an unnamed operation'}"
    description += f", to {best.accuracy:g} m" if has_accuracy else ", of unknown accuracy"
    if not group.best_available and group.unavailable_operations:
        better = group.unavailable_operations[0]
        grids = ", ".join(grid.short_name for grid in better.grids)
        description += f"; {better.name} to {better.accuracy:g} m needs {grids} in PROJ's folder"
    return BestOperation(best, description, is_good=0.0 <= best.accuracy <= _GOOD_M)


def to_wgs84(
    horizontal: "CRS", lon_lat: Array, where: str, key: str, *, target: str = "EPSG:4326"
) -> BestOperation:
    """The best transformation to WGS 84 in the extent of (2, n) longitudes and latitudes [deg].

    ``target`` is WGS 84 with or without heights. Refuses (CRS-BALLPARK) a system that has none.
    """
    best = best_operation(horizontal, lon_lat, target)
    if best is None:
        raise messages.crs_ballpark(where=where, name=horizontal.name, named=key)
    return best
