"""Cameras with a light of their own: R, its sigma, exports and `correct`, band by band."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.helpers import entry_of, refused
from unbend import correct, standard_atmosphere

pytestmark = pytest.mark.usefixtures("plain_report")

RED_M = 0.65e-6
BLUE_M = 0.45e-6
USUAL_M = 0.55e-6
LIGHTS_M = {"nadir": RED_M, "oblique": BLUE_M}


def dispersion(wavelength_m: float) -> float:
    """(n - 1) 1e8 of standard air by Edlen (1966), Metrologia 2(2), Eq. 1."""
    s2 = (1e-6 / wavelength_m) ** 2
    return 8342.13 + 2_406_030.0 / (130.0 - s2) + 15_997.0 / (38.9 - s2)


def factor_of(wavelength_m: float) -> float:
    """Refraction in a light over that in the usual one."""
    return dispersion(wavelength_m) / dispersion(USUAL_M)


@pytest.fixture(scope="module")
def runs(mission_factory, tmp_path_factory):
    """One flight three times: all at 0.55 um, all at 0.65, and each camera in its own light."""
    made = {}
    for name in ("usual", "red", "bands"):
        mission = mission_factory(tmp_path_factory.mktemp(name) / "mission")
        if name == "red":
            mission.config.setdefault("atmosphere", {})["wavelength_m"] = RED_M
        if name == "bands":
            for camera, light_m in LIGHTS_M.items():
                mission.config["cameras"][camera]["wavelength_m"] = light_m
        mission.run_to_manifest()
        made[name] = mission
    return made


def of_camera(mission, camera: str):
    """The rows of a camera."""
    camera_of_image = mission.stations().to_pandas().set_index("image")["camera"]
    table = mission.results().to_pandas()
    return table[(table["image"].map(camera_of_image) == camera).to_numpy()]


@pytest.mark.parametrize("camera", LIGHTS_M)
def test_refraction_of_air_and_window_is_that_of_the_cameras_light(runs, camera):
    factor = factor_of(LIGHTS_M[camera])
    assert abs(factor - 1.0) > 0.003
    usual = of_camera(runs["usual"], camera)
    bands = of_camera(runs["bands"], camera)
    # One parameter of the air for all lights, whose sigma is that of the mission in one light.
    assert (bands["dx_ds_px"] / usual["dx_ds_px"]).median() == pytest.approx(factor, rel=3e-3)
    close = {"r_c_rad": 3e-4, "r_cc_rad": 3e-4, "sigma_r_c_rad": 2e-3, "sigma_r_cc_rad": 1e-3}
    for column, rtol in close.items():
        ratio = (bands[column] / usual[column])[usual[column] != 0.0]
        assert len(ratio)
        np.testing.assert_allclose(ratio, factor, rtol=rtol)


def test_a_camera_is_the_same_whoever_flies_beside_it(runs):
    """The red camera of the rig, and of a mission that is red as a whole."""
    red = of_camera(runs["red"], "nadir")
    bands = of_camera(runs["bands"], "nadir")
    for column in red.columns:
        if column in ("image", "point", "status"):
            assert (red[column] == bands[column]).all()
            continue
        rtol = 1e-3 if column in ("dx_ds_px", "dy_ds_px") else 1e-12
        np.testing.assert_allclose(bands[column], red[column], rtol=rtol, err_msg=column)


def stated_lights(schema: pa.Schema) -> dict[str, float]:
    return json.loads(schema.metadata[b"unbend.wavelength_m"])


def test_the_air_of_the_mission_stays_in_its_own_light(runs):
    usual = runs["usual"].output
    bands = runs["bands"].output
    for name in ("profile.parquet", "stations.parquet"):
        assert pq.read_table(bands / name).equals(pq.read_table(usual / name)), name
    manifest = runs["bands"].manifest()
    light = entry_of(manifest, "CAMERA-LIGHT")["what"]
    assert "nadir at 0.65 um" in light
    assert "oblique at 0.45 um" in light
    assert manifest["uncertainty"]["profiles"] == 1
    (part,) = bands.glob("observations/*.parquet")
    assert stated_lights(pq.read_schema(part)) == LIGHTS_M


def test_exports_are_in_the_light_of_each_camera_and_say_so(runs, unbend, tmp_path):
    tables = {}
    for name in ("usual", "bands"):
        out = tmp_path / f"{name}.parquet"
        ended = unbend("export", runs[name].output, "--format", "radial", "--out", out)
        assert ended.code == 0, ended.text
        assert "AIR-CHANGES" not in ended.text
        tables[name] = pq.read_table(out)
    assert stated_lights(tables["bands"].schema) == LIGHTS_M
    usual = tables["usual"].to_pandas()
    bands = tables["bands"].to_pandas()
    assert set(usual["wavelength_m"]) == {USUAL_M}
    assert (bands["wavelength_m"] == bands["camera"].map(LIGHTS_M)).all()
    assert (bands["camera"] == usual["camera"]).all()
    ratio = bands["k_urad"] / usual["k_urad"]
    np.testing.assert_allclose(ratio, bands["wavelength_m"].map(factor_of), rtol=3e-4)


def correct_bands(runs, air) -> pa.Table:
    """The observations of the rig by the library, in some air."""
    mission = runs["bands"]
    names = ["image", "point", "x_px", "y_px", "h_g_m"]
    measured = mission.results().select(names).replace_schema_metadata(None)
    sections = mission.config
    return correct(measured, mission.stations(), air, sections["cameras"], mount=sections["mount"])


def test_the_library_has_the_bands_of_the_run(runs):
    mission = runs["bands"]
    expected = mission.results()
    result = correct_bands(runs, pq.read_table(mission.output / "profile.parquet"))
    for name in ("x_corrected_px", "y_corrected_px", "r_cc_rad", "sigma_r_cc_rad"):
        assert result[name].combine_chunks().equals(expected[name].combine_chunks()), name
    np.testing.assert_allclose(result["r_c_rad"], expected["r_c_rad"], rtol=1e-12)


def test_the_library_refuses_a_band_in_air_of_one_light(runs):
    with refused("WAVELENGTH-FORMULA") as refusal:
        correct_bands(runs, standard_atmosphere("us1976", index="gyer"))
    assert "one fixed wavelength" in str(refusal.value)
    assert "cameras.nadir.wavelength_m" in str(refusal.value)


def test_a_check_of_a_rig_says_the_lights(runs, unbend):
    ended = unbend("check", "-v", runs["bands"].file)
    assert ended.code == 0, ended.text
    assert "CAMERA-LIGHT" in ended.text


def test_a_mission_file_with_a_formula_of_one_light_is_refused(mission):
    mission.config["cameras"]["nadir"]["wavelength_m"] = RED_M
    mission.config.setdefault("atmosphere", {})["index"] = "gyer"
    printed = mission.refusal("CONFIG-INVALID", exit_code=2)
    assert "cameras.nadir.wavelength_m has no effect" in printed


# ---------------------------------------------------------------- unbend angle

ONE = ("angle", "--camera-height", 6000, "--ground-height", 0, "--nadir-angle", 45)
TABLE = ("angle", "--camera-height", 6000, "--ground-height", 0, "--step", 15)


@pytest.fixture
def answer(unbend):
    """What a command answers with --json."""

    def answered(*words):
        return json.loads(unbend(*words, "--json").out)

    return answered


def test_one_angle_in_another_light(answer, unbend):
    infrared_m = 0.85e-6
    usual = answer(*ONE)
    infrared = answer(*ONE, "--wavelength", infrared_m)
    assert usual["wavelength_m"] == USUAL_M
    assert infrared["wavelength_m"] == infrared_m
    ratio = infrared["r_c_rad"] / usual["r_c_rad"]
    assert ratio == pytest.approx(factor_of(infrared_m), rel=1e-4)
    assert "index ciddor at 0.85 um" in unbend(*ONE, "--wavelength", infrared_m).out
    assert answer(*ONE, "--index", "gyer")["wavelength_m"] == 0.589e-6


def test_tables_of_a_mission_in_the_light_of_a_camera(runs, answer):
    mission = ("--config", runs["bands"].file)
    usual = answer(*TABLE, *mission)["rows"][-1]
    assert usual["wavelength_m"] == USUAL_M
    for camera, light_m in LIGHTS_M.items():
        row = answer(*TABLE, *mission, "--camera", camera)["rows"][-1]
        assert row["wavelength_m"] == light_m
        ratio = row["r_c_urad"] / usual["r_c_urad"]
        assert ratio == pytest.approx(factor_of(light_m), rel=3e-4)


def test_lights_that_an_angle_cannot_have_are_refused(runs, unbend):
    ended = unbend(*ONE, "--index", "gyer", "--wavelength", 0.85e-6)
    assert ended.code == 2, ended.text
    assert "ANGLE-WAVELENGTH" in ended.text
    ended = unbend(*TABLE, "--config", runs["bands"].file, "--camera", "nir")
    assert ended.code == 2, ended.text
    assert "ANGLE-CAMERA" in ended.text
    assert "nadir, oblique" in ended.text
    ended = unbend(*TABLE, "--camera", "nadir")
    assert ended.code == 2, ended.text
