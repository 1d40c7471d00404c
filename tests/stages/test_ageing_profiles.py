"""Exposures long after the climb: their air is less certain, in every result that tells of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import entry_of
from unbend.batch.runs import read_mission
from unbend.library import corrected_table
from unbend.messages import Ledger
from unbend.stages.air_of_mission import adjusted_profiles
from unbend.tables.writing import table_of_profiles, table_of_stations

HOURS = np.array([0.0, 3.0, 6.0])
"""How long after the flight the first, second and third exposure of each camera seem to be."""


@pytest.fixture(scope="module")
def fresh(baseline):
    """The sample mission as it was flown."""
    return read_mission(baseline.file)


@pytest.fixture(scope="module")
def aged(fresh):
    """The same with exposures that are hours later, in the air that was measured in the climb."""
    exposure = np.unique(fresh.stations.time_ns // 10**9, return_inverse=True)[1]
    later_ns = (HOURS[exposure * HOURS.size // (exposure.max() + 1)] * 3600e9).astype(np.int64)
    stations = replace(fresh.stations, time_ns=fresh.stations.time_ns + later_ns)
    ledger = Ledger()
    air = adjusted_profiles(fresh.mission, stations, fresh.samples, fresh.sources, ledger)
    return replace(fresh, stations=stations, air=air, ledger=ledger), later_ns


def test_the_same_angles_and_larger_sigmas(fresh, aged):
    prepared, later_ns = aged
    before, _ = corrected_table(replace(fresh, ledger=Ledger()))
    after, results = corrected_table(prepared)
    for column in ("r_c_rad", "x_corrected_px"):
        np.testing.assert_array_equal(after[column], before[column])
    growth = after["sigma_air_dx_px"].to_numpy() / before["sigma_air_dx_px"].to_numpy()
    later_of_image = dict(zip(prepared.stations.image, later_ns, strict=True))
    later = np.array([later_of_image[name] for name in after["image"].to_pylist()])
    least_by_age = [growth[later == age].min() for age in np.unique(later)]
    assert least_by_age[0] == pytest.approx(1.0, abs=1e-3)
    assert least_by_age[1] > 1.5
    assert least_by_age[2] > least_by_age[1]
    assert entry_of(results.row(), "AIR-AGED")["count"] == np.count_nonzero(later_ns)


def test_every_table_tells_of_it(fresh, aged):
    prepared, later_ns = aged
    stations = table_of_stations(prepared.stations, prepared.air.series).to_pandas()
    assert stations["profile_id"].groupby(later_ns).nunique().tolist() == [1, 1, 1]
    before = table_of_profiles(fresh.air.adjustment, fresh.air.series).to_pandas()
    profiles = table_of_profiles(prepared.air.adjustment, prepared.air.series).to_pandas()
    assert set(profiles["profile_id"]) == set(stations["profile_id"])
    sigmas_k = []
    for name in stations.groupby(later_ns)["profile_id"].first():
        rows = profiles[profiles["profile_id"] == name]
        assert rows["temperature_k"].tolist() == before["temperature_k"].tolist()
        low = rows["h_m"].between(600.0, 900.0)
        sigmas_k.append(rows["sigma_temperature_k"][low].mean())
    low = before["h_m"].between(600.0, 900.0)
    assert sigmas_k[0] == pytest.approx(before["sigma_temperature_k"][low].mean(), rel=1e-3)
    assert sigmas_k[1] > 1.5 * sigmas_k[0]
    assert sigmas_k[2] > sigmas_k[1]


def test_the_effect_of_the_flight_is_that_of_its_middle_exposure(fresh, aged):
    prepared, _ = aged
    before = fresh.air.effects[0]
    after = prepared.air.effects[0]
    assert after.r_c_rad == before.r_c_rad
    assert after.sigma_rad > 1.5 * before.sigma_rad
