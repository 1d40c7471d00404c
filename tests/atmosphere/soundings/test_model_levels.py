"""The 137 levels of ERA5 against ECMWF's published pressures, and heights of known air on them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_trapezoid

from tests.atmosphere.adjusting import all_airs
from tests.atmosphere.values import HYDROSTATIC_K_PER_M
from tests.helpers import refused
from tests.model_files import PRESSURE_LEVELS
from unbend.atmosphere.soundings.model_column import model_column
from unbend.atmosphere.soundings.model_field import ModelField, checked_field
from unbend.atmosphere.soundings.model_levels import half_levels, level_coefficients
from unbend.errors import InputError

# "L137 model level definitions", ECMWF: pressures of the half levels 1 to 137 [hPa] over a surface
# of 1013.25 hPa.
PUBLISHED = """
0.02 0.031 0.0467 0.0683 0.0975 0.1361 0.1861 0.2499 0.3299 0.4288 0.5496 0.6952 0.869 1.0742
1.3143 1.5928 1.9134 2.2797 2.6954 3.1642 3.6898 4.2759 4.9262 5.6441 6.4334 7.2974 8.2397
9.2634 10.3720 11.5685 12.8561 14.2377 15.7162 17.2945 18.9752 20.7610 22.6543 24.6577 26.7735
29.0039 31.3512 33.8174 36.4047 39.1149 41.9493 44.9082 47.9915 51.1990 54.5299 57.9834 61.5607
65.2695 69.1187 73.1187 77.2810 81.6182 86.1450 90.8774 95.8280 101.0047 106.4153 112.0681
117.9714 124.1337 130.5637 137.2703 144.2624 151.5493 159.1403 167.0450 175.2731 183.8344
192.7389 201.9969 211.6186 221.6146 231.9954 242.7719 253.9549 265.5556 277.5852 290.0548
302.9762 316.3607 330.2202 344.5663 359.4111 374.7666 390.6450 407.0583 424.0190 441.5395
459.6321 478.3096 497.5845 517.4198 537.7195 558.3430 579.1926 600.1668 621.1624 642.0764
662.8084 683.2620 703.3467 722.9795 742.0855 760.5996 778.4661 795.6396 812.0847 827.7756
842.6959 856.8376 870.2004 882.7910 894.6222 905.7116 916.0815 925.7571 934.7666 943.1399
950.9082 958.1037 964.7584 970.9046 976.5737 981.7968 986.6036 991.0230 995.0824 998.8081
1002.2250 1005.3562 1008.2239 1010.8487 1013.2500
"""


def test_half_levels_are_the_published_ones():
    published = np.array(PUBLISHED.split(), float)
    half_hpa = half_levels(np.array([101_325.0]))[0, 1:] / 100.0
    assert half_hpa == pytest.approx(published, abs=5.1e-5)  # four decimals


def test_coefficients_are_smooth_and_end_at_nothing_and_at_the_surface():
    a, b = level_coefficients()
    assert (a[0], b[0]) == (0.0, 0.0)
    assert (a[-1], b[-1]) == (0.0, 1.0)
    # A wrong digit in one row shows in the third differences, where the next rows do not.
    assert np.abs(np.diff(a, 3)).max() < 12.0
    assert np.abs(np.diff(b, 3)).max() < 2e-4
    half = half_levels(np.array([101_325.0, 60_000.0]))
    assert (np.diff(half, axis=1) > 0.0).all()


def full_levels(surface_pa):
    """Pressures [Pa] of the 137 levels: means of their half levels."""
    (half,) = half_levels(np.array([surface_pa]))
    return 0.5 * (half[1:] + half[:-1])


def column_field(level, t, q, *, ground_m, surface_pa, **more):
    """A field of one time and node, from columns (l,)."""
    return ModelField(
        "era5.nc",
        np.zeros(1, np.int64),
        np.zeros(1),
        np.zeros(1),
        level,
        np.reshape(t, (1, -1, 1, 1)),
        np.reshape(q, (1, -1, 1, 1)),
        surface=np.full((1, 1, 1, 1), ground_m),
        log_surface_pa=np.full((1, 1, 1, 1), np.log(surface_pa)),
        **more,
    )


@pytest.mark.parametrize("first", [1, 60])
def test_heights_and_pressures_of_model_levels_are_those_of_known_air(first):
    """Within 1e-4 of p up to 10 km, as 0.8 m: levels are means of half levels, not their air.

    The air has two lapse rates, is moist below 3 km, and integrated every metre.
    """
    height = np.arange(0.0, 40_000.0)
    t = np.maximum(288.0 - 6.5e-3 * height, 217.0)
    q = 0.012 * np.exp(-height / 2500.0)
    vapour = q / (0.622 + 0.378 * q)
    fall = HYDROSTATIC_K_PER_M * (1.0 - 0.378 * vapour) / t
    log_p = np.log(100_500.0) - cumulative_trapezoid(fall, height, initial=0.0)
    surface_pa = np.exp(log_p[300])
    log_level = np.log(full_levels(surface_pa)[first - 1 :])
    h = np.interp(-log_level, -log_p, height)
    t_of_levels = np.interp(h, height, t)
    field = column_field(
        np.arange(first, 138.0),
        t_of_levels,
        np.interp(h, height, q),
        ground_m=300.0,
        surface_pa=surface_pa,
        on_model_levels=True,
    )

    air = field.columns(
        np.zeros(1),
        np.zeros(1),
        np.zeros(1, np.int64),
    )

    assert_allclose(air.log_pressure[0], log_level, rtol=1e-12)
    assert_allclose(air.temperature_k[0], t_of_levels)
    assert_allclose(air.vapour[0], np.interp(h, height, vapour), rtol=1e-6)
    off = np.abs(np.interp(air.height[0], height, log_p) - log_level)
    low = h < 10_000.0
    assert low.sum() == 57
    assert off[low].max() < 1e-4
    assert off[h < 30_000.0].max() < 5e-4


COARSE = np.array(["200", "250", "300", "400", "500", "700", "850", "925", "1000"], float)
FINE = np.array(PRESSURE_LEVELS[::-1])
"""Pressures of levels [hPa]."""


@pytest.mark.parametrize("kind", ["model", "coarse", "fine"])
@pytest.mark.parametrize("number", range(14))
def test_real_columns_on_coarse_and_model_levels_are_air(number, kind):
    """Nine soundings and five extremes: inversions of 15 K, a desert's noon."""
    truth = all_airs()[number]
    on_model_levels = kind == "model"
    levels_pa = {
        "model": full_levels(truth.p0),
        "coarse": 100.0 * COARSE,
        "fine": 100.0 * FINE,
    }
    p = levels_pa[kind]
    level = np.arange(1.0, p.size + 1) if on_model_levels else p
    inside = (p > truth.p[-1]) & (p < truth.p0)
    p = p[inside]
    e = truth.at_pressure(truth.e, p)
    heights = {}
    if not on_model_levels:
        height = truth.at_pressure(truth.H, p)
        heights["height"] = height.reshape(1, -1, 1, 1)
    field = column_field(
        level[inside],
        truth.at_pressure(truth.t, p),
        0.622 * e / (p - 0.378 * e),
        ground_m=truth.H[0],
        surface_pa=truth.p0,
        on_model_levels=on_model_levels,
        **heights,
    )

    checked, notes = checked_field(field, truth.name)
    _, notes_of_column = model_column(checked, (0.0, 0.0, 0), ground_h_m=truth.ground_m)

    assert {"MODEL-UNDERGROUND", "MODEL-EXTENDED"} >= {
        message.code for message in (*notes, *notes_of_column)
    }


@pytest.mark.parametrize("lowest_k", [282.0, np.nan])
def test_a_ground_is_metres_only_where_the_lowest_level_has_a_temperature(lowest_k):
    """Without, pressure cannot be reduced to sea level, and nothing contradicts geopotential."""
    ground_m = 900.0
    field = column_field(
        np.array([136.0, 137.0]),
        [281.9, lowest_k],
        [0.005, 0.005],
        ground_m=ground_m / 9.80665,
        surface_pa=101_325.0 * np.exp(-ground_m / 8300.0),
        on_model_levels=True,
        ground_has_unit=False,
    )

    checked, notes = checked_field(field, "era5.nc")

    is_known = bool(np.isfinite(lowest_k))
    assert [note.code for note in notes] == ["MODEL-GROUND-UNIT"] * is_known
    assert checked.ground_has_unit is is_known


NODES_DEG = [46.0, 46.25, 46.5, 46.75, 47.0]


def field_over(latitude_deg, longitude_deg):
    """Fields of one time and level over nodes [deg]; their values do not matter."""
    shape = (1, 1, len(latitude_deg), len(longitude_deg))
    return ModelField(
        "era5.nc",
        np.zeros(1, np.int64),
        np.radians(latitude_deg),
        np.radians(longitude_deg),
        np.array([85_000.0]),
        np.full(shape, 280.0),
        np.full(shape, 0.005),
    )


@pytest.mark.parametrize(
    ("north", "east", "away_km"),
    [
        (47.5, 8.5, 55.6),  # half a degree of 111.19 km
        (45.5, 8.5, 55.6),
        (46.5, 10.0, 76.5),  # one degree of longitude, cos(46.5 deg)
        (46.5, 7.0, 76.5),
        (47.5, 10.0, 93.4),
    ],
)
def test_places_beside_a_models_nodes_are_refused_with_their_distance(north, east, away_km):
    field = field_over(NODES_DEG, [8.0, 8.25, 8.5, 8.75, 9.0])
    norths = np.radians([46.0, 47.0, 46.1, north])
    easts = np.radians([8.0, 9.0, 8.99, east])
    field.refuse_outside(norths[:3], easts[:3])
    with refused("MODEL-AREA", InputError) as caught:
        field.refuse_outside(norths, easts)
    expected = {
        "north": north,
        "east": east,
        "away_km": away_km,
        "south_node": 46.0,
        "north_node": 47.0,
        "west_node": 8.0,
        "east_node": 9.0,
    }
    assert caught.value.values == pytest.approx(expected, rel=1e-3)


def test_a_hole_between_nodes_is_outside():
    """The nodes at 46.5 and 46.75 deg are missing: of three steps the middle is no neighbour."""
    north_east = np.radians([[46.5], [8.1]])
    holed = field_over([45.75, 46.0, 46.25, 47.0, 47.25], [8.0, 8.25, 8.5])
    with refused("MODEL-AREA", InputError) as caught:
        holed.refuse_outside(*north_east)
    assert_allclose(caught.value.values["away_km"], 27.8, rtol=1e-3)
    whole = field_over(NODES_DEG, [8.0, 8.3, 8.6])
    whole.refuse_outside(*north_east)
