"""Finished runs that are made by hand, what a format writes of them, and places by PROJ."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pyproj
from pyarrow.csv import ConvertOptions, read_csv
from scipy.spatial.transform import Rotation

from tests.helpers import with_code
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.flight.stations import empty_stations
from unbend.messages import Ledger
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.tables.exports import FORMATS, ExportCamera, FinishedRun
from unbend.tables.pixels import PixelSystem

AIR = standard_atmosphere("us1976")
DOWN = np.diag([1.0, -1.0, -1.0])
"""From east, north, up to a camera that looks down with north above; or photogrammetry's axes."""
HERE = Path()
TO_ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)


def ecef_of(lon, lat, h):
    """(..., 3) earth-centred coordinates, by PROJ."""
    return np.stack(TO_ECEF.transform(lon, lat, h), axis=-1)


def enu_axes(lon, lat):
    """(3, 3) from earth-centred axes to east, north, up."""
    to_ecef = Rotation.from_euler("ZX", [90.0 + lon, 90.0 - lat], degrees=True)
    return to_ecef.as_matrix().T


def rotation_to_photo(angles):
    """From the frame to the photo (x right, y up): Elements of Photogrammetry, Eq. C-33."""
    radians = np.radians(angles[["omega_deg", "phi_deg", "kappa_deg"]].to_numpy(float))
    so, sp, sk = np.sin(radians)
    co, cp, ck = np.cos(radians)
    return np.array(
        [
            [cp * ck, so * sp * ck + co * sk, -co * sp * ck + so * sk],
            [-cp * sk, -so * sp * sk + co * ck, co * sp * sk + so * ck],
            [sp, -so * cp, co * cp],
        ]
    )


def quaternions_of(turns):
    """(n, 4), NaN where a turn is unknown."""
    turns = np.asarray(turns)
    quaternions = np.full((len(turns), 4), np.nan)
    has_turn = np.isfinite(turns).all(axis=(1, 2))
    rotation = Rotation.from_matrix(turns[has_turn])
    quaternions[has_turn] = rotation.as_quat(canonical=True, scalar_first=True)
    return quaternions


def stations_at(names, camera, lon, lat, h_msl, h_ellipsoid, turns, **columns):
    """Stations [deg, m] whose ``turns`` (n, 3, 3) lead from east, north, up to the cameras."""
    count = len(names)
    image = np.array(names, object)
    cameras = np.broadcast_to(np.array(camera, object), count).copy()
    return replace(
        empty_stations(image, cameras, "ok"),
        lat_rad=np.radians(np.broadcast_to(lat, count)),
        lon_rad=np.radians(np.broadcast_to(lon, count)),
        h_msl_m=np.full(count, h_msl, float),
        h_ellipsoid_m=np.full(count, h_ellipsoid, float),
        quaternion=quaternions_of(turns),
        **columns,
    )


def finished_run(
    stations,
    turns,
    cameras: dict[str, ExportCamera],
    ground_m,
    **changes,
):
    """A run in the US standard atmosphere, over level ground, all of whose stations are usable.

    Pixels count from the centre.
    """
    count = len(stations)
    outside = AIR.refractivity(stations.h_msl_m)
    exposures = Exposures(
        usable=np.full(count, True),
        rotation=np.asarray(turns),
        latitude_rad=stations.lat_rad,
        height_m=stations.h_msl_m,
        refractivity_outside=outside,
        refractivity_cabin=outside,
    )
    run = FinishedRun(
        mission="small",
        stations=stations,
        exposures=exposures,
        air=constant_series(TimedProfile(None, AIR), count),
        rays=(rays_by(AIR, "spherical"),),
        method="spherical",
        cameras=cameras,
        find_ground=lambda _: np.full(count, ground_m),
        pixels=PixelSystem("centre"),
        parts=(),
        metadata={"unbend.mission": "small"},
    )
    return replace(run, **changes)


@dataclass(frozen=True)
class Written:
    """What a format wrote: a file or a folder, the number of its rows, and what was said."""

    path: Path
    count: int
    ledger: Ledger

    @property
    def counts(self):
        """Kind, code and count of each message."""
        return [(message.kind, message.code, message.count) for message in self.ledger]

    def message(self, code):
        """The only message of this code."""
        (message,) = with_code(self.ledger, code)
        return message

    def table(self):
        """The rows of a CSV, in which nothing stands for null, or of Parquet."""
        table = read_table(self.path)
        assert len(table) == self.count
        return table


def read_table(path):
    if path.suffix == ".parquet":
        return pq.read_table(path).to_pandas()
    options = ConvertOptions(null_values=[""], strings_can_be_null=True)
    return read_csv(path, convert_options=options).to_pandas()


def write_export(run, name, folder=HERE, **values):
    """Write a format under a name that is new in the folder."""
    form = FORMATS[name]
    number = len(list(folder.iterdir()))
    path = folder.absolute() / f"out{number}{form.ending}"
    if not form.ending:
        path.mkdir()
    ledger = Ledger()
    count = form.write(run, form.values(values), path, ledger)
    return Written(path, count, ledger)
