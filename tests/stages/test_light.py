"""Cameras with a light of their own: R, its sigma, exports and `correct`, band by band."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from unbend import correct, standard_atmosphere
from unbend.errors import UnbendError

pytestmark = pytest.mark.usefixtures("plain_report")

RED_M = 0.65e-6
BLUE_M = 0.45e-6
USUAL_M = 0.55e-6


def dispersion(wavelength_m: float) -> float:
    """(n - 1) 1e8 of standard air by Edlen (1966), Metrologia 2(2), Eq. 1."""
    s2 = (1e-6 / wavelength_m) ** 2
    return 8342.13 + 2_406_030.0 / (130.0 - s2) + 15_997.0 / (38.9 - s2)


@pytest.fixture(scope="module")
def runs(mission_factory, tmp_path_factory):
    """One flight three times: all at 0.55 um, all at 0.65, and each camera in its own light."""
    made = {}
    for name in ("usual", "red", "bands"):
        mission = mission_factory(tmp_path_factory.mktemp(name) / "mission")
        if name == "red":
            mission.config.setdefault("atmosphere", {})["wavelength_m"] = RED_M
        if name == "bands":
            mission.config["cameras"]["nadir"]["wavelength_m"] = RED_M
            mission.config["cameras"]["oblique"]["wavelength_m"] = BLUE_M
        ended = mission.run()
        assert ended.code == 0, ended.text
        made[name] = mission
    return made


def of_camera(mission, camera: str):
    """The rows of a camera."""
    camera_of_image = mission.stations().to_pandas().set_index("image")["camera"]
    table = mission.results().to_pandas()
    return table[(table["image"].map(camera_of_image) == camera).to_numpy()]


@pytest.mark.parametrize(("camera", "light_m"), [("nadir", RED_M), ("oblique", BLUE_M)])
def test_refraction_of_air_and_window_is_that_of_the_cameras_light(runs, camera, light_m):
    usual = of_camera(runs["usual"], camera)
    bands = of_camera(runs["bands"], camera)
    factor = dispersion(light_m) / dispersion(USUAL_M)
    assert abs(factor - 1.0) > 0.003
    for column in ("r_c_rad", "r_cc_rad"):
        ratio = (bands[column] / usual[column]).to_numpy()
        assert np.isfinite(ratio).any()
        np.testing.assert_allclose(ratio[np.isfinite(ratio)], factor, rtol=3e-4)
    sigma = (bands["sigma_r_c_rad"] / usual["sigma_r_c_rad"]).to_numpy()
    np.testing.assert_allclose(sigma, factor, rtol=2e-3)
    cabin = (bands["sigma_r_cc_rad"] / usual["sigma_r_cc_rad"]).to_numpy()
    np.testing.assert_allclose(cabin, factor, rtol=1e-3)
    # One parameter of the air for all lights, whose sigma is that of the mission in one light.
    by_mode = (bands["dx_ds_px"] / usual["dx_ds_px"]).median()
    assert by_mode == pytest.approx(factor, rel=3e-3)


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


def test_the_air_of_the_mission_stays_in_its_own_light(runs):
    usual = runs["usual"].output
    bands = runs["bands"].output
    for name in ("profile.parquet", "stations.parquet"):
        assert pq.read_table(bands / name).equals(pq.read_table(usual / name)), name
    manifest = json.loads((bands / "manifest.json").read_text(encoding="utf-8"))
    (light,) = [e["what"] for e in manifest["ledger"] if e["code"] == "CAMERA-LIGHT"]
    assert "nadir at 0.65 um" in light
    assert "oblique at 0.45 um" in light
    assert manifest["uncertainty"]["profiles"] == 1
    (part,) = bands.glob("observations/*.parquet")
    stated = json.loads(pq.read_schema(part).metadata[b"unbend.wavelength_m"])
    assert stated == {"nadir": RED_M, "oblique": BLUE_M}


def test_exports_are_in_the_light_of_each_camera_and_say_so(runs, unbend, tmp_path):
    tables = {}
    for name in ("usual", "bands"):
        out = tmp_path / f"{name}.parquet"
        ended = unbend("export", runs[name].output, "--format", "radial", "--out", out)
        assert ended.code == 0, ended.text
        assert "AIR-CHANGES" not in ended.text
        tables[name] = pq.read_table(out)
    for camera, light_m in (("nadir", RED_M), ("oblique", BLUE_M)):
        rows = {}
        for name, table in tables.items():
            whole = table.to_pandas()
            rows[name] = whole[whole["camera"] == camera]
        assert set(rows["bands"]["wavelength_m"]) == {light_m}
        assert set(rows["usual"]["wavelength_m"]) == {USUAL_M}
        ratio = rows["bands"]["k_urad"].to_numpy() / rows["usual"]["k_urad"].to_numpy()
        np.testing.assert_allclose(ratio, dispersion(light_m) / dispersion(USUAL_M), rtol=3e-4)
    stated = json.loads(tables["bands"].schema.metadata[b"unbend.wavelength_m"])
    assert stated == {"nadir": RED_M, "oblique": BLUE_M}


def test_the_library_has_the_bands_of_the_run(runs):
    mission = runs["bands"]
    expected = mission.results()
    given = [name for name in mission.measurements().column_names if name != "h_g_m"]
    measured = expected.select([*given, "h_g_m"]).replace_schema_metadata(None)
    profile = pq.read_table(mission.output / "profile.parquet")
    config = mission.config
    found = correct(measured, mission.stations(), profile, config["cameras"], mount=config["mount"])
    for name in ("x_corrected_px", "y_corrected_px", "r_cc_rad", "sigma_r_cc_rad"):
        assert found[name].combine_chunks().equals(expected[name].combine_chunks()), name
    np.testing.assert_allclose(found["r_c_rad"], expected["r_c_rad"], rtol=1e-12)


def test_the_library_refuses_a_band_in_air_of_one_light(runs):
    mission = runs["bands"]
    measured = mission.results().select(["image", "point", "x_px", "y_px", "h_g_m"])
    measured = measured.replace_schema_metadata(None)
    air = standard_atmosphere("us1976", index="gyer")
    with pytest.raises(UnbendError, match="one fixed wavelength") as refused:
        correct(
            pa.table(measured),
            mission.stations(),
            air,
            mission.config["cameras"],
            mount=mission.config["mount"],
        )
    assert refused.value.code == "WAVELENGTH-FORMULA"
    assert "cameras.nadir.wavelength_m" in str(refused.value)


def test_a_check_of_a_rig_says_the_lights(runs, unbend):
    ended = unbend("check", "-v", runs["bands"].file)
    assert ended.code == 0, ended.text
    assert "CAMERA-LIGHT" in ended.text


def test_a_mission_file_with_a_formula_of_one_light_is_refused(mission):
    mission.config["cameras"]["nadir"]["wavelength_m"] = RED_M
    mission.config.setdefault("atmosphere", {})["index"] = "gyer"
    ended = mission.run()
    assert ended.code == 2, ended.text
    assert "cameras.nadir.wavelength_m has no effect" in ended.text


# ---------------------------------------------------------------- unbend angle

ONE = ("angle", "--camera-height", 6000, "--ground-height", 0, "--nadir-angle", 45)
TABLE = ("angle", "--camera-height", 6000, "--ground-height", 0, "--step", 15, "--json")


def test_one_angle_in_another_light(unbend):
    usual = json.loads(unbend(*ONE, "--json").out)
    near_infrared = json.loads(unbend(*ONE, "--wavelength", 0.85e-6, "--json").out)
    assert (usual["wavelength_m"], near_infrared["wavelength_m"]) == (USUAL_M, 0.85e-6)
    ratio = near_infrared["r_c_rad"] / usual["r_c_rad"]
    assert ratio == pytest.approx(dispersion(0.85e-6) / dispersion(USUAL_M), rel=1e-4)
    assert "index ciddor at 0.85 um" in unbend(*ONE, "--wavelength", 0.85e-6).out
    gyer = json.loads(unbend(*ONE, "--index", "gyer", "--json").out)
    assert gyer["wavelength_m"] == 0.589e-6


def test_a_light_that_the_formula_does_not_know(unbend):
    ended = unbend(*ONE, "--index", "gyer", "--wavelength", 0.85e-6)
    assert ended.code == 2, ended.text
    assert "ANGLE-WAVELENGTH" in ended.text


def test_tables_of_a_mission_in_the_light_of_a_camera(runs, unbend):
    config = runs["bands"].file
    rows = {}
    for camera in (None, "nadir", "oblique"):
        chosen = () if camera is None else ("--camera", camera)
        answered = json.loads(unbend(*TABLE, "--config", config, *chosen).out)
        rows[camera] = answered["rows"][-1]
    assert [row["wavelength_m"] for row in rows.values()] == [USUAL_M, RED_M, BLUE_M]
    for camera, light_m in (("nadir", RED_M), ("oblique", BLUE_M)):
        ratio = rows[camera]["r_c_urad"] / rows[None]["r_c_urad"]
        assert ratio == pytest.approx(dispersion(light_m) / dispersion(USUAL_M), rel=3e-4)
    ended = unbend(*TABLE, "--config", config, "--camera", "nir")
    assert ended.code == 2, ended.text
    assert "ANGLE-CAMERA" in ended.text
    assert "nadir, oblique" in ended.text
    ended = unbend(*TABLE, "--camera", "nadir")
    assert ended.code == 2, ended.text
