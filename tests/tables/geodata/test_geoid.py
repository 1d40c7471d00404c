"""Undulations: the grid of the package and others, against PROJ and published values."""

from __future__ import annotations

import hashlib
import struct
from importlib.resources import files

import numpy as np
import pyarrow as pa
import pyproj
import pytest

from unbend.errors import InputError
from unbend.geodesy import GeoidGrid
from unbend.tables.geodata.geoid import package_geoid, read_geoid
from unbend.units import ARCSEC

PUBLISHED_SHA256 = "c02a6eb70a7a78efebe5adf3ade626eb75390e170bb8b3f36136a2c28f5326a0"


def gtx(values, south=40.0, west=10.0, step=0.5) -> bytes:
    rows, columns = values.shape
    return (
        struct.pack(">4d2i", south, west, step, step, rows, columns)
        + values.astype(">f4").tobytes()
    )


def places(count):
    rng = np.random.default_rng(7)
    lat = rng.uniform(-90.0, 90.0, count)
    lon = rng.uniform(-180.0, 180.0, count)
    lat[:6], lon[:6] = [90.0, -90.0, 0.0, 0.0, 89.99, -12.3], [10.0, 10.0, 180.0, -180.0, 179.99, 0]
    lon[6:30] = rng.uniform(179.7, 180.0, 24) * rng.choice([-1.0, 1.0], 24)
    return lat, lon


def test_undulations_are_those_of_proj(tmp_path):
    path = tmp_path / "egm96_15.gtx"
    packed = files("unbend.tables").joinpath("data/egm96_15.gtx.zst").read_bytes()
    planes = pa.decompress(packed, 40 + 4 * 721 * 1440, "zstd", asbytes=True)
    values = np.frombuffer(planes, np.uint8, offset=40).reshape(4, -1).T
    path.write_bytes(planes[:40] + values.tobytes())
    # The file that PROJ distributes, bit for bit.
    assert hashlib.sha256(path.read_bytes()).hexdigest() == PUBLISHED_SHA256
    shift = pyproj.Transformer.from_pipeline(f"+proj=vgridshift +grids={path} +multiplier=1")
    lat, lon = places(1000)
    # The forward shift takes a height above the geoid to one above the ellipsoid.
    wanted = shift.transform(lon, lat, np.zeros(1000))[2]
    grid = package_geoid()
    found = grid.undulation(np.radians(lat), np.radians(lon))
    np.testing.assert_allclose(found, np.array(wanted), rtol=0.0, atol=1e-3)
    assert found.min() < -80.0
    assert found.max() > 60.0
    from_file = read_geoid(path).undulation(np.radians(lat), np.radians(lon))
    np.testing.assert_array_equal(from_file, found)


@pytest.mark.parametrize(
    ("lat", "lon", "published"),
    [  # NGA's test points of EGM96, README of F477
        (38.6281550, 269.7791550, -31.628), (-14.6212170, 305.0211140, -2.969),
        (46.8743190, 102.4487290, -43.575), (-23.6174460, 133.8747120, 15.871),
        (38.6254730, 359.9995000, 50.066), (-0.4667440, 0.0023000, 17.329),
    ],
)  # fmt: skip
def test_undulations_are_the_published_ones(lat, lon, published):
    found = float(package_geoid().undulation(np.radians(lat), np.radians(lon)))
    assert found == pytest.approx(published, abs=0.1)


def test_a_plane_is_exact_and_outside_is_unknown(tmp_path):
    north, east = np.mgrid[0:5, 0:7] * 0.5
    path = tmp_path / "plane.gtx"
    path.write_bytes(gtx(20.0 + 2.0 * north - 3.0 * east))
    grid = read_geoid(path)
    lat = np.radians([41.3, 42.0, 40.0, 39.9, 41.0])
    lon = np.radians([12.1, 13.0, 10.0, 11.0, 13.1])
    found = grid.undulation(lat, lon)
    np.testing.assert_allclose(found[:3], [20.0 + 2.6 - 6.3, 15.0, 20.0], rtol=1e-6)
    assert np.isnan(found[3:]).all()
    xi, eta = grid.deflection(lat[0], lon[0])
    # 2 m in a degree of latitude at 41.3 deg: 111,063 m (meridian radius 6,363,456 m).
    assert float(xi) == pytest.approx(-2.0 / 111_063.0, rel=1e-4)
    assert float(eta) == pytest.approx(3.0 / (np.cos(lat[0]) * 111_483.0), rel=1e-3)


def test_deflections_are_differences_of_projs_undulations(tmp_path):
    """One second of arc around each place, on the ellipsoid by PROJ's own geodesic."""
    path = tmp_path / "egm96_15.gtx"
    packed = files("unbend.tables").joinpath("data/egm96_15.gtx.zst").read_bytes()
    planes = pa.decompress(packed, 40 + 4 * 721 * 1440, "zstd", asbytes=True)
    values = np.frombuffer(planes, np.uint8, offset=40).reshape(4, -1).T
    path.write_bytes(planes[:40] + values.tobytes())
    # The file that PROJ distributes, bit for bit.
    assert hashlib.sha256(path.read_bytes()).hexdigest() == PUBLISHED_SHA256
    shift = pyproj.Transformer.from_pipeline(f"+proj=vgridshift +grids={path} +multiplier=1")
    rng = np.random.default_rng(3)
    step = 1.0 / 3600.0
    lat, lon = (
        rng.integers(low, high, 200) * 0.25 + 0.1 for low, high in ((-320, 320), (-720, 719))
    )
    xi, eta = package_geoid().deflection(np.radians(lat), np.radians(lon))

    def slope(from_lat, from_lon, to_lat, to_lon):
        ends = ((from_lon, from_lat), (to_lon, to_lat))
        rise = [shift.transform(x, y, np.zeros(200))[2] for x, y in ends]
        metres = pyproj.Geod(ellps="WGS84").inv(from_lon, from_lat, to_lon, to_lat)[2]
        return (rise[1] - rise[0]) / metres

    np.testing.assert_allclose(-xi, slope(lat - step, lon, lat + step, lon), atol=1e-8)
    np.testing.assert_allclose(-eta, slope(lat, lon - step, lat, lon + step), atol=1e-8)


def test_the_deflection_at_greenwich_is_the_published_one():
    """Airy's meridian lies 5.31 arcsec of longitude west of the ellipsoid's (Malys et al. 2015)."""
    _, eta = package_geoid().deflection(np.radians(51.4778), np.radians(-0.00147))
    assert float(eta) / ARCSEC == pytest.approx(5.31 * np.cos(np.radians(51.4778)), abs=0.3)


def test_a_hole_is_unknown(tmp_path):
    values = np.full((3, 3), 45.0)
    values[1, 1] = -88.8888
    path = tmp_path / "hole.gtx"
    path.write_bytes(gtx(values))
    assert np.isnan(read_geoid(path).undulation(np.radians(40.2), np.radians(10.2)))


def test_a_geotiff_is_the_same_grid(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    values = np.random.default_rng(1).uniform(30.0, 50.0, (5, 7)).astype(np.float32)
    (tmp_path / "a.gtx").write_bytes(gtx(values))
    path = tmp_path / "a.tif"
    transform = rasterio.Affine(0.5, 0.0, 10.0 - 0.25, 0.0, -0.5, 42.0 + 0.25)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=5,
        width=7,
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=transform,
    ) as raster:
        raster.write(values[::-1], 1)
    lat = np.radians([40.7, 41.9])
    lon = np.radians([10.1, 12.7])
    known = read_geoid(tmp_path / "a.gtx").undulation(lat, lon)
    np.testing.assert_allclose(read_geoid(path).undulation(lat, lon), known, rtol=0.0, atol=1e-9)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=5,
        width=7,
        count=1,
        dtype="int16",
        crs="EPSG:4326",
        transform=transform,
    ) as raster:
        raster.write(np.round((values[::-1] - 20.0) * 1000.0).astype(np.int16), 1)
        raster.scales, raster.offsets = [0.001], [20.0]
    np.testing.assert_allclose(read_geoid(path).undulation(lat, lon), known, rtol=0.0, atol=6e-4)
    west = transform.c
    north = transform.f
    (tmp_path / "b.tif").write_text(
        f'<VRTDataset rasterXSize="7" rasterYSize="5"><SRS>EPSG:4326</SRS><GeoTransform>{west},'
        f' 0.5, 0, {north}, 0, -0.5</GeoTransform><VRTRasterBand dataType="Float32" band="1">'
        f"<SimpleSource><SourceFilename>{path}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(InputError, match="in the file itself"):
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
    with pytest.raises(InputError, match=why) as refusal:
        read_geoid(path)
    assert refusal.value.code == "GEOID-GRID"


def test_a_projected_raster_is_refused(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "utm.tif"
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=2,
        width=2,
        count=1,
        dtype="float32",
        crs="EPSG:32632",
        transform=rasterio.Affine(1, 0, 0, 0, -1, 9),
    ) as raster:
        raster.write(np.ones((2, 2), np.float32), 1)
    with pytest.raises(InputError, match="geographic"):
        read_geoid(path)


def test_longitudes_of_both_signs_are_one_place():
    grid = package_geoid()
    assert isinstance(grid, GeoidGrid)
    lon = np.radians([-100.3, 259.7, -460.3])
    assert np.ptp(grid.undulation(0.7, lon)) < 1e-9
