"""The air behind a window, from a log that may lack it. Truth by hand and by simulated rays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.physics.ray_on_sphere import ray_angle_sphere
from unbend.atmosphere import standard_atmosphere
from unbend.batch import opening
from unbend.config.windows import CabinSection
from unbend.flight.channels import Channel, Source
from unbend.flight.stations import Stations, empty_stations
from unbend.ingest import open_log
from unbend.messages import Ledger
from unbend.refraction import StationSigmas, correct_observations, ray_table, uncertainty_of
from unbend.refraction.camera.camera import Camera, LensInAir
from unbend.refraction.uncertainty.sigmas import SEALED
from unbend.refraction.window import Cabin, Window
from unbend.simulate.optics import cameras, through_window
from unbend.simulate.true_air import edlen_index
from unbend.stages.cabin_air import cabin_changes, cabin_from_log, with_cabin_air
from unbend.stages.exposure_setup import exposures_of
from unbend.units import ZERO_CELSIUS_K

US1976 = standard_atmosphere("us1976")
DOWN = (0.0, 1.0, 0.0, 0.0)
RADIUS = 6_371_000.0
KM6_PA = 47_217.0  # US 1976, its own table


def stations(*heights: float, **cabin: float) -> Stations:
    """Exposures of a camera that looks straight down, with what the log has of its cabin."""
    n = len(heights)
    made = empty_stations(
        np.array([f"i{k}" for k in range(n)], object), np.full(n, "cam", object), "ok"
    )
    return replace(
        made,
        lat_rad=np.full(n, 0.8),
        lon_rad=np.full(n, 0.1),
        h_msl_m=np.array(heights),
        quaternion=np.tile(DOWN, (n, 1)),
        aircraft_quaternion=np.tile(DOWN, (n, 1)),
        **{name: np.full(n, value) for name, value in cabin.items()},
    )


def filled(at: Stations, cabin: Cabin) -> tuple[Stations, Ledger]:
    ledger = Ledger()
    return with_cabin_air(at, {"cam": Window(cabin)}, (), US1976, ledger), ledger


def channel(name: str, **columns: float) -> Channel:
    return Channel(name, np.arange(3), {k: np.full(3, v) for k, v in columns.items()}, Source(name))


BARO = channel("BARO[1]", pressure_pa=80_000.0, board_temperature_k=315.0)
HULL = channel("BARO[0]", pressure_pa=50_000.0, board_temperature_k=300.0)
PROBE = channel("HYGR[1]", temperature_k=294.0, relative_humidity=0.1)


# ---------------------------------------------------------------- values and sigmas


@pytest.mark.parametrize(
    ("section", "logged", "expected"),
    [
        # Pressurised: 21 +- 5 degC, a logged barometer +- 3 hPa.
        ({"pressure": "log"}, (80_000.0, np.nan), (80_000.0, 294.15, 300.0, 5.0)),
        ({"pressure": "log"}, (80_000.0, 290.0), (80_000.0, 290.0, 300.0, 1.0)),
        # 20 hPa above the air outside is the border: 10 hPa are no pressurisation.
        ({"pressure": "log"}, (KM6_PA + 1000.0, np.nan), (KM6_PA + 1000.0, 294.15, 300.0, 10.0)),
        ({"pressure": "ambient"}, (np.nan, np.nan), (KM6_PA, 294.15, 300.0, 10.0)),
        (
            {"pressure": "ambient", "temperature_c": 5.0},
            (np.nan, 290.0),
            (KM6_PA, 278.15, 300.0, np.nan),
        ),
        # Numbers without a sigma have none; with one it counts, whatever is logged.
        ({"pressure": 812.5}, (np.nan, np.nan), (81_250.0, 294.15, np.nan, 5.0)),
        (
            {"pressure_hpa": 812.5, "temperature_c": 20.0},
            (np.nan, np.nan),
            (81_250.0, 293.15, np.nan, np.nan),
        ),
        (
            {
                "pressure": 812.5,
                "temperature_c": 20.0,
                "sigma_pressure_hpa": 2.0,
                "sigma_temperature_k": 0.5,
            },
            (np.nan, 280.0),
            (81_250.0, 293.15, 200.0, 0.5),
        ),
        (
            {"pressure": "log", "sigma_pressure_hpa": 0.5, "sigma_temperature_k": 3.0},
            (80_000.0, np.nan),
            (80_000.0, 294.15, 50.0, 3.0),
        ),
    ],
)
def test_values_and_sigmas(section, logged, expected):
    at = stations(6000.0, cabin_pressure_pa=logged[0], cabin_temperature_k=logged[1])
    found, _ = filled(at, CabinSection(**section).build())
    got = (
        found.cabin_pressure_pa[0],
        found.cabin_temperature_k[0],
        found.sigma_cabin_pressure_pa[0],
        found.sigma_cabin_temperature_k[0],
    )
    assert got == pytest.approx(expected, rel=3e-5, nan_ok=True)


def test_the_schedule_has_the_sigma_of_a_temperature_that_is_assumed():
    found, _ = filled(stations(2000.0, 8000.0), Cabin("standard_schedule"))
    assert found.cabin_temperature_k.tolist() == [294.26] * 2
    assert found.sigma_cabin_temperature_k.tolist() == [10.0, 5.0]
    assert np.isnan(found.sigma_cabin_pressure_pa).all()


def test_the_vapour_of_the_cabin():
    """Dry, as stated, and outside's where the cabin is open; 21 degC saturated is 24.9 hPa."""
    at = stations(1000.0, cabin_pressure_pa=90_000.0, cabin_temperature_k=294.15)
    dry, ledger = filled(at, Cabin("log"))
    assert dry.cabin_vapour_pressure_pa.tolist() == [0.0]
    assert [e.code for e in ledger] == ["CABIN-DRY"]
    stated, ledger = filled(at, Cabin("log", relative_humidity=0.4))
    assert stated.cabin_vapour_pressure_pa[0] == pytest.approx(0.4 * 2489.0, rel=6e-3)
    assert not len(ledger)


def test_cameras_without_a_window_or_behind_a_bare_dome_have_no_sigma():
    at = stations(6000.0, cabin_pressure_pa=80_000.0)
    for windows in ({}, {"cam": Window(Cabin("log"), shape="spherical")}):
        found = with_cabin_air(at, windows, (), US1976, Ledger())
        assert np.isnan(found.sigma_cabin_pressure_pa).all()
        assert np.isnan(found.sigma_cabin_temperature_k).all()
    dome = {"cam": Window(Cabin("log"), shape="spherical")}
    found = with_cabin_air(at, dome, ["cam"], US1976, Ledger())
    assert found.sigma_cabin_temperature_k.tolist() == [5.0]


# ---------------------------------------------------------------- what the log lacks


def test_a_missing_barometer_names_what_could_play_it():
    at = stations(6000.0, 6000.0)
    found, (entry,) = cabin_from_log(
        at, "cam", Cabin("log"), (HULL, BARO, PROBE), {"pressure": HULL}
    )
    assert found.status.tolist() == ["suspect"] * 2
    assert (entry.kind, entry.code, entry.count) == ("loss", "CABIN-MISSING", 2)
    assert entry.what.endswith("log.channels.cabin_pressure could be BARO[1]")
    assert "temperature" not in entry.what


def test_a_missing_thermometer_loses_no_row():
    at = stations(6000.0, 6000.0, cabin_pressure_pa=80_000.0)
    found, (entry,) = cabin_from_log(at, "cam", Cabin("log"), (HULL, BARO, PROBE), {})
    assert found.ok.all()
    assert (entry.kind, entry.code, entry.count) == ("fallback", "CABIN-TEMPERATURE", 2)
    assert "pressure" not in entry.what
    assert "HYGR[1]" in entry.what
    assert "BARO[1] (its board, warmer than the air)" in entry.what
    # A mission file that names the log for it misses something: exit code 3, no row lost either.
    named = Cabin("log", temperature_logged=True)
    found, (entry,) = cabin_from_log(at, "cam", named)
    assert found.ok.all()
    assert entry.kind == "loss"
    assert entry.what.endswith("no channel of the log could play cabin_temperature")
    stated = Cabin("log", temperature_k=290.0)
    assert cabin_from_log(at, "cam", stated, (PROBE,)) == (at, ())


def test_a_board_is_warmer_than_the_air():
    """315 K on the board are 305 +- 6 K of air."""
    at = stations(6000.0, cabin_pressure_pa=80_000.0, cabin_temperature_k=315.0)
    at, (entry,) = cabin_from_log(at, "cam", Cabin("log"), (BARO,), {"cabin_temperature": BARO})
    assert (entry.kind, entry.code) == ("fallback", "CABIN-BOARD")
    assert "BARO[1], minus 10 +- 6 K" in entry.what
    found, _ = filled(at, Cabin("log"))
    assert (found.cabin_temperature_k[0], found.sigma_cabin_temperature_k[0]) == (305.0, 6.0)


def test_a_cabin_thinner_than_the_air_outside_is_told():
    thin = stations(1000.0, cabin_pressure_pa=80_000.0, cabin_temperature_k=290.0)
    _, ledger = filled(thin, Cabin("log"))
    (entry,) = (e for e in ledger if e.code == "CABIN-IMPLAUSIBLE")
    assert entry.kind == "warning"  # 898.76 hPa at 1000 m
    assert "less pressure than the air outside: 800 hPa and 17 degC" in entry.what
    _, ledger = filled(replace(thin, h_msl_m=np.array([1900.0])), Cabin("log"))  # 805 hPa
    assert "CABIN-IMPLAUSIBLE" not in [e.code for e in ledger]


def test_a_camera_that_took_no_image_is_no_error():
    stated = {"cam": Window(Cabin("constant", 80_000.0, 294.0)), "other": Window(Cabin("ambient"))}
    at = stations(1000.0)
    found = with_cabin_air(at, stated | {"none": stated["cam"]}, (), US1976, Ledger())
    assert found.cabin_pressure_pa.tolist() == [80_000.0]


@pytest.mark.parametrize(("inside_pa", "doubtful"), [(61_917.0, True), (47_300.0, False)])
def test_a_cabin_that_is_said_to_be_ambient_and_is_not(inside_pa, doubtful):
    at = stations(6000.0, 6000.0, pressure_pa=KM6_PA)
    at = replace(at, time_ns=np.array([0, 1]))
    other = channel("BARO[1]", pressure_pa=inside_pa)
    _, notes = cabin_from_log(at, "cam", Cabin("ambient"), (HULL, other), {"pressure": HULL})
    warnings = [entry for entry in notes if entry.code == "CABIN-IMPLAUSIBLE"]
    assert len(warnings) == doubtful
    if doubtful:
        assert "BARO[1] measures 147 hPa more" in warnings[0].what


@pytest.mark.parametrize(
    ("celsius", "height", "doubtful"),
    [(2.0, 6000.0, False), (0.0, 6000.0, True), (0.0, 1900.0, False), (-20.0, 1900.0, True)],
)
def test_a_temperature_that_is_no_cabins_is_told(celsius, height, doubtful):
    """Four sigmas of 21 +- 5 degC in a pressurised cabin, +- 10 in another; a number stands."""
    at = stations(height, cabin_pressure_pa=80_000.0, cabin_temperature_k=celsius + 273.15)
    found, ledger = filled(at, Cabin("log"))
    told = [e.what for e in ledger if e.code == "CABIN-IMPLAUSIBLE"]
    assert bool(told) == doubtful
    assert all(f"800 hPa and {celsius:.0f} degC" in what for what in told)
    assert found.cabin_temperature_k[0] == celsius + 273.15


# ---------------------------------------------------------------- the sigma against the truth


def claimed(at: Stations, lens: LensInAir | None = None, normal=(0.0, 0.0, 1.0), x=None, y=None):
    """Corrections with sigmas of pixels of a simulated camera straight above, at h = 0."""
    model = cameras(20_000.0)[0]
    camera = Camera(14_000, 10_600, 20_000.0, 20_000.0, model.cx_px, model.cy_px)
    lenses = {} if lens is None else {"cam": lens}
    exposures = exposures_of(
        at, US1976, {"cam": Window(Cabin("log"), normal)}, lenses, Ledger(), radius_m=RADIUS
    )
    one = np.zeros(1)
    sigmas = StationSigmas(
        one + np.nan,
        one + np.nan,
        np.array([[0.0, 0.0, 1.0]]),
        one,
        cabin_changes(at, lenses, US1976),
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
    zero = np.zeros(x.size)
    return correct_observations(
        x,
        y,
        zero,
        zero.astype(np.int64),
        exposures,
        camera=camera,
        table=ray_table(US1976),
        uncertainty=uncertainty,
    )


def test_draws_of_the_cabin_lie_within_their_sigma():
    """200 cabins of 21 +- 5 degC, the rays by the simulator's own window, index and camera."""
    celsius = np.random.default_rng(11).normal(21.0, 5.0, 200)
    h = 6000.0
    zeta = 0.30
    azimuth = 0.7
    n_out = float(1.0 + US1976.refractivity(h))
    n_in = edlen_index(np.full(200, 70_120.0), celsius + ZERO_CELSIUS_K, np.zeros(200))
    r_c = ray_angle_sphere(lambda z: float(1.0 + US1976.refractivity(z)), h, 0.0, zeta, RADIUS)
    model = replace(cameras(20_000.0)[0], distortion=(0.0,) * 5)

    def ray(angle):
        return np.array(
            [
                math.sin(angle) * math.cos(azimuth),
                math.sin(angle) * math.sin(azimuth),
                math.cos(angle),
            ]
        )

    inside, _ = through_window(np.tile(ray(zeta), (200, 1)), np.full(200, n_out), n_in)
    x, y = model.project(inside)
    true_x, true_y = model.project(ray(zeta - r_c)[None])
    at, _ = filled(stations(h, cabin_pressure_pa=70_120.0), Cabin("log", sigma_pressure_pa=0.0))
    found = claimed(at, x=x, y=y)
    assert np.isfinite(found.x_corrected_px).all(), "no row is lost"
    for error, sigma in (
        (found.x_corrected_px - true_x, found.sigmas.cabin_dx_px),
        (found.y_corrected_px - true_y, found.sigmas.cabin_dy_px),
    ):
        within = np.abs(error) <= sigma
        assert 0.60 <= within.mean() <= 0.76, within.mean()
        assert np.std(error) / np.median(sigma) == pytest.approx(np.std(celsius) / 5.0, rel=0.03)
    # 5 K of 294.15 are 3.19e-6 of the 187.84e-6 of Gyer's Table 7: 5 % of R at 6 km.
    assert np.median(found.sigmas.r_cc_rad) == pytest.approx(3.19e-6 * math.tan(zeta), rel=0.01)
    assert np.median(found.sigmas.r_cc_rad / found.r_c_rad) == pytest.approx(0.05, abs=0.006)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.5, math.sqrt(0.75))])
@pytest.mark.parametrize("lens", [None, LensInAir(20_000.0, 101_325.0, 288.15, 4e-5, -0.02)])
def test_against_corrections_with_other_air(normal, lens):
    """Half the difference of corrections with a sigma more and less, both quantities."""
    rng = np.random.default_rng(2)
    x = rng.uniform(500.0, 13_500.0, 30)
    y = rng.uniform(500.0, 10_100.0, 30)
    at, _ = filled(stations(6000.0, cabin_pressure_pa=80_000.0), Cabin("log"))
    found = claimed(at, lens, normal, x, y)
    expected = np.zeros((2, 30))
    for name, sigma in (("cabin_pressure_pa", 300.0), ("cabin_temperature_k", 5.0)):
        more, less = (
            claimed(replace(at, **{name: getattr(at, name) + d}), lens, normal, x, y)
            for d in (sigma, -sigma)
        )
        half = np.stack([more.dx_px - less.dx_px, more.dy_px - less.dy_px]) / 2.0
        expected = np.hypot(expected, half)
    for got, of_axis in zip(
        (found.sigmas.cabin_dx_px, found.sigmas.cabin_dy_px), expected, strict=True
    ):
        np.testing.assert_allclose(got, of_axis, rtol=0.005, atol=0.003 * np.median(of_axis))


# ---------------------------------------------------------------- the whole program


@pytest.mark.usefixtures("plain_report")
def test_a_log_without_a_cabin_thermometer(mission, unbend, monkeypatch):
    """No row is lost, check and run end with 0, and the sigma says what it costs."""
    channels = mission.config["log"]["channels"]
    del channels["cabin_temperature"], channels["cabin_humidity"]

    def without_box(*given, **named):
        log = open_log(*given, **named)
        return replace(log, channels=tuple(c for c in log.channels if c.name != "HYGR[1]"))

    monkeypatch.setattr(opening, "open_log", without_box)
    checked = unbend("check", mission.save())
    assert checked.code == 0, checked.text
    assert "CABIN-TEMPERATURE" in checked.text
    ended = mission.run()
    assert ended.code == 0, ended.text
    assert "CABIN-TEMPERATURE" in ended.text
    assert "% only. " in " ".join(ended.text.split())
    table = mission.results().to_pandas()
    assert (table["status"] == "ok").all()
    at = pq.read_table(mission.output / "stations.parquet").to_pandas()
    assert (at["cabin_temperature_k"] == 294.15).all()
    assert (at["sigma_cabin_temperature_k"] == 5.0).all()
    # 3 hPa of some 825 and 5 K of 294 are 1.74 % of N: R_cc turns by that, tan of the angle.
    n_minus_1 = 225e-6
    tangent = table["sigma_r_cc_rad"] / (n_minus_1 * math.hypot(3.0 / 825.0, 5.0 / 294.15))
    u = np.hypot(table["x_px"] - 7000.0, table["y_px"] - 5300.0) / 20_000.0
    assert np.median(tangent / u) == pytest.approx(1.0, abs=0.02)


@pytest.mark.usefixtures("plain_report")
def test_a_cabin_barometer_by_its_board(mission):
    mission.config["log"]["channels"]["cabin_temperature"] = "BARO[1]"
    ended = mission.run()
    assert ended.code == 0, ended.text
    assert "CABIN-BOARD" in ended.text
    at = pq.read_table(mission.output / "stations.parquet").to_pandas()
    assert (at["sigma_cabin_temperature_k"] == 6.0).all()
