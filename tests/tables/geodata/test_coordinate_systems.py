"""Positions in stated coordinate systems: PROJ's own numbers, published ones, and refusals."""

import re
from pathlib import Path

import numpy as np
import pyproj
import pyproj.network
import pytest

import unbend
from tests.helpers import with_code
from tests.tables.checks import assert_within
from tests.tables.geodata.rasters import level_geoid
from unbend.errors import InputError
from unbend.tables.geodata.coordinate_systems import places_of


def placed(crs, x, y, h=0.0, heights="msl", geoid=None):
    columns = np.broadcast_arrays(*np.atleast_1d(x, y, h))
    return places_of(
        crs,
        tuple(np.asarray(column, float) for column in columns),
        heights=heights,
        geoid=geoid,
        where="points.csv",
        key="crs",
    )


def refusal(*arguments, **options):
    with pytest.raises(InputError) as refused:
        placed(*arguments, **options)
    return refused.value


def test_utm_has_the_published_place_and_convergence():
    """Ordnance Survey's worked example, guide to coordinate systems: OSGB36 E 651409.903."""
    places, notes = placed("EPSG:27700", 651409.903, 313177.270)

    # On WGS 84 by the guide's Helmert example within the 5 m that it promises.
    lat = 52 + 39 / 60 + 28.8282 / 3600
    lon = 1 + 42 / 60 + 57.8663 / 3600
    assert np.degrees(places.lat_rad[0]) == pytest.approx(lat, abs=5e-5)
    assert np.degrees(places.lon_rad[0]) == pytest.approx(lon, abs=8e-5)
    (entry,) = notes
    assert entry.kind == "warning"
    assert entry.code == "CRS-DATUM"
    assert "needs uk_os_OSTN15" in entry.what
    assert "python -m pyproj sync --file" in entry.what
    assert entry.what.endswith("write that system as crs")


EGM96_AT_0_0 = 17.16  # m, published
AT_0_0 = ("EPSG:32631+7837", 166_021.44, 0.0, 500.0)


@pytest.mark.parametrize(
    ("off_m", "kind"),
    [
        (1.5, "note"),
        (5.0, "warning"),
    ],
)
def test_a_grid_that_is_not_of_the_vertical_datum_is_named_with_its_distance_from_egm96(
    off_m, kind
):
    _, notes = placed(*AT_0_0, geoid=level_geoid(EGM96_AT_0_0 + off_m))

    note = notes[-1]
    assert note.code == "CRS-VERTICAL"
    assert note.kind == kind
    (distance,) = re.findall(r"([+-][\d.]+) m from EGM96", note.what)
    assert float(distance) == pytest.approx(off_m, abs=0.06)


def test_a_grid_with_the_other_sign_is_refused():
    error = refusal(*AT_0_0, geoid=level_geoid(-EGM96_AT_0_0))
    assert error.code == "CRS-VERTICAL"
    assert "-34.3 m" in error.what


@pytest.mark.parametrize(
    "code",
    [
        25832,
        32733,
        2056,
        2154,
        31467,
        27561,
    ],
)
def test_convergence_is_the_azimuth_of_grid_north(code):
    """One metre to the grid's north, its azimuth on the ellipsoid by PROJ's geodesic."""
    system = pyproj.CRS(code)
    west, south, east, north = system.area_of_use.bounds
    rng = np.random.default_rng(5)
    lon = rng.uniform(west, east, 50)
    lat = rng.uniform(south, min(north, 70.0), 50)
    # Lambert Nord counts grads from Paris; its datum in degrees from Greenwich is EPSG:4275.
    geodetic = "EPSG:4275" if code == 27561 else system.geodetic_crs
    to_grid = pyproj.Transformer.from_crs(geodetic, system, always_xy=True)
    x, y = to_grid.transform(lon, lat)
    below = to_grid.transform(x, y - 1.0, direction="INVERSE")
    above = to_grid.transform(x, y + 1.0, direction="INVERSE")
    azimuth, _, _ = system.get_geod().inv(*below, *above)

    places, _ = placed(f"EPSG:{code}", x, y)

    assert_within(np.degrees(places.convergence_rad), azimuth, 2e-5)


@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:32632", "EPSG:3035"])
def test_places_are_projs_whatever_the_order_of_the_axes(crs):
    lon = np.array([9.1, 9.4])
    lat = np.array([48.2, 48.9])
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    x, y = to_grid.transform(lon, lat)

    places, notes = placed(crs, x, y, 300.0)

    assert_within(np.degrees(places.lon_rad), lon, 1e-8)
    assert_within(np.degrees(places.lat_rad), lat, 1e-8)
    assert places.h_m.tolist() == [300.0, 300.0]
    assert [note.kind for note in notes] == ["note"]


def test_longitudes_and_latitudes_have_no_convergence():
    places, _ = placed("EPSG:4326", 9.1, 48.2)
    assert places.convergence_rad.tolist() == [0.0]


PLACE = (500_000.0, 5_400_000.0, 100.0)


@pytest.mark.parametrize(
    ("crs", "place", "heights"),
    [
        ("EPSG:25832+5773", PLACE, "msl"),
        ("EPSG:4979", (9.0, 48.0, 100.0), "ellipsoid"),
    ],
)
def test_heights_by_the_name_of_their_datum(crs, place, heights):
    places, _ = placed(crs, *place, heights=heights)
    assert places.heights == heights
    assert places.h_m.tolist() == [100.0]


def test_heights_of_a_national_datum_need_its_grid():
    error = refusal("EPSG:25832+7837", *PLACE)
    assert error.code == "CRS-VERTICAL"
    assert "DHHN2016 height" in str(error)
    assert "mission.geoid" in str(error)

    places, notes = placed("EPSG:25832+7837", *PLACE, geoid=level_geoid(46.0))
    assert places.heights == "ellipsoid"
    assert places.h_m[0] == pytest.approx(146.0)
    assert "CRS-VERTICAL" in {note.code for note in notes}


def test_heights_that_are_not_those_that_are_stated_are_refused():
    assert refusal("EPSG:25832+7837", *PLACE, heights="ellipsoid").code == "CRS-VERTICAL"
    assert refusal("EPSG:4979", 9.0, 48.0, 100.0).code == "CRS-VERTICAL"
    # Above Bessel's ellipsoid nobody measures.
    assert "Bessel" in str(refusal("EPSG:31467", 3_500_000, 5_400_000, heights="ellipsoid"))


def test_feet_of_a_compound_system_are_metres():
    to_grid = pyproj.Transformer.from_crs("EPSG:4269", "EPSG:2263", always_xy=True)
    x, y = to_grid.transform(-73.5, 40.7)

    places, _ = placed("EPSG:2263+6360", x, y, 1000.0, geoid=level_geoid(-32.0))

    us_foot_m = 1200.0 / 3937.0
    assert places.h_m[0] == pytest.approx(1000.0 * us_foot_m - 32.0, abs=1e-6)
    assert np.degrees(places.lat_rad[0]) == pytest.approx(40.7, abs=3e-5)


@pytest.mark.parametrize(
    "crs",
    [
        "EPSG:99999",
        "no system",
        "EPSG:5773",
        "EPSG:4978",
        "EPSG:25832+99",
    ],
)
def test_what_is_no_system_is_refused(crs):
    assert refusal(crs, 500_000.0, 5_400_000.0).code == "CRS-UNKNOWN"


def test_a_ballpark_transformation_is_refused():
    local = "+proj=tmerc +lat_0=48 +lon_0=9 +x_0=0 +y_0=0 +ellps=bessel +type=crs"
    assert refusal(local, 100.0, 200.0).code == "CRS-BALLPARK"


def test_positions_outside_the_area_of_the_system():
    error = refusal("EPSG:25832", [5_400_000.0, 5_401_000.0], [500_000.0, 500_100.0])
    assert error.code == "CRS-AREA"
    assert "2 of 2" in str(error)
    assert refusal("EPSG:25832", np.nan, np.nan).code == "CRS-AREA"

    places, notes = placed("EPSG:25832", [5e5, 5e5, 0.0], [5.4e6, 5.4e6, 0.0])
    assert np.isnan(places.lat_rad).tolist() == [False, False, True]
    (loss,) = with_code(notes, "CRS-AREA")
    assert loss.kind == "loss"
    assert "write it as crs" in loss.what


def test_an_area_across_the_date_line():
    """The Chatham Islands, on its other side."""
    places, _ = placed("EPSG:3793", 3_500_000.0, 5_100_000.0)
    assert places.lon_rad[0] < 0.0


def test_the_network_of_proj_changes_nothing(monkeypatch):
    """DHDN: the grid BETA2007, which PROJ would ask for, is not here."""
    places, notes = placed("EPSG:31467", 3_500_000.0, 5_500_000.0)

    monkeypatch.setenv("PROJ_NETWORK", "ON")
    pyproj.network.set_network_enabled(True)
    try:
        again, notes_again = placed("EPSG:31467", 3_500_000.0, 5_500_000.0)
    finally:
        pyproj.network.set_network_enabled(False)

    assert "needs de_adv_BETA2007.tif" in notes[0].what
    assert notes_again == notes
    assert again.lat_rad == places.lat_rad
    assert again.lon_rad == places.lon_rad


def test_three_modules_use_pyproj():
    """Two bring places to WGS 84, one of them those of earth-centred axes; the third from there."""
    package = Path(unbend.__file__).parent
    at_start = re.compile(r"^\s*(import|from) pyproj", re.M)
    users = [path.name for path in package.rglob("*.py") if at_start.search(path.read_text())]
    # One lists the files of its grids, another only loads it, before ecCodes.
    assert sorted(users) == [
        "coordinate_systems.py",
        "fingerprint.py",
        "geocentric_datums.py",
        "map_grids.py",
        "weather_files.py",
    ]
