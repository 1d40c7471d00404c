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

HOUR_NS = 3600 * 10**9


@pytest.fixture(scope="module")
def fresh(baseline):
    """The sample mission as it was flown."""
    return read_mission(baseline.file)


@pytest.fixture(scope="module")
def aged(fresh):
    """The same with a second exposure of each camera 3 h later, and a third 6 h later."""
    flown = fresh.stations
    hours = pd.Series(flown.image).str[-1].map({"1": 0, "2": 3, "3": 6})
    later_ns = hours.to_numpy() * HOUR_NS
    stations = replace(flown, time_ns=flown.time_ns + later_ns)
    ledger = Ledger()
    air = adjusted_profiles(
        fresh.mission,
        stations,
        fresh.samples,
        fresh.sources,
        ledger,
    )
    return replace(fresh, stations=stations, air=air, ledger=ledger)


def test_the_same_angles_and_larger_sigmas(fresh, aged):
    before, _ = corrected_table(replace(fresh, ledger=Ledger()))
    after, results = corrected_table(aged)
    before = before.to_pandas()
    after = after.to_pandas()

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
    """The profiles of a mission between 600 and 900 m, and which one each image has."""
    air = prepared.air
    profiles = table_of_profiles(air.adjustment, air.series)
    profiles = profiles.to_pandas()
    stations = table_of_stations(prepared.stations, air.series)
    stations = stations.to_pandas()
    is_low = profiles["h_m"].between(600.0, 900.0)
    profile_of_image = stations.set_index("image")["profile_id"]
    return profiles[is_low], profile_of_image


def test_every_table_tells_of_it(fresh, aged):
    before, _ = low_air(fresh)
    profiles, profile_of_image = low_air(aged)
    assert set(profile_of_image) == set(profiles["profile_id"])

    sigmas_k = []
    for number in "123":
        nadir, oblique = profile_of_image.filter(like=number)
        assert nadir == oblique
        rows = profiles[profiles["profile_id"] == nadir]
        assert list(rows["temperature_k"]) == list(before["temperature_k"])
        sigmas_k.append(rows["sigma_temperature_k"].mean())

    in_time, three_hours, six_hours = sigmas_k
    fresh_k = before["sigma_temperature_k"].mean()
    assert in_time == pytest.approx(fresh_k, rel=1e-3)
    assert six_hours > three_hours > 1.5 * in_time
