"""Sources of the air in a mission, and the several airs of a long one, end to end."""

from __future__ import annotations

import hashlib
import json
import shutil

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.conftest import without_plots
from tests.helpers import entry_of, refused, with_code
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.atmosphere.series.time_windows import TimeWindow
from unbend.batch.finished_run.read_back import air_of
from unbend.batch.runs import read_mission
from unbend.config.atmosphere import SensorsSection, SurfaceSection
from unbend.config.keys import mission_keys
from unbend.messages import Ledger
from unbend.simulate.mission import FIELD_LAT_RAD
from unbend.simulate.true_air import (
    saturation_pressure_pa,
    temperature_k,
    true_air,
    vapour_pressure_pa,
)
from unbend.stages import air_of_mission
from unbend.stages.air_sources import read_report
from unbend.units import ARCSEC

METAR = "METAR KXYZ 151055Z 24011KT 9999 SCT040 12/08 Q1013"


def with_air(mission, **entries) -> None:
    mission.config.setdefault("atmosphere", {}).update(entries)


def read_codes(prepared) -> set[str]:
    return {message.code for message in prepared.ledger}


def uses(prepared) -> dict:
    """What became of each source of the air, the last of those with one name."""
    return {use.source: use for use in prepared.air.adjustment.sources}


def line_of(prepared, label: str) -> str:
    """How `unbend check` describes a source."""
    return dict(prepared.sources.lines())[label]


def sounding_text(offset_k: float = 0.0, **columns: object) -> str:
    """The simulator's own air as a balloon would list it, from the ground up."""
    h = np.arange(450.0, 9000.0, 150.0)
    temperature = temperature_k(h) + offset_k
    vapour = np.maximum(vapour_pressure_pa(h), 1.0)
    dew_points = np.linspace(190.0, 320.0, 4000)
    dew_point = np.interp(vapour, saturation_pressure_pa(dew_points), dew_points)
    table = pd.DataFrame(
        {
            "h_m": h,
            "pressure_hpa": true_air(FIELD_LAT_RAD).pressure_pa(h) / 100.0,
            "temperature_c": temperature - 273.15,
            "dew_point_c": np.minimum(dew_point, temperature) - 273.15,
        }
    )
    return table.assign(**columns).to_csv(index=False, float_format="%.2f")


def with_balloon(mission, text: str) -> None:
    (mission.folder / "balloon.csv").write_text(text)
    with_air(mission, soundings=[{"path": "balloon.csv"}])


def true_arcsec(h_g: float, h_c: float) -> float:
    """R at 45 degrees in the simulator's air [arcsec], plane: the sphere takes 0.1 % away.

    Mean of n along the way minus n at the camera (Gyer 1996, Eq. 24).
    """
    n = true_air(FIELD_LAT_RAD).n(np.linspace(h_g, h_c, 3001)) - 1.0
    mean = np.mean(0.5 * (n[1:] + n[:-1]))
    return float(mean - n[-1]) / ARCSEC


# ---- soundings


def test_a_sounding_is_used_hashed_and_named(mission, unbend):
    with_balloon(mission, sounding_text())
    checked = unbend("check", mission.save())
    assert "57 levels from 450 to 8850 m" in " ".join(checked.out.split())
    manifest = mission.run_to_manifest()
    roles = {entry["role"]: entry["name"] for entry in manifest["inputs"]}
    assert roles["sounding 1"] == "balloon.csv"
    sources = {row["source"]: row for row in manifest["profile"]["sources"]}
    assert sources["sounding balloon.csv"]["used"]
    assert sources["sounding balloon.csv"]["readings"] > 0
    assert sources["surface report"]["why_not"] == "none in the mission file"
    assert "nothing to do" in mission.run().out
    with_balloon(mission, sounding_text(0.5))
    assert "nothing to do" not in mission.run().out


def test_a_sounding_stands_in_for_a_thermometer(mission):
    """Without a thermometer R has a sigma of 3 %; a balloon of the same air brings it down.

    It has neither time nor place: 6 h and 100 km change temperatures by 2.4 K, not by 1.5 K.
    """
    channels = mission.config["log"]["channels"]
    channels["temperature"] = channels["humidity"] = "HYGR[9]"
    without = read_mission(mission.save())
    with_balloon(mission, sounding_text())
    beside = read_mission(mission.save())
    assert "CHANNEL-MISSING" in read_codes(without)
    assert uses(beside)["thermometer"].why_not == "none outside in the log"
    effect = beside.air.effects[0]
    assert effect.sigma_rad < 0.85 * without.air.effects[0].sigma_rad
    right = true_arcsec(effect.h_g_m, effect.h_c_m) * ARCSEC
    assert abs(effect.r_c_rad - right) < 2.0 * effect.sigma_rad + 0.002 * right


def test_a_sounding_that_is_missing_or_none(mission):
    with_balloon(mission, "nothing of the kind\n")
    assert "balloon.csv" in mission.refusal("SOUNDING-FORMAT")
    (mission.folder / "balloon.csv").unlink()
    assert "balloon.csv" in mission.refusal("INPUT-MISSING")
    assert not (mission.output / "manifest.json").exists()


def test_a_standard_that_is_kept_uses_no_source(mission):
    with_balloon(mission, sounding_text())
    with_air(mission, adjust=False)
    manifest = mission.run_to_manifest()
    assert entry_of(manifest, "AIR-SOURCES-UNUSED")
    assert manifest["profile"]["basis"] == "standard"
    sources = {row["source"]: row for row in manifest["profile"]["sources"]}
    assert sources["us1976"]["used"]
    for name in ("sounding balloon.csv", "barometer BARO[0]", "thermometer HYGR[0]"):
        assert not sources[name]["used"]
        assert "adjust is false" in sources[name]["why_not"]


FLIGHT = "2025-06-12T09:00:00Z"


@pytest.mark.parametrize(
    ("time", "north", "east", "codes"),
    [
        (FLIGHT, 47.4, 8.3, set()),
        (FLIGHT, 52.0, 8.3, {"SOUNDING-FAR-AWAY"}),
        (FLIGHT, 71.3, -156.8, {"SOUNDING-FAR-AWAY", "AIR-SOURCE-FAR"}),
        ("2010-06-12T09:00:00Z", 47.4, 8.3, {"SOUNDING-FAR-IN-TIME", "AIR-SOURCE-FAR"}),
        ("", 47.4, 8.3, {"SOUNDING-UNDATED"}),
    ],
    ids=["near", "far", "farther", "old", "undated"],
)
def test_a_sounding_of_another_time_or_place(mission, time, north, east, codes):
    text = sounding_text(time_utc=time, latitude_deg=north, longitude_deg=east)
    with_balloon(mission, text)
    prepared = read_mission(mission.save())
    of_sources = {
        code for code in read_codes(prepared) if code.startswith(("SOUNDING-", "AIR-SOURCE"))
    }
    assert of_sources == codes
    minute = time.removesuffix(":00Z")
    is_used = uses(prepared)[f"sounding balloon.csv {minute}".rstrip()].fit is not None
    assert is_used == ("AIR-SOURCE-FAR" not in codes)
    if time:
        assert f"balloon.csv of {minute} UTC" in line_of(prepared, "sounding")


def test_without_any_sensor_the_ground_is_where_it_took_off(mission):
    """The simulated field lies 450 m above the sea."""
    channels = mission.config["log"]["channels"]
    channels["temperature"] = channels["humidity"] = channels["pressure"] = "NONE"
    prepared = read_mission(mission.save())
    assert prepared.air.effects[0].h_g_m == pytest.approx(450.0, abs=0.5)


# ---- stations on the ground


@pytest.mark.parametrize(
    ("report", "name"),
    [
        ({"metar": METAR}, "surface report METAR KXYZ"),
        (
            {
                "temperature_c": 18.0,
                "pressure_hpa": 966.0,
                "relative_humidity": 0.6,
                "time_utc": "2025-06-12T11:20:00+02:00",
            },
            "surface report mission file",
        ),
    ],
    ids=["metar", "numbers"],
)
def test_a_station_is_used_and_named(mission, report, name):
    with_air(mission, surface=[{"h_msl_m": 450} | report])
    prepared = read_mission(mission.save())
    assert uses(prepared)[name].fit is not None
    assert "at 450 m" in line_of(prepared, "surface")


@pytest.mark.parametrize(
    ("stated", "distance_m"),
    [({}, 100e3), ({"distance_km": 0.0}, 0.0), ({"distance_km": 12.0}, 12e3)],
)
def test_a_station_whose_distance_is_not_stated_is_not_near(stated, distance_m):
    """It weighs as one of 100 km, and that is told."""
    ledger = Ledger()
    report = report_of({"h_msl_m": 450, "metar": METAR} | stated, ledger)
    assert report.distance_m == pytest.approx(distance_m)
    assert bool(with_code(ledger, "SURFACE-UNPLACED")) is (not stated)


def report_of(entries: dict, ledger: Ledger):
    """A report as a mission over the simulated field in June has it."""
    background = climatology(latitude_rad=FIELD_LAT_RAD, month=6.0)
    section = SurfaceSection(**entries)
    return read_report(section, "atmosphere.surface[0]", None, background, ledger)


def test_a_report_of_another_day_is_left_out(mission):
    numbers = {"h_msl_m": 450, "temperature_c": 18.0}
    with_air(mission, surface=[numbers | {"time_utc": "1999-01-12T09:20:00Z"}])
    codes_of_old = read_codes(read_mission(mission.save()))
    assert codes_of_old >= {"SURFACE-FAR-IN-TIME", "AIR-SOURCE-FAR"}
    with_air(mission, surface=[numbers])
    codes_of_undated = read_codes(read_mission(mission.save()))
    assert "SURFACE-UNDATED" in codes_of_undated
    assert "AIR-SOURCE-FAR" not in codes_of_undated


@pytest.mark.parametrize(
    ("report", "code", "words"),
    [
        ({"temperature_c": 77.0}, "SURFACE-TEMPERATURE", "Fahrenheit"),
        ({"temperature_c": 59.0}, "SURFACE-CLIMATE", "Fahrenheit"),
        ({"temperature_c": 45.0}, "SURFACE-CLIMATE", "45.0 F would be 7.2 C"),
        # On a summer's day -0.8 C (30.5 F) at 1500 m is as unusual as 30.5 C; on a high plateau:
        ({"temperature_c": 9.0, "h_msl_m": 5000.0}, "SURFACE-CLIMATE", "9.0 F would be -12.8 C"),
        ({"temperature_c": -30.0}, "SURFACE-CLIMATE", "sigma"),
        ({"pressure_hpa": 1013.0, "h_msl_m": 345.0}, "SURFACE-LEVEL", "as QNH"),
        ({"pressure_hpa": 1019.0, "h_msl_m": 450.0}, "SURFACE-LEVEL", "as QNH"),
        ({"pressure_hpa": 900.0, "h_msl_m": 450.0}, "SURFACE-LEVEL", "not reduced to sea level"),
        ({"temperature_c": 288.0}, "SURFACE-TEMPERATURE", "Kelvin"),
        ({"pressure_hpa": 1013.0}, "SURFACE-PRESSURE", "not reduced to sea level"),
        ({"pressure_hpa": 29.92}, "SURFACE-PRESSURE", "hPa"),
        ({"temperature_c": 15.0, "relative_humidity": 55.0}, "SURFACE-HUMIDITY", "0.55"),
        ({"metar": "it was a fine day"}, "METAR-PARSE", "fine day"),
        ({"metar": METAR.replace("12/08", "92/08")}, "METAR-RANGE", "digit"),
    ],
)
def test_values_that_no_ground_has(report, code, words):
    with refused(code) as refusal:
        report_of({"h_msl_m": 1500.0} | report, Ledger())
    assert words in str(refusal.value)
    assert refusal.value.where.startswith("atmosphere.surface[0]")


def test_a_refused_report_is_named_by_its_place_in_the_mission_file(mission):
    with_air(mission, surface=[{"h_msl_m": 450, "metar": METAR}, {"h_msl_m": 1, "metar": "fine"}])
    assert "atmosphere.surface[1]" in mission.refusal("METAR-PARSE")


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"surface": [{"h_msl_m": 450}]}, "give either metar, or temperature_c"),
        ({"surface": [{"h_msl_m": 450, "metar": METAR, "temperature_c": 12.0}]}, "either metar"),
        (
            {"surface": [{"h_msl_m": 450, "temperature_c": 1.0, "time_utc": "noon"}]},
            "not a time like",
        ),
        ({"climatology": "tropics"}, "supplements1966"),
        ({"board_temperature": True}, "log.channels.temperature"),
    ],
)
def test_a_mission_file_that_says_nothing_sensible_of_the_air(mission, entries, words):
    if "board_temperature" in entries:
        mission.config["log"]["channels"].pop("temperature")
    with_air(mission, **entries)
    mission.refusal(words, 2)


# ---- the climatology, and a board


def test_a_climatology_by_name(mission):
    with_air(mission, climatology="us1976")
    prepared = read_mission(mission.save())
    assert "standard atmosphere us1976" in line_of(prepared, "climatology")


def test_the_temperature_of_a_board_if_the_user_insists(mission):
    """The simulator's board is 15 K too warm, of which the estimate must take most away."""
    mission.config["log"]["channels"]["temperature"] = "BARO[0]"
    (missing,) = with_code(read_mission(mission.save()).ledger, "CHANNEL-MISSING")
    assert "atmosphere.board_temperature" in missing.what
    with_air(mission, board_temperature=True)
    profile = mission.run_to_manifest()["profile"]
    assert profile["basis"] == "thermometer"
    sensors = {sensor["what"]: sensor for sensor in profile["sensors"]}
    assert sensors["thermometer bias [K]"]["value"] == pytest.approx(15.0, abs=4.0)
    assert sensors["thermometer bias [K]"]["expected_sigma"] == 10.0
    table = pq.read_table(mission.output / "profile.parquet").to_pandas()
    flown = table[table["h_m"].between(600.0, 2500.0)]
    error = flown["temperature_k"] - temperature_k(flown["h_m"].to_numpy())
    assert np.abs(error / flown["sigma_temperature_k"]).max() < 3.0


# ---- what is known of the sensors


def test_every_key_of_a_calibration_arrives_in_si():
    section = SensorsSection.model_validate(
        {
            "thermometer": {
                "bias_k": 0.1,
                "sigma_bias_k": 0.2,
                "lag_s": 3.0,
                "sigma_lag_s": 4.0,
                "transient_k": 5.0,
                "sigma_transient_k": 6.0,
                "recovery": 0.7,
                "sigma_recovery": 0.8,
                "sigma_drift_k": 0.9,
            },
            "barometer": {"offset_hpa": 1.1, "sigma_offset_hpa": 1.2, "sigma_scale": 0.017},
            "hygrometer": {"bias": 0.13, "sigma_bias": 0.14},
            "gnss": {"sigma_height_m": 15.0},
        }
    )
    calibration = section.calibration
    assert {fault: (k.mean, k.sigma) for fault, k in calibration.items()} == {
        SensorFault.THERMOMETER_BIAS: (0.1, 0.2),
        SensorFault.THERMOMETER_LAG: (3.0, 4.0),
        SensorFault.TAKEOFF_TRANSIENT: (5.0, 6.0),
        SensorFault.RECOVERY_FACTOR: (0.7, 0.8),
        SensorFault.THERMOMETER_DRIFT: (None, 0.9),
        SensorFault.HYGROMETER_BIAS: (0.13, 0.14),
        SensorFault.PRESSURE_OFFSET: (pytest.approx(110.0), pytest.approx(120.0)),
        SensorFault.GNSS_HEIGHT_OFFSET: (None, 15.0),
        SensorFault.PRESSURE_SCALE: (None, 0.017),
    }
    assert {k.path for k in calibration.values()} <= {key.path for key in mission_keys()}
    assert SensorsSection().calibration == {}


def test_what_is_known_of_the_sensors_reaches_the_air(mission, baseline):
    sensors = {
        "thermometer": {"bias_k": 0.5, "sigma_bias_k": 0.05},
        "gnss": {"sigma_height_m": 0.2},
        "barometer": {"sigma_offset_hpa": 0.07},
    }
    with_air(mission, sensors=sensors)
    manifest = mission.run_to_manifest()
    profile = manifest["profile"]
    expected_sigmas = {row["what"]: row["expected_sigma"] for row in profile["sensors"]}
    assert expected_sigmas["thermometer bias [K]"] == 0.05
    assert expected_sigmas["GNSS height offset [m]"] == 0.2
    assert expected_sigmas["static pressure offset [Pa]"] == pytest.approx(7.0)
    assert "0.5" in entry_of(manifest, "AIR-CALIBRATED")["what"]
    assert profile["effect"] != baseline.manifest()["profile"]["effect"]
    with_air(mission, adjust=False)
    unadjusted = read_mission(mission.save())
    assert "thermometer bias [K] 0.5 ± 0.05" in line_of(unadjusted, "sensors")
    assert "AIR-SOURCES-UNUSED" in read_codes(unadjusted)


# ---- what is told


def test_the_manifest_tells_the_scale_of_r_and_the_sensors(baseline):
    profile = baseline.manifest()["profile"]
    assert [effect["nadir_angle_deg"] for effect in profile["effect"]] == [45.0, 75.0]
    for effect in profile["effect"]:
        ratio = effect["r_c_arcsec"] / effect["standard_arcsec"]
        assert effect["factor"] == pytest.approx(ratio, abs=2e-4)
        assert 0.0 < effect["sigma_factor"] < 0.02
    assert profile["profiles"] == 1
    assert profile["windows"] == []
    sensors = {row["what"] for row in profile["sensors"]}
    assert sensors >= {"thermometer bias [K]", "thermometer lag [s]"}
    quantities = {
        row["quantity"] for row in profile["sources"] if row["used"] and "quantity" in row
    }
    assert quantities == {"temperature", "pressure", "humidity"}
    why_not = {row["source"]: row["why_not"] for row in profile["sources"] if not row["used"]}
    assert why_not.keys() >= {"sounding", "surface report", "us1976"}
    assert all(why_not.values())


def test_the_sigma_of_the_factor_covers_its_error(baseline):
    effect = baseline.manifest()["profile"]["effect"][0]
    right = true_arcsec(effect["h_g_m"], effect["h_c_m"])
    error = effect["r_c_arcsec"] - right
    assert abs(error) < 3.0 * effect["sigma_arcsec"] + 0.002 * right


def test_the_profile_has_its_sigmas(baseline):
    table = pq.read_table(baseline.output / "profile.parquet").to_pandas()
    flown = table["h_m"].between(600.0, 2800.0)
    above = table["h_m"].between(6e3, 2e4)
    assert table["sigma_temperature_k"].notna().all()
    assert table.loc[flown, "sigma_temperature_k"].max() < 1.0
    assert table.loc[above, "sigma_temperature_k"].min() > 1.0
    assert (table["sigma_refractivity"] > 0.0).all()


# ---- several airs in one mission

SUMMER = "afgl1986_midlatitude_summer"
SUBARCTIC = "afgl1986_subarctic_summer"


def good_rows(mission) -> pd.DataFrame:
    table = mission.results().to_pandas().set_index(["image", "point"])
    return table[table["status"] == "ok"]


@pytest.fixture(scope="module")
def changed(mission_factory, baseline, tmp_path_factory):
    """The mission in air that changes from one climate at the first image to another at the last.

    With it the rows in the first air, in the last, and in the air that changes. All airs have the
    flight's pressure at the height of the cameras.
    """
    mission = mission_factory(tmp_path_factory.mktemp("changed") / "mission")
    stations = baseline.stations().to_pandas()
    times = stations["time_utc"].astype("int64")
    height = np.array([stations["h_msl_m"].median()])
    climates = ["of the first image", "of the last image"]

    def windows_of_climates(adjustment, *_):
        gravity = adjustment.profile.gravity
        pressure = adjustment.profile.pressure(height)
        windows = []
        for time_ns, name in zip((int(times.min()), int(times.max())), climates, strict=True):
            climate = climatology(name, latitude_rad=gravity.latitude_rad, month=6.0)
            air = TimedProfile(time_ns, climate.profile.at_level(height, pressure))
            windows.append(TimeWindow(time_ns, time_ns + 1, air, 0.1, 0.01))
        return tuple(windows), ()

    rows = []
    with pytest.MonkeyPatch.context() as patch, without_plots():
        patch.setattr(air_of_mission, "estimate_windows", windows_of_climates)
        for airs in ((SUMMER, SUMMER), (SUBARCTIC, SUBARCTIC), (SUMMER, SUBARCTIC)):
            climates[:] = airs
            ended = mission.run("--force")
            assert ended.code == 0, ended.text
            rows.append(good_rows(mission))
    return mission, rows


@pytest.mark.parametrize(
    ("angle", "differs_by", "tolerance"), [("r_c_rad", 0.01, 8e-4), ("r_cc_rad", 0.02, 2e-3)]
)
def test_each_image_is_corrected_in_the_air_of_its_time(changed, angle, differs_by, tolerance):
    """R goes from that of the first air to that of the last, linear in time to 0.05 %.

    The window stands in the air of the time too.
    """
    mission, rows = changed
    in_first, in_last, changing = (table[angle] for table in rows)
    stations = mission.stations().to_pandas().set_index("image")
    times = stations["time_utc"].astype("int64")
    share_of_image = (times - times.min()) / (times.max() - times.min())
    share = share_of_image.loc[changing.index.get_level_values("image")].to_numpy()
    assert np.abs(in_last / in_first - 1.0).max() > differs_by
    expected = (1.0 - share) * in_first + share * in_last
    np.testing.assert_allclose(changing, expected, rtol=tolerance)


def test_the_tables_name_the_profile_of_each_image(changed):
    mission, _ = changed
    stations = mission.stations().to_pandas().sort_values("time_utc")
    table = pq.read_table(mission.output / "profile.parquet").to_pandas()
    time_of_profile = table.groupby("profile_id")["time_utc"].first()
    assert set(stations["profile_id"]) == set(time_of_profile.index)
    profile = mission.manifest()["profile"]
    assert len(time_of_profile) == profile["profiles"] > 2
    assert stations["profile_id"].is_monotonic_increasing
    times = pd.to_datetime(stations["time_utc"].to_list(), utc=True)
    profile_times = time_of_profile.loc[stations["profile_id"]].to_list()
    apart = pd.to_datetime(profile_times, utc=True) - times
    assert np.abs(apart).max() < pd.Timedelta(20, "s")
    begins = [window["start_utc"] for window in profile["windows"]]
    from_ends = pd.to_datetime(begins, utc=True) - times[[0, -1]]
    assert np.abs(from_ends).max() < pd.Timedelta(1, "s")


def test_a_changing_run_is_exported_as_it_was(changed, unbend, tmp_path):
    mission, rows = changed
    out = tmp_path / "lattice.parquet"
    lattice = unbend("export", mission.output, "--format", "lattice", "--out", out)
    assert lattice.code == 0, lattice.text
    images = pq.read_table(out).column("image").to_pylist()
    assert set(images) == set(rows[2].index.get_level_values("image"))


def test_swapped_profiles_do_not_pass_for_the_run(changed, unbend, tmp_path):
    mission, _ = changed
    folder = tmp_path / "mission"
    shutil.copytree(mission.folder, folder)
    output = folder / mission.output.name
    path = output / "profile.parquet"
    table = pq.read_table(path)
    ids = table["profile_id"].to_pylist()
    names = sorted(set(ids))
    other_name = dict(zip(names, reversed(names), strict=True))
    swapped = [other_name[name] for name in ids]
    pq.write_table(table.set_column(0, table.schema.field("profile_id"), [swapped]), path)
    manifest = json.loads((output / "manifest.json").read_text(encoding="utf-8"))
    (entry,) = [entry for entry in manifest["outputs"] if entry["name"] == path.name]
    entry["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    entry["bytes"] = path.stat().st_size
    (output / "manifest.json").write_text(json.dumps(manifest))
    out = tmp_path / "lattice.parquet"
    ended = unbend("export", output, "--format", "lattice", "--out", out)
    assert ended.code == 6, ended.text
    assert "EXPORT-NOT-REPRODUCED" in ended.err


def test_the_profile_of_an_image_is_read_back_by_its_name(changed):
    mission, _ = changed
    table = pq.read_table(mission.output / "profile.parquet")
    ids = mission.stations().column("profile_id")
    series = air_of(table, pa.chunked_array([ids.to_pylist()[::-1]]))
    numbers = series.profile_number.tolist()
    assert numbers == air_of(table, ids).profile_number.tolist()[::-1]
    assert len(set(numbers)) > 2


# ---- the index of refraction


def refractivity(mission, **entries) -> np.ndarray:
    mission.config["atmosphere"] = {"adjust": False} | entries
    air = read_mission(mission.save()).air
    return air.adjustment.profile.refractivity(np.array([500.0, 2000.0]))


def test_the_index_of_the_mission_file_counts(mission):
    usual = refractivity(mission)
    gyer = refractivity(mission, index="gyer")
    assert (gyer != usual).all()


@pytest.mark.parametrize(
    ("ground", "h_g_m"),
    [
        ({"height": 600.0, "reference": "msl"}, 600.0),
        ({"height": 600.0, "reference": "relative"}, 450.0),  # of the field, where it was sampled
    ],
)
def test_the_effect_on_r_is_that_on_the_ground_of_the_mission(mission, ground, h_g_m):
    mission.config["ground"] = ground
    air = read_mission(mission.save()).air
    assert [effect.h_g_m for effect in air.effects] == pytest.approx([h_g_m] * 2, abs=10.0)
    assert all(effect.h_c_m > 2500.0 for effect in air.effects)
