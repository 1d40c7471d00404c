"""The derivatives by the leading mode and by the cabin's air, against corrections in changed air.

The independent chain: the profile is changed along the mode, its hydrostatics and rays are made
anew, and the same pixels are corrected again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.layers import stack_layers
from unbend.refraction import (
    BrownConrady,
    Camera,
    Exposures,
    StationSigmas,
    apply_refraction,
    correct_observations,
    ray_table,
    uncertainty_of,
)
from unbend.refraction.uncertainty.sigmas import OPEN, SCHEDULED, SEALED

RADIUS = 6_371_000.0
CAMERA = Camera(
    14_000,
    10_600,
    20_000.0,
    20_200.0,
    7012.4,
    5291.7,
    BrownConrady(-0.02, 0.01, -0.002, 2e-4, -1e-4),
)
LONG = replace(CAMERA, fx_px=90_000.0, fy_px=90_500.0)  # 75 degrees and 5 to either side
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
CABIN = 2.4e-4
AHEAD = (0.0, 0.0, 1.0)
TILTED = tuple(Rotation.from_euler("xy", [25, -10], degrees=True).as_matrix()[:, 2])
GROUND = 100.0


def looking(degrees: float) -> np.ndarray:
    return Rotation.from_euler("zx", [20.0, -degrees], degrees=True).as_matrix() @ DOWN


def floor(degrees: float) -> tuple[float, ...]:
    """A level window, whatever the camera does."""
    return tuple(-looking(degrees)[:, 2])


# Camera, its nadir angle, normal of the window, what is in front.
LOOKS = {
    "nadir, open": (CAMERA, 0.0, AHEAD, OPEN),
    "nadir, level pane": (CAMERA, 0.0, AHEAD, SEALED),
    "nadir, tilted pane": (CAMERA, 0.0, TILTED, SEALED),
    "nadir, vented": (CAMERA, 0.0, AHEAD, SCHEDULED),
    "45, open": (CAMERA, 45.0, AHEAD, OPEN),
    "45, own pane": (CAMERA, 45.0, AHEAD, SEALED),
    "45, level pane": (CAMERA, 45.0, floor(45.0), SEALED),
    "75, open": (LONG, 75.0, AHEAD, OPEN),
    "75, own pane": (LONG, 75.0, AHEAD, SEALED),
    "75, tilted pane": (LONG, 75.0, TILTED, SEALED),
    "75, level pane": (LONG, 75.0, floor(75.0), SEALED),
}


def exposed(profile, look, cabin: float = CABIN) -> Exposures:
    _, degrees, normal, kind = look
    h = np.array([2680.0])
    outside = profile.refractivity(h)
    inside = {
        OPEN: outside,
        SEALED: np.array([cabin]),
        SCHEDULED: profile.index.refractivity(294.26, profile.pressure(h), 0.0),
    }[kind]
    return Exposures(
        np.array([True]),
        looking(degrees)[None],
        np.array([0.8]),
        h,
        outside,
        inside,
        np.array([normal]),
        radius_m=RADIUS,
    )


def pixels(camera, n=60) -> tuple[np.ndarray, np.ndarray]:
    return np.random.default_rng(5).uniform(0, 1, (2, n)) * [[camera.width_px], [camera.height_px]]


def corrected(profile, exposures, look, **more):
    x, y = pixels(look[0])
    zero = np.zeros(x.size, np.int64)
    return correct_observations(
        x,
        y,
        np.full(x.size, GROUND),
        zero,
        exposures,
        camera=look[0],
        table=ray_table(profile),
        **more,
    )


def prepared(profile, covariance, look):
    no_sigma = np.full(1, np.nan)
    return uncertainty_of(
        profile,
        covariance,
        exposed(profile, look),
        StationSigmas(no_sigma, no_sigma, np.array([AHEAD]), no_sigma),
        [(look[0], np.array([True]))],
        ground_heights_m=(-600.0, 10_000.0),
        window_kinds=np.array([look[3]]),
        typical_ground_m=GROUND,
    )


def along(airs, mode, sigmas: float):
    """The air that many sigmas along the mode."""
    size = airs.EDGES.size
    state = sigmas * mode.state
    return airs.profile_of(
        airs.temperatures() + state[:size], float(state[size]), airs.vapour() + state[size + 1 :]
    )


def difference(one, two) -> np.ndarray:
    return np.stack(
        [one.x_corrected_px - two.x_corrected_px, one.y_corrected_px - two.y_corrected_px]
    )


def is_close(found, expected) -> bool:
    """To 0.06 %, and 0.02 % of the usual where it nearly vanishes."""
    error = np.hypot(*(found - expected))
    size = np.hypot(*expected)
    return bool((error <= 6e-4 * size + 2e-4 * np.median(size)).all())


@pytest.fixture(scope="module")
def claims(airs):
    """By name: derivatives claimed, central differences, R alone, corrected less measured."""
    profile, covariance = airs.air()
    made = {}
    for name, look in LOOKS.items():
        uncertainty = prepared(profile, covariance, look)
        ours = corrected(profile, exposed(profile, look), look, uncertainty=uncertainty)
        step = 0.3
        more, less = (along(airs, uncertainty.mode, step * sign) for sign in (1.0, -1.0))
        unit = 2.0 * step * uncertainty.mode.sigma
        true = difference(*(corrected(a, exposed(a, look), look) for a in (more, less))) / unit
        same = exposed(profile, look)  # the window as it was
        of_r = difference(*(corrected(a, same, look) for a in (more, less))) / unit
        found = np.stack([ours.sigmas.dx_ds_px, ours.sigmas.dy_ds_px]).astype(float)
        made[name] = found, true, of_r, np.stack([ours.dx_px, ours.dy_px]), uncertainty
    return made


@pytest.mark.parametrize("name", LOOKS)
def test_the_derivative_is_a_difference_of_corrections(claims, name):
    found, true, of_r, shift, _ = claims[name]
    assert is_close(found, true)
    # What it is easily mistaken for is seen: the other sign; behind a pane R alone, and the shift.
    assert not is_close(-found, true)
    assert is_close(of_r, true) == name.endswith("open")
    assert name.endswith("open") or not is_close(shift, true)


def test_what_a_pane_does_to_it(claims):
    """N at the camera cancels behind a level pane; the shift itself is a fraction of it."""

    def share(name, number):
        found, *others = claims[name]
        return float(np.sum(found * others[number - 1]) / np.sum(found**2))

    assert share("nadir, level pane", 2) < 0.7
    assert share("nadir, level pane", 3) < 0.4
    assert 0.8 < share("nadir, open", 3) < 1.25


def sum_over_layers(warmer_k: float) -> tuple[float, float]:
    """Total and R_c over tan of the angle in the cabin, 10 degrees, from 6 km to the ground.

    Level layers of 1 m of the standard troposphere, n sin(zeta) the same in all and in the cabin;
    the pressure is held at the camera; n by Gladstone and Dale from 2.779e-4 (15 deg C, 550 nm).
    """
    h = np.arange(0.0, 6000.5, 1.0)
    kelvin = 288.15 - 0.0065 * h + warmer_k
    n_cabin = 1.0 + CABIN
    angle = np.radians(10.0)
    fall = 9.80665 * 0.0289644 / 8.31432 * np.diff(h) * 0.5 * (1 / kelvin[1:] + 1 / kelvin[:-1])
    pressure = 47_181.0 * np.exp(np.append(np.cumsum(fall[::-1])[::-1], 0.0))
    n = 1.0 + 2.779e-4 * (pressure / 101_325.0) * 288.15 / kelvin
    sine = n_cabin * np.sin(angle) / n
    chord = np.arctan2(trapezoid(sine / np.sqrt(1.0 - sine**2), h), h[-1])
    return (angle - chord) / np.tan(angle), (np.arcsin(sine[-1]) - chord) / np.tan(angle)


def test_one_kelvin_behind_a_level_pane():
    """Of a uniform kelvin, the pressure held at the camera, R_c has less than half."""
    more = sum_over_layers(0.5)
    less = sum_over_layers(-0.5)
    total, of_r = (1e6 * abs(a - b) for a, b in zip(more, less, strict=True))
    assert (total, of_r) == (pytest.approx(1.10, abs=0.02), pytest.approx(0.51, abs=0.005))
    profile = standard_atmosphere("us1976")
    airs = []
    for kelvin in (0.5, -0.5):
        layers = profile.layers
        vapour = np.append(layers.vapour, 0.0)
        top = 6000.0 * 6_356_766.0 / 6_362_766.0  # geopotential
        airs.append(
            replace(
                profile,
                layers=stack_layers(
                    layers.edge,
                    layers.edge_temperature + kelvin,
                    vapour,
                    layers.source,
                    anchor=(top, float(profile.pressure(6000.0))),
                    constant=profile.constant,
                ),
            )
        )
    h = np.array([6000.0])
    r_c = []
    shifted = []
    for air in airs:
        exposures = Exposures(
            np.array([True]),
            looking(0.0)[None],
            np.array([0.8]),
            h,
            air.refractivity(h),
            np.array([CABIN]),
            np.array([AHEAD]),
            radius_m=RADIUS,
        )
        x = np.array([CAMERA.cx_px + CAMERA.fx_px * np.tan(np.radians(10.0))])
        plain = replace(CAMERA, fy_px=CAMERA.fx_px, distortion=BrownConrady())
        done = correct_observations(
            x,
            np.array([plain.cy_px]),
            np.zeros(1),
            np.zeros(1, np.int64),
            exposures,
            camera=plain,
            table=ray_table(air),
        )
        shifted.append(np.arctan((done.x_corrected_px[0] - plain.cx_px) / plain.fx_px))
        r_c.append(done.r_c_rad[0])
    ppm = 1e6 / np.tan(np.radians(10.0))
    assert abs(shifted[0] - shifted[1]) * ppm == pytest.approx(total, rel=0.01)
    assert abs(r_c[0] - r_c[1]) * ppm == pytest.approx(of_r, rel=0.01)


@pytest.mark.parametrize("name", LOOKS)
def test_its_part_of_sigma_air(airs, claims, name):
    """Of one camera at one height nearly all; what the mode leaves is not negative."""
    look = LOOKS[name]
    uncertainty = claims[name][4]
    sigmas = corrected(
        airs.air()[0], exposed(airs.air()[0], look), look, uncertainty=uncertainty
    ).sigmas
    part = uncertainty.mode.sigma * np.hypot(sigmas.dx_ds_px, sigmas.dy_ds_px)
    whole = np.hypot(sigmas.air_dx_px, sigmas.air_dy_px)
    assert (part <= 1.005 * whole).all()
    share = np.sum(part**2) / np.sum(whole**2)
    np.testing.assert_allclose(share, uncertainty.mode.variance_share, atol=0.02)
    assert share > 0.9


def test_drawn_airs_move_along_it(airs, claims):
    """200 airs from the covariance: their first principal component is the column."""
    look = LOOKS["nadir, tilted pane"]
    found, *_, uncertainty = claims["nadir, tilted pane"]
    rng = np.random.default_rng(2)
    nominal = airs.air()[0]
    moved = []
    for _ in range(200):
        air = airs.drawn(rng)
        moved.append(
            difference(
                corrected(air, exposed(air, look), look),
                corrected(nominal, exposed(nominal, look), look),
            )
        )
    _, size, direction = np.linalg.svd(np.array(moved).reshape(200, -1), full_matrices=False)
    cosine = direction[0] @ found.ravel() / np.linalg.norm(found)
    assert abs(cosine) > 0.999
    one_sigma = size[0] / np.sqrt(200.0)  # good to 5 % of 200 draws
    np.testing.assert_allclose(uncertainty.mode.sigma * np.linalg.norm(found), one_sigma, rtol=0.15)


@pytest.mark.parametrize("name", [name for name, look in LOOKS.items() if look[3] == SEALED])
def test_the_air_in_the_cabin(airs, name):
    profile = airs.air()[0]
    look = LOOKS[name]
    step = 1e-6
    found = corrected(
        profile, exposed(profile, look), look, uncertainty=prepared(profile, None, look)
    ).sigmas
    true = difference(
        *(corrected(profile, exposed(profile, look, CABIN + d), look) for d in (step, -step))
    ) / (2.0 * step)
    assert is_close(np.stack([found.dx_dncc_px, found.dy_dncc_px]).astype(float), true)
    assert np.isnan(found.dx_ds_px).all()
    assert np.isnan(found.dy_ds_px).all()


def test_no_pane_no_cabin(airs):
    profile, covariance = airs.air()
    look = LOOKS["45, open"]
    sigmas = corrected(
        profile, exposed(profile, look), look, uncertainty=prepared(profile, covariance, look)
    ).sigmas
    assert np.isnan(sigmas.dx_dncc_px).all()
    assert np.isnan(sigmas.dy_dncc_px).all()


@pytest.mark.parametrize("name", ["45, own pane", "nadir, tilted pane"])
def test_displaced_observations_go_the_other_way(airs, name):
    profile, covariance = airs.air()
    look = LOOKS[name]
    uncertainty, (x, y) = prepared(profile, covariance, look), 0.9 * pixels(look[0]) + 100.0
    zero = np.zeros(x.size, np.int64)

    def displaced(air, exposures, **more):
        return apply_refraction(
            x,
            y,
            np.full(x.size, GROUND),
            zero,
            exposures,
            camera=look[0],
            table=ray_table(air),
            **more,
        )

    found = displaced(profile, exposed(profile, look), uncertainty=uncertainty).sigmas
    more, less = (along(airs, uncertainty.mode, sign) for sign in (0.3, -0.3))
    true = difference(*(displaced(a, exposed(a, look)) for a in (more, less)))
    true /= 0.6 * uncertainty.mode.sigma
    assert is_close(np.stack([found.dx_ds_px, found.dy_ds_px]).astype(float), true)
    denser, thinner = (displaced(profile, exposed(profile, look, CABIN + d)) for d in (1e-6, -1e-6))
    true = difference(denser, thinner) / 2e-6
    assert is_close(np.stack([found.dx_dncc_px, found.dy_dncc_px]).astype(float), true)


def test_another_unit_of_the_parameter(airs):
    """What is common to several profiles: the product with its sigma stays."""
    profile, covariance = airs.air()
    look = LOOKS["45, own pane"]
    uncertainty = prepared(profile, covariance, look)
    twice = uncertainty.with_scale(2.0 * uncertainty.mode.sigma)
    one, two = (
        corrected(profile, exposed(profile, look), look, uncertainty=u).sigmas
        for u in (uncertainty, twice)
    )
    np.testing.assert_allclose(2.0 * two.dx_ds_px, one.dx_ds_px, rtol=1e-6)
    np.testing.assert_array_equal(two.air_dx_px, one.air_dx_px)
    np.testing.assert_array_equal(two.dx_dncc_px, one.dx_dncc_px)
    assert twice.mode.sigma == 2.0 * uncertainty.mode.sigma
