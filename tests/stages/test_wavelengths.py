"""Cameras with a light of their own: R, its sigma, exports and `correct`, band by band."""

import json

import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal

from tests.helpers import entry_of, refused
from tests.stages.corrected_rows import rows_of_camera
from unbend import correct, standard_atmosphere

RED_M = 0.65e-6
BLUE_M = 0.45e-6
USUAL_M = 0.55e-6
LIGHTS_M = {"nadir": RED_M, "oblique": BLUE_M}


def dispersion(wavelength_m):
    """(n - 1) 1e8 of standard air by Edlen (1966), Metrologia 2(2), Eq. 1."""
    s2 = (1e-6 / wavelength_m) ** 2
    return 8342.13 + 2_406_030.0 / (130.0 - s2) + 15_997.0 / (38.9 - s2)


def factor_of(wavelength_m):
    """Refraction in a light over that in the usual one."""
    return dispersion(wavelength_m) / dispersion(USUAL_M)


@pytest.fixture(scope="module")
def runs(mission_factory, tmp_path_factory):
    """One flight three times: all at 0.55 um, all at 0.65, and each camera in its own light."""
    missions = {}
    for name in ("usual", "red", "bands"):
        folder = tmp_path_factory.mktemp(name)
        missions[name] = mission_factory(folder / "mission")
    in_all_air(missions["red"], "wavelength_m", RED_M)
    cameras = missions["bands"].config["cameras"]
    for camera, light_m in LIGHTS_M.items():
        cameras[camera]["wavelength_m"] = light_m
    for mission in missions.values():
        mission.run_to_manifest()
    return missions


def in_all_air(mission, key, value):
    mission.config.setdefault("atmosphere", {})[key] = value


@pytest.mark.parametrize("camera", LIGHTS_M)
def test_refraction_of_air_and_window_is_that_of_the_cameras_light(runs, camera):
    factor = factor_of(LIGHTS_M[camera])
    assert abs(factor - 1.0) > 0.003
    usual = rows_of_camera(runs["usual"], camera)
    bands = rows_of_camera(runs["bands"], camera)
    # One parameter of the air for all lights, whose sigma is that of the mission in one light.
    scale = bands["dx_ds_px"] / usual["dx_ds_px"]
    assert scale.median() == pytest.approx(factor, rel=3e-3)
    tolerances = {
        "r_c_rad": 3e-4,
        "r_cc_rad": 3e-4,
        "sigma_r_c_rad": 2e-3,
        "sigma_r_cc_rad": 1e-3,
    }
    for column, rtol in tolerances.items():
        bent = usual[column] != 0.0
        assert bent.any()
        ratio = bands[column][bent] / usual[column][bent]
        assert_allclose(ratio, factor, rtol=rtol)


def test_a_camera_is_the_same_whoever_flies_beside_it(runs):
    """The red camera of the rig, and of a mission that is red as a whole."""
    red = rows_of_camera(runs["red"], "nadir")
    bands = rows_of_camera(runs["bands"], "nadir")
    by_air = ["dx_ds_px", "dy_ds_px"]
    assert_frame_equal(bands[by_air], red[by_air], rtol=1e-3, atol=0.0)
    exact = red.columns.drop(by_air)
    assert_frame_equal(bands[exact], red[exact], rtol=1e-12, atol=0.0)


def lights_in(schema):
    return json.loads(schema.metadata[b"unbend.wavelength_m"])


def test_the_air_of_the_mission_stays_in_its_own_light(runs):
    usual = runs["usual"].output
    bands = runs["bands"].output
    for name in ("profile.parquet", "stations.parquet"):
        table = pq.read_table(bands / name)
        assert table.equals(pq.read_table(usual / name)), name
    manifest = runs["bands"].manifest()
    light = entry_of(manifest, "CAMERA-LIGHT")["what"]
    assert "nadir at 0.65 um" in light
    assert "oblique at 0.45 um" in light
    assert manifest["uncertainty"]["profiles"] == 1
    (part,) = bands.glob("observations/*.parquet")
    assert lights_in(pq.read_schema(part)) == LIGHTS_M


def test_exports_are_in_the_light_of_each_camera_and_say_so(runs, obeyed, tmp_path):
    tables = {}
    for name in ("usual", "bands"):
        out = tmp_path / f"{name}.parquet"
        output = runs[name].output
        assert "AIR-CHANGES" not in obeyed("export", output, "--format", "radial", "--out", out)
        tables[name] = pq.read_table(out)
    assert lights_in(tables["bands"].schema) == LIGHTS_M
    usual = tables["usual"].to_pandas()
    bands = tables["bands"].to_pandas()
    lights = bands["wavelength_m"]
    assert set(usual["wavelength_m"]) == {USUAL_M}
    assert (lights == bands["camera"].map(LIGHTS_M)).all()
    assert (bands["camera"] == usual["camera"]).all()
    ratio = bands["k_urad"] / usual["k_urad"]
    assert_allclose(ratio, lights.map(factor_of), rtol=3e-4)


def correct_bands(runs, air):
    """The observations of the rig by the library, in some air."""
    mission = runs["bands"]
    names = ["image", "point", "x_px", "y_px", "h_g_m"]
    measured = mission.results().select(names)
    measured = measured.replace_schema_metadata(None)
    cameras = mission.config["cameras"]
    mount = mission.config["mount"]
    return correct(measured, mission.stations(), air, cameras, mount=mount)


def test_the_library_has_the_bands_of_the_run(runs):
    mission = runs["bands"]
    expected = mission.results()
    air = pq.read_table(mission.output / "profile.parquet")
    result = correct_bands(runs, air)
    for name in ("x_corrected_px", "y_corrected_px", "r_cc_rad", "sigma_r_cc_rad"):
        assert result[name].equals(expected[name]), name
    assert_allclose(result["r_c_rad"], expected["r_c_rad"], rtol=1e-12)


def test_the_library_refuses_a_band_in_air_of_one_light(runs):
    air = standard_atmosphere("us1976", index="gyer")
    with refused("WAVELENGTH-FORMULA") as refusal:
        correct_bands(runs, air)
    text = str(refusal.value)
    assert "one fixed wavelength" in text
    assert "cameras.nadir.wavelength_m" in text


def test_a_mission_file_with_a_formula_of_one_light_is_refused(mission):
    mission.config["cameras"]["nadir"]["wavelength_m"] = RED_M
    in_all_air(mission, "index", "gyer")
    printed = mission.refusal("CONFIG-INVALID", exit_code=2)
    assert "cameras.nadir.wavelength_m has no effect" in printed


# ---------------------------------------------------------------- unbend angle

RAY = ("angle", "--camera-height", 6000, "--ground-height", 0)
ONE = (*RAY, "--nadir-angle", 45)
TABLE = (*RAY, "--step", 15)


@pytest.fixture
def answer(unbend):
    """What a command answers with --json."""

    def answered(*words):
        ended = unbend(*words, "--json")
        return json.loads(ended.out)

    return answered


def test_one_angle_in_another_light(answer, unbend):
    usual = answer(*ONE)
    infrared = answer(*ONE, "--wavelength", 0.85e-6)
    assert usual["wavelength_m"] == USUAL_M
    assert infrared["wavelength_m"] == 0.85e-6
    ratio = infrared["r_c_rad"] / usual["r_c_rad"]
    assert ratio == pytest.approx(factor_of(0.85e-6), rel=1e-4)
    ended = unbend(*ONE, "--wavelength", 0.85e-6)
    assert "index ciddor at 0.85 um" in ended.out
    by_gyer = answer(*ONE, "--index", "gyer")
    assert by_gyer["wavelength_m"] == 0.589e-6


def test_tables_of_a_mission_in_the_light_of_a_camera(runs, answer):
    words = (*TABLE, "--config", runs["bands"].file)
    *_, usual = answer(*words)["rows"]
    assert usual["wavelength_m"] == USUAL_M
    for camera, light_m in LIGHTS_M.items():
        *_, row = answer(*words, "--camera", camera)["rows"]
        assert row["wavelength_m"] == light_m
        ratio = row["r_c_urad"] / usual["r_c_urad"]
        assert ratio == pytest.approx(factor_of(light_m), rel=3e-4)


@pytest.fixture
def refuse_angle(unbend):
    def refusal(*words):
        ended = unbend(*words)
        assert ended.code == 2, ended.text
        return ended.text

    return refusal


def test_a_light_that_a_formula_does_not_have(refuse_angle):
    text = refuse_angle(*ONE, "--index", "gyer", "--wavelength", 0.85e-6)
    assert "ANGLE-WAVELENGTH" in text


def test_a_camera_that_no_mission_has(runs, refuse_angle):
    mission = runs["bands"].file
    text = refuse_angle(*TABLE, "--config", mission, "--camera", "nir")
    assert "ANGLE-CAMERA" in text
    assert "nadir, oblique" in text
    refuse_angle(*TABLE, "--camera", "nadir")
