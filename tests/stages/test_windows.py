"""Windows and lenses from the mission file to the results."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from unbend.batch.results import read_manifest

pytestmark = pytest.mark.usefixtures("plain_report")

LENS = {
    "reference": {"pressure_hpa": 1013.25, "temperature_c": 20.0},
    "dc_dp_px_per_hpa": 0.002,
    "dc_dt_px_per_k": 0.0,
}


def ran(mission, exit_code: int = 0) -> dict:
    ended = mission.run()
    assert ended.code == exit_code, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def said(manifest: dict) -> dict[tuple[str, str], str]:
    return {(e["code"], e["where"].removeprefix("cameras.")): e["what"] for e in manifest["ledger"]}


def test_a_dome_a_schedule_and_a_lens(mission):
    """No channel of a cabin is named, and none is missed."""
    cameras = mission.config["cameras"]
    cameras["nadir"]["window"] = {"shape": "spherical"}
    cameras["oblique"]["window"] = {"cabin": "standard_schedule", "frame": "body"}
    cameras["oblique"]["principal_distance"] = LENS
    channels = mission.config["log"].get("channels", {})
    for role in ("cabin_pressure", "cabin_temperature", "cabin_humidity"):
        channels.pop(role, None)
    ledger = said(ran(mission))
    assert ("WINDOW-SPHERICAL", "nadir.window") in ledger
    assert "is not removed" in ledger["WINDOW-GLASS", "oblique.window"]
    assert ("CABIN-SCHEDULE", "oblique.window.cabin") in ledger
    assert ("LENS-IN-AIR", "oblique.principal_distance") in ledger
    assert "distance of nadir is not" in ledger["LENS-NOT-REMOVED", "<name>.principal_distance"]
    table = mission.results().to_pandas()
    camera = mission.stations().to_pandas().set_index("image")["camera"]
    nadir = (table["image"].map(camera) == "nadir").to_numpy()
    assert (table["r_cc_rad"][nadir] == 0.0).all()
    assert np.isfinite(table["r_cc_rad"]).all()


def miss_px(mission) -> float:
    """How far the rays of tie points miss each other, as the ledger states it [px]."""
    ledger = said(ran(mission))
    (text,) = [what for (code, _), what in ledger.items() if code == "TIES-RESIDUALS"]
    return float(re.search(r"by ([0-9.]+) px", text)[1])


def test_misses_of_rays_are_in_pixels_behind_a_window_too(mission):
    """A window with the air of outside bends nothing: with it the rays miss by as many pixels."""
    for role in ("cabin_pressure", "cabin_temperature", "cabin_humidity"):
        mission.config["log"]["channels"].pop(role)
    for camera in mission.config["cameras"].values():
        camera.pop("window")
    without_window = miss_px(mission)
    for camera in mission.config["cameras"].values():
        camera["opening"] = {"warmer_k": 0.0}
    assert miss_px(mission) == pytest.approx(without_window, rel=0.05)


@pytest.mark.parametrize("pressure", [819, 819.5, "log", "ambient"])
def test_every_pressure_of_a_cabin_comes_back_from_the_manifest(mission, pressure):
    """What a mission file may state, its manifest and its report must be able to read."""
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": {"pressure": pressure, "temperature_c": 21}}
    ended = mission.run()
    assert ended.code in (0, 3), ended.text  # an unpressurised cabin contradicts the log
    sections = read_manifest(mission.output).sections
    assert sections.cameras["nadir"].window.cabin.pressure == pressure


def test_an_absurd_lens_refuses_the_mission(mission):
    lens = LENS | {"dc_dp_px_per_hpa": 5.0}
    mission.config["cameras"]["nadir"]["principal_distance"] = lens
    ended = mission.run()
    assert ended.code == 6, ended.text
    assert "LENS-CHANGE" in ended.text
    assert "cameras.nadir.principal_distance" in ended.text


def test_a_window_that_looks_away_refuses_the_file(mission):
    mission.config["cameras"]["oblique"]["window"] = {
        "cabin": "log",
        "frame": "body",
        "normal": [0.0, 0.0, -1.0],
    }
    ended = mission.run()
    assert ended.code == 2, ended.text
    assert "'oblique' has a normal away" in ended.text


def test_an_aircraft_attitude_that_the_log_does_not_have(mission):
    mission.config["log"].setdefault("channels", {})["aircraft_attitude"] = "ATT[9]"
    ended = mission.run()
    assert ended.code == 6, ended.text
    assert "log.channels.aircraft_attitude" in ended.text
