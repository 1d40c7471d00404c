"""Exposures long after the climb: their air is less certain, in every result that tells of it."""

from dataclasses import replace

import pandas as pd
import pytest

from tests.helpers import entry_of, with_code
from unbend.batch.runs import read_mission
from unbend.library import corrected_table
from unbend.messages import Ledger
from unbend.stages.air_of_mission import adjusted_profiles
from unbend.tables.writing import table_of_profiles, table_of_stations

THREE_HOURS_NS = 3 * 3600 * 10**9


@pytest.fixture(scope="module")
def fresh(baseline):
    """The sample mission as it was flown."""
    return read_mission(baseline.file)


@pytest.fixture(scope="module")
def aged(fresh):
    """The same with a second exposure of each camera 3 h later, and a third 6 h later."""
    number = pd.Series(fresh.stations.image).str[-1].astype(int)
    later_ns = THREE_HOURS_NS * (number.to_numpy() - 1)
    stations = replace(fresh.stations, time_ns=fresh.stations.time_ns + later_ns)
    ledger = Ledger()
    air = adjusted_profiles(fresh.mission, stations, fresh.samples, fresh.sources, ledger)
    return replace(fresh, stations=stations, air=air, ledger=ledger)


def test_the_same_angles_and_larger_sigmas(fresh, aged):
    table, _ = corrected_table(replace(fresh, ledger=Ledger()))
    before = table.to_pandas()
    table, results = corrected_table(aged)
    after = table.to_pandas()

    for column in ("r_c_rad", "x_corrected_px"):
        assert after[column].equals(before[column])
    growth = after["sigma_air_dx_px"] / before["sigma_air_dx_px"]
    number = after["image"].str[-1]
    in_time, three_hours, six_hours = growth.groupby(number).median()
    assert in_time == pytest.approx(1.0, abs=1e-3)
    assert six_hours > three_hours > 1.5
    assert with_code(fresh.ledger, "AIR-AGED") == []
    assert entry_of(results.row(), "AIR-AGED")["count"] == 4
    effect, *_ = fresh.air.effects
    of_middle_exposure, *_ = aged.air.effects
    assert of_middle_exposure.r_c_rad == effect.r_c_rad
    assert of_middle_exposure.sigma_rad > 1.5 * effect.sigma_rad


def low_air(prepared):
    """The profiles of a mission between 600 and 900 m, and those of its stations by name."""
    air = prepared.air
    profiles = table_of_profiles(air.adjustment, air.series).to_pandas()
    stations = table_of_stations(prepared.stations, air.series).to_pandas()
    is_low = profiles["h_m"].between(600.0, 900.0)
    return profiles[is_low], stations.set_index("image")


def test_every_table_tells_of_it(fresh, aged):
    before, _ = low_air(fresh)
    profiles, stations = low_air(aged)
    assert set(stations["profile_id"]) == set(profiles["profile_id"])
    sigmas_k = []
    for number in "123":
        nadir, oblique = stations["profile_id"].filter(like=number)
        assert nadir == oblique
        rows = profiles[profiles["profile_id"] == nadir]
        assert rows["temperature_k"].tolist() == before["temperature_k"].tolist()
        sigmas_k.append(rows["sigma_temperature_k"].mean())
    in_time, three_hours, six_hours = sigmas_k
    assert in_time == pytest.approx(before["sigma_temperature_k"].mean(), rel=1e-3)
    assert six_hours > three_hours > 1.5 * in_time
