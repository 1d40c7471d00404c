"""Results in a stated coordinate system. Truth: PROJ's own coordinates, convergence and scale."""

import numpy as np
import pyproj
import pytest

from tests.helpers import refused, with_code
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


def radians(*degrees):
    """Arrays of each of these."""
    return [np.radians(np.atleast_1d(values)) for values in degrees]


def opened(crs, lat, lon, *, geoid=None, needs_angles=True):
    return open_grid(
        crs,
        *radians(lat, lon),
        geoid=geoid,
        needs_angles=needs_angles,
    )


def axes_of(crs, lat, lon):
    grid, _ = opened(crs, lat, lon)
    return grid.axes_at(*radians(lat, lon))


def refusal(crs, lat=47.4, lon=8.6, **options):
    with refused("EXPORT-CRS") as caught:
        opened(crs, lat, lon, **options)
    assert caught.value.exit_code == 2
    return caught.value


@pytest.mark.parametrize("crs", SYSTEMS)
def test_coordinates_convergence_and_scale_are_those_of_proj(crs):
    lat, lon, datum_shift = SYSTEMS[crs]

    grid, _ = opened(crs, lat, lon)
    axes = grid.axes_at(*radians(lat, lon))

    transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    expected = transformer.transform([lon], [lat])
    assert_within(grid.coordinates(*radians(lat, lon)), expected, 1e-6)
    factors = pyproj.Proj(crs).get_factors(lon, lat)
    difference = np.degrees(axes.convergence_rad[0]) - factors.meridian_convergence
    within_a_turn = (difference + 180.0) % 360.0 - 180.0
    assert within_a_turn == pytest.approx(0.0, abs=1e-6 + 60 * datum_shift)
    scale = pytest.approx(factors.meridional_scale, abs=2e-8 + datum_shift)
    assert axes.scale[0] == scale
    assert axes.distortion[0] < 1e-7 + datum_shift


def test_axes_to_the_west_and_south_are_half_a_turn_from_grid_north():
    """South African Lo: y counts to the west, x to the south; the second axis looks south."""
    grid, _ = opened("EPSG:2048", -33.0, 19.4)
    axes = axes_of("EPSG:2048", -33.0, 19.4)

    to_north = pyproj.Proj("+proj=tmerc +lon_0=19 +ellps=WGS84")
    factors = to_north.get_factors(19.4, -33.0)
    turned = np.degrees(axes.convergence_rad[0]) - factors.meridian_convergence
    assert abs(turned) == pytest.approx(180.0, abs=1e-6)
    assert grid.axes == ("west", "south")


def height_in(grid, lat=47.4, lon=8.6):
    """Of a place 452 m above the sea and 500 m above the ellipsoid."""
    (height,) = grid.height.heights(
        *radians(lat, lon),
        np.array([452.0]),
        np.array([500.0]),
    )
    return height


def test_a_grid_in_feet_says_so_and_has_heights_in_feet():
    grid, _ = opened("EPSG:2263", 40.8, -73.6)
    assert grid.unit.suffix == "us_ft"
    assert grid.height.unit.suffix == "us_ft"
    feet = 500.0 * 3937.0 / 1200.0
    assert height_in(grid, 40.8, -73.6) == pytest.approx(feet)


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
    geoid = None
    if undulation is not None:
        geoid = level_geoid(undulation)
    has_axes = crs != "EPSG:4979"

    grid, _ = opened(crs, 47.4, 8.6, geoid=geoid, needs_angles=has_axes)

    assert height_in(grid) == pytest.approx(height)
    is_national = "7837" in crs
    assert ("DHHN2016" in grid.height.name) == is_national


def test_a_geoid_far_from_egm96_is_a_warning_and_another_height_is_refused():
    crs = "EPSG:25832+7837"  # heights of DHHN2016
    _, notes = opened(crs, 47.4, 8.6, geoid=level_geoid(52.5))
    kinds = {note.kind for note in with_code(notes, "CRS-VERTICAL")}
    assert "warning" in kinds

    other_sign = level_geoid(-47.5)
    assert "it is not the grid" in refusal(crs, geoid=other_sign).what

    values = np.full((3, 3), 47.0, np.float32)
    hole = GeoidGrid("far.gtx", values, -50.0, 100.0, 1.0, 1.0)
    assert "no value at the place" in refusal(crs, geoid=hole).what


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
    ("crs", "lat", "lon", "words"),
    [
        ("EPSG:25832", np.nan, np.nan, "no station has a position"),
        ("ESRI:53004", 47.4, 8.6, "accuracy"),
    ],
)
def test_systems_that_are_unfit_elsewhere(crs, lat, lon, words):
    assert words in refusal(crs, lat, lon).what


@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:25832+5773"])
def test_a_geoid_for_heights_that_need_none_is_refused(crs):
    assert "no vertical part" in refusal(crs, geoid=level_geoid(47.0)).what


def test_a_mirrored_system_has_one_that_is_not():
    error = refusal("EPSG:5513", 49.8, 15.5)
    assert "mirrored" in error.what
    assert "EPSG:5514" in error.remedy


def test_heights_above_another_ellipsoid_are_refused():
    assert "ellipsoid" in refusal("EPSG:9267", 47.4, 13.0, needs_angles=False).what


def height_notes(crs):
    """The texts of notes on the heights of a system."""
    _, notes = opened(crs, 47.4, 8.6, needs_angles=False)
    return [note.what for note in notes if "heights" in note.what]


def test_heights_of_a_system_without_a_vertical_part_are_named():
    (of_zone,) = height_notes("EPSG:25832")
    assert "(z) count from the ellipsoid of WGS 84" in of_zone
    assert "write --crs EPSG:25832+5773" in of_zone
    (of_projection,) = height_notes("+proj=utm +zone=32")
    assert "(z) count from the ellipsoid of WGS 84" in of_projection
    assert "--crs" not in of_projection


@pytest.mark.parametrize("crs", ["EPSG:25832+5773", "EPSG:4979"])
def test_heights_that_a_system_names_itself_need_no_note(crs):
    assert height_notes(crs) == []


def test_the_area_of_use_to_two_degrees_is_a_warning():
    lat = [47.4, 47.4]
    lon = [12.5, 11.9]
    _, notes = opened("EPSG:25832", lat, lon)
    (warning,) = [note for note in notes if note.kind == "warning"]
    assert warning.code == "EXPORT-GRID"
    assert warning.count == 1
    assert "area" in warning.what

    _, notes = opened("EPSG:25832", 47.4, 11.9)
    assert {note.kind for note in notes} == {"note"}


def test_a_datum_without_its_grid_is_a_warning_that_names_it():
    _, notes = opened("EPSG:27700", 52.0, -1.0)
    note, _ = notes
    assert note.kind == "warning"
    assert note.code == "EXPORT-GRID"
    assert "needs uk_os_OSTN15" in note.what


def checked_axes(crs, lat, lon):
    grid, _ = opened(crs, lat, lon)
    axes = axes_of(crs, lat, lon)
    return check_grid_axes(axes, crs=crs, name=grid.name)


def test_a_scale_beyond_surveys_is_refused():
    with pytest.raises(UnbendError, match="have different scales"):
        checked_axes("EPSG:3857", 52.0, 5.0)


def test_a_projection_that_is_not_conformal_is_a_warning():
    note, warning = checked_axes("EPSG:3035", 52.0, 5.0)

    assert note.kind == "note"
    assert warning.kind == "warning"
    factors = pyproj.Proj("EPSG:3035").get_factors(5.0, 52.0)
    difference = factors.tissot_semimajor - factors.tissot_semiminor
    assert f"{100.0 * difference:.3f} %" in warning.what


def test_convergence_and_scale_are_noted():
    (note,) = checked_axes("EPSG:25832", 47.4, 8.6)
    factors = pyproj.Proj("EPSG:25832").get_factors(8.6, 47.4)
    assert f"{factors.meridian_convergence:.4f}°" in note.what
    assert f"{factors.meridional_scale:.6f}" in note.what
