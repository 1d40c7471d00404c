"""Windows and lenses from the mission file to the results."""

import re

import numpy as np
import pytest

from tests.helpers import entry_of
from tests.stages.corrected_rows import rows_of_camera
from unbend.batch.results import read_manifest

LENS = {
    "reference": {"pressure_hpa": 1013.25, "temperature_c": 20.0},
    "dc_dp_px_per_hpa": 0.002,
    "dc_dt_px_per_k": 0.0,
}


def without_cabin_channels(mission):
    channels = mission.config["log"]["channels"]
    for quantity in ("pressure", "temperature", "humidity"):
        del channels[f"cabin_{quantity}"]


def test_a_dome_a_schedule_and_a_lens(mission):
    """No channel of a cabin is named, and none is missed."""
    cameras = mission.config["cameras"]
    cameras["nadir"]["window"] = {"shape": "spherical"}
    cameras["oblique"] |= {
        "window": {"cabin": "standard_schedule", "frame": "body"},
        "principal_distance": LENS,
    }
    without_cabin_channels(mission)

    manifest = mission.run_to_manifest()
    keys = {
        "WINDOW-SPHERICAL": "cameras.nadir.window",
        "WINDOW-GLASS": "cameras.oblique.window",
        "CABIN-SCHEDULE": "cameras.oblique.window.cabin",
        "LENS-IN-AIR": "cameras.oblique.principal_distance",
        "LENS-NOT-REMOVED": "cameras.<name>.principal_distance",
    }
    for code, key in keys.items():
        assert entry_of(manifest, code)["where"] == key
    assert "is not removed" in entry_of(manifest, "WINDOW-GLASS")["what"]
    assert "distance of nadir is not" in entry_of(manifest, "LENS-NOT-REMOVED")["what"]
    behind_the_dome = rows_of_camera(mission, "nadir")
    assert set(behind_the_dome["r_cc_rad"]) == {0.0}
    assert np.isfinite(mission.result_rows()["r_cc_rad"]).all()


def miss_px(mission):
    """How far the rays of tie points miss each other, as the ledger states it [px]."""
    manifest = mission.checked().manifest.values
    text = entry_of(manifest, "TIES-RESIDUALS")["what"]
    return float(re.search(r"by ([0-9.]+) px", text)[1])


def test_misses_of_rays_are_in_pixels_behind_a_window_too(mission):
    """A window with the air of outside bends nothing: with it the rays miss by as many pixels."""
    without_cabin_channels(mission)
    cameras = mission.config["cameras"].values()
    for camera in cameras:
        del camera["window"]
    without_window = miss_px(mission)
    for camera in cameras:
        camera["opening"] = {"warmer_k": 0.0}
    assert miss_px(mission) == pytest.approx(without_window, rel=0.05)


@pytest.mark.parametrize("pressure", [819, 819.5, "log", "ambient"])
def test_every_pressure_of_a_cabin_comes_back_from_the_manifest(mission, pressure):
    """What a mission file may state, its manifest and its report must be able to read."""
    cabin = {"pressure": pressure, "temperature_c": 21}
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": cabin}
    ended = mission.run()
    assert ended.code in (0, 3), ended.text  # an unpressurised cabin contradicts the log
    sections = read_manifest(mission.output).sections
    assert sections.cameras["nadir"].window.cabin.pressure == pressure
