"""The three sigmas of a correction against corrections with changed inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.refraction import (
    BrownConrady,
    Camera,
    Exposures,
    StationSigmas,
    apply_refraction,
    correct_observations,
    ray_table,
    refraction_angle,
    uncertainty_of,
)
from unbend.refraction.status_codes import FAR_BRANCH, NO_GROUND, NO_STATION
from unbend.refraction.uncertainty.sigmas import PARTIALS
from unbend.units import DEGREE

RADIUS = 6_371_000.0
H_C = 2680.0
CAMERA = Camera(
    14_000,
    10_600,
    11_000.0,
    11_200.0,
    7012.4,
    5291.7,
    BrownConrady(-0.02, 0.01, -0.002, 2e-4, -1e-4),
)
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
# Aircraft banked and pitched, its camera 40 degrees to the side: nothing is level here.
BODY = Rotation.from_euler("zxy", [33.0, 7.0, -11.0], degrees=True).as_matrix()
TILTED = Rotation.from_euler("zyx", [20.0, 5.0, 40.0], degrees=True).as_matrix() @ DOWN @ BODY
TILT = 0.4 * DEGREE
YAW = 1.1 * DEGREE
HEIGHT = 12.0
GROUND = 9.0


@pytest.fixture(scope="module")
def air(airs):
    return airs.air()


def exposed(profile, rotation=TILTED, h_c=H_C, cabin=0.0) -> Exposures:
    outside = profile.refractivity(np.array([h_c]))
    return Exposures(
        np.array([True]),
        rotation[None],
        np.array([0.8]),
        np.array([h_c]),
        outside,
        outside + cabin,
        radius_m=RADIUS,
    )


def station_sigmas(tilt=TILT, yaw=YAW, height=HEIGHT, axis=(0.0, 0.0, 1.0), n=1) -> StationSigmas:
    return StationSigmas(
        np.full(n, tilt),
        np.full(n, yaw),
        np.tile(np.asarray(axis, float), (n, 1)),
        np.full(n, height),
        np.full((n, 4), 1e-6),
    )


def points(n=400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    x = rng.uniform(0, CAMERA.width_px, n)
    y = rng.uniform(0, CAMERA.height_px, n)
    return x, y, rng.uniform(0.0, 700.0, n)


def shifts(air, ex, x, y, h_g, **more):
    one = np.zeros(x.size, np.int64)
    return correct_observations(x, y, h_g, one, ex, camera=CAMERA, table=ray_table(air), **more)


def with_sigmas(air, ex, stations, x, y, h_g, covariance=None, sigma=GROUND):
    uncertainty = uncertainty_of(
        air,
        covariance,
        ex,
        stations,
        [(CAMERA, np.array([True]))],
        ground_heights_m=(-600.0, 10_000.0),
    )
    return shifts(air, ex, x, y, h_g, uncertainty=uncertainty, sigma_h_g=np.full(x.size, sigma))


def central(plus, minus) -> np.ndarray:
    """(2, n) what one sigma does to dx and dy."""
    return 0.5 * np.stack([plus.dx_px - minus.dx_px, plus.dy_px - minus.dy_px])


def turned(ex: Exposures, axis, angle: float) -> Exposures:
    """The camera turned about an axis of its own."""
    turn = Rotation.from_rotvec(angle * np.asarray(axis)).as_matrix()
    return replace(ex, rotation=turn @ ex.rotation)


def test_the_station_against_a_turned_and_lifted_camera(air):
    """Tilt about two axes of the body, yaw about its third, height: in quadrature."""
    profile, _ = air
    ex, (x, y, h_g) = exposed(profile), points()
    # The columns are the body's axes in the camera frame.
    axes = Rotation.from_euler("zyx", [20.0, 5.0, 40.0], degrees=True).as_matrix() @ DOWN
    yaw_axis = -axes[:, 2]
    sigmas = with_sigmas(profile, ex, station_sigmas(axis=yaw_axis), x, y, h_g).sigmas
    variance = np.zeros((2, x.size))
    for axis, sigma in ((axes[:, 0], TILT), (axes[:, 1], TILT), (yaw_axis, YAW)):
        both = (shifts(profile, turned(ex, axis, s * sigma), x, y, h_g) for s in (1.0, -1.0))
        variance += central(*both) ** 2
    high, low = (
        shifts(profile, exposed(profile, h_c=H_C + d), x, y, h_g) for d in (HEIGHT, -HEIGHT)
    )
    variance += central(high, low) ** 2
    expected = np.sqrt(variance)
    # Half a degree is not quite a small angle, where a shift of some pixels hardly changes.
    for found, true in zip((sigmas.station_dx_px, sigmas.station_dy_px), expected, strict=True):
        np.testing.assert_allclose(found, true, rtol=0.01, atol=0.003 * np.median(expected))


def test_the_height_of_the_station_alone(air):
    profile, _ = air
    ex, (x, y, h_g) = exposed(profile), points()
    sigmas = with_sigmas(profile, ex, station_sigmas(tilt=0.0, yaw=0.0), x, y, h_g).sigmas
    high, low = (
        shifts(profile, exposed(profile, h_c=H_C + d), x, y, h_g) for d in (HEIGHT, -HEIGHT)
    )
    expected = np.abs(central(high, low))
    for found, true in zip((sigmas.station_dx_px, sigmas.station_dy_px), expected, strict=True):
        np.testing.assert_allclose(found, true, rtol=0.01, atol=0.002 * np.median(expected))


def test_a_turn_about_the_vertical_changes_nothing(air):
    """Level aircraft, any camera: no yaw. The camera is the same seen from its own frame."""
    profile, _ = air
    ex, (x, y, h_g) = exposed(profile), points(50)
    nadir = -ex.rotation[0, :, 2]
    steady = station_sigmas(tilt=0.0, yaw=5.0 * DEGREE, height=0.0, axis=nadir)
    sigmas = with_sigmas(profile, ex, steady, x, y, h_g).sigmas
    assert float(np.max(sigmas.station_dx_px)) < 1e-6
    # About the axis of a camera 40 degrees off the vertical it turns the shift by 9 %.
    swung = station_sigmas(tilt=0.0, yaw=5.0 * DEGREE, height=0.0)
    found = with_sigmas(profile, ex, swung, x, y, h_g)
    turned_by = np.hypot(found.sigmas.station_dx_px, found.sigmas.station_dy_px)
    assert 0.04 < float(np.median(turned_by / np.hypot(found.dx_px, found.dy_px))) < 0.12


def test_the_ground_against_a_raised_point(air):
    profile, _ = air
    ex, (x, y, h_g) = exposed(profile, cabin=6e-5), points()
    sigmas = with_sigmas(profile, ex, station_sigmas(), x, y, h_g).sigmas
    raised, lowered = (shifts(profile, ex, x, y, h_g + d) for d in (GROUND, -GROUND))
    expected = np.abs(central(raised, lowered))
    for found, true in zip((sigmas.ground_dx_px, sigmas.ground_dy_px), expected, strict=True):
        np.testing.assert_allclose(found, true, rtol=0.01, atol=0.002 * np.median(expected))


def test_the_air_against_drawn_air(airs, air):
    """300 airs from the covariance, each corrected with: a sigma of 300 is good to 4 %."""
    profile, covariance = air
    ex, (x, y, h_g) = exposed(profile), points(40)
    sigmas = with_sigmas(profile, ex, station_sigmas(), x, y, h_g, covariance).sigmas
    rng = np.random.default_rng(8)
    drawn = [shifts(airs.drawn(rng), ex, x, y, h_g) for _ in range(300)]
    for name, found in (
        ("dx_px", sigmas.air_dx_px),
        ("dy_px", sigmas.air_dy_px),
        ("r_c_rad", sigmas.r_c_rad),
    ):
        spread = np.std([getattr(one, name) for one in drawn], axis=0)
        np.testing.assert_allclose(found, spread, rtol=0.12)


def test_a_tilt_of_half_a_degree(air):
    """1.8, 2.1, 3.7 % of R at 45, 60, 75 degrees; 13 % at 85, to first order (15 if it adds)."""
    profile, _ = air
    narrow = Camera(200, 200, 20_000.0, 20_000.0, 100.0, 100.0)
    share = []
    for degrees in (45.0, 60.0, 75.0, 85.0):
        looking = Rotation.from_euler("x", -degrees, degrees=True).as_matrix() @ DOWN
        ex = exposed(profile, looking, 10_000.0)
        uncertainty = uncertainty_of(
            profile,
            None,
            ex,
            station_sigmas(0.5 * DEGREE, 0.5 * DEGREE, 0.0),
            [(narrow, np.array([True]))],
            ground_heights_m=(0.0, 0.0),
        )
        centre = np.array([100.0])
        found = correct_observations(
            centre,
            centre,
            np.zeros(1),
            np.zeros(1, np.int64),
            ex,
            camera=narrow,
            table=ray_table(profile),
            uncertainty=uncertainty,
        )
        assert abs(found.dx_px[0]) < 1e-9
        share.append(100.0 * float(found.sigmas.station_dy_px[0] / abs(found.dy_px[0])))
        across = float(found.sigmas.station_dx_px[0] / abs(found.dy_px[0]))
        np.testing.assert_allclose(across, 0.5 * DEGREE / np.sin(degrees * DEGREE), rtol=1e-3)
    np.testing.assert_allclose(share, [1.75, 2.02, 3.57, 13.0], rtol=0.01)
    added = [refraction_angle(profile, 10_000.0, 0.0, d * DEGREE) for d in (85.0, 85.5)]
    np.testing.assert_allclose(added[1] / added[0] - 1.0, 0.15, atol=0.005)


def test_exactly_at_the_nadir(air):
    """There the shift is zero in every direction, and a tilt moves it alike in each."""
    profile, _ = air
    ex = exposed(profile, DOWN)
    pinhole = replace(CAMERA, fy_px=11_000.0, distortion=BrownConrady())
    uncertainty = uncertainty_of(
        profile,
        None,
        ex,
        station_sigmas(),
        [(pinhole, np.array([True]))],
        ground_heights_m=(-600.0, 1e4),
    )
    x = np.array([pinhole.cx_px, pinhole.cx_px + 1.0])
    y = np.array([pinhole.cy_px, pinhole.cy_px])
    found = correct_observations(
        x,
        y,
        np.zeros(2),
        np.zeros(2, np.int64),
        ex,
        camera=pinhole,
        table=ray_table(profile),
        uncertainty=uncertainty,
        sigma_h_g=np.full(2, GROUND),
    )
    s = found.sigmas
    expected = TILT * found.r_c_rad[1] * pinhole.fx_px / (1.0 / pinhole.fx_px)
    for column in (s.station_dx_px, s.station_dy_px):
        np.testing.assert_allclose(column, expected, rtol=2e-3)
    assert s.ground_dx_px[0] == s.ground_dy_px[0] == 0.0


@pytest.mark.parametrize("order", [[0, 1, 0, 1], [1, 0, 1, 0] * 30])
def test_rows_in_any_order(air, order):
    """Mixed exposures are sorted inside and come back in their places."""
    profile, covariance = air
    ex = exposed(profile)
    two = replace(
        ex,
        usable=np.ones(2, bool),
        rotation=np.stack([TILTED, DOWN]),
        latitude_rad=np.full(2, 0.8),
        height_m=np.array([H_C, 2700.0]),
        refractivity_outside=profile.refractivity(np.array([H_C, 2700.0])),
        refractivity_cabin=profile.refractivity(np.array([H_C, 2700.0])),
    )
    uncertainty = uncertainty_of(
        profile,
        covariance,
        two,
        station_sigmas(n=2),
        [(CAMERA, np.ones(2, bool))],
        ground_heights_m=(0.0, 900.0),
    )
    row = np.array(order)
    x, y, h_g = points(row.size)

    def sigmas(rows):
        return correct_observations(
            x[rows],
            y[rows],
            h_g[rows],
            row[rows],
            two,
            camera=CAMERA,
            table=ray_table(profile),
            uncertainty=uncertainty,
            sigma_h_g=1.0 + 0.25 * rows,  # another in each row
        ).sigmas._asdict()

    together = sigmas(np.arange(row.size))
    for i in range(min(row.size, 6)):
        alone = sigmas(np.array([i]))
        for name, values in together.items():
            np.testing.assert_array_equal(values[i], alone[name][0])


def test_what_is_unknown_is_not_a_number(air):
    profile, covariance = air
    ex, (x, y, h_g) = exposed(profile), points(30)
    known = with_sigmas(profile, ex, station_sigmas(), x, y, h_g, covariance).sigmas._asdict()
    no_window = {"dx_dncc_px", "dy_dncc_px"}
    for name, values in known.items():
        assert (np.isnan if name in no_window else np.isfinite)(values).all()

    def lost(**changed) -> set[str]:
        how = {"stations": station_sigmas(), "covariance": covariance, "sigma": GROUND} | changed
        stations = how.pop("stations")
        columns = with_sigmas(profile, ex, stations, x, y, h_g, **how).sigmas._asdict()
        for name, values in columns.items():
            assert np.isnan(values).all() or np.array_equal(values, known[name])
        lacking = {name for name, values in columns.items() if np.isnan(values).all()}
        return lacking - no_window

    assert lost(covariance=None) == {"r_c_rad", "air_dx_px", "air_dy_px", "dx_ds_px", "dy_ds_px"}
    assert lost(stations=station_sigmas(tilt=np.nan)) == {"station_dx_px", "station_dy_px"}
    assert lost(sigma=np.nan) == {"ground_dx_px", "ground_dy_px"}
    # A height without a sigma does not count; what the attitude does is the larger by far.
    level = with_sigmas(profile, ex, station_sigmas(height=np.nan), x, y, h_g).sigmas
    exact = with_sigmas(profile, ex, station_sigmas(height=0.0), x, y, h_g).sigmas
    np.testing.assert_array_equal(level.station_dx_px, exact.station_dx_px)


def test_without_a_correction_no_sigma(air):
    profile, covariance = air
    ex, (x, y, h_g) = exposed(profile), points(4)
    h_g[1] = np.nan
    row = np.array([0, 0, -1, 0])
    uncertainty = uncertainty_of(
        profile,
        covariance,
        ex,
        station_sigmas(),
        [(CAMERA, np.array([True]))],
        ground_heights_m=(0.0, 900.0),
    )
    found = correct_observations(
        x,
        y,
        h_g,
        row,
        ex,
        camera=CAMERA,
        table=ray_table(profile),
        uncertainty=uncertainty,
        sigma_h_g=np.full(4, GROUND),
    )
    assert found.status[1:3].tolist() == [NO_GROUND, NO_STATION]
    for name, values in found.sigmas._asdict().items():
        no_window = "dncc" in name
        assert np.isnan(values).tolist() == [no_window, True, True, no_window]
    assert set(found.to_pandas()) >= {"sigma_air_dx_px", "sigma_r_c_rad", "status"}


def test_the_far_branch_has_none(air):
    """Sigmas are those of the near crossing; a distance that means the other one leaves none."""
    profile, _ = air
    level = Rotation.from_euler("x", -88.0, degrees=True).as_matrix() @ DOWN
    ex = exposed(profile, level, 6000.0)
    narrow = Camera(200, 200, 20_000.0, 20_000.0, 100.0, 100.0)
    uncertainty = uncertainty_of(
        profile,
        None,
        ex,
        station_sigmas(),
        [(narrow, np.array([True]))],
        ground_heights_m=(0.0, 6000.0),
    )
    centre = np.full(2, 100.0)
    h_g = np.full(2, 5900.0)
    found = correct_observations(
        centre,
        centre,
        h_g,
        np.zeros(2, np.int64),
        ex,
        camera=narrow,
        table=ray_table(profile),
        distance_m=np.array([3000.0, 500_000.0]),
        uncertainty=uncertainty,
    )
    assert found.status[1] == FAR_BRANCH
    assert np.isfinite(found.dy_px).all()
    assert np.isnan(found.sigmas.station_dy_px).tolist() == [False, True]


def test_displacing_has_the_sigmas_of_where_it_ends(air):
    profile, covariance = air
    ex, (x, y, h_g) = exposed(profile), points(60)
    uncertainty = uncertainty_of(
        profile,
        covariance,
        ex,
        station_sigmas(),
        [(CAMERA, np.array([True]))],
        ground_heights_m=(0.0, 900.0),
    )
    how = {"uncertainty": uncertainty, "sigma_h_g": np.full(x.size, GROUND)}
    there = apply_refraction(
        x, y, h_g, np.zeros(x.size, np.int64), ex, camera=CAMERA, table=ray_table(profile), **how
    )
    back = shifts(profile, ex, there.x_corrected_px, there.y_corrected_px, h_g, **how)
    for name, values in there.sigmas._asdict().items():
        sign = -1.0 if name in PARTIALS else 1.0  # displaced is where corrected comes from
        np.testing.assert_allclose(values, sign * getattr(back.sigmas, name), rtol=1e-6)


def test_nobody_flies(air):
    profile, covariance = air
    ex = replace(exposed(profile), usable=np.array([False]))
    cameras = [(CAMERA, np.array([True]))]
    assert (
        uncertainty_of(
            profile, covariance, ex, station_sigmas(), cameras, ground_heights_m=(0.0, 1.0)
        )
        is None
    )
