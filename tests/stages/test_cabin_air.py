"""The air behind a window, from a log that may lack it. Truth by hand and by simulated rays."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose

from tests.helpers import channel, with_code
from tests.stages.level_cameras import US1976, stations
from tests.stages.other_logs import read_folder
from unbend.atmosphere.climatology import climatology
from unbend.config.windows import CabinSection
from unbend.library import corrected_table
from unbend.messages import Kind, Ledger
from unbend.refraction import StationSigmas, correct_observations, ray_table, uncertainty_of
from unbend.refraction.camera.camera import Camera, LensInAir
from unbend.refraction.uncertainty.sigmas import SEALED
from unbend.refraction.window import Cabin, Window
from unbend.simulate.optics import cameras
from unbend.stages.cabin_air import cabin_changes, with_cabin_air, with_logged_cabin
from unbend.stages.exposure_setup import exposures_of
from unbend.units import ZERO_CELSIUS_K

RADIUS = 6_371_000.0
KM6_PA = 47_217.0  # US 1976, its own table
UNSEALED_PA = KM6_PA + 1900.0
SEALED_PA = KM6_PA + 2100.0
NAN = math.nan

THREE_S = np.arange(3.0)
BARO = channel("BARO[1]", THREE_S, pressure_pa=80_000.0, board_temperature_k=315.0)
HULL = channel("BARO[0]", THREE_S, pressure_pa=50_000.0, board_temperature_k=300.0)
PROBE = channel("HYGR[1]", THREE_S, temperature_k=294.0, relative_humidity=0.1)
ALL = (HULL, BARO, PROBE)
LOGGED = Cabin("log")


def filled(exposed, cabin, *, shape="plane", lenses=(), profile=US1976):
    """Stations with the air behind a window of the nadir camera, and what is said of it."""
    ledger = Ledger()
    windows = {"nadir": Window(cabin, shape=shape)}
    return with_cabin_air(exposed, windows, lenses, profile, ledger), ledger


def from_log(exposed, cabin, channels=(), **roles):
    """Stations with the air of the cabin as far as the log has it, and the messages."""
    return with_logged_cabin(exposed, "nadir", cabin, channels, roles)


# ---------------------------------------------------------------- values and sigmas


@pytest.mark.parametrize(
    ("section", "logged", "expected"),
    [
        # Pressurised: 21 +- 5 degC, a logged barometer +- 3 hPa.
        ("pressure: log", (80_000.0, NAN), (80_000.0, 294.15, 300.0, 5.0)),
        ("pressure: log", (80_000.0, 290.0), (80_000.0, 290.0, 300.0, 1.0)),
        # 20 hPa above the air outside is the border: 19 hPa are no pressurisation.
        ("pressure: log", (UNSEALED_PA, NAN), (UNSEALED_PA, 294.15, 300.0, 10.0)),
        ("pressure: log", (SEALED_PA, NAN), (SEALED_PA, 294.15, 300.0, 5.0)),
        ("pressure: ambient", (NAN, NAN), (KM6_PA, 294.15, 300.0, 10.0)),
        (
            "{pressure: ambient, temperature_c: 5.0}",
            (NAN, 290.0),
            (KM6_PA, 278.15, 300.0, NAN),
        ),
        # Numbers without a sigma have none; with one it counts, whatever is logged.
        ("pressure: 812.5", (NAN, NAN), (81_250.0, 294.15, NAN, 5.0)),
        (
            "{pressure_hpa: 812.5, temperature_c: 20.0}",
            (NAN, NAN),
            (81_250.0, 293.15, NAN, NAN),
        ),
        (
            """
            pressure: 812.5
            temperature_c: 20.0
            sigma_pressure_hpa: 2.0
            sigma_temperature_k: 0.5
            """,
            (NAN, 280.0),
            (81_250.0, 293.15, 200.0, 0.5),
        ),
        (
            "{pressure: log, sigma_pressure_hpa: 0.5, sigma_temperature_k: 3.0}",
            (80_000.0, NAN),
            (80_000.0, 294.15, 50.0, 3.0),
        ),
    ],
)
def test_values_and_sigmas(section, logged, expected):
    pressure_pa, temperature_k = logged
    exposed = stations(6000.0, cabin_pressure_pa=pressure_pa, cabin_temperature_k=temperature_k)
    cabin = CabinSection(**yaml.safe_load(section)).build()

    with_air, _ = filled(exposed, cabin)

    values = np.concatenate(
        [
            with_air.cabin_pressure_pa,
            with_air.cabin_temperature_k,
            with_air.sigma_cabin_pressure_pa,
            with_air.sigma_cabin_temperature_k,
        ]
    )
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

    humid, ledger = filled(exposed, Cabin("log", relative_humidity=0.4))
    assert humid.cabin_vapour_pressure_pa[0] == pytest.approx(0.4 * 2489.0, rel=6e-3)
    assert not len(ledger)


HUMID = climatology(latitude_rad=0.8, month=7.0).profile
OUTSIDE_PA = float(HUMID.vapour_pressure(1000.0))
HATCH = Cabin(
    "opening",
    warmer_k=10.0,
    excess_pa=-0.1 * float(HUMID.pressure(1000.0)),
)


@pytest.mark.parametrize(
    ("cabin", "logged_pa", "expected_pa"),
    [
        (Cabin("ambient"), 500.0, 500.0),
        (Cabin("ambient"), NAN, OUTSIDE_PA),
        (LOGGED, 500.0, 500.0),
        (Cabin("constant", 80_000.0, 294.0), 500.0, 500.0),
        # What is logged may be of another cabin.
        (Cabin("standard_schedule"), 500.0, 0.0),
        # Air under another pressure has as large a share of vapour.
        (HATCH, 500.0, 0.9 * OUTSIDE_PA),
    ],
)
def test_logged_vapour_of_the_cabin(cabin, logged_pa, expected_pa):
    exposed = stations(1000.0, cabin_pressure_pa=9e4, cabin_vapour_pressure_pa=logged_pa)
    with_air, _ = filled(exposed, cabin, profile=HUMID)
    assert OUTSIDE_PA > 600.0
    assert with_air.cabin_vapour_pressure_pa == pytest.approx([expected_pa])


@pytest.mark.parametrize(
    ("shape", "lenses", "sigma_k"),
    [
        ("spherical", (), NAN),
        ("spherical", ("nadir",), 5.0),
        ("plane", (), 5.0),
    ],
)
def test_air_behind_a_dome_counts_only_for_a_lens(shape, lenses, sigma_k):
    exposed = stations(6000.0, cabin_pressure_pa=80_000.0)
    with_air, _ = filled(exposed, LOGGED, shape=shape, lenses=lenses)
    assert with_air.sigma_cabin_temperature_k == pytest.approx([sigma_k], nan_ok=True)
    assert np.isnan(with_air.sigma_cabin_pressure_pa).tolist() == [math.isnan(sigma_k)]


def test_a_camera_that_took_no_image_is_no_error():
    constant = Window(Cabin("constant", 80_000.0, 294.0))
    windows = {
        "nadir": constant,
        "other": Window(Cabin("ambient")),
        "none": constant,
    }
    with_air = with_cabin_air(stations(1000.0), windows, (), US1976, Ledger())
    assert with_air.cabin_pressure_pa.tolist() == [80_000.0]


# ---------------------------------------------------------------- what the log lacks


def test_a_missing_barometer_names_what_could_play_it():
    exposed = stations(6000.0, 6000.0)
    lost, (entry,) = from_log(exposed, LOGGED, ALL, pressure=HULL)
    assert lost.status.tolist() == ["suspect"] * 2
    assert entry.kind is Kind.LOSS
    assert entry.code == "CABIN-MISSING"
    assert entry.count == 2
    assert entry.what.endswith("log.channels.cabin_pressure could be BARO[1]")
    assert "temperature" not in entry.what


@pytest.fixture
def without_temperature():
    return stations(6000.0, 6000.0, cabin_pressure_pa=80_000.0)


def test_a_missing_thermometer_loses_no_row(without_temperature):
    kept, (entry,) = from_log(without_temperature, LOGGED, ALL)
    assert kept.ok.all()
    assert entry.kind is Kind.FALLBACK
    assert entry.code == "CABIN-TEMPERATURE"
    assert entry.count == 2
    assert "pressure" not in entry.what
    assert "HYGR[1]" in entry.what
    assert "BARO[1] (its board, warmer than the air)" in entry.what


def test_a_mission_file_that_names_the_log_for_a_temperature_misses_it(without_temperature):
    """Exit code 3, and no row lost either."""
    kept, (entry,) = from_log(without_temperature, Cabin("log", temperature_logged=True))
    assert kept.ok.all()
    assert entry.kind is Kind.LOSS
    assert entry.what.endswith("no channel of the log could play cabin_temperature")


def test_a_stated_temperature_needs_no_thermometer(without_temperature):
    cabin = Cabin("log", temperature_k=290.0)
    assert from_log(without_temperature, cabin, (PROBE,)) == (without_temperature, ())


def test_a_board_is_warmer_than_the_air():
    """315 K on the board are 305 +- 6 K of air."""
    exposed = stations(6000.0, cabin_pressure_pa=80_000.0, cabin_temperature_k=315.0)
    with_board, (entry,) = from_log(exposed, LOGGED, (BARO,), cabin_temperature=BARO)
    assert entry.kind is Kind.FALLBACK
    assert entry.code == "CABIN-BOARD"
    assert "BARO[1], minus 10 +- 6 K" in entry.what
    with_air, _ = filled(with_board, LOGGED)
    assert with_air.cabin_temperature_k.tolist() == [305.0]
    assert with_air.sigma_cabin_temperature_k.tolist() == [6.0]


@pytest.mark.parametrize(
    ("height_m", "warnings"),
    [
        (1000.0, 1),
        (1848.0, 1),
        (1851.0, 0),
    ],
)
def test_a_cabin_10_hpa_thinner_than_the_air_outside_is_told(height_m, warnings):
    """US 1976 has 898.76 hPa at 1000 m, 810.0 hPa at 1849 m."""
    thin = stations(height_m, cabin_pressure_pa=80_000.0, cabin_temperature_k=290.0)
    _, ledger = filled(thin, LOGGED)
    messages = with_code(ledger, "CABIN-IMPLAUSIBLE")
    assert len(messages) == warnings
    for message in messages:
        assert message.kind is Kind.WARNING
        assert "less pressure than the air outside: 800 hPa and 17 degC" in message.what


@pytest.mark.parametrize(
    ("inside_pa", "warnings"),
    [
        (61_917.0, 1),
        (47_300.0, 0),
    ],
)
def test_a_cabin_that_is_said_to_be_ambient_and_is_not(inside_pa, warnings):
    exposed = stations(6000.0, 6000.0, pressure_pa=KM6_PA)
    exposed = replace(exposed, time_ns=np.array([0, 1]))
    inside = channel("BARO[1]", THREE_S, pressure_pa=inside_pa)
    _, notes = from_log(exposed, Cabin("ambient"), (HULL, inside), pressure=HULL)
    messages = with_code(notes, "CABIN-IMPLAUSIBLE")
    assert len(messages) == warnings
    for message in messages:
        assert "BARO[1] measures 147 hPa more" in message.what


@pytest.mark.parametrize(
    ("celsius", "height", "warnings"),
    [
        (2.0, 6000.0, 0),
        (0.0, 6000.0, 1),
        (0.0, 1900.0, 0),
        (-20.0, 1900.0, 1),
    ],
)
def test_a_temperature_that_is_no_cabins_is_told(celsius, height, warnings):
    """Four sigmas of 21 +- 5 degC in a pressurised cabin, +- 10 in another; a number stays."""
    kelvin = celsius + ZERO_CELSIUS_K
    exposed = stations(height, cabin_pressure_pa=80_000.0, cabin_temperature_k=kelvin)
    with_air, ledger = filled(exposed, LOGGED)
    assert with_air.cabin_temperature_k.tolist() == [kelvin]
    messages = with_code(ledger, "CABIN-IMPLAUSIBLE")
    assert len(messages) == warnings
    for message in messages:
        assert f"800 hPa and {celsius:.0f} degC" in message.what


# ---------------------------------------------------------------- the sigma against the truth

MODEL = cameras(20_000.0)[0]
CAMERA = Camera(14_000, 10_600, 20_000.0, 20_000.0, MODEL.cx_px, MODEL.cy_px)
FORWARD = (0.0, 0.0, 1.0)


def claimed(exposed, x, y, *, lenses, normal=FORWARD):
    """Corrections with sigmas of pixels of a simulated camera straight above, at h = 0."""
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
        [(CAMERA, np.ones(1, bool))],
        ground_heights_m=(0.0, 0.0),
        window_kinds=np.array([SEALED]),
    )
    return correct_observations(
        x,
        y,
        np.zeros(x.size),
        np.zeros(x.size, np.int64),
        exposures,
        camera=CAMERA,
        table=ray_table(US1976),
        uncertainty=uncertainty,
    )


LENS = LensInAir(20_000.0, 101_325.0, 288.15, 4e-5, -0.02)


@pytest.mark.parametrize("normal", [FORWARD, (0.0, 0.5, math.sqrt(0.75))])
@pytest.mark.parametrize("lenses", [{}, {"nadir": LENS}], ids=["none", "lens"])
def test_against_corrections_with_other_air(normal, lenses):
    """Half the difference of corrections with a sigma more and less, both quantities."""
    rng = np.random.default_rng(2)
    x = rng.uniform(500.0, 13_500.0, 30)
    y = rng.uniform(500.0, 10_100.0, 30)
    exposed, _ = filled(stations(6000.0, cabin_pressure_pa=80_000.0), LOGGED)

    def shift(pressure_pa=0.0, temperature_k=0.0):
        """In a cabin of so much more pressure and temperature."""
        other = replace(
            exposed,
            cabin_pressure_pa=exposed.cabin_pressure_pa + pressure_pa,
            cabin_temperature_k=exposed.cabin_temperature_k + temperature_k,
        )
        corrections = claimed(other, x, y, lenses=lenses, normal=normal)
        return np.array([corrections.dx_px, corrections.dy_px])

    by_pressure = shift(pressure_pa=300.0) - shift(pressure_pa=-300.0)
    by_temperature = shift(temperature_k=5.0) - shift(temperature_k=-5.0)
    expected_x, expected_y = np.hypot(by_pressure, by_temperature) / 2.0

    claims = claimed(exposed, x, y, lenses=lenses, normal=normal)

    sigmas = claims.sigmas
    atol_x = 0.003 * np.median(expected_x)
    atol_y = 0.003 * np.median(expected_y)
    assert_allclose(sigmas.cabin_dx_px, expected_x, rtol=0.005, atol=atol_x)
    assert_allclose(sigmas.cabin_dy_px, expected_y, rtol=0.005, atol=atol_y)


# ---------------------------------------------------------------- the whole program


def test_what_a_missing_thermometer_costs(mission):
    """No row is lost, and the sigma says what it costs."""
    prepared = read_folder(mission)
    unknown = np.full(len(prepared.stations), NAN)
    exposed = replace(
        prepared.stations,
        cabin_temperature_k=unknown,
        cabin_vapour_pressure_pa=unknown,
    )

    corrected, _ = corrected_table(replace(prepared, stations=exposed))

    table = corrected.to_pandas()
    assert (table["status"] == "ok").all()
    # 3 hPa of some 825 and 5 K of 294 are 1.74 % of N: R_cc turns by that, tan of the angle.
    n_minus_1 = 225e-6
    sigma_n = n_minus_1 * math.hypot(3.0 / 825.0, 5.0 / 294.15)
    tangent = table["sigma_r_cc_rad"] / sigma_n
    right_px = table["x_px"] - 7000.0
    down_px = table["y_px"] - 5300.0
    u = np.hypot(right_px, down_px) / 20_000.0
    assert np.median(tangent / u) == pytest.approx(1.0, abs=0.02)


def test_a_thermometer_on_a_board_is_told_of_each_camera(mission):
    mission.config["log"]["channels"]["cabin_temperature"] = "BARO[1]"
    prepared = read_folder(mission)
    assert len(with_code(prepared.ledger, "CABIN-BOARD")) == 2
    assert (prepared.stations.sigma_cabin_temperature_k == 6.0).all()
