"""Sources of the air in a mission, and the several airs of a long one, end to end."""

from __future__ import annotations

import copy
import hashlib
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.conftest import without_plots
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.atmosphere.series.time_windows import TimeWindow
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
from unbend.stages import air_of_mission as batch_air
from unbend.stages.air_sources import read_report

METAR = "METAR KXYZ 151055Z 24011KT 9999 SCT040 12/08 Q1013"


def sounding_text(offset_k: float = 0.0) -> str:
    """The simulator's own air as a balloon would list it, from the ground up."""
    h = np.arange(450.0, 9000.0, 150.0)
    t = temperature_k(h) + offset_k
    e = np.maximum(vapour_pressure_pa(h), 1.0)
    table = np.linspace(190.0, 320.0, 4000)
    dew = np.interp(e, saturation_pressure_pa(table), table)
    rows = zip(
        h,
        true_air(FIELD_LAT_RAD).pressure_pa(h) / 100.0,
        t - 273.15,
        np.minimum(dew, t) - 273.15,
        strict=True,
    )
    lines = [",".join(f"{value:.2f}" for value in row) for row in rows]
    return "\n".join(["h_m,pressure_hpa,temperature_c,dew_point_c", *lines])


def true_factor(h_g: float, h_c: float) -> float:
    """R at 45 degrees in the simulator's air [arcsec], plane: the sphere takes 0.1 % away.

    Mean of n along the way minus n at the camera (Gyer 1996, Eq. 24).
    """
    n = true_air(FIELD_LAT_RAD).n(np.linspace(h_g, h_c, 3001)) - 1.0
    return float(np.mean(0.5 * (n[1:] + n[:-1])) - n[-1]) / np.radians(1.0 / 3600.0)


def manifest(mission):
    return json.loads((mission.output / "manifest.json").read_text())


def sources(mission) -> dict[str, dict]:
    """The last row of the manifest for each source."""
    return {row["source"]: row for row in manifest(mission)["profile"]["sources"]}


def atmosphere(mission, **entries):
    mission.config.setdefault("atmosphere", {}).update(entries)


# ---- soundings


def test_a_sounding_is_used_hashed_and_named(mission, unbend, plain_report):
    path = mission.folder / "balloon.csv"
    path.write_text(sounding_text())
    atmosphere(mission, soundings=[{"path": "balloon.csv"}])
    checked = unbend("check", mission.save())
    assert checked.code == 0, checked.text
    assert "57 levels from 450 to 8850 m" in " ".join(checked.out.split())
    assert mission.run().code == 0
    inputs = {entry["role"]: entry["name"] for entry in manifest(mission)["inputs"]}
    assert inputs["sounding 1"] == "balloon.csv"
    used = sources(mission)
    assert used["sounding balloon.csv"]["used"]
    assert used["sounding balloon.csv"]["readings"] > 0
    assert used["surface report"]["why_not"] == "none in the mission file"
    assert "nothing to do" in mission.run().out
    path.write_text(sounding_text(0.5))
    again = mission.run()
    assert again.code == 0, again.text
    assert "nothing to do" not in again.out


def test_a_sounding_stands_in_for_a_thermometer(mission, baseline, plain_report):
    """Without a thermometer R has a sigma of 3 %; a balloon of the same air brings it down.

    It has neither time nor place: 6 h and 100 km change temperatures by 2.4 K, not by 1.5 K.
    """
    (mission.folder / "balloon.csv").write_text(sounding_text())
    channels = mission.config["log"]["channels"]
    channels["temperature"] = channels["humidity"] = "HYGR[9]"
    effects = []
    for soundings in ([], [{"path": "balloon.csv"}]):
        atmosphere(mission, soundings=soundings)
        ended = mission.run()
        assert ended.code == 3, ended.text
        assert "CHANNEL-MISSING" in ended.text
        effects.append(manifest(mission)["profile"]["effect"][0])
    right = true_factor(effects[0]["h_g_m"], effects[0]["h_c_m"])
    without, beside = effects
    assert beside["sigma_arcsec"] < 0.85 * without["sigma_arcsec"]
    assert abs(beside["r_c_arcsec"] - right) < 2.0 * beside["sigma_arcsec"] + 0.002 * right
    assert (sources(mission)["thermometer"])["why_not"] == "none outside in the log"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (None, "INPUT-MISSING"),
        ("h_m,pressure_hpa,temperature_c\n0,1013,15\n", "SOUNDING-LEVELS"),
        (sounding_text().replace("temperature_c", "temperature_k", 1), "SOUNDING-[A-Z-]+"),
        ("nothing of the kind\n", "SOUNDING-FORMAT"),
    ],
)
def test_soundings_that_cannot_be_used(mission, text, code):
    if text is not None:
        (mission.folder / "balloon.csv").write_text(text)
    atmosphere(mission, soundings=[{"path": "balloon.csv"}])
    ended = mission.run()
    assert ended.code == 6
    assert re.search(code, ended.err), ended.err
    assert "balloon.csv" in ended.err
    assert not (mission.output / "manifest.json").exists()


def test_a_standard_that_is_kept_uses_no_source(mission, plain_report):
    (mission.folder / "balloon.csv").write_text(sounding_text())
    atmosphere(mission, adjust=False, soundings=[{"path": "balloon.csv"}])
    ended = mission.run()
    assert ended.code == 0
    assert "AIR-SOURCES-UNUSED" in ended.out
    assert manifest(mission)["profile"]["basis"] == "standard"
    uses = sources(mission)
    assert uses["us1976"]["used"]
    for name in ("sounding balloon.csv", "barometer BARO[0]", "thermometer HYGR[0]"):
        assert not uses[name]["used"]
        assert "adjust is false" in uses[name]["why_not"]


def placed(text: str, time: str, north: float, east: float) -> str:
    """A sounding with time and place in its columns."""
    head, *rows = text.splitlines()
    return "\n".join(
        [
            f"{head},time_utc,latitude_deg,longitude_deg",
            *(f"{r},{time},{north},{east}" for r in rows),
        ]
    )


@pytest.mark.parametrize(
    ("time", "north", "east", "said", "used"),
    [
        ("{flight}", 47.4, 8.3, [], True),
        ("{flight}", 52.0, 8.3, ["SOUNDING-FAR-AWAY"], True),
        ("{flight}", 71.3, -156.8, ["SOUNDING-FAR-AWAY", "AIR-SOURCE-FAR"], False),
        ("2010-06-12T09:00:00Z", 47.4, 8.3, ["SOUNDING-FAR-IN-TIME", "AIR-SOURCE-FAR"], False),
        ("", 47.4, 8.3, ["SOUNDING-UNDATED"], True),
    ],
)
def test_a_sounding_of_another_time_or_place(
    mission, unbend, baseline, time, north, east, said, used
):
    when = baseline.stations().column("time_utc")[0].as_py().strftime("%Y-%m-%dT%H:%M:%SZ")
    text = placed(sounding_text(), time.format(flight=when), north, east)
    (mission.folder / "balloon.csv").write_text(text)
    atmosphere(mission, soundings=[{"path": "balloon.csv"}])
    ended = unbend("profile", mission.save())
    assert ended.code == (0 if used else 3), ended.text
    for code in ("SOUNDING-FAR-AWAY", "SOUNDING-FAR-IN-TIME", "SOUNDING-UNDATED", "AIR-SOURCE-FAR"):
        assert (code in ended.out) is (code in said), (code, ended.out)
    checked = " ".join(unbend("check", mission.save()).out.split())
    year = when[:4] if time == "{flight}" else time[:4]
    if time:
        assert f"balloon.csv of {year}-" in checked


def test_without_any_sensor_the_ground_is_where_it_took_off(mission, unbend):
    """The simulated field lies 450 m above the sea."""
    channels = mission.config["log"]["channels"]
    channels["temperature"] = channels["humidity"] = channels["pressure"] = "NONE"
    ended = unbend("profile", mission.save())
    assert ended.code == 3, ended.text
    assert re.search(r"R at 45° from \d+ m to 450 m", ended.out), ended.out


# ---- stations on the ground


@pytest.mark.parametrize(
    ("report", "name"),
    [
        ({"h_msl_m": 450, "metar": METAR}, "surface report METAR KXYZ"),
        (
            {
                "h_msl_m": 450,
                "temperature_c": 18.0,
                "pressure_hpa": 966.0,
                "relative_humidity": 0.6,
                "time_utc": "2025-06-12T11:20:00+02:00",
            },
            "surface report mission file",
        ),
    ],
)
def test_a_station_is_used_and_named(mission, unbend, plain_report, report, name):
    atmosphere(mission, surface=[report])
    assert f"at {report['h_msl_m']} m" in unbend("check", mission.save()).out
    assert mission.run().code in (0, 3)
    assert sources(mission)[name]["used"]


@pytest.mark.parametrize(
    ("stated", "distance_m"),
    [({}, 100e3), ({"distance_km": 0.0}, 0.0), ({"distance_km": 12.0}, 12e3)],
)
def test_a_station_whose_distance_is_not_stated_is_not_near(stated, distance_m):
    """It weighs as one of 100 km, and that is told."""
    section = SurfaceSection(h_msl_m=450, metar=METAR, **stated)
    ledger = Ledger()
    background = climatology(latitude_rad=FIELD_LAT_RAD, month=6.0)
    report = read_report(section, "atmosphere.surface[0]", None, background, ledger)
    assert report.distance_m == pytest.approx(distance_m)
    assert ("SURFACE-UNPLACED" in {entry.code for entry in ledger}) is (not stated)


def test_a_report_of_another_day_is_left_out(mission, unbend):
    numbers = {"h_msl_m": 450, "temperature_c": 18.0, "time_utc": "1999-01-12T09:20:00Z"}
    atmosphere(mission, surface=[numbers])
    ended = unbend("profile", mission.save())
    assert ended.code == 3
    assert "SURFACE-FAR-IN-TIME" in ended.out
    assert "AIR-SOURCE-FAR" in ended.out
    del numbers["time_utc"]
    atmosphere(mission, surface=[numbers])
    ended = unbend("profile", mission.save())
    assert ended.code == 0
    assert "SURFACE-UNDATED" in ended.out


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
def test_values_that_no_ground_has(mission, report, code, words):
    atmosphere(mission, surface=[{"h_msl_m": 1500.0} | report])
    ended = mission.run()
    assert ended.code == 6
    assert code in ended.err
    assert words in ended.err
    assert "atmosphere.surface[0]" in ended.err


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"surface": [{"h_msl_m": 450}]}, "give either metar, or temperature_c"),
        ({"surface": [{"h_msl_m": 450, "metar": METAR, "temperature_c": 12.0}]}, "either metar"),
        ({"surface": [{"h_msl_m": 450, "relative_humidity": 0.5}]}, "needs temperature_c"),
        ({"surface": [{"h_msl_m": 450, "temperature_f": 64.0}]}, "temperature_c"),
        (
            {"surface": [{"h_msl_m": 450, "temperature_c": 1.0, "time_utc": "noon"}]},
            "not a time like",
        ),
        ({"surface": [{"temperature_c": 12.0}]}, "h_msl_m"),
        ({"soundings": [{"path": "a.csv", "format": "bufr"}]}, "wyoming_csv"),
        ({"climatology": "tropics"}, "supplements1966"),
        ({"board_temperature": True}, "log.channels.temperature"),
    ],
)
def test_a_mission_file_that_says_nothing_sensible_of_the_air(mission, entries, words):
    if "board_temperature" in entries:
        mission.config["log"]["channels"].pop("temperature")
    atmosphere(mission, **entries)
    ended = mission.run()
    assert ended.code == 2
    assert words in ended.err


# ---- the climatology, and a board


def test_a_climatology_by_name(mission, unbend, plain_report):
    atmosphere(mission, climatology="us1976")
    assert "standard atmosphere us1976" in " ".join(unbend("check", mission.save()).out.split())


def test_the_temperature_of_a_board_if_the_user_insists(mission, plain_report):
    """The simulator's board is 15 K too warm, of which the estimate must take most away."""
    mission.config["log"]["channels"]["temperature"] = "BARO[0]"
    refused = mission.run().text
    assert "CHANNEL-MISSING" in refused
    assert "atmosphere.board_temperature" in refused
    atmosphere(mission, board_temperature=True)
    ended = mission.run()
    assert ended.code == 0, ended.text
    profile = manifest(mission)["profile"]
    assert profile["basis"] == "thermometer"
    (bias,) = [s for s in profile["sensors"] if s["what"] == "thermometer bias [K]"]
    assert bias["value"] == pytest.approx(15.0, abs=4.0)
    assert bias["expected_sigma"] == 10.0
    table = pq.read_table(mission.output / "profile.parquet").to_pandas()
    table = table[table["h_m"].between(600.0, 2500.0)]
    error = table["temperature_k"] - temperature_k(table["h_m"].to_numpy())
    assert np.abs(error / table["sigma_temperature_k"]).max() < 3.0


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
    assert {name: (k.mean, k.sigma) for name, k in section.calibration.items()} == {
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
    assert {known.path for known in section.calibration.values()} <= {
        key.path for key in mission_keys()
    }
    assert SensorsSection().calibration == {}


def test_what_is_known_of_the_sensors_reaches_the_air(mission, unbend, plain_report):
    usual = mission.run()
    assert usual.code == 0, usual.text
    before = manifest(mission)["profile"]
    atmosphere(
        mission,
        sensors={
            "thermometer": {"bias_k": 0.5, "sigma_bias_k": 0.05},
            "gnss": {"sigma_height_m": 0.2},
            "barometer": {"sigma_offset_hpa": 0.07},
        },
    )
    checked = unbend("check", mission.save())
    assert "thermometer bias [K] 0.5 ± 0.05" in " ".join(checked.out.split())
    assert mission.run().code == 0
    after = manifest(mission)
    expected = {s["what"]: s["expected_sigma"] for s in after["profile"]["sensors"]}
    assert expected["thermometer bias [K]"] == 0.05
    assert expected["GNSS height offset [m]"] == 0.2
    assert expected["static pressure offset [Pa]"] == pytest.approx(7.0)
    (note,) = [e for e in after["ledger"] if e["code"] == "AIR-CALIBRATED"]
    assert "0.5" in note["what"]
    assert after["profile"]["effect"] != before["effect"]
    atmosphere(mission, adjust=False)
    assert "AIR-SOURCES-UNUSED" in mission.run().text


# ---- what is told


def test_the_manifest_tells_the_scale_of_r_and_the_sensors(baseline):
    profile = manifest(baseline)["profile"]
    at_45, at_75 = profile["effect"]
    assert (at_45["nadir_angle_deg"], at_75["nadir_angle_deg"]) == (45.0, 75.0)
    for effect in (at_45, at_75):
        ratio = effect["r_c_arcsec"] / effect["standard_arcsec"]
        assert effect["factor"] == pytest.approx(ratio, abs=2e-4)
        assert 0.0 < effect["sigma_factor"] < 0.02
    assert profile["profiles"] == 1
    assert profile["windows"] == []
    assert {"thermometer bias [K]", "thermometer lag [s]"} <= {
        s["what"] for s in profile["sensors"]
    }
    used = {s["quantity"] for s in profile["sources"] if s["used"] and "quantity" in s}
    assert used == {"temperature", "pressure", "humidity"}
    unused = {s["source"] for s in profile["sources"] if not s["used"]}
    assert {"sounding", "surface report", "us1976"} <= unused
    assert all(s["why_not"] for s in profile["sources"] if not s["used"])
    page = (baseline.output / "report.html").read_text()
    for words in (
        "R at 75° from",
        "thermometer bias [K]",
        "only shown for comparison",
        "sigma inflation",
        "degrees of freedom for signal",
    ):
        assert words in page


def test_the_sigma_of_the_factor_covers_its_error(baseline):
    effect = manifest(baseline)["profile"]["effect"][0]
    right = true_factor(effect["h_g_m"], effect["h_c_m"])
    error = effect["r_c_arcsec"] - right
    assert abs(error) < 3.0 * effect["sigma_arcsec"] + 0.002 * right


def test_the_profile_has_its_sigmas(baseline):
    table = pq.read_table(baseline.output / "profile.parquet").to_pandas()
    inside = table["h_m"].between(600.0, 2800.0)
    assert table["sigma_temperature_k"].notna().all()
    assert table.loc[inside, "sigma_temperature_k"].max() < 1.0
    assert table.loc[~inside & table["h_m"].between(6e3, 2e4), "sigma_temperature_k"].min() > 1.0
    assert (table["sigma_refractivity"] > 0.0).all()


# ---- several airs in one mission

ENDS = ("afgl1986_midlatitude_summer", "afgl1986_subarctic_summer")


def two_airs(mission, baseline, monkeypatch, names=ENDS):
    """Make the air of a mission change from one climate to another between first and last image.

    Both have the flight's pressure at the height of the cameras.
    """
    stations = baseline.stations().to_pandas()
    times = np.sort(stations["time_utc"].astype("int64"))
    height = float(stations["h_msl_m"].median())

    def windows(whole, *_):
        p = float(whole.profile.pressure(height))
        climates = [
            climatology(name, latitude_rad=whole.profile.gravity.latitude_rad, month=6.0)
            for name in names
        ]
        airs = [c.profile.at_level(np.array([height]), np.array([p])) for c in climates]
        return tuple(
            TimeWindow(int(t), int(t) + 1, TimedProfile(int(t), air), 0.1, 0.01)
            for t, air in zip((times[0], times[-1]), airs, strict=True)
        ), ()

    monkeypatch.setattr(batch_air, "estimate_windows", windows)


def angles(mission):
    table = mission.results().to_pandas().set_index(["image", "point"])
    return table[table["status"] == "ok"]


@pytest.fixture(scope="module")
def changed_once(mission_factory, baseline, tmp_path_factory):
    """The mission in air that changes, and the same in the first and in the last air alone."""
    mission = mission_factory(tmp_path_factory.mktemp("changed") / "mission")
    found = {}
    with pytest.MonkeyPatch.context() as patch, without_plots():
        for name, climates in (
            ("first", (ENDS[0],) * 2),
            ("last", (ENDS[1],) * 2),
            ("changing", ENDS),
        ):
            two_airs(mission, baseline, patch, climates)
            ended = mission.run("--force")
            assert ended.code == 0, ended.text
            found[name] = angles(mission)
    return mission, found


@pytest.fixture
def changed(changed_once, baseline, monkeypatch, plain_report, tmp_path):
    """A copy of these runs for a test of its own, in the air that changes."""
    mission, found = changed_once
    own = replace(mission, folder=tmp_path / "mission", config=copy.deepcopy(mission.config))
    shutil.copytree(mission.folder, own.folder)
    two_airs(own, baseline, monkeypatch)
    return own, found


def test_each_image_is_corrected_in_the_air_of_its_time(changed):
    """R goes from that of the first air to that of the last, linear in time to 0.05 %."""
    mission, found = changed
    stations = mission.stations().to_pandas().set_index("image")
    times = stations["time_utc"].astype("int64")
    share = (times - times.min()) / (times.max() - times.min())
    at = share.loc[found["changing"].index.get_level_values("image")].to_numpy()
    first = found["first"]["r_c_rad"].to_numpy()
    last = found["last"]["r_c_rad"].to_numpy()
    assert np.abs(last / first - 1.0).max() > 0.01
    expected = (1.0 - at) * first + at * last
    assert found["changing"]["r_c_rad"].to_numpy() == pytest.approx(expected, rel=8e-4)
    # The window stands in the air of the time too.
    first = found["first"]["r_cc_rad"].to_numpy()
    last = found["last"]["r_cc_rad"].to_numpy()
    assert np.abs(last / first - 1.0).max() > 0.02
    expected = (1.0 - at) * first + at * last
    assert found["changing"]["r_cc_rad"].to_numpy() == pytest.approx(expected, rel=2e-3)


def test_the_tables_name_the_profile_of_each_image(changed):
    mission, _ = changed
    stations = mission.stations().to_pandas().sort_values("time_utc")
    table = pq.read_table(mission.output / "profile.parquet").to_pandas()
    assert set(stations["profile_id"]) == set(table["profile_id"])
    assert len(set(table["profile_id"])) == manifest(mission)["profile"]["profiles"] > 2
    assert stations["profile_id"].is_monotonic_increasing
    of = table.groupby("profile_id")["time_utc"].first()
    apart = (of.loc[stations["profile_id"]].to_numpy() - stations["time_utc"].to_numpy()).astype(
        "timedelta64[ms]"
    )
    assert np.abs(apart).max() < np.timedelta64(20, "s")
    windows = manifest(mission)["profile"]["windows"]
    assert len(windows) == 2
    ends = [np.datetime64(w[end].removesuffix("Z")) for w in windows for end in _ENDS_OF_A_WINDOW]
    from_flight = np.array(ends, "datetime64[s]") - stations["time_utc"].iloc[0].to_datetime64()
    assert np.abs(from_flight).max() < np.timedelta64(12, "h")


_ENDS_OF_A_WINDOW = ("start_utc", "end_utc")


def test_a_changing_run_is_exported_as_it_was(changed, unbend, tmp_path):
    mission, found = changed
    out = tmp_path / "lattice.parquet"
    ended = unbend("export", mission.output, "--format", "lattice", "--out", out)
    assert ended.code == 0, ended.text
    images = pq.read_table(out).to_pandas()["image"].unique()
    assert set(images) == set(found["changing"].index.get_level_values("image"))
    radial = unbend(
        "export", mission.output, "--format", "radial-csv", "--out", tmp_path / "radial.csv"
    )
    assert radial.code == 0, radial.text
    assert "EXPORT-AIR-CHANGES" in radial.out


def test_swapped_profiles_do_not_pass_for_the_run(changed, unbend, tmp_path):
    mission, _ = changed
    path = mission.output / "profile.parquet"
    table = pq.read_table(path)
    ids = table["profile_id"].to_pylist()
    turned = dict(zip(sorted(set(ids)), sorted(set(ids), reverse=True), strict=True))
    swapped = table.set_column(0, table.schema.field(0), [[turned[name] for name in ids]])
    pq.write_table(swapped, path)
    content = manifest(mission)
    for entry in content["outputs"]:
        if entry["name"] == "profile.parquet":
            entry["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
            entry["bytes"] = path.stat().st_size
    (mission.output / "manifest.json").write_text(json.dumps(content))
    ended = unbend(
        "export", mission.output, "--format", "lattice", "--out", tmp_path / "lattice.parquet"
    )
    assert ended.code == 6, ended.text
    assert "EXPORT-NOT-REPRODUCED" in ended.err


def test_the_profile_command_writes_every_profile(changed, unbend, tmp_path):
    mission, _ = changed
    target = tmp_path / "air.csv"
    assert unbend("profile", mission.file, "--csv", target, "--step", "1000").code == 0
    rows = target.read_text().splitlines()
    assert rows[0].startswith("profile_id,time_utc,h_m")
    assert len({row.split(",")[0] for row in rows[1:]}) > 2
    plot = tmp_path / "air.png"
    assert unbend("profile", mission.file, "--plot", plot).code == 0
    assert plot.read_bytes().startswith(b"\x89PNG")
    shown = " ".join(unbend("profile", mission.file).out.split())
    assert "profiles, because the air changes" in shown
    assert "R at 45° from" in shown


# ---- the index of refraction


def refractivity(mission, **entries) -> np.ndarray:
    mission.config["atmosphere"] = {"adjust": False} | entries
    air = read_mission(mission.save()).air
    return air.adjustment.profile.refractivity(np.array([500.0, 2000.0]))


def test_index_wavelength_and_carbon_dioxide_of_the_mission_file_count(mission):
    """Ciddor 1996: n - 1 of dry air grows by 0.534e-6 of itself a ppm; Edlen's dispersion."""
    usual = refractivity(mission)
    more = refractivity(mission, co2_ppm=1450.0)
    assert more / usual - 1.0 == pytest.approx([5.34e-4, 5.34e-4], rel=2e-2)
    blue = refractivity(mission, wavelength_m=0.4e-6)
    # Of dry air at 15 degC: 2.8275e-4 at 0.4 um, 2.7784e-4 at 0.55 um (Ciddor 1996, Eq. 1).
    assert blue / usual == pytest.approx([1.0177, 1.0177], abs=4e-4)
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
