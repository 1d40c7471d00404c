"""Undulations: the grid of the package and others, against PROJ and published values."""

import hashlib
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyproj
import pytest
import rasterio
from numpy.testing import assert_allclose, assert_array_equal

from tests.stages import terrain_models
from tests.tables.checks import assert_within, refused_with
from tests.tables.geodata.rasters import write_raster
from unbend.tables.geodata.geoid import package_geoid, read_geoid

PUBLISHED_SHA256 = "c02a6eb70a7a78efebe5adf3ade626eb75390e170bb8b3f36136a2c28f5326a0"


gtx = partial(terrain_models.gtx, 40.0, 10.0, 0.5)
"""A grid of half degrees from 40 degrees north and 10 degrees east."""


def level_gtx(undulation_m):
    return gtx(np.full((3, 3), undulation_m))


def read_gtx(content):
    path = Path("a.gtx")
    path.write_bytes(content)
    return read_geoid(path)


def undulation_of(grid, latitude, longitude):
    return grid.undulation(np.radians(latitude), np.radians(longitude))


SINGULAR_PLACES = [
    (90.0, 10.0),
    (-90.0, 10.0),
    (0.0, 180.0),
    (0.0, -180.0),
    (89.99, 179.99),
    (-12.3, 0.0),
]


def places(count):
    """Latitudes and longitudes, among them poles and both sides of the date line."""
    rng = np.random.default_rng(7)
    lat = rng.uniform(-90.0, 90.0, count)
    lon = rng.uniform(-180.0, 180.0, count)
    lat[:6], lon[:6] = np.transpose(SINGULAR_PLACES)
    beside_date_line = rng.uniform(179.7, 180.0, 24)
    lon[6:30] = beside_date_line * rng.choice([-1.0, 1.0], 24)
    return lat, lon


@pytest.fixture(scope="module")
def egm96(tmp_path_factory):
    """The file that PROJ distributes, bit for bit, out of the package's."""
    packed = files("unbend.tables").joinpath("data/egm96_15.gtx.zst").read_bytes()
    size = 40 + 4 * 721 * 1440  # of the head and the values
    planes = pa.decompress(packed, size, "zstd", asbytes=True)
    head = planes[:40]
    planes_of_bytes = np.frombuffer(planes, np.uint8, offset=40).reshape(4, -1)
    content = head + planes_of_bytes.T.tobytes()
    assert hashlib.sha256(content).hexdigest() == PUBLISHED_SHA256
    path = tmp_path_factory.mktemp("geoid") / "egm96_15.gtx"
    path.write_bytes(content)
    return path


def undulations_by_proj(path, lat, lon):
    """The forward shift takes a height above the geoid to one above the ellipsoid."""
    shift = pyproj.Transformer.from_pipeline(f"+proj=vgridshift +grids={path} +multiplier=1")
    sea_level = np.zeros(len(lat))
    _, _, h = shift.transform(lon, lat, sea_level)
    return np.array(h)


def test_undulations_are_those_of_proj(egm96):
    lat, lon = places(1000)
    undulation = undulation_of(package_geoid(), lat, lon)
    assert_within(undulation, undulations_by_proj(egm96, lat, lon), 1e-3)
    assert_array_equal(undulation_of(read_geoid(egm96), lat, lon), undulation)


def test_a_plane_is_exact_and_outside_is_unknown():
    north, east = np.mgrid[0:5, 0:7] * 0.5
    plane = 20.0 + 2.0 * north - 3.0 * east
    lat = [41.3, 42.0, 40.0, 39.9, 41.0]
    lon = [12.1, 13.0, 10.0, 11.0, 13.1]

    undulation = undulation_of(read_gtx(gtx(plane)), lat, lon)

    expected = [20.0 + 2.6 - 6.3, 15.0, 20.0]
    assert_allclose(undulation[:3], expected, rtol=1e-6)
    assert np.isnan(undulation[3:]).all()


def test_deflections_are_differences_of_projs_undulations(egm96):
    """One second of arc around each place, on the ellipsoid by PROJ's own geodesic."""
    rng = np.random.default_rng(3)
    step = 1.0 / 3600.0
    # Away from the nodes of the grid.
    lat = 0.1 + 0.25 * rng.integers(-320, 320, 200)
    lon = 0.1 + 0.25 * rng.integers(-720, 719, 200)
    geoid = package_geoid()
    xi, eta = geoid.deflection(np.radians(lat), np.radians(lon))

    def slope(lat_step, lon_step):
        low = (lat - lat_step, lon - lon_step)
        high = (lat + lat_step, lon + lon_step)
        below_m = undulations_by_proj(egm96, *low)
        above_m = undulations_by_proj(egm96, *high)
        geod = pyproj.Geod(ellps="WGS84")
        _, _, distance_m = geod.inv(*low[::-1], *high[::-1])
        return (above_m - below_m) / distance_m

    assert_within(-xi, slope(step, 0.0), 1e-8)
    assert_within(-eta, slope(0.0, step), 1e-8)


def test_a_hole_is_unknown():
    values = np.full((3, 3), 45.0)
    values[1, 1] = -88.8888
    assert np.isnan(undulation_of(read_gtx(gtx(values)), 40.2, 10.2))


RNG = np.random.default_rng(1)
VALUES = RNG.uniform(30.0, 50.0, (5, 7)).astype(np.float32)
OF_VALUES = rasterio.Affine(0.5, 0.0, 9.75, 0.0, -0.5, 42.25)


@pytest.mark.parametrize(
    ("scale", "offset", "kind", "tolerance_m"),
    [
        (1.0, 0.0, np.float32, 1e-9),
        (0.001, 20.0, np.int16, 6e-4),
    ],
)
def test_a_geotiff_is_the_same_grid(scale, offset, kind, tolerance_m):
    northwards = VALUES[::-1]
    stored = (northwards - np.float32(offset)) / np.float32(scale)
    if kind == np.int16:
        stored = stored.round()
    path = write_raster(
        "a.tif",
        stored.astype(kind),
        OF_VALUES,
        scale=scale,
        offset=offset,
    )
    lat = [40.7, 41.9]
    lon = [10.1, 12.7]

    undulation = undulation_of(read_geoid(path), lat, lon)

    expected = undulation_of(read_gtx(gtx(VALUES)), lat, lon)
    assert_within(undulation, expected, tolerance_m)


def test_a_raster_that_names_another_is_refused():
    path = write_raster("a.tif", VALUES, OF_VALUES)
    naming = Path("b.tif")
    naming.write_text(
        '<VRTDataset rasterXSize="7" rasterYSize="5"><SRS>EPSG:4326</SRS><GeoTransform>9.75, 0.5,'
        ' 0, 42.25, 0, -0.5</GeoTransform><VRTRasterBand dataType="Float32" band="1">'
        f"<SimpleSource><SourceFilename>{path.absolute()}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with refused_with("GEOID-GRID", "in the file itself"):
        read_geoid(naming)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "header"),
        (b"II*\0" + bytes(60), "header"),
        (level_gtx(45.0)[:-4], "values"),
        (level_gtx(45_000.0), "undulations are"),
        (level_gtx(-88.8888), "no value"),
    ],
)
def test_what_is_no_grid_is_refused(content, why):
    with refused_with("GEOID-GRID", why):
        read_gtx(content)


def test_a_projected_raster_is_refused():
    path = write_raster(
        "utm.tif",
        np.ones((2, 2), np.float32),
        rasterio.Affine(1, 0, 0, 0, -1, 9),
        crs="EPSG:32632",
    )
    with refused_with("GEOID-GRID", "geographic"):
        read_geoid(path)


def test_longitudes_of_both_signs_are_one_place():
    lon = [-100.3, 259.7, -460.3]
    undulation = undulation_of(package_geoid(), 40.1, lon)
    assert np.ptp(undulation) < 1e-9
