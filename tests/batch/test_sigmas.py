"""Standard deviations from the mission file to the results, and what is said where there are none.

The covariance here is that of the pressure alone: R goes with pressure, so its relative error is
that of the pressure, whatever the ray.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline import stages
from pipeline.atmosphere.covariance import ProfileCovariance

pytestmark = pytest.mark.usefixtures("plain_report")

LN_P = 0.004
COLUMNS = {
    kind: [f"sigma_{kind}_dx_px", f"sigma_{kind}_dy_px"] for kind in ("air", "station", "ground")
}


def with_covariance(monkeypatch, covariance_of):
    """Runs whose air, all of it, has this covariance."""
    original = stages.adjust_air

    def adjust_air(*given):
        air = original(*given)
        covariance = covariance_of(air.adjustment.profile)
        airs = tuple(replace(one, own=covariance, ends=None) for one in air.along.airs)
        adjustment = replace(air.adjustment, covariance=covariance)
        return replace(air, adjustment=adjustment, along=replace(air.along, airs=airs))

    monkeypatch.setattr(stages, "adjust_air", adjust_air)


@pytest.fixture
def pressure_in_doubt(monkeypatch):
    """Runs know their pressure to 0.4 %, and nothing else of the air is in doubt."""

    def covariance_of(profile):
        size = profile.layers.edge.size
        matrix = np.zeros((2 * size + 1, 2 * size + 1))
        matrix[size, size] = LN_P**2
        return ProfileCovariance(profile, 1000.0, matrix)

    with_covariance(monkeypatch, covariance_of)


@pytest.fixture
def nothing_in_doubt(monkeypatch):
    """Runs of which nobody knows how good their air is."""
    with_covariance(monkeypatch, lambda profile: None)


def ran(mission, exit_code: int = 0) -> dict:
    ended = mission.run()
    assert ended.code == exit_code, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def unknown(manifest: dict) -> list[str]:
    return [e["what"] for e in manifest["ledger"] if e["code"] == "SIGMA-UNKNOWN"]


def with_tilt(mission, tilt=0.2) -> None:
    for mount in mission.config["mount"].values():
        mount["sigma_tilt_deg"] = tilt


def good(mission):
    table = mission.results().to_pandas()
    return table[table["status"] == "ok"]


@pytest.mark.usefixtures("pressure_in_doubt")
def test_all_three(mission):
    with_tilt(mission)
    mission.config["ground"]["sigma_m"] = 5.0
    manifest = ran(mission)
    table = good(mission)
    for names in COLUMNS.values():
        assert np.isfinite(table[names].to_numpy()).all()
        assert (table[names].to_numpy() > 0.0).all()
    np.testing.assert_allclose(table["sigma_r_c_rad"], LN_P * table["r_c_rad"], rtol=2e-3)
    scale = manifest["uncertainty"]
    np.testing.assert_allclose(scale["scale_sigma"], LN_P, rtol=1e-3)
    np.testing.assert_allclose(scale["correlation"], 1.0, rtol=1e-6)
    assert 0 < scale["rays"] <= len(table)
    assert not unknown(manifest)
    meaning = mission.results().schema.field("sigma_air_dx_px").metadata[b"meaning"]
    assert b"never to be added" in meaning


@pytest.mark.usefixtures("pressure_in_doubt")
def test_the_shift_is_scaled_by_the_air(mission):
    """Without a window the whole shift is refraction, and the air scales it in x and y alike."""
    for camera in mission.config["cameras"].values():
        del camera["window"]
    ran(mission)
    table = good(mission)
    for axis in "xy":
        shift = (table[f"{axis}_corrected_px"] - table[f"{axis}_px"]).abs()
        np.testing.assert_allclose(table[f"sigma_air_d{axis}_px"], LN_P * shift, rtol=5e-3)


@pytest.mark.usefixtures("nothing_in_doubt")
def test_nobody_knows_anything(mission):
    manifest = ran(mission)
    table = mission.results()
    for name in ("sigma_r_c_rad", *COLUMNS["air"], *COLUMNS["station"], *COLUMNS["ground"]):
        assert table[name].null_count == table.num_rows
    assert manifest["uncertainty"] is None
    (what,) = unknown(manifest)
    for missing in ("covariance", "mount.nadir.sigma_tilt_deg", "ground.sigma_m"):
        assert missing in what


@pytest.mark.usefixtures("nothing_in_doubt")
def test_yaw_of_a_level_aircraft_moves_nothing(mission):
    """Its axis is the aircraft's vertical, not the camera's axis, also where that looks aside."""
    for mount in mission.config["mount"].values():
        mount |= {"sigma_tilt_deg": 0.0, "sigma_yaw_deg": 3.0}
    ran(mission)
    table = good(mission)
    shift = np.hypot(
        table["x_corrected_px"] - table["x_px"], table["y_corrected_px"] - table["y_px"]
    )
    sigma = np.hypot(table["sigma_station_dx_px"], table["sigma_station_dy_px"])
    oblique = np.degrees(table["zeta_c_rad"]) > 30.0
    # The whole yaw would be 5 % of the shift, about the axis of the oblique camera some 4 %.
    assert float((sigma / shift)[oblique].median()) < 0.01


@pytest.mark.usefixtures("nothing_in_doubt")
def test_one_camera_and_a_column_of_sigmas(mission):
    """Each column is null where its own cause is unknown; a bad sigma is counted."""
    mission.config["mount"]["nadir"]["sigma_tilt_deg"] = 0.1
    table = mission.measurements()
    sigma = np.full(table.num_rows, 3.0)
    sigma[:3] = np.nan, -1.0, np.inf
    mission.observe(table.append_column("sigma_h", [sigma]))
    mission.config["ground"]["sigma_column"] = "sigma_h"
    manifest = ran(mission)
    (what,) = unknown(manifest)
    assert "mount.oblique.sigma_tilt_deg" in what
    assert "nadir" not in what
    assert "ground" not in what
    (bad,) = [e for e in manifest["ledger"] if e["code"] == "OBS-SIGMA"]
    assert bad["count"] == 2
    out = mission.results().to_pandas()
    ok = (out["status"] == "ok").to_numpy()
    camera = out["image"].map(mission.stations().to_pandas().set_index("image")["camera"])
    nadir = (camera == "nadir").to_numpy()
    assert (out["sigma_station_dx_px"].notna() == (ok & nadir)).all()
    assert out["sigma_ground_dx_px"][:3].isna().all()
    assert out["sigma_ground_dx_px"][3:][ok[3:]].notna().all()
    assert out["sigma_air_dx_px"].isna().all()
    np.testing.assert_array_equal(out["sigma_h"], sigma)


def test_a_column_that_is_not_there(mission):
    mission.config["ground"]["sigma_column"] = "sigma_h"
    ended = mission.run()
    assert ended.code == 6, ended.text
    assert "OBS-COLUMN" in ended.text
    assert "ground.sigma_column" in ended.text


@pytest.mark.usefixtures("pressure_in_doubt")
def test_displaced_observations_have_them_too(mission):
    with_tilt(mission)
    mission.config["refraction"] = {"direction": "apply"}
    manifest = ran(mission)
    table = good(mission)
    np.testing.assert_allclose(table["sigma_r_c_rad"], LN_P * table["r_c_rad"], rtol=2e-3)
    assert (table["sigma_station_dx_px"] > 0.0).all()
    np.testing.assert_allclose(manifest["uncertainty"]["scale_sigma"], LN_P, rtol=1e-3)
