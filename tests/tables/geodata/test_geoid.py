"""Undulations: the grid of the package and others, against PROJ and published values."""

from __future__ import annotations

import hashlib
import struct
from importlib.resources import files

import numpy as np
import pyarrow as pa
import pyproj
import pytest
import rasterio
from numpy.testing import assert_allclose, assert_array_equal

from tests.tables.checks import assert_within, refused_with
from tests.tables.geodata.rasters import write_raster
from unbend.tables.geodata.geoid import package_geoid, read_geoid

PUBLISHED_SHA256 = "c02a6eb70a7a78efebe5adf3ade626eb75390e170bb8b3f36136a2c28f5326a0"


def gtx(values, south=40.0, west=10.0, step=0.5) -> bytes:
    head = struct.pack(">4d2i", south, west, step, step, *values.shape)
    return head + values.astype(">f4").tobytes()


def places(count):
    """Latitudes and longitudes, among them poles and both sides of the date line."""
    rng = np.random.default_rng(7)
    lat = rng.uniform(-90.0, 90.0, count)
    lon = rng.uniform(-180.0, 180.0, count)
    lat[:6] = [90.0, -90.0, 0.0, 0.0, 89.99, -12.3]
    lon[:6] = [10.0, 10.0, 180.0, -180.0, 179.99, 0]
    lon[6:30] = rng.uniform(179.7, 180.0, 24) * rng.choice([-1.0, 1.0], 24)
    return lat, lon


@pytest.fixture(scope="module")
def egm96(tmp_path_factory):
    """The file that PROJ distributes, bit for bit, out of the package's."""
    packed = files("unbend.tables").joinpath("data/egm96_15.gtx.zst").read_bytes()
    planes = pa.decompress(packed, 40 + 4 * 721 * 1440, "zstd", asbytes=True)
    values = np.frombuffer(planes, np.uint8, offset=40).reshape(4, -1).T
    content = planes[:40] + values.tobytes()
    assert hashlib.sha256(content).hexdigest() == PUBLISHED_SHA256
    path = tmp_path_factory.mktemp("geoid") / "egm96_15.gtx"
    path.write_bytes(content)
    return path


def undulations_by_proj(path, lat, lon) -> np.ndarray:
    """The forward shift takes a height above the geoid to one above the ellipsoid."""
    shift = pyproj.Transformer.from_pipeline(f"+proj=vgridshift +grids={path} +multiplier=1")
    return np.array(shift.transform(lon, lat, np.zeros(len(lat)))[2])


def test_undulations_are_those_of_proj(egm96):
    lat, lon = places(1000)
    expected = undulations_by_proj(egm96, lat, lon)
    undulation = package_geoid().undulation(np.radians(lat), np.radians(lon))
    assert_within(undulation, expected, 1e-3)
    from_file = read_geoid(egm96).undulation(np.radians(lat), np.radians(lon))
    assert_array_equal(from_file, undulation)


def test_a_plane_is_exact_and_outside_is_unknown(tmp_path):
    north, east = np.mgrid[0:5, 0:7] * 0.5
    path = tmp_path / "plane.gtx"
    path.write_bytes(gtx(20.0 + 2.0 * north - 3.0 * east))
    grid = read_geoid(path)
    lat = np.radians([41.3, 42.0, 40.0, 39.9, 41.0])
    lon = np.radians([12.1, 13.0, 10.0, 11.0, 13.1])
    undulation = grid.undulation(lat, lon)
    assert_allclose(undulation[:3], [20.0 + 2.6 - 6.3, 15.0, 20.0], rtol=1e-6)
    assert np.isnan(undulation[3:]).all()


def test_deflections_are_differences_of_projs_undulations(egm96):
    """One second of arc around each place, on the ellipsoid by PROJ's own geodesic."""
    rng = np.random.default_rng(3)
    step = 1.0 / 3600.0
    lat = rng.integers(-320, 320, 200) * 0.25 + 0.1
    lon = rng.integers(-720, 719, 200) * 0.25 + 0.1
    xi, eta = package_geoid().deflection(np.radians(lat), np.radians(lon))

    def slope(lat_step, lon_step):
        low = (lat - lat_step, lon - lon_step)
        high = (lat + lat_step, lon + lon_step)
        rise = undulations_by_proj(egm96, *high) - undulations_by_proj(egm96, *low)
        return rise / pyproj.Geod(ellps="WGS84").inv(*low[::-1], *high[::-1])[2]

    assert_within(-xi, slope(step, 0.0), 1e-8)
    assert_within(-eta, slope(0.0, step), 1e-8)


def test_a_hole_is_unknown(tmp_path):
    values = np.full((3, 3), 45.0)
    values[1, 1] = -88.8888
    path = tmp_path / "hole.gtx"
    path.write_bytes(gtx(values))
    assert np.isnan(read_geoid(path).undulation(np.radians(40.2), np.radians(10.2)))


VALUES = np.random.default_rng(1).uniform(30.0, 50.0, (5, 7)).astype(np.float32)
OF_VALUES = rasterio.Affine(0.5, 0.0, 10.0 - 0.25, 0.0, -0.5, 42.0 + 0.25)


@pytest.mark.parametrize(
    ("scale", "offset", "kind", "atol"),
    [(1.0, 0.0, np.float32, 1e-9), (0.001, 20.0, np.int16, 6e-4)],
)
def test_a_geotiff_is_the_same_grid(tmp_path, scale, offset, kind, atol):
    (tmp_path / "a.gtx").write_bytes(gtx(VALUES))
    stored = (VALUES[::-1] - np.float32(offset)) / np.float32(scale)
    stored = stored.round() if kind == np.int16 else stored
    path = write_raster(
        tmp_path / "a.tif", stored.astype(kind), OF_VALUES, scale=scale, offset=offset
    )
    lat = np.radians([40.7, 41.9])
    lon = np.radians([10.1, 12.7])
    expected = read_geoid(tmp_path / "a.gtx").undulation(lat, lon)
    undulation = read_geoid(path).undulation(lat, lon)
    assert_within(undulation, expected, atol)


def test_a_raster_that_names_another_is_refused(tmp_path):
    path = write_raster(tmp_path / "a.tif", VALUES, OF_VALUES)
    (tmp_path / "b.tif").write_text(
        '<VRTDataset rasterXSize="7" rasterYSize="5"><SRS>EPSG:4326</SRS><GeoTransform>9.75, 0.5,'
        ' 0, 42.25, 0, -0.5</GeoTransform><VRTRasterBand dataType="Float32" band="1">'
        f"<SimpleSource><SourceFilename>{path}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with refused_with("GEOID-GRID", "in the file itself"):
        read_geoid(tmp_path / "b.tif")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "header"),
        (b"II*\0" + bytes(60), "header"),
        (gtx(np.full((3, 3), 45.0))[:-4], "values"),
        (gtx(np.full((3, 3), 45_000.0)), "undulations are"),
        (gtx(np.full((3, 3), -88.8888)), "no value"),
    ],
)
def test_what_is_no_grid_is_refused(tmp_path, content, why):
    path = tmp_path / "bad.gtx"
    path.write_bytes(content)
    with refused_with("GEOID-GRID", why):
        read_geoid(path)


def test_a_projected_raster_is_refused(tmp_path):
    transform = rasterio.Affine(1, 0, 0, 0, -1, 9)
    values = np.ones((2, 2), np.float32)
    path = write_raster(tmp_path / "utm.tif", values, transform, crs="EPSG:32632")
    with refused_with("GEOID-GRID", "geographic"):
        read_geoid(path)


def test_longitudes_of_both_signs_are_one_place():
    lon = np.radians([-100.3, 259.7, -460.3])
    assert np.ptp(package_geoid().undulation(0.7, lon)) < 1e-9
