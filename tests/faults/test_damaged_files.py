"""Damaged binary files that are no logs: read, or refused by name, within a limit of time.

Rasters of heights and undulations, weather models as netCDF-4 and GRIB, databases of COLMAP, with
the damages of `mutate.KINDS`. Never another exception or a warning, never an impossible result.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rasterio import Affine

from tests import model_files
from tests.faults.extreme_inputs import impossible_values
from tests.faults.extreme_weather import read_weather_model
from tests.faults.mutate import KINDS, limited, mutated, recipes, work_unit_s
from tests.small_block import SmallBlock
from tests.tables.geodata.rasters import write_raster
from unbend.errors import UnbendError
from unbend.tables.geodata.elevation import open_elevation
from unbend.tables.geodata.geoid import read_geoid
from unbend.tables.imports import blocks

LONGEST_UNITS = 100.0  # of work: 3 to 10 s


LATITUDE_DEG = np.array([47.5, 47.25, 47.0])
LONGITUDE_DEG = np.array([8.25, 8.5, 8.75])
TIMES = ("2026-05-06T11:00", "2026-05-06T12:00", "2026-05-06T13:00")


@dataclass(frozen=True)
class Kind:
    """A kind of file: how a sound one is written into a folder, and how the package reads it."""

    write: Callable[[Path], Path]
    read: Callable[[Path], object]


def write_heights(folder, mean, spread):
    """A GeoTIFF of random numbers about a mean, in compressed tiles."""
    numbers = mean + spread * np.random.default_rng(1).standard_normal((300, 300))
    return write_raster(
        folder / "heights.tif",
        numbers.astype("f4"),
        Affine(0.01, 0.0, 8.0, 0.0, -0.01, 48.0),
        compress="deflate",
        tiled=True,
        blockxsize=128,
        blockysize=128,
    )


def read_elevation(path):
    model, _ = open_elevation(
        [path],
        None,
        reference="msl",
        undulation=lambda lat, _: 0.0 * lat,
    )
    latitude_rad = np.radians(np.linspace(45.5, 47.5, 50))
    longitude_rad = np.radians(np.linspace(8.5, 10.5, 50))
    return model.heights(*model.nodes(latitude_rad, longitude_rad))


def read_undulations(path):
    return read_geoid(path).undulation(np.radians([46.5]), np.radians([8.5]))


def standard_column(latitude_rad, longitude_rad, time):
    """Heights, temperature, pressure and vapour pressure of the same air everywhere."""
    h_m = np.arange(0.0, 20_000.0, 100.0)
    temperature_k = np.maximum(288.15 - 0.0065 * h_m, 216.65)
    scale_height_m = 29.27 * temperature_k
    falls = np.cumsum(100.0 / scale_height_m)
    pressure_pa = 101_325.0 * np.exp(falls[0] - falls)
    return h_m, temperature_k, pressure_pa, 0.003 * pressure_pa


def write_netcdf(folder):
    return model_files.netcdf(folder / "model.nc", weather_model())


def write_grib(folder):
    return model_files.grib(folder / "model.grib", weather_model())


def weather_model():
    return model_files.dataset(standard_column, LATITUDE_DEG, LONGITUDE_DEG, TIMES)


def write_database(folder):
    block = SmallBlock.make()
    places = np.column_stack([block.lat, block.lon, block.h])
    block.write_colmap_database(folder / "block.db", known=places)
    return folder / "block.db"


def read_database(path):
    reader = blocks.block_reader("colmap")
    with blocks.damage_refused(path, "colmap"):
        cameras = [make() for make in reader.read_cameras(path).values()]
    places = [place.position for place in blocks.read_block_places(path, "colmap")]
    rows = list(blocks.block_rows(path, "colmap"))
    return cameras, places, len(rows)


FILES = {
    "elevation model": Kind(partial(write_heights, mean=500.0, spread=100.0), read_elevation),
    "geoid": Kind(partial(write_heights, mean=47.0, spread=3.0), read_undulations),
    "netCDF-4": Kind(write_netcdf, read_weather_model),
    "GRIB": Kind(write_grib, read_weather_model),
    "database of COLMAP": Kind(write_database, read_database),
}
READ_SLOWLY = ("netCDF-4", "GRIB")  # half a second each, a twentieth for the others


# h5netcdf does not clean up behind a file that it cannot open: its `close` fails when collected.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_read_or_refused(tmp_path, mutation_count, mutation_seed, name):
    kind = FILES[name]
    path = kind.write(tmp_path)
    sound = path.read_bytes()
    kind.read(path)
    limit_s = LONGEST_UNITS * work_unit_s()
    count = mutation_count // (100 if name in READ_SLOWLY else 10)
    refusals = []
    for recipe in recipes(1, count, mutation_seed):
        path.write_bytes(mutated(sound, recipe.kind, recipe.seed))
        try:
            with limited(limit_s):
                result = kind.read(path)
            assert not list(impossible_values(result))
        except UnbendError as error:
            refusals.append(error)
        except BaseException as error:
            error.add_note(f"{name} {recipe}")
            raise
    assert all(error.remedy for error in refusals)


def test_a_netcdf_whose_structure_has_no_end_is_refused(tmp_path):
    """Zeros among the references to dimensions: the HDF5 library looped for ever."""
    path = write_netcdf(tmp_path)
    damaged = mutated(path.read_bytes(), KINDS.index("zero_4k"), 33)
    path.write_bytes(damaged)
    with pytest.raises(UnbendError, match="does not come to an end") as caught:
        read_weather_model(path)
    assert caught.value.code == "MODEL-UNREADABLE"
