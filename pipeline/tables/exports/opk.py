"""Exterior orientation as omega, phi, kappa: against each station's own horizon, or in one frame.

M = Rx(omega) Ry(phi) Rz(kappa) turns from the camera of photogrammetry (x right, y up, z backward)
to the frame; see `pipeline.flight.rotations`. The vertical turns 324 arcsec in 10 km: angles of the
two formats differ by that.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.flight.rotations import in_turned_frame, opk_of_quaternion
from pipeline.flight.stations import station_columns
from pipeline.geodesy import ecef_of_geodetic, enu_from_ecef
from pipeline.ledger import Ledger
from pipeline.tables.exports.footprints import placed_stations
from pipeline.tables.exports.format import ExportFormat, FinishedRun, Values, write_csv_stream
from pipeline.tables.schemas import schema_of
from pipeline.tables.writing import table_of

_PLACES = ("lat_deg", "lon_deg", "h_ellipsoid_m")
_ANGLES = ("omega_deg", "phi_deg", "kappa_deg")
_AXES = ("x_m", "y_m", "z_m")
_WORDS = ("image", "camera", "status", "time_utc")
_SIGMAS = ("sigma_horizontal_m", "sigma_height_m", "sigma_tilt_deg", "sigma_yaw_deg")


def _write(topocentric: bool, run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """A row for each usable station with a height above the ellipsoid."""
    stations, columns = run.stations, station_columns(run.stations)
    known = stations.ok & np.isfinite([*stations.quaternion.T, *map(columns.get, _PLACES)]).all(0)
    rows = placed_stations(run, known, "usable position, attitude and ellipsoidal height", ledger)
    lat, lon, h = stations.lat_rad[rows], stations.lon_rad[rows], stations.h_ellipsoid_m[rows]
    attitude = stations.quaternion[rows]
    found: dict[str, object] = {n: columns[n][rows] for n in (*_WORDS, *_PLACES, *_SIGMAS)}
    if topocentric and rows.size:
        origin = _middle(lat, lon, h)
        to_origin = enu_from_ecef(*origin[:2])[0]
        xyz = ecef_of_geodetic(lat, lon, h) - ecef_of_geodetic(*origin)
        found |= dict(zip(_AXES, (xyz @ to_origin.T).T, strict=True))
        attitude = in_turned_frame(attitude, enu_from_ecef(lat, lon) @ to_origin.T)
        stated = np.degrees(origin[0]), np.degrees(origin[1]), origin[2]
        found |= {
            f"origin_{n}": np.repeat(v, rows.size) for n, v in zip(_PLACES, stated, strict=True)
        }
    angles = np.degrees(opk_of_quaternion(attitude))
    found |= dict(zip(_ANGLES, angles.T, strict=True))
    names = [*_WORDS, *_PLACES, *_ANGLES, *_SIGMAS]
    if topocentric:
        names += [*_AXES, *(f"origin_{name}" for name in _PLACES)]
    texts = dict.fromkeys(_WORDS, pa.string()) | {"time_utc": pa.timestamp("ns", "UTC")}
    kinds = {name: (texts.get(name, pa.float64()), "", "") for name in names}
    schema = schema_of(kinds, run.metadata)
    return write_csv_stream(path, schema, [table_of(found, schema)])


def _middle(*places: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The origin: the place in the middle of the extent, to 1e-6 rad (6 m) and one metre."""
    lat, lon, h = places
    lon = np.unwrap([np.full(lon.shape, lon[0]), lon], axis=0)[1]
    return [
        np.round([0.5 * (float(values.min()) + float(values.max()))], digits)
        for values, digits in ((lat, 6), (lon, 6), (h, 0))
    ]


FORMATS = (
    ExportFormat("opk", "omega, phi, kappa against each station's east, north, up", ".csv",
                 partial(_write, False)),
    ExportFormat("opk-enu", "omega, phi, kappa and x, y, z in one east-north-up frame", ".csv",
                 partial(_write, True)),
)  # fmt: skip
