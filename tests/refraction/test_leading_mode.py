"""The derivatives by the leading mode and by the cabin's air, against corrections in changed air.

The independent chain: the profile is changed along the mode, its hydrostatics and rays are made
anew, and the same pixels are corrected again.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.refraction import uncertain_air
from tests.refraction.comparing import assert_close, assert_near
from tests.refraction.images import (
    SKEWED,
    Look,
    corrected,
    displaced,
    looking,
    station_sigmas,
    turned,
    uncertainties,
)
from tests.refraction.uncertain_air import AIR, COVARIANCE
from unbend.refraction import ray_table
from unbend.refraction.uncertainty.sigmas import OPEN, SCHEDULED, SEALED

CAMERA = replace(SKEWED, fx_px=20_000.0, fy_px=20_200.0)
LONG = replace(CAMERA, fx_px=90_000.0, fy_px=90_500.0)  # 75 degrees and 5 to either side
TILTED = tuple(turned("xy", [25, -10])[:, 2])
H_C = 2680.0
GROUND = 100.0
STEP = 0.3  # sigmas along the mode
DENSER = 1e-6  # in the cabin


def looks_of(name, degrees, camera, panes):
    """A camera with no pane or with some of these: its own, a tilted one, a level one."""
    rotation = looking(degrees, azimuth_deg=-20.0)
    bare = Look(rotation, H_C, camera=camera)
    sealed = replace(bare, kind=SEALED)
    looks = {
        "open": bare,
        "vented": replace(bare, kind=SCHEDULED),
        "own pane": sealed,
        "tilted pane": replace(sealed, normal=TILTED),
        "level pane": replace(sealed, normal=tuple(-rotation[:, 2])),
    }
    return {f"{name}, {pane}": looks[pane] for pane in panes}


LOOKS = {
    **looks_of(
        "nadir",
        0.0,
        CAMERA,
        ["open", "own pane", "tilted pane", "vented"],
    ),
    **looks_of(
        "45",
        45.0,
        CAMERA,
        ["open", "own pane", "level pane"],
    ),
    **looks_of(
        "75",
        75.0,
        LONG,
        ["open", "own pane", "tilted pane", "level pane"],
    ),
}
BEHIND_A_PANE = [name for name in LOOKS if LOOKS[name].kind == SEALED]


def pixels(look, function=corrected, air=AIR, exposures=None, **options):
    """Corrected pixels of a look, or displaced ones some way off the edges of the image."""
    margin = 0.02 if function is displaced else 0.0
    x, y = np.random.default_rng(5).uniform(margin, 1.0 - margin, (2, 60))
    return function(
        x * look.camera.width_px,
        y * look.camera.height_px,
        exposures or look.exposure(air),
        ray_table(air),
        camera=look.camera,
        h_g=GROUND,
        **options,
    )


def prepared(look, covariance=COVARIANCE):
    return uncertainties(
        AIR,
        covariance,
        look.exposure(AIR),
        look.camera,
        station_sigmas(tilt=np.nan, yaw=np.nan, height=np.nan),
        window_kinds=np.array([look.kind]),
        typical_ground_m=GROUND,
    )


def along(mode, sigmas):
    """The air that many sigmas along the mode."""
    return uncertain_air.changed(sigmas * mode.state)


def difference(plus, minus):
    x = plus.x_corrected_px - minus.x_corrected_px
    y = plus.y_corrected_px - minus.y_corrected_px
    return np.stack([x, y])


def by_mode(sigmas):
    return np.stack([sigmas.dx_ds_px, sigmas.dy_ds_px]).astype(float)


def by_cabin(sigmas):
    return np.stack([sigmas.dx_dncc_px, sigmas.dy_dncc_px]).astype(float)


def is_close(derivative, expected):
    """To 0.06 %, and 0.02 % of the usual where it nearly vanishes."""
    error = np.hypot(*(derivative - expected))
    size = np.hypot(*expected)
    usual = np.median(size)
    return np.all(error <= 6e-4 * size + 2e-4 * usual)


def slope_by_mode(look, mode, function=corrected, exposures=None):
    """By changed air; with exposures, these are as they were."""
    plus = pixels(look, function, along(mode, STEP), exposures)
    minus = pixels(
        look,
        function,
        along(mode, -STEP),
        exposures,
    )
    return difference(plus, minus) / (2.0 * STEP * mode.sigma)


def slope_by_cabin(look, function=corrected):
    plus = look.exposure(AIR, denser=DENSER)
    minus = look.exposure(AIR, denser=-DENSER)
    denser = pixels(look, function, exposures=plus)
    thinner = pixels(look, function, exposures=minus)
    return difference(denser, thinner) / (2.0 * DENSER)


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
def test_the_derivative_is_a_difference_of_corrections(look):
    made = prepared(look)

    corrections = pixels(look, uncertainty=made)

    expected = slope_by_mode(look, made.mode)
    assert is_close(by_mode(corrections.sigmas), expected)
    # What it is easily mistaken for is seen behind a pane: the shift itself, and R alone, with the
    # window as it was.
    shift = np.stack([corrections.dx_px, corrections.dy_px])
    assert look.kind == OPEN or not is_close(shift, expected)
    of_r = slope_by_mode(look, made.mode, exposures=look.exposure(AIR))
    assert is_close(of_r, expected) == (look.kind == OPEN)


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
def test_its_part_of_sigma_air(look):
    """Of one camera at one height nearly all; what the mode leaves is not negative."""
    made = prepared(look)
    sigmas = pixels(look, uncertainty=made).sigmas
    part = made.mode.sigma * np.hypot(*by_mode(sigmas))
    whole = np.hypot(sigmas.air_dx_px, sigmas.air_dy_px)
    assert (part <= 1.005 * whole).all()
    share = np.sum(part**2) / np.sum(whole**2)
    assert_near(share, made.mode.variance_share, 0.02)
    assert share > 0.9


@pytest.mark.parametrize("name", BEHIND_A_PANE)
def test_the_air_in_the_cabin(name):
    look = LOOKS[name]
    made = prepared(look, covariance=None)
    sigmas = pixels(look, uncertainty=made).sigmas
    assert is_close(by_cabin(sigmas), slope_by_cabin(look))
    assert np.isnan(by_mode(sigmas)).all()


@pytest.mark.parametrize("name", ["45, own pane", "nadir, tilted pane"])
def test_displaced_observations_go_the_other_way(name):
    look = LOOKS[name]
    made = prepared(look)
    sigmas = pixels(look, displaced, uncertainty=made).sigmas
    assert is_close(by_mode(sigmas), slope_by_mode(look, made.mode, displaced))
    assert is_close(by_cabin(sigmas), slope_by_cabin(look, displaced))


def test_another_unit_of_the_parameter():
    """What is common to several profiles: the product with its sigma stays."""
    look = LOOKS["45, own pane"]
    made = prepared(look)
    twice = made.with_scale(2.0 * made.mode.sigma)
    assert twice.mode.sigma == 2.0 * made.mode.sigma

    by_sigma = pixels(look, uncertainty=made).sigmas
    by_twice = pixels(look, uncertainty=twice).sigmas

    assert_close(2.0 * by_mode(by_twice), by_mode(by_sigma), rtol=1e-6)
    assert_array_equal(by_twice.air_dx_px, by_sigma.air_dx_px)
    assert_array_equal(by_twice.dx_dncc_px, by_sigma.dx_dncc_px)
