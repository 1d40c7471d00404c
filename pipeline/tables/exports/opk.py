"""Exterior orientation as omega, phi, kappa: against each station's own horizon, or in one frame.

M = Rx(omega) Ry(phi) Rz(kappa) turns from the camera of photogrammetry (x right, y up, z backward)
to the frame; see `pipeline.flight.rotations`. The vertical turns 324 arcsec in 10 km: angles of the
two formats differ by that.
"""

from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from pipeline.flight.rotations import opk_of_quaternion
from pipeline.flight.stations import station_columns
from pipeline.ledger import Ledger
from pipeline.tables.exports.footprints import placed_stations, stations_in_one_frame
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
    attitude = stations.quaternion[rows]
    found: dict[str, object] = {n: columns[n][rows] for n in (*_WORDS, *_PLACES, *_SIGMAS)}
    if topocentric and rows.size:
        frame = stations_in_one_frame(run, rows)
        attitude = frame.quaternion
        found |= dict(zip(_AXES, frame.position_m.T, strict=True))
        found |= {
            f"origin_{n}": np.full(rows.size, v)
            for n, v in zip(_PLACES, frame.origin_deg, strict=True)
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


_USE = (
    "neither earth curvature nor a map projection is in these positions and angles: adjust in a "
    "Cartesian frame, with the program's own corrections of refraction and earth curvature off"
)

FORMATS = (
    ExportFormat("opk", "omega, phi, kappa against each station's east, north, up", ".csv",
                 partial(_write, False), use=_USE),
    ExportFormat("opk-enu", "omega, phi, kappa and x, y, z in one frame: east, north, up", ".csv",
                 partial(_write, True), use=_USE),
)  # fmt: skip
