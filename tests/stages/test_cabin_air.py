"""The air behind a window, from a log that may lack it. Truth by hand and by simulated rays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import channel, with_code
from tests.physics.ray_on_sphere import ray_angle_sphere
from tests.stages.level_cameras import US1976, stations
from unbend.atmosphere.climatology import climatology
from unbend.batch.runs import read_mission
from unbend.config.windows import CabinSection
from unbend.flight.stations import Stations
from unbend.library import corrected_table
from unbend.messages import Kind, Ledger
from unbend.refraction import StationSigmas, correct_observations, ray_table, uncertainty_of
from unbend.refraction.camera.camera import Camera, LensInAir
from unbend.refraction.uncertainty.sigmas import SEALED
from unbend.refraction.window import Cabin, Window
from unbend.simulate.optics import cameras, through_window
from unbend.simulate.true_air import edlen_index
from unbend.stages.cabin_air import cabin_changes, cabin_from_log, with_cabin_air
from unbend.stages.exposure_setup import exposures_of
from unbend.units import ZERO_CELSIUS_K

RADIUS = 6_371_000.0
KM6_PA = 47_217.0  # US 1976, its own table
NAN = math.nan

THREE_S = np.arange(3.0)
BARO = channel("BARO[1]", THREE_S, pressure_pa=80_000.0, board_temperature_k=315.0)
HULL = channel("BARO[0]", THREE_S, pressure_pa=50_000.0, board_temperature_k=300.0)
PROBE = channel("HYGR[1]", THREE_S, temperature_k=294.0, relative_humidity=0.1)
LOGGED = Cabin("log")


def filled(exposed: Stations, cabin: Cabin) -> tuple[Stations, Ledger]:
    ledger = Ledger()
    return with_cabin_air(exposed, {"nadir": Window(cabin)}, (), US1976, ledger), ledger


# ---------------------------------------------------------------- values and sigmas


@pytest.mark.parametrize(
    ("section", "logged", "expected"),
    [
        # Pressurised: 21 +- 5 degC, a logged barometer +- 3 hPa.
        ({"pressure": "log"}, (80_000.0, NAN), (80_000.0, 294.15, 300.0, 5.0)),
        ({"pressure": "log"}, (80_000.0, 290.0), (80_000.0, 290.0, 300.0, 1.0)),
        # 20 hPa above the air outside is the border: 19 hPa are no pressurisation.
        ({"pressure": "log"}, (KM6_PA + 1900.0, NAN), (KM6_PA + 1900.0, 294.15, 300.0, 10.0)),
        ({"pressure": "log"}, (KM6_PA + 2100.0, NAN), (KM6_PA + 2100.0, 294.15, 300.0, 5.0)),
        ({"pressure": "ambient"}, (NAN, NAN), (KM6_PA, 294.15, 300.0, 10.0)),
        (
            {"pressure": "ambient", "temperature_c": 5.0},
            (NAN, 290.0),
            (KM6_PA, 278.15, 300.0, NAN),
        ),
        # Numbers without a sigma have none; with one it counts, whatever is logged.
        ({"pressure": 812.5}, (NAN, NAN), (81_250.0, 294.15, NAN, 5.0)),
        (
            {"pressure_hpa": 812.5, "temperature_c": 20.0},
            (NAN, NAN),
            (81_250.0, 293.15, NAN, NAN),
        ),
        (
            {
                "pressure": 812.5,
                "temperature_c": 20.0,
                "sigma_pressure_hpa": 2.0,
                "sigma_temperature_k": 0.5,
            },
            (NAN, 280.0),
            (81_250.0, 293.15, 200.0, 0.5),
        ),
        (
            {"pressure": "log", "sigma_pressure_hpa": 0.5, "sigma_temperature_k": 3.0},
            (80_000.0, NAN),
            (80_000.0, 294.15, 50.0, 3.0),
        ),
    ],
)
def test_values_and_sigmas(section, logged, expected):
    pressure_pa, temperature_k = logged
    exposed = stations(6000.0, cabin_pressure_pa=pressure_pa, cabin_temperature_k=temperature_k)
    with_air, _ = filled(exposed, CabinSection(**section).build())
    columns = (
        with_air.cabin_pressure_pa,
        with_air.cabin_temperature_k,
        with_air.sigma_cabin_pressure_pa,
        with_air.sigma_cabin_temperature_k,
    )
    values = [float(column[0]) for column in columns]
    assert values == pytest.approx(expected, rel=3e-5, nan_ok=True)


def test_the_schedule_has_the_sigma_of_a_temperature_that_is_assumed():
    with_air, _ = filled(stations(2000.0, 8000.0), Cabin("standard_schedule"))
    assert with_air.cabin_temperature_k.tolist() == [294.26] * 2
    assert with_air.sigma_cabin_temperature_k.tolist() == [10.0, 5.0]
    assert np.isnan(with_air.sigma_cabin_pressure_pa).all()


def test_the_vapour_of_the_cabin():
    """Dry if nothing says more, else as stated; 21 degC saturated is 24.9 hPa."""
    exposed = stations(1000.0, cabin_pressure_pa=90_000.0, cabin_temperature_k=294.15)
    dry, ledger = filled(exposed, LOGGED)
    assert dry.cabin_vapour_pressure_pa.tolist() == [0.0]
    assert [entry.code for entry in ledger] == ["CABIN-DRY"]
    stated, ledger = filled(exposed, Cabin("log", relative_humidity=0.4))
    assert stated.cabin_vapour_pressure_pa[0] == pytest.approx(0.4 * 2489.0, rel=6e-3)
    assert not len(ledger)


HUMID = climatology(latitude_rad=0.8, month=7.0).profile
OUTSIDE_PA = float(HUMID.vapour_pressure(1000.0))
HATCH = Cabin("opening", warmer_k=10.0, excess_pa=-0.1 * float(HUMID.pressure(1000.0)))


@pytest.mark.parametrize(
    ("cabin", "expected_pa"),
    [
        (Cabin("ambient"), 500.0),
        (LOGGED, 500.0),
        (Cabin("constant", 80_000.0, 294.0), 500.0),
        # What is logged may be of another cabin.
        (Cabin("standard_schedule"), 0.0),
        # Air under another pressure has as large a share of vapour.
        (HATCH, 0.9 * OUTSIDE_PA),
    ],
)
def test_logged_vapour_of_the_cabin(cabin, expected_pa):
    exposed = stations(1000.0, cabin_pressure_pa=9e4, cabin_vapour_pressure_pa=500.0)
    windows = {"nadir": Window(cabin)}
    with_air = with_cabin_air(exposed, windows, (), HUMID, Ledger())
    assert with_air.cabin_vapour_pressure_pa == pytest.approx([expected_pa])


def test_an_open_cabin_has_the_vapour_of_the_air_outside():
    windows = {"nadir": Window(Cabin("ambient"))}
    with_air = with_cabin_air(stations(1000.0), windows, (), HUMID, Ledger())
    assert OUTSIDE_PA > 500.0
    assert with_air.cabin_vapour_pressure_pa.tolist() == [OUTSIDE_PA]


@pytest.mark.parametrize(
    ("shape", "lenses", "sigma_k"),
    [("spherical", (), NAN), ("spherical", ("nadir",), 5.0), ("plane", (), 5.0)],
)
def test_air_behind_a_dome_counts_only_for_a_lens(shape, lenses, sigma_k):
    exposed = stations(6000.0, cabin_pressure_pa=80_000.0)
    windows = {"nadir": Window(LOGGED, shape=shape)}
    with_air = with_cabin_air(exposed, windows, lenses, US1976, Ledger())
    assert with_air.sigma_cabin_temperature_k == pytest.approx([sigma_k], nan_ok=True)
    assert np.isnan(with_air.sigma_cabin_pressure_pa).tolist() == [math.isnan(sigma_k)]


def test_a_camera_that_took_no_image_is_no_error():
    constant = Window(Cabin("constant", 80_000.0, 294.0))
    windows = {"nadir": constant, "other": Window(Cabin("ambient")), "none": constant}
    with_air = with_cabin_air(stations(1000.0), windows, (), US1976, Ledger())
    assert with_air.cabin_pressure_pa.tolist() == [80_000.0]


# ---------------------------------------------------------------- what the log lacks


def test_a_missing_barometer_names_what_could_play_it():
    exposed = stations(6000.0, 6000.0)
    logged = (HULL, BARO, PROBE)
    lost, (entry,) = cabin_from_log(exposed, "nadir", LOGGED, logged, {"pressure": HULL})
    assert lost.status.tolist() == ["suspect"] * 2
    assert entry.kind is Kind.LOSS
    assert entry.code == "CABIN-MISSING"
    assert entry.count == 2
    assert entry.what.endswith("log.channels.cabin_pressure could be BARO[1]")
    assert "temperature" not in entry.what


def test_a_missing_thermometer_loses_no_row():
    exposed = stations(6000.0, 6000.0, cabin_pressure_pa=80_000.0)
    kept, (entry,) = cabin_from_log(exposed, "nadir", LOGGED, (HULL, BARO, PROBE), {})
    assert kept.ok.all()
    assert entry.kind is Kind.FALLBACK
    assert entry.code == "CABIN-TEMPERATURE"
    assert entry.count == 2
    assert "pressure" not in entry.what
    assert "HYGR[1]" in entry.what
    assert "BARO[1] (its board, warmer than the air)" in entry.what
    # A mission file that names the log for it misses something: exit code 3, no row lost either.
    named = Cabin("log", temperature_logged=True)
    kept, (entry,) = cabin_from_log(exposed, "nadir", named)
    assert kept.ok.all()
    assert entry.kind is Kind.LOSS
    assert entry.what.endswith("no channel of the log could play cabin_temperature")
    stated = Cabin("log", temperature_k=290.0)
    assert cabin_from_log(exposed, "nadir", stated, (PROBE,)) == (exposed, ())


def test_a_board_is_warmer_than_the_air():
    """315 K on the board are 305 +- 6 K of air."""
    exposed = stations(6000.0, cabin_pressure_pa=80_000.0, cabin_temperature_k=315.0)
    roles = {"cabin_temperature": BARO}
    with_board, (entry,) = cabin_from_log(exposed, "nadir", LOGGED, (BARO,), roles)
    assert entry.kind is Kind.FALLBACK
    assert entry.code == "CABIN-BOARD"
    assert "BARO[1], minus 10 +- 6 K" in entry.what
    with_air, _ = filled(with_board, LOGGED)
    assert with_air.cabin_temperature_k.tolist() == [305.0]
    assert with_air.sigma_cabin_temperature_k.tolist() == [6.0]


@pytest.mark.parametrize(("height_m", "is_told"), [(1000.0, True), (1848.0, True), (1851.0, False)])
def test_a_cabin_10_hpa_thinner_than_the_air_outside_is_told(height_m, is_told):
    """US 1976 has 898.76 hPa at 1000 m, 810.0 hPa at 1849 m."""
    thin = stations(height_m, cabin_pressure_pa=80_000.0, cabin_temperature_k=290.0)
    _, ledger = filled(thin, LOGGED)
    warnings = with_code(ledger, "CABIN-IMPLAUSIBLE")
    assert len(warnings) == is_told
    for warning in warnings:
        assert warning.kind is Kind.WARNING
        assert "less pressure than the air outside: 800 hPa and 17 degC" in warning.what


@pytest.mark.parametrize(("inside_pa", "is_told"), [(61_917.0, True), (47_300.0, False)])
def test_a_cabin_that_is_said_to_be_ambient_and_is_not(inside_pa, is_told):
    exposed = stations(6000.0, 6000.0, pressure_pa=KM6_PA)
    exposed = replace(exposed, time_ns=np.array([0, 1]))
    inside = channel("BARO[1]", THREE_S, pressure_pa=inside_pa)
    roles = {"pressure": HULL}
    _, notes = cabin_from_log(exposed, "nadir", Cabin("ambient"), (HULL, inside), roles)
    warnings = with_code(notes, "CABIN-IMPLAUSIBLE")
    assert len(warnings) == is_told
    for warning in warnings:
        assert "BARO[1] measures 147 hPa more" in warning.what


@pytest.mark.parametrize(
    ("celsius", "height", "is_told"),
    [(2.0, 6000.0, False), (0.0, 6000.0, True), (0.0, 1900.0, False), (-20.0, 1900.0, True)],
)
def test_a_temperature_that_is_no_cabins_is_told(celsius, height, is_told):
    """Four sigmas of 21 +- 5 degC in a pressurised cabin, +- 10 in another; a number stands."""
    kelvin = celsius + ZERO_CELSIUS_K
    exposed = stations(height, cabin_pressure_pa=80_000.0, cabin_temperature_k=kelvin)
    with_air, ledger = filled(exposed, LOGGED)
    assert with_air.cabin_temperature_k.tolist() == [kelvin]
    warnings = with_code(ledger, "CABIN-IMPLAUSIBLE")
    assert len(warnings) == is_told
    for warning in warnings:
        assert f"800 hPa and {celsius:.0f} degC" in warning.what


# ---------------------------------------------------------------- the sigma against the truth


def claimed(exposed: Stations, x, y, lens: LensInAir | None = None, normal=(0.0, 0.0, 1.0)):
    """Corrections with sigmas of pixels of a simulated camera straight above, at h = 0."""
    model = cameras(20_000.0)[0]
    camera = Camera(14_000, 10_600, 20_000.0, 20_000.0, model.cx_px, model.cy_px)
    lenses = {} if lens is None else {"nadir": lens}
    windows = {"nadir": Window(LOGGED, normal)}
    exposures = exposures_of(exposed, US1976, windows, lenses, Ledger(), radius_m=RADIUS)
    sigmas = StationSigmas(
        tilt_rad=np.array([NAN]),
        yaw_rad=np.array([NAN]),
        yaw_axis=np.array([[0.0, 0.0, 1.0]]),
        height_m=np.zeros(1),
        cabin=cabin_changes(exposed, lenses, US1976),
    )
    uncertainty = uncertainty_of(
        US1976,
        None,
        exposures,
        sigmas,
        [(camera, np.ones(1, bool))],
        ground_heights_m=(0.0, 0.0),
        window_kinds=np.array([SEALED]),
    )
    return correct_observations(
        x,
        y,
        np.zeros(x.size),
        np.zeros(x.size, np.int64),
        exposures,
        camera=camera,
        table=ray_table(US1976),
        uncertainty=uncertainty,
    )


def test_a_cabin_one_sigma_warmer_or_cooler_is_within_its_sigma():
    """Cabins of 16, 21 and 26 degC: rays by the simulator's own window, index and camera."""
    celsius = np.array([16.0, 21.0, 26.0])
    h = 6000.0
    zeta = 0.30
    azimuth = 0.7

    def refractivity(height: float) -> float:
        return float(US1976.refractivity(height))

    def ray(angle: float) -> np.ndarray:
        across = math.sin(angle)
        return np.array([across * math.cos(azimuth), across * math.sin(azimuth), math.cos(angle)])

    n_outside = np.full(3, 1.0 + refractivity(h))
    n_inside = edlen_index(np.full(3, 70_120.0), celsius + ZERO_CELSIUS_K, np.zeros(3))
    r_c = ray_angle_sphere(lambda height: 1.0 + refractivity(height), h, 0.0, zeta, RADIUS)
    model = replace(cameras(20_000.0)[0], distortion=(0.0,) * 5)
    inside, _ = through_window(np.tile(ray(zeta), (3, 1)), n_outside, n_inside)
    x, y = model.project(inside)
    true_x, true_y = model.project(ray(zeta - r_c)[None])
    exposed, _ = filled(
        stations(h, cabin_pressure_pa=70_120.0), Cabin("log", sigma_pressure_pa=0.0)
    )
    corrected = claimed(exposed, x, y)
    for error, sigma in (
        (corrected.x_corrected_px - true_x, corrected.sigmas.cabin_dx_px),
        (corrected.y_corrected_px - true_y, corrected.sigmas.cabin_dy_px),
    ):
        assert abs(error[1]) < 0.02 * sigma[1]
        assert abs(error[2] - error[0]) / 2.0 == pytest.approx(sigma[1], rel=0.02)
    # 5 K of 294.15 are 3.19e-6 of the 187.84e-6 of Gyer's Table 7: 5 % of R at 6 km.
    sigma_r_cc = corrected.sigmas.r_cc_rad[1]
    assert sigma_r_cc == pytest.approx(3.19e-6 * math.tan(zeta), rel=0.01)
    assert sigma_r_cc / corrected.r_c_rad[1] == pytest.approx(0.05, abs=0.006)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.5, math.sqrt(0.75))])
@pytest.mark.parametrize("lens", [None, LensInAir(20_000.0, 101_325.0, 288.15, 4e-5, -0.02)])
def test_against_corrections_with_other_air(normal, lens):
    """Half the difference of corrections with a sigma more and less, both quantities."""
    rng = np.random.default_rng(2)
    x = rng.uniform(500.0, 13_500.0, 30)
    y = rng.uniform(500.0, 10_100.0, 30)
    exposed, _ = filled(stations(6000.0, cabin_pressure_pa=80_000.0), LOGGED)
    corrected = claimed(exposed, x, y, lens, normal)
    expected = np.zeros((2, 30))
    for name, sigma in (("cabin_pressure_pa", 300.0), ("cabin_temperature_k", 5.0)):
        value = getattr(exposed, name)
        more = claimed(replace(exposed, **{name: value + sigma}), x, y, lens, normal)
        less = claimed(replace(exposed, **{name: value - sigma}), x, y, lens, normal)
        half = np.stack([more.dx_px - less.dx_px, more.dy_px - less.dy_px]) / 2.0
        expected = np.hypot(expected, half)
    sigmas = (corrected.sigmas.cabin_dx_px, corrected.sigmas.cabin_dy_px)
    for sigma, of_axis in zip(sigmas, expected, strict=True):
        np.testing.assert_allclose(sigma, of_axis, rtol=0.005, atol=0.003 * np.median(of_axis))


# ---------------------------------------------------------------- the whole program


def test_what_a_missing_thermometer_costs(mission):
    """No row is lost, and the sigma says what it costs."""
    prepared = read_mission(mission.save())
    unknown = np.full(len(prepared.stations), NAN)
    exposed = replace(
        prepared.stations, cabin_temperature_k=unknown, cabin_vapour_pressure_pa=unknown
    )
    corrected, _ = corrected_table(replace(prepared, stations=exposed))
    table = corrected.to_pandas()
    assert (table["status"] == "ok").all()
    # 3 hPa of some 825 and 5 K of 294 are 1.74 % of N: R_cc turns by that, tan of the angle.
    n_minus_1 = 225e-6
    tangent = table["sigma_r_cc_rad"] / (n_minus_1 * math.hypot(3.0 / 825.0, 5.0 / 294.15))
    u = np.hypot(table["x_px"] - 7000.0, table["y_px"] - 5300.0) / 20_000.0
    assert np.median(tangent / u) == pytest.approx(1.0, abs=0.02)


def test_a_thermometer_on_a_board_is_told_of_each_camera(mission):
    mission.config["log"]["channels"]["cabin_temperature"] = "BARO[1]"
    prepared = read_mission(mission.save())
    assert len(with_code(prepared.ledger, "CABIN-BOARD")) == 2
    assert (prepared.stations.sigma_cabin_temperature_k == 6.0).all()
