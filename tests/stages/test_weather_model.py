"""A weather model as a source of a mission's air, end to end; the truth is the simulator's."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.helpers import codes_of, entry_of, with_code
from tests.model_files import dataset, netcdf
from tests.stages.oriented_tables import PINHOLES, columns_of
from tests.stages.other_logs import read_folder
from tests.stages.plane_rays import TRUE_AIR, plane_factor, true_refractivity
from unbend import correct
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.series import profiles_by_place
from unbend.batch.results import verify_run
from unbend.messages import Ledger
from unbend.simulate.true_air import temperature_k, vapour_pressure_pa
from unbend.stages.air_of_mission import adjusted_profiles
from unbend.stages.air_sources import read_air_sources

NORTH = (48.0, 47.5, 47.0)
EAST = (8.0, 8.5, 9.0)
HOURS = ("2025-06-12T09", "2025-06-12T10", "2025-06-12T11")
H = np.arange(-200.0, 20_000.0, 20.0)
PRESSURE = TRUE_AIR.pressure_pa(H)
NAME = "weather model era5.nc 2025-06-12T10:00"


def true_column(*_):
    vapour = np.maximum(vapour_pressure_pa(H), 1e-4)
    return H, temperature_k(H), PRESSURE, vapour


@pytest.fixture(scope="module")
def fields():
    return dataset(true_column, NORTH, EAST, HOURS)


def write_model(mission, fields):
    netcdf(mission.folder / "era5.nc", fields)


@pytest.fixture
def modelled(mission, fields):
    """The mission with a weather model beside its sensors."""
    write_model(mission, fields)
    mission.config["atmosphere"] = {"model": {"path": "era5.nc"}}
    return mission


def test_beside_the_sensors_it_is_used_hashed_and_named(modelled, unbend):
    checked = unbend("check", modelled.save())
    assert checked.code == 0, checked.text
    assert "weather model  era5.nc of 2025-06-12T10:00 UTC:" in checked.out
    manifest = modelled.run_to_manifest()
    column = entry_of(manifest, "MODEL-COLUMN")
    assert "0.4 h from the nearest time of the file" in column["what"]
    assert "weather model" in {item["role"] for item in manifest["inputs"]}
    profile = manifest["profile"]
    used = [row["quantity"] for row in profile["sources"] if row["source"] == NAME]
    assert used == ["temperature", "humidity", "pressure"]
    assert profile["basis"] == "thermometer"
    assert f"with {NAME}" in profile["reason"]
    assert "0 missions of 1 would run" in unbend("status", modelled.file).out
    with (modelled.folder / "era5.nc").open("ab") as file:
        file.write(bytes(8))
    assert "weather model" in unbend("status", modelled.file).out


def test_the_flights_own_sensors_win(modelled, fields):
    write_model(modelled, fields.assign(t=fields.t + 2.0))
    with_model = read_folder(modelled).air.adjustment.profile
    del modelled.config["atmosphere"]["model"]
    alone = read_folder(modelled).air.adjustment.profile
    h = np.linspace(500.0, 2900.0, 50)
    # A thermometer and a barometer are good to 0.5 K together, an analysis to 1 K, and to 2 K low.
    difference_k = with_model.temperature(h) - alone.temperature(h)
    assert np.abs(difference_k).max() < 0.4


def test_without_sensors_the_air_is_the_models(modelled):
    read = read_folder(modelled)
    nothing = AirSamples()
    ledger = Ledger()
    heights = replace(read.flight.heights, home_h_msl_m=450.0)
    flight = replace(read.flight, heights=heights, roles={})
    sources = read_air_sources(
        read.mission,
        read.inputs,
        flight,
        read.stations,
        nothing,
        ledger=ledger,
    )
    series = adjusted_profiles(read.mission, read.stations, nothing, sources, ledger)
    air = series.adjustment
    assert air.basis == "weather model"
    assert air.is_measured
    assert air.reason == NAME
    right = plane_factor(true_refractivity, 450.0, 2950.0)
    relative_sigma = air.covariance.relative_sigma(2950.0, 450.0)
    assert 0.015 < relative_sigma < 0.05
    # An analysis is good to 2 K near the ground: the climatology draws it 1.8 K to its own side.
    estimated = plane_factor(air.profile.refractivity, 450.0, 2950.0)
    assert estimated == pytest.approx(right, rel=relative_sigma)


def test_a_standard_asked_for_leaves_it_unused(modelled):
    modelled.config["atmosphere"]["adjust"] = False
    ledger = read_folder(modelled).ledger
    (unused,) = with_code(ledger, "AIR-SOURCES-UNUSED")
    assert "1 column (soundings, weather model)" in unused.what
    assert unused.count == 1  # sources that are not used
    assert not ledger.has_losses


def test_in_a_long_flight_each_exposure_has_the_air_of_its_place(
    modelled, fields, baseline, monkeypatch
):
    # The simulated flight has two kilometres; a mission that is long has hundreds.
    monkeypatch.setattr(profiles_by_place, "LONG_KM", 0.5)
    monkeypatch.setattr(profiles_by_place, "_CELL_KM", 0.2)
    steep = fields.t + 50.0 * (fields.longitude - 8.5)  # 66 K in 100 km
    write_model(modelled, fields.assign(t=steep))
    entry = entry_of(modelled.run_to_manifest(), "AIR-BY-PLACE")
    stations = modelled.station_rows()
    profiles = pd.read_parquet(modelled.output / "profile.parquet")
    names = set(profiles["profile_id"])
    assert set(stations["profile_id"]) == names
    assert 2 < len(names) <= entry["count"]
    # R follows the air of the place, against the one profile of the usual run.
    rows = modelled.result_rows()
    usual = baseline.result_rows()
    ratios = rows["r_c_rad"] / usual["r_c_rad"]
    ratio = ratios.groupby(rows["image"]).median().dropna()
    longitude = stations.set_index("image")["lon_deg"][ratio.index]
    assert np.corrcoef(ratio, longitude)[0, 1] < -0.8
    assert verify_run(modelled.output)


@pytest.mark.filterwarnings("ignore::UserWarning")  # pinholes do not fit the points
def test_correct_takes_it_from_python(modelled, baseline):
    """Paths of the section are relative to the working folder, or whole."""
    path = modelled.folder / "era5.nc"
    atmosphere = {"model": {"path": str(path)}}
    run = baseline.result_rows()
    stations = columns_of(baseline.station_rows())
    measured = run[["image", "point", "x_px", "y_px", "h_g_m"]]
    result = correct(
        measured,
        stations.rename(columns={"time": "time_utc"}),
        atmosphere,
        PINHOLES,
        orientation={"heights": "msl"},
    )
    assert "MODEL-COLUMN" in codes_of(result.attrs)
    ratio = (result["r_c_rad"] / run["r_c_rad"]).median()
    # The sensors know the inversion over this flight, the model's air is drawn to the usual one.
    assert ratio == pytest.approx(1.0, abs=0.03)
