"""A weather model as a source of a mission's air, end to end; the truth is the simulator's."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.conftest import run_command
from tests.model_files import dataset, netcdf
from unbend import correct
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.series import profiles_by_place
from unbend.batch.results import verify_run
from unbend.batch.runs import read_mission
from unbend.messages import Ledger
from unbend.simulate.flight import FIELD_LAT_RAD
from unbend.simulate.true_air import temperature_k, true_air, vapour_pressure_pa
from unbend.stages.air_of_mission import adjusted_profiles
from unbend.stages.air_sources import read_air_sources

from .test_oriented_stations import columns_of

pytestmark = pytest.mark.usefixtures("plain_report")

NORTH = (48.0, 47.5, 47.0)
EAST = (8.0, 8.5, 9.0)
HOURS = ("2025-06-12T09", "2025-06-12T10", "2025-06-12T11")
H = np.arange(-200.0, 20_000.0, 20.0)
PRESSURE = true_air(FIELD_LAT_RAD).pressure_pa(H)
NAME = "weather model era5.nc 2025-06-12T10:00"


def true_column(*_):
    return H, temperature_k(H), PRESSURE, np.maximum(vapour_pressure_pa(H), 1e-4)


@pytest.fixture(scope="module")
def fields():
    return dataset(true_column, NORTH, EAST, HOURS)


@pytest.fixture
def modelled(mission, fields):
    """The mission with a weather model beside its sensors."""
    netcdf(mission.folder / "era5.nc", fields)
    mission.config["atmosphere"] = {"model": {"path": "era5.nc"}}
    return mission


def manifest(mission):
    return json.loads((mission.output / "manifest.json").read_text())


def true_factor(h_g: float, h_c: float) -> float:
    """R / tan(zeta) in the plane: Gyer 1996, Eq. 24."""
    n = true_air(FIELD_LAT_RAD).n(np.linspace(h_g, h_c, 3001)) - 1.0
    return float(np.mean(0.5 * (n[1:] + n[:-1])) - n[-1])


def factor(profile, h_g: float, h_c: float) -> float:
    n = profile.refractivity(np.linspace(h_g, h_c, 3001))
    return float(np.mean(0.5 * (n[1:] + n[:-1])) - n[-1])


def test_beside_the_sensors_it_is_used_hashed_and_named(modelled, unbend):
    checked = unbend("check", modelled.save())
    assert checked.code == 0, checked.text
    assert "weather model  era5.nc of 2025-06-12T10:00 UTC:" in checked.out
    assert modelled.run().code == 0
    told = manifest(modelled)
    (entry,) = [e for e in told["ledger"] if e["code"] == "MODEL-COLUMN"]
    assert "0.4 h from the nearest time of the file" in entry["what"]
    assert "weather model" in {row["role"] for row in told["inputs"]}
    used = [row for row in told["profile"]["sources"] if row["source"] == NAME]
    assert [row["quantity"] for row in used] == ["temperature", "humidity", "pressure"]
    assert told["profile"]["basis"] == "thermometer"
    assert "with " + NAME in told["profile"]["reason"]
    assert "0 missions of 1 would run" in unbend("status", modelled.file).out
    with (modelled.folder / "era5.nc").open("ab") as file:
        file.write(bytes(8))
    assert "weather model" in unbend("status", modelled.file).out


def test_the_flights_own_sensors_win(modelled, fields):
    netcdf(modelled.folder / "era5.nc", fields.assign(t=fields.t + 2.0))
    air = read_mission(modelled.save()).air.adjustment
    del modelled.config["atmosphere"]["model"]
    alone = read_mission(modelled.save()).air.adjustment
    h = np.linspace(500.0, 2900.0, 50)
    # A thermometer and a barometer are good to 0.5 K together, an analysis to 1 K, and to 2 K low.
    assert np.abs(air.profile.temperature(h) - alone.profile.temperature(h)).max() < 0.4


def test_without_sensors_the_air_is_the_models(modelled):
    read = read_mission(modelled.save())
    nothing = AirSamples()
    ledger = Ledger()
    heights = replace(read.flight.heights, home_h_msl_m=450.0)
    flight = replace(read.flight, heights=heights, roles={})
    sources = read_air_sources(
        read.mission, read.inputs, flight, read.stations, nothing, ledger=ledger
    )
    air = adjusted_profiles(read.mission, read.stations, nothing, sources, ledger).adjustment
    assert air.basis == "weather model"
    assert air.is_measured
    assert air.reason == NAME
    right = true_factor(450.0, 2950.0)
    relative_sigma = air.covariance.relative_sigma(2950.0, 450.0)
    assert 0.015 < relative_sigma < 0.05
    # An analysis is good to 2 K near the ground: the climatology draws it 1.8 K to its own side.
    assert factor(air.profile, 450.0, 2950.0) == pytest.approx(right, rel=relative_sigma)


def test_one_of_another_day_is_refused(modelled, fields):
    later = fields.valid_time + np.timedelta64(1, "D")
    netcdf(modelled.folder / "era5.nc", fields.assign_coords(valid_time=later))
    ended = modelled.run()
    assert ended.code == 6
    assert "MODEL-TIME: its times, 2025-06-13T09:00 to 2025-06-13T11:00 UTC" in ended.err


def test_a_standard_asked_for_leaves_it_unused(modelled):
    modelled.config["atmosphere"]["adjust"] = False
    (entry,) = [e for e in read_mission(modelled.save()).ledger if e.code == "AIR-SOURCES-UNUSED"]
    assert "1 column (soundings, weather model)" in entry.what
    assert entry.count == 1  # sources that are not used
    assert run_command("check", modelled.file).code == 0


def test_in_a_long_flight_each_exposure_has_the_air_of_its_place(
    modelled, fields, baseline, monkeypatch
):
    monkeypatch.setattr(profiles_by_place, "LONG_KM", 0.5)
    monkeypatch.setattr(profiles_by_place, "_CELL_KM", 0.2)
    steep = fields.t + 50.0 * (fields.longitude - 8.5)  # 66 K in 100 km
    netcdf(modelled.folder / "era5.nc", fields.assign(t=steep))
    assert modelled.run().code == 0
    (entry,) = [e for e in manifest(modelled)["ledger"] if e["code"] == "AIR-BY-PLACE"]
    stations = modelled.stations().to_pandas()
    profiles = pq.read_table(modelled.output / "profile.parquet").to_pandas()
    assert set(stations["profile_id"]) == set(profiles["profile_id"])
    assert 2 < profiles["profile_id"].nunique() <= entry["count"]
    # R follows the air of the place, against the one profile of the usual run.
    both = [
        run.results().to_pandas().set_index(["image", "point"])["r_c_rad"]
        for run in (modelled, baseline)
    ]
    east = stations.set_index("image")["lon_deg"] - stations["lon_deg"].median()
    ratio = (both[0] / both[1]).groupby("image").median().dropna()
    assert np.corrcoef(ratio, east[ratio.index])[0, 1] < -0.8
    assert verify_run(modelled.output)


def test_correct_takes_it_from_python(modelled, baseline):
    """Paths of the section are relative to the working folder, or whole."""
    atmosphere = {"model": {"path": str(modelled.folder / "era5.nc")}}
    camera = {
        "width_px": 14000,
        "height_px": 10600,
        "f_px": 20000.0,
        "cx_px": 7012.4,
        "cy_px": 5291.7,
        "calibration": "laboratory",
    }
    run = baseline.results().to_pandas()
    stations = columns_of(baseline.stations().to_pandas()).rename(columns={"time": "time_utc"})
    given = run[["image", "point", "x_px", "y_px", "h_g_m"]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # pinholes do not fit the points
        corrected = correct(
            given,
            stations,
            atmosphere,
            {"nadir": camera, "oblique": camera},
            orientation={"heights": "msl"},
        )
    told = [entry["code"] for entry in corrected.attrs["ledger"]]
    assert "MODEL-COLUMN" in told
    ratio = (corrected["r_c_rad"] / run["r_c_rad"].to_numpy()).median()
    assert ratio == pytest.approx(1.0, abs=0.02)
