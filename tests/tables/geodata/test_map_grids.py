"""Results in a stated coordinate system. Truth: PROJ's own coordinates, convergence and scale."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from unbend.errors import ConfigError
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


def opened(crs, lat, lon, **options):
    defaults = {"geoid": None, "needs_angles": True}
    lat = np.radians(np.atleast_1d(lat))
    lon = np.radians(np.atleast_1d(lon))
    return open_grid(crs, lat, lon, **(defaults | options))


def refusal(crs, lat=47.4, lon=8.6, **options) -> ConfigError:
    with pytest.raises(ConfigError) as refused:
        opened(crs, lat, lon, **options)
    assert refused.value.code == "EXPORT-CRS"
    assert refused.value.exit_code == 2
    assert refused.value.remedy
    return refused.value


def grid_of(value: float) -> GeoidGrid:
    values = np.full((181, 361), value, np.float32)
    return GeoidGrid("national.gtx", values, -90.0, -180.0, 1.0, 1.0)


@pytest.mark.parametrize("crs", SYSTEMS)
def test_coordinates_convergence_and_scale_are_those_of_proj(crs):
    lat, lon, datum_shift = SYSTEMS[crs]
    grid, _ = opened(crs, lat, lon)
    x, y = grid.coordinates(np.radians([lat]), np.radians([lon]))
    transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    np.testing.assert_allclose((x[0], y[0]), transformer.transform(lon, lat), atol=1e-6)
    axes = grid.axes_at(np.radians([lat]), np.radians([lon]))
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


def test_a_grid_in_feet_says_so_and_has_heights_in_feet():
    grid, _ = opened("EPSG:2263", 40.8, -73.6)
    foot = 1200.0 / 3937.0
    assert (grid.unit.suffix, grid.height.unit.suffix) == ("us_ft", "us_ft")
    place = np.radians([40.8]), np.radians([-73.6])
    height = grid.height.heights(*place, np.array([100.0]), np.array([70.0]))
    assert height[0] == pytest.approx(70.0 / foot)


def test_what_heights_count_from():
    """Without a vertical part the ellipsoid; EGM96 and MSL are sea level; others need a grid."""
    place = (np.radians([47.4]), np.radians([8.6]))
    msl = np.array([452.0])
    ellipsoid = [500.0]

    def height(crs, **options):
        grid, _ = opened(crs, 47.4, 8.6, **options)
        return grid.height.heights(*place, msl, np.array(ellipsoid))[0], grid

    assert height("EPSG:25832")[0] == 500.0
    assert height("EPSG:25832+5773")[0] == 452.0
    assert height("EPSG:25832+5715", geoid=grid_of(48.0))[0] == -452.0  # a depth
    value, grid = height("EPSG:25832+7837", geoid=grid_of(47.5))
    assert value == pytest.approx(452.5)
    assert "DHHN2016" in grid.height.name
    assert height("EPSG:4979", needs_angles=False)[0] == 500.0


def test_a_geoid_far_from_egm96_is_a_warning_and_another_height_is_refused():
    _, notes = opened("EPSG:25832+7837", 47.4, 8.6, geoid=grid_of(52.5))
    assert ("warning", "CRS-VERTICAL") in [(note.kind, note.code) for note in notes]
    assert "it is not the grid" in refusal("EPSG:25832+7837", geoid=grid_of(-47.5)).what
    hole = GeoidGrid("far.gtx", np.full((3, 3), 47.0, np.float32), -50.0, 100.0, 1.0, 1.0)
    assert "no value at the place" in refusal("EPSG:25832+7837", geoid=hole).what


@pytest.mark.parametrize(
    ("crs", "said"),
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
def test_what_is_unfit_is_refused_with_what_to_do(crs, said):
    assert said in refusal(crs).what


def test_other_unfit_systems():
    assert "mirrored" in refusal("EPSG:5513", 49.8, 15.5).what
    assert "EPSG:5514" in refusal("EPSG:5513", 49.8, 15.5).remedy
    assert "no vertical part" in refusal("EPSG:25832", geoid=grid_of(47.0)).what
    assert "no vertical part" in refusal("EPSG:25832+5773", geoid=grid_of(47.0)).what
    assert "no station has a position" in refusal("EPSG:25832", np.nan, np.nan).what
    assert "accuracy" in refusal("ESRI:53004", 47.4, 8.6).what
    assert "ellipsoid" in refusal("EPSG:9267", 47.4, 13.0, needs_angles=False).what


def test_the_area_of_use_to_two_degrees_is_a_warning():
    _, notes = opened("EPSG:25832", [47.4, 47.4], [12.5, 11.9])
    said = [note for note in notes if note.kind == "warning"]
    assert [(note.code, note.count) for note in said] == [("EXPORT-GRID", 1)]
    assert "area" in said[0].what
    _, notes = opened("EPSG:25832", 47.4, 11.9)
    assert {note.kind for note in notes} == {"note"}


def test_a_datum_without_its_grid_is_a_warning_that_names_it():
    _, notes = opened("EPSG:27700", 52.0, -1.0)
    (note,) = notes
    assert (note.kind, note.code) == ("warning", "EXPORT-GRID")
    assert "needs uk_os_OSTN15" in note.what


def test_a_scale_beyond_surveys_and_a_projection_that_is_not_conformal():
    place = np.radians([52.0]), np.radians([5.0])
    mercator, _ = opened("EPSG:3857", 52.0, 5.0)
    with pytest.raises(ConfigError, match="have different scales"):
        check_grid_axes(mercator.axes_at(*place), crs="EPSG:3857", name=mercator.name)
    equal_area, _ = opened("EPSG:3035", 52.0, 5.0)
    notes = check_grid_axes(equal_area.axes_at(*place), crs="EPSG:3035", name=equal_area.name)
    assert [note.kind for note in notes] == ["note", "warning"]
    factors = pyproj.Proj("EPSG:3035").get_factors(5.0, 52.0)
    expected = factors.tissot_semimajor - factors.tissot_semiminor
    assert f"{100.0 * expected:.3f} %" in notes[1].what
    utm, _ = opened("EPSG:25832", 47.4, 8.6)
    axes = utm.axes_at(np.radians([47.4]), np.radians([8.6]))
    (note,) = check_grid_axes(axes, crs="EPSG:25832", name=utm.name)
    factors = pyproj.Proj("EPSG:25832").get_factors(8.6, 47.4)
    assert f"{factors.meridian_convergence:.4f}°" in note.what
    assert f"{factors.meridional_scale:.6f}" in note.what
