"""The three sigmas of a correction against corrections with changed inputs."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.spatial.transform import Rotation

from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import (
    DOWN,
    NARROW,
    PINHOLE,
    SKEWED,
    corrected,
    displaced,
    exposure,
    looking,
    station_sigmas,
    together,
    turned,
    uncertainties,
)
from tests.refraction.uncertain_air import AIR, COVARIANCE, TABLE
from unbend.refraction import ray_table, refraction_angle
from unbend.refraction.status_codes import FAR_BRANCH, NO_GROUND, NO_STATION
from unbend.refraction.uncertainty.sigmas import PARTIALS
from unbend.units import DEGREE

H_C = 2680.0
# Aircraft banked and pitched, its camera 40 degrees to the side: nothing is level here.
BODY = turned("zxy", [33.0, 7.0, -11.0])
# The columns are the body's axes in the camera frame.
BODY_AXES = turned("zyx", [20.0, 5.0, 40.0]) @ DOWN
TILTED = BODY_AXES @ BODY
TILT = 0.4 * DEGREE
YAW = 1.1 * DEGREE
HEIGHT = 12.0
GROUND = 9.0


def exposed(rotation=TILTED, h_c=H_C, **options):
    return exposure(AIR, rotation, h_c=h_c, **options)


def known_to(tilt=TILT, yaw=YAW, height=HEIGHT, **options):
    return station_sigmas(tilt=tilt, yaw=yaw, height=height, cabin=1e-6, **options)


def points(count=100):
    """Pixels, and heights of the ground."""
    rng = np.random.default_rng(5)
    x = rng.uniform(0, SKEWED.width_px, count)
    y = rng.uniform(0, SKEWED.height_px, count)
    return {"x": x, "y": y, "h_g": rng.uniform(0.0, 700.0, count)}


def shifts(setup, seen, air=AIR, **options):
    return corrected(
        exposures=setup,
        table=ray_table(air),
        camera=SKEWED,
        **seen,
        **options,
    )


def with_sigmas(setup, stations, seen, covariance=None, sigma_h_g=GROUND):
    made = uncertainties(AIR, covariance, setup, SKEWED, stations)
    return shifts(setup, seen, uncertainty=made, sigma_h_g=sigma_h_g)


def halves(plus, minus):
    """(2, n) what one sigma does to dx and dy."""
    dx = plus.dx_px - minus.dx_px
    dy = plus.dy_px - minus.dy_px
    return 0.5 * np.stack([dx, dy])


def assert_sigmas(sigmas, kind, expected, atol):
    """Within 1 %, and a part of the usual where they nearly vanish."""
    dx = getattr(sigmas, f"{kind}_dx_px")
    dy = getattr(sigmas, f"{kind}_dy_px")
    usual = np.median(expected)
    assert_close(np.stack([dx, dy]), expected, rtol=0.01, atol=atol * usual)


def effect_of_height(seen):
    higher = shifts(exposed(h_c=H_C + HEIGHT), seen)
    lower = shifts(exposed(h_c=H_C - HEIGHT), seen)
    return halves(higher, lower)


def test_the_station_against_a_turned_and_lifted_camera():
    """Tilt about two axes of the body, yaw about its third, height: in quadrature."""
    setup = exposed()
    seen = points()
    yaw_axis = -BODY_AXES[:, 2]
    variance = effect_of_height(seen) ** 2
    one_sigma = [
        TILT * BODY_AXES[:, 0],
        TILT * BODY_AXES[:, 1],
        YAW * yaw_axis,
    ]
    for rotation_vector in one_sigma:
        turn = Rotation.from_rotvec(rotation_vector).as_matrix()
        forwards = replace(setup, rotation=turn @ setup.rotation)
        backwards = replace(setup, rotation=turn.T @ setup.rotation)
        variance += halves(shifts(forwards, seen), shifts(backwards, seen)) ** 2
    sigmas = with_sigmas(setup, known_to(axis=yaw_axis), seen).sigmas
    # Half a degree is not quite a small angle, where a shift of some pixels hardly changes.
    assert_sigmas(sigmas, "station", np.sqrt(variance), atol=0.003)


def test_a_turn_about_the_vertical_changes_nothing():
    """Level aircraft, any camera: no yaw. The camera is the same seen from its own frame."""
    setup = exposed()
    nadir = -setup.rotation[0, :, 2]
    steady = known_to(tilt=0.0, yaw=5.0 * DEGREE, height=0.0, axis=nadir)
    sigmas = with_sigmas(setup, steady, points(50)).sigmas
    assert np.max(sigmas.station_dx_px) < 1e-6


def test_the_ground_against_a_raised_point():
    setup = exposed(cabin_excess=6e-5)
    seen = points()
    h_g = seen["h_g"]
    raised = shifts(setup, seen | {"h_g": h_g + GROUND})
    lowered = shifts(setup, seen | {"h_g": h_g - GROUND})
    sigmas = with_sigmas(setup, known_to(), seen).sigmas
    expected = np.abs(halves(raised, lowered))
    assert_sigmas(sigmas, "ground", expected, atol=0.002)


def at_centre(setup, stations, ground_heights_m=(0.0, 6000.0), **options):
    """Corrections and sigmas in the middle of a narrow image."""
    options["uncertainty"] = uncertainties(
        AIR,
        None,
        setup,
        NARROW,
        stations,
        ground_heights_m=ground_heights_m,
    )
    return corrected(100.0, 100.0, setup, TABLE, camera=NARROW, **options)


@pytest.mark.parametrize(
    ("degrees", "percent"),
    [
        (45.0, 1.75),
        (60.0, 2.02),
        (75.0, 3.57),
        (85.0, 13.0),
    ],
)
def test_a_tilt_of_half_a_degree(degrees, percent):
    """1.8, 2.1, 3.7 % of R at 45, 60, 75 degrees; 13 % at 85, to first order."""
    half_a_degree = 0.5 * DEGREE
    stations = station_sigmas(tilt=half_a_degree, yaw=half_a_degree)
    setup = exposed(looking(degrees), 10_000.0)

    corrections = at_centre(setup, stations, (0.0, 0.0))

    assert abs(corrections.dx_px[0]) < 1e-9
    shift = np.abs(corrections.dy_px)
    share = corrections.sigmas.station_dy_px / shift
    assert_close(100.0 * share, [percent], rtol=0.01)
    across = corrections.sigmas.station_dx_px / shift
    expected = half_a_degree / np.sin(degrees * DEGREE)
    assert_close(across, [expected], rtol=1e-3)


def test_half_a_degree_more_adds_15_percent_at_85_degrees():
    """Where the first order has 13."""
    zeta = np.radians([85.0, 85.5])
    r_c, more = refraction_angle(AIR, 10_000.0, 0.0, zeta)
    assert_near(more / r_c - 1.0, 0.15, 0.005)


def test_exactly_at_the_nadir():
    """There the shift is zero in every direction, and a tilt moves it alike in each."""
    setup = exposed(DOWN)
    made = uncertainties(AIR, None, setup, PINHOLE, known_to())
    x = PINHOLE.cx_px + np.array([0.0, 1.0])
    corrections = corrected(
        x,
        PINHOLE.cy_px,
        setup,
        TABLE,
        uncertainty=made,
        sigma_h_g=GROUND,
    )
    sigmas = corrections.sigmas
    expected = TILT * corrections.r_c_rad[1] * PINHOLE.fx_px**2
    assert_close(sigmas.station_dx_px, expected, rtol=2e-3)
    assert_close(sigmas.station_dy_px, expected, rtol=2e-3)
    assert sigmas.ground_dx_px[0] == 0.0
    assert sigmas.ground_dy_px[0] == 0.0


@pytest.mark.parametrize(
    "order",
    [
        [0, 1] * 2,
        [1, 0] * 60,
    ],
    ids=len,
)
def test_rows_in_any_order(order):
    """Mixed exposures are sorted inside and come back in their places."""
    two = together(exposed(), exposed(DOWN, 2700.0))
    made = uncertainties(
        AIR,
        COVARIANCE,
        two,
        SKEWED,
        known_to(count=2),
        ground_heights_m=(0.0, 900.0),
    )
    row = np.array(order)
    columns = points(row.size)
    columns["row"] = row
    columns["sigma_h_g"] = 1.0 + 0.25 * np.arange(row.size)  # another in each row

    def sigmas(number):
        seen = {name: values[number] for name, values in columns.items()}
        return shifts(two, seen, uncertainty=made).sigmas._asdict()

    mixed = sigmas(np.arange(row.size))
    for i in range(4):
        alone = sigmas([i])
        for name, values in mixed.items():
            assert_array_equal(values[i], alone[name][0])


NO_WINDOW = {"dx_dncc_px", "dy_dncc_px"}
OF_AIR = {"r_c_rad", "air_dx_px", "air_dy_px", "dx_ds_px", "dy_ds_px"}


@pytest.mark.parametrize(
    ("changed", "lacking"),
    [
        ({}, set()),
        ({"covariance": None}, OF_AIR),
        ({"stations": known_to(tilt=np.nan)}, {"station_dx_px", "station_dy_px"}),
        ({"sigma_h_g": np.nan}, {"ground_dx_px", "ground_dy_px"}),
    ],
    ids=["all is known", "no covariance", "no tilt", "no sigma of the ground"],
)
def test_what_is_unknown_is_not_a_number(changed, lacking):
    setup = exposed()
    seen = points(30)
    options = {"stations": known_to(), "covariance": COVARIANCE}

    def sigmas(**options):
        return with_sigmas(setup, seen=seen, **options).sigmas._asdict()

    complete = sigmas(**options)
    for name, values in sigmas(**(options | changed)).items():
        if name in lacking | NO_WINDOW:
            assert np.isnan(values).all(), name
        else:
            assert np.isfinite(values).all(), name
            assert_array_equal(values, complete[name])


def test_a_height_without_a_sigma_does_not_count():
    """What the attitude does is the larger by far."""
    seen = points(30)
    unknown = with_sigmas(exposed(), known_to(height=np.nan), seen).sigmas
    exact = with_sigmas(exposed(), known_to(height=0.0), seen).sigmas
    assert_array_equal(unknown.station_dx_px, exact.station_dx_px)


def test_without_a_correction_no_sigma():
    setup = exposed()
    seen = points(4)
    seen["h_g"][1] = np.nan
    seen["row"] = np.array([0, 0, -1, 0])

    corrections = with_sigmas(setup, known_to(), seen, COVARIANCE)

    assert corrections.status[1:3].tolist() == [NO_GROUND, NO_STATION]
    for name, values in corrections.sigmas._asdict().items():
        is_lacking = name in NO_WINDOW
        assert np.isnan(values).tolist() == [is_lacking, True, True, is_lacking]
    columns = set(corrections.to_pandas())
    assert columns >= {"sigma_air_dx_px", "sigma_r_c_rad", "status"}


def test_the_far_branch_has_none():
    """Sigmas are those of the near crossing; a distance that means the other one leaves none."""
    setup = exposed(looking(88.0), 6000.0)
    distance = np.array([3000.0, 500_000.0])
    corrections = at_centre(setup, known_to(), h_g=5900.0, distance_m=distance)
    assert corrections.status[1] == FAR_BRANCH
    assert np.isfinite(corrections.dy_px).all()
    sigma = corrections.sigmas.station_dy_px
    assert np.isnan(sigma).tolist() == [False, True]


def test_displacing_has_the_sigmas_of_where_it_ends():
    setup = exposed()
    seen = points(60)
    options = {
        "uncertainty": uncertainties(AIR, COVARIANCE, setup, SKEWED, known_to()),
        "sigma_h_g": GROUND,
    }
    there = displaced(
        exposures=setup,
        table=TABLE,
        camera=SKEWED,
        **seen,
        **options,
    )
    end = seen | {"x": there.x_corrected_px, "y": there.y_corrected_px}
    back = shifts(setup, end, **options)
    for name, values in there.sigmas._asdict().items():
        expected = getattr(back.sigmas, name)
        if name in PARTIALS:
            expected = -expected  # displaced is where corrected comes from
        assert_close(values, expected, rtol=1e-6, equal_nan=True)


def test_nobody_flies():
    setup = replace(exposed(), usable=np.array([False]))
    assert uncertainties(AIR, COVARIANCE, setup, SKEWED, known_to()) is None
