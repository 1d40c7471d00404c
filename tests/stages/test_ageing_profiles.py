"""Exposures long after the climb: their air is less certain, in every result that tells of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from unbend.atmosphere.series import ageing, profile_series

pytestmark = pytest.mark.usefixtures("plain_report")

SLOT_S = 5


@pytest.fixture
def restless(mission, baseline, monkeypatch):
    """The sample mission in air that changes in minutes as much as elsewhere in hours."""
    monkeypatch.setattr(ageing, "FRESH_S", 90.0)
    calm = ageing.variation_parts
    monkeypatch.setattr(
        ageing,
        "variation_parts",
        lambda *of: tuple(replace(part, sigma_k=14.0 * part.sigma_k) for part in calm(*of)),
    )
    monkeypatch.setattr(profile_series, "SLOT_NS", SLOT_S * 10**9)
    ended = mission.run("--force")
    assert ended.code == 0, ended.text
    return mission


def manifest(mission):
    return json.loads((mission.output / "manifest.json").read_text())


def test_the_same_angles_and_larger_sigmas(restless, baseline):
    old, new = (
        run.results().to_pandas().set_index(["image", "point"]) for run in (baseline, restless)
    )
    np.testing.assert_array_equal(new["r_c_rad"], old["r_c_rad"])
    np.testing.assert_array_equal(new["x_corrected_px"], old["x_corrected_px"])
    grown = (new["sigma_air_dx_px"] / old["sigma_air_dx_px"]).dropna()
    assert grown.min() > 0.999
    assert grown.median() > 2.0
    # All exposures within five seconds share the age of their air.
    stations = restless.stations().to_pandas().set_index("image")
    times = stations["time_utc"].astype("int64")
    slots = ((times - times.min()) // (SLOT_S * 10**9)).groupby(stations["profile_id"]).nunique()
    assert len(slots) > 2
    assert slots.max() == 1 or slots.drop(index=slots.idxmax()).max() == 1


def test_every_table_tells_of_it(restless, baseline):
    profiles = pq.read_table(restless.output / "profile.parquet").to_pandas()
    ids = set(restless.stations().to_pandas()["profile_id"].dropna())
    assert ids == set(profiles["profile_id"])
    before = pq.read_table(baseline.output / "profile.parquet").to_pandas().set_index("h_m")
    for _, one in profiles.set_index("h_m").groupby("profile_id"):
        assert (one["temperature_k"] == before["temperature_k"]).all()
        grown = one["sigma_temperature_k"] / before["sigma_temperature_k"]
        assert grown.min() > 0.999
        assert grown[(grown.index > 600.0) & (grown.index < 900.0)].min() > 3.0
    told = manifest(restless)
    (entry,) = [e for e in told["ledger"] if e["code"] == "AIR-AGED"]
    assert entry["count"] > 0
    assert not [e for e in manifest(baseline)["ledger"] if e["code"] == "AIR-AGED"]
    before, after = (m["profile"]["effect"][0]["sigma_factor"] for m in (manifest(baseline), told))
    assert after > 2.0 * before
