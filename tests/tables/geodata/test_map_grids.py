"""Results in a stated coordinate system. Truth: PROJ's own coordinates, convergence and scale."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from tests.helpers import refused
from tests.tables.checks import assert_within
from tests.tables.geodata.rasters import level_geoid
from unbend.errors import UnbendError
from unbend.geodesy import GeoidGrid
from unbend.tables.geodata.map_grids import check_grid_axes, open_grid

# A code, a place in its area of use (latitude, longitude), and a bound of the difference of scale
# and convergence by the shift of the datum, which PROJ's factors do not have.
SYSTEMS = {
    "EPSG:25832": (47.4, 8.6, 1e-9),
    "EPSG:32733": (-33.9, 18.4, 1e-9),
    "EPSG:2056": (47.0, 8.2, 1e-4),
    "EPSG:31468": (48.1, 11.5, 1e-4),
    "EPSG:2263": (40.8, -73.6, 1e-6),
    "EPSG:3031": (-75.0, 130.0, 1e-9),
    "EPSG:32660": (52.0, 179.9, 1e-9),
}


def opened(crs, lat, lon, *, geoid=None, needs_angles=True):
    places = np.radians(np.atleast_1d(lat)), np.radians(np.atleast_1d(lon))
    return open_grid(crs, *places, geoid=geoid, needs_angles=needs_angles)


def refusal(crs, lat=47.4, lon=8.6, **options) -> UnbendError:
    with refused("EXPORT-CRS") as caught:
        opened(crs, lat, lon, **options)
    assert caught.value.exit_code == 2
    return caught.value


@pytest.mark.parametrize("crs", SYSTEMS)
def test_coordinates_convergence_and_scale_are_those_of_proj(crs):
    lat, lon, datum_shift = SYSTEMS[crs]
    grid, _ = opened(crs, lat, lon)
    place = np.radians([lat]), np.radians([lon])
    transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    expected = np.reshape(transformer.transform(lon, lat), (2, 1))
    assert_within(grid.coordinates(*place), expected, 1e-6)
    axes = grid.axes_at(*place)
    factors = pyproj.Proj(crs).get_factors(lon, lat)
    difference = np.degrees(axes.convergence_rad[0]) - factors.meridian_convergence
    assert (difference + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6 + 60 * datum_shift)
    assert axes.scale[0] == pytest.approx(factors.meridional_scale, abs=2e-8 + datum_shift)
    assert axes.distortion[0] < 1e-7 + datum_shift


def test_axes_to_the_west_and_south_are_half_a_turn_from_grid_north():
    """South African Lo: y counts to the west, x to the south; the second axis looks south."""
    grid, _ = opened("EPSG:2048", -33.0, 19.4)
    axes = grid.axes_at(np.radians([-33.0]), np.radians([19.4]))
    northwards = pyproj.Proj("+proj=tmerc +lon_0=19 +ellps=WGS84").get_factors(19.4, -33.0)
    turned = np.degrees(axes.convergence_rad[0]) - northwards.meridian_convergence
    assert abs(turned) == pytest.approx(180.0, abs=1e-6)
    assert grid.axes == ("west", "south")


def height_in(grid, lat=47.4, lon=8.6) -> float:
    """Of a place 452 m above the sea and 500 m above the ellipsoid."""
    place = np.radians([lat]), np.radians([lon])
    return grid.height.heights(*place, np.array([452.0]), np.array([500.0]))[0]


def test_a_grid_in_feet_says_so_and_has_heights_in_feet():
    grid, _ = opened("EPSG:2263", 40.8, -73.6)
    assert grid.unit.suffix == "us_ft"
    assert grid.height.unit.suffix == "us_ft"
    assert height_in(grid, 40.8, -73.6) == pytest.approx(500.0 * 3937.0 / 1200.0)


@pytest.mark.parametrize(
    ("crs", "undulation", "height"),
    [
        ("EPSG:25832", None, 500.0),
        ("EPSG:25832+5773", None, 452.0),
        ("EPSG:25832+5715", 48.0, -452.0),  # a depth
        ("EPSG:25832+7837", 47.5, 452.5),
        ("EPSG:4979", None, 500.0),
    ],
)
def test_what_heights_count_from(crs, undulation, height):
    """Without a vertical part the ellipsoid; EGM96 and MSL are sea level; others need a grid."""
    geoid = None if undulation is None else level_geoid(undulation)
    grid, _ = opened(crs, 47.4, 8.6, geoid=geoid, needs_angles=crs != "EPSG:4979")
    assert height_in(grid) == pytest.approx(height)
    assert ("DHHN2016" in grid.height.name) == ("7837" in crs)


def test_a_geoid_far_from_egm96_is_a_warning_and_another_height_is_refused():
    _, notes = opened("EPSG:25832+7837", 47.4, 8.6, geoid=level_geoid(52.5))
    assert ("warning", "CRS-VERTICAL") in [(note.kind, note.code) for note in notes]
    assert "it is not the grid" in refusal("EPSG:25832+7837", geoid=level_geoid(-47.5)).what
    hole = GeoidGrid("far.gtx", np.full((3, 3), 47.0, np.float32), -50.0, 100.0, 1.0, 1.0)
    assert "no value at the place" in refusal("EPSG:25832+7837", geoid=hole).what


@pytest.mark.parametrize(
    ("crs", "words"),
    [
        ("EPSG:99999", "not a coordinate system"),
        ("UTM 32", "not a coordinate system"),
        ("EPSG:4978", "no map coordinates"),
        ("EPSG:5773", "no map coordinates"),
        ("EPSG:4326", "no grid for omega"),
        ("EPSG:4258+5773", "no grid for omega"),
        ("EPSG:32635", "outside the area"),
        ("EPSG:32732", "outside the area"),
        ("EPSG:25832+7837", "need the grid"),
        ("EPSG:25832+3855", "need the grid"),
    ],
)
def test_what_is_unfit_is_refused_with_what_to_do(crs, words):
    assert words in refusal(crs).what


@pytest.mark.parametrize(
    ("crs", "place", "options", "words"),
    [
        ("EPSG:5513", (49.8, 15.5), {}, "mirrored"),
        ("EPSG:25832", (47.4, 8.6), {"geoid": level_geoid(47.0)}, "no vertical part"),
        ("EPSG:25832+5773", (47.4, 8.6), {"geoid": level_geoid(47.0)}, "no vertical part"),
        ("EPSG:25832", (np.nan, np.nan), {}, "no station has a position"),
        ("ESRI:53004", (47.4, 8.6), {}, "accuracy"),
        ("EPSG:9267", (47.4, 13.0), {"needs_angles": False}, "ellipsoid"),
    ],
)
def test_other_unfit_systems(crs, place, options, words):
    assert words in refusal(crs, *place, **options).what


def test_a_mirrored_system_has_one_that_is_not():
    assert "EPSG:5514" in refusal("EPSG:5513", 49.8, 15.5).remedy


def test_the_area_of_use_to_two_degrees_is_a_warning():
    _, notes = opened("EPSG:25832", [47.4, 47.4], [12.5, 11.9])
    (warning,) = [note for note in notes if note.kind == "warning"]
    assert warning.code == "EXPORT-GRID"
    assert warning.count == 1
    assert "area" in warning.what
    _, notes = opened("EPSG:25832", 47.4, 11.9)
    assert {note.kind for note in notes} == {"note"}


def test_a_datum_without_its_grid_is_a_warning_that_names_it():
    _, notes = opened("EPSG:27700", 52.0, -1.0)
    (note,) = notes
    assert note.kind == "warning"
    assert note.code == "EXPORT-GRID"
    assert "needs uk_os_OSTN15" in note.what


def checked_axes(crs, lat, lon):
    grid, _ = opened(crs, lat, lon)
    axes = grid.axes_at(np.radians([lat]), np.radians([lon]))
    return check_grid_axes(axes, crs=crs, name=grid.name)


def test_a_scale_beyond_surveys_is_refused():
    with pytest.raises(UnbendError, match="have different scales"):
        checked_axes("EPSG:3857", 52.0, 5.0)


def test_a_projection_that_is_not_conformal_is_a_warning():
    notes = checked_axes("EPSG:3035", 52.0, 5.0)
    assert [note.kind for note in notes] == ["note", "warning"]
    factors = pyproj.Proj("EPSG:3035").get_factors(5.0, 52.0)
    expected = factors.tissot_semimajor - factors.tissot_semiminor
    assert f"{100.0 * expected:.3f} %" in notes[1].what


def test_convergence_and_scale_are_noted():
    (note,) = checked_axes("EPSG:25832", 47.4, 8.6)
    factors = pyproj.Proj("EPSG:25832").get_factors(8.6, 47.4)
    assert f"{factors.meridian_convergence:.4f}°" in note.what
    assert f"{factors.meridional_scale:.6f}" in note.what
