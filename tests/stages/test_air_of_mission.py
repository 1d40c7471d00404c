"""Sources of the air in a mission, and the several airs of a long one, end to end."""

from functools import partial

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from tests.conftest import without_plots
from tests.helpers import entry_of, one_line, refused, with_code
from tests.stages.plane_rays import plane_factor, true_refractivity
from tests.weather_texts import sounding_text
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
from unbend.simulate.true_air import temperature_k
from unbend.stages import air_of_mission
from unbend.stages.air_sources import read_report

METAR = "METAR KXYZ 151055Z 24011KT 9999 SCT040 12/08 Q1013"


def read(mission, **air):
    """The mission, read with these entries of its section atmosphere."""
    mission.config["atmosphere"] |= air
    return read_mission(mission.save())


def codes_in(prepared):
    return {message.code for message in prepared.ledger}


def uses(prepared):
    """What became of each source of the air, the last of those with one name."""
    return {use.source: use for use in prepared.air.adjustment.sources}


def line_of(prepared, label):
    """How `unbend check` describes a source."""
    return dict(prepared.sources.lines())[label]


def sources_of(manifest):
    return {row["source"]: row for row in manifest["profile"]["sources"]}


def with_balloon(mission, text):
    (mission.folder / "balloon.csv").write_text(text)
    mission.config["atmosphere"]["soundings"] = [{"path": "balloon.csv"}]


# ---- soundings


def test_a_sounding_is_used_hashed_and_named(mission, unbend):
    with_balloon(mission, sounding_text())
    checked = unbend("check", mission.save())
    assert "57 levels from 450 to 8850 m" in one_line(checked.out)

    manifest = mission.run_to_manifest()

    roles = {entry["role"]: entry["name"] for entry in manifest["inputs"]}
    assert roles["sounding 1"] == "balloon.csv"
    sources = sources_of(manifest)
    balloon = sources["sounding balloon.csv"]
    assert balloon["used"]
    assert balloon["readings"] > 0
    assert sources["surface report"]["why_not"] == "none in the mission file"
    assert "nothing to do" in mission.run().out
    with_balloon(mission, sounding_text(offset_k=0.5))
    assert "nothing to do" not in mission.run().out
    with_balloon(mission, "nothing of the kind\n")
    assert "balloon.csv" in mission.refusal("SOUNDING-FORMAT")


def test_a_sounding_stands_in_for_a_thermometer(mission):
    """Without a thermometer R has a sigma of 3 %; a balloon of the same air brings it down.

    It has neither time nor place: 6 h and 100 km change temperatures by 2.4 K, not by 1.5 K.
    """
    channels = mission.config["log"]["channels"]
    channels["temperature"] = "HYGR[9]"
    channels["humidity"] = "HYGR[9]"
    without = read(mission)
    with_balloon(mission, sounding_text())

    beside = read(mission)

    assert "CHANNEL-MISSING" in codes_in(without)
    assert uses(beside)["thermometer"].why_not == "none outside in the log"
    effect = beside.air.effects[0]
    assert effect.sigma_rad < 0.85 * without.air.effects[0].sigma_rad
    true_rad = plane_factor(true_refractivity, effect.h_g_m, effect.h_c_m)
    error_rad = abs(effect.r_c_rad - true_rad)
    assert error_rad < 2.0 * effect.sigma_rad + 0.002 * true_rad


def test_a_standard_that_is_kept_uses_no_source(mission):
    with_balloon(mission, sounding_text())
    mission.config["atmosphere"]["adjust"] = False

    manifest = mission.run_to_manifest()

    assert entry_of(manifest, "AIR-SOURCES-UNUSED")
    assert entry_of(manifest, "AIR-NOT-ADJUSTED")["kind"] == "note"
    assert manifest["profile"]["basis"] == "standard"
    sources = sources_of(manifest)
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
        ("2025-06-11T09:00:00Z", 47.4, 8.3, {"SOUNDING-FAR-IN-TIME"}),
        ("2010-06-12T09:00:00Z", 47.4, 8.3, {"AIR-SOURCE-FAR"}),
        ("", 47.4, 8.3, {"SOUNDING-UNDATED"}),
    ],
    ids=["near", "far", "farther", "of the day before", "old", "undated"],
)
def test_a_sounding_of_another_time_or_place(mission, time, north, east, codes):
    text = sounding_text(time_utc=time, latitude_deg=north, longitude_deg=east)
    with_balloon(mission, text)

    prepared = read(mission)

    about_sources = {
        code for code in codes_in(prepared) if code.startswith(("SOUNDING-", "AIR-SOURCE"))
    }
    assert about_sources == codes
    minute = time.removesuffix(":00Z")
    use = uses(prepared)[f"sounding balloon.csv {minute}".rstrip()]
    is_used = use.fit is not None
    assert is_used == ("AIR-SOURCE-FAR" not in codes)
    if time:
        assert f"balloon.csv of {minute} UTC" in line_of(prepared, "sounding")


def test_without_any_sensor_the_ground_is_where_it_took_off(mission):
    """The simulated field is 450 m above the sea."""
    channels = mission.config["log"]["channels"]
    for role in ("temperature", "humidity", "pressure"):
        channels[role] = "NONE"
    prepared = read(mission)
    assert prepared.air.effects[0].h_g_m == pytest.approx(450.0, abs=0.5)


# ---- stations on the ground


@pytest.mark.parametrize(
    ("report", "name"),
    [
        (f"metar: {METAR}", "surface report METAR KXYZ"),
        (
            """
            temperature_c: 18.0
            pressure_hpa: 966.0
            relative_humidity: 0.6
            time_utc: "2025-06-12T11:20:00+02:00"
            """,
            "surface report mission file",
        ),
    ],
    ids=["metar", "numbers"],
)
def test_a_station_is_used_and_named(mission, report, name):
    entries = {"h_msl_m": 450} | yaml.safe_load(report)
    prepared = read(mission, surface=[entries])
    assert uses(prepared)[name].fit is not None
    assert "at 450 m" in line_of(prepared, "surface")


@pytest.mark.parametrize(
    ("time", "codes"),
    [
        ("2025-06-12T09:20:00Z", set()),
        (None, {"SURFACE-UNDATED"}),
        ("2025-06-11T09:20:00Z", {"SURFACE-FAR-IN-TIME"}),
        ("1999-01-12T09:20:00Z", {"AIR-SOURCE-FAR"}),
    ],
    ids=["near", "undated", "of the day before", "old"],
)
def test_a_report_of_another_time(mission, time, codes):
    entries = {"h_msl_m": 450, "temperature_c": 18.0, "time_utc": time}
    prepared = read(mission, surface=[entries])
    about_time = {"SURFACE-UNDATED", "SURFACE-FAR-IN-TIME", "AIR-SOURCE-FAR"}
    assert codes_in(prepared) & about_time == codes


def report_of(entries, ledger):
    """A report as a mission over the simulated field in June has it."""
    background = climatology(latitude_rad=FIELD_LAT_RAD, month=6.0)
    section = SurfaceSection(**entries)
    return read_report(section, "atmosphere.surface[0]", None, background, ledger)


@pytest.mark.parametrize(
    ("entry", "distance_m"),
    [
        ({}, 100e3),
        ({"distance_km": 0.0}, 0.0),
        ({"distance_km": 12.0}, 12e3),
    ],
)
def test_a_station_whose_distance_is_not_stated_is_not_near(entry, distance_m):
    """It weighs as one of 100 km, and a message says so."""
    ledger = Ledger()
    report = report_of({"h_msl_m": 450, "metar": METAR} | entry, ledger)
    assert report.distance_m == pytest.approx(distance_m)
    is_assumed = not entry
    assert bool(with_code(ledger, "SURFACE-UNPLACED")) is is_assumed


@pytest.mark.parametrize(
    ("report", "code", "words"),
    [
        ("{temperature_c: 77.0}", "SURFACE-TEMPERATURE", "Fahrenheit"),
        ("{temperature_c: 59.0}", "SURFACE-CLIMATE", "Fahrenheit"),
        ("{temperature_c: 45.0}", "SURFACE-CLIMATE", "45.0 F would be 7.2 C"),
        # On a summer's day -0.8 C (30.5 F) at 1500 m is as unusual as 30.5 C; on a high plateau:
        ("{temperature_c: 9.0, h_msl_m: 5000.0}", "SURFACE-CLIMATE", "9.0 F would be -12.8 C"),
        ("{temperature_c: -30.0}", "SURFACE-CLIMATE", "sigma"),
        ("{pressure_hpa: 1013.0, h_msl_m: 345.0}", "SURFACE-LEVEL", "as QNH"),
        ("{pressure_hpa: 1019.0, h_msl_m: 450.0}", "SURFACE-LEVEL", "as QNH"),
        ("{pressure_hpa: 900.0, h_msl_m: 450.0}", "SURFACE-LEVEL", "not reduced to sea level"),
        ("{temperature_c: 288.0}", "SURFACE-TEMPERATURE", "Kelvin"),
        ("{pressure_hpa: 1013.0}", "SURFACE-PRESSURE", "not reduced to sea level"),
        ("{pressure_hpa: 29.92}", "SURFACE-PRESSURE", "hPa"),
        ("{temperature_c: 15.0, relative_humidity: 55.0}", "SURFACE-HUMIDITY", "0.55"),
        ("{metar: it was a fine day}", "METAR-PARSE", "fine day"),
        (f"{{metar: {METAR.replace('12/08', '92/08')}}}", "METAR-RANGE", "digit"),
    ],
)
def test_values_that_no_ground_has(report, code, words):
    entries = {"h_msl_m": 1500.0} | yaml.safe_load(report)
    with refused(code) as refusal:
        report_of(entries, Ledger())
    assert words in str(refusal.value)
    assert refusal.value.where.startswith("atmosphere.surface[0]")


def test_a_refused_report_is_named_by_its_place_in_the_mission_file(mission):
    reports = [
        {"h_msl_m": 450, "metar": METAR},
        {"h_msl_m": 1, "metar": "fine"},
    ]
    mission.config["atmosphere"]["surface"] = reports
    assert "atmosphere.surface[1]" in mission.refusal("METAR-PARSE")


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("surface: [{h_msl_m: 450}]", "give either metar, or temperature_c"),
        (f"surface: [{{h_msl_m: 450, metar: {METAR}, temperature_c: 12.0}}]", "either metar"),
        ("climatology: tropics", "supplements1966"),
        ("board_temperature: true", "log.channels.temperature"),
    ],
)
def test_a_mission_file_that_says_nothing_sensible_of_the_air(mission, section, words):
    if "board_temperature" in section:
        del mission.config["log"]["channels"]["temperature"]
    mission.config["atmosphere"] |= yaml.safe_load(section)
    mission.refusal(words, 2)


# ---- the climatology, and a board


def test_a_climatology_by_name(mission):
    prepared = read(mission, climatology="us1976")
    assert "standard atmosphere us1976" in line_of(prepared, "climatology")


def profile_of(mission):
    """The table of the profile that a run has written."""
    return pq.read_table(mission.output / "profile.parquet").to_pandas()


def test_the_temperature_of_a_board_if_the_user_insists(mission):
    """The simulator's board is 15 K too warm, of which the estimate must take most away."""
    mission.config["log"]["channels"]["temperature"] = "BARO[0]"
    (missing,) = with_code(read(mission).ledger, "CHANNEL-MISSING")
    assert "atmosphere.board_temperature" in missing.what
    mission.config["atmosphere"]["board_temperature"] = True

    profile = mission.run_to_manifest()["profile"]

    assert profile["basis"] == "thermometer"
    sensors = {sensor["what"]: sensor for sensor in profile["sensors"]}
    bias = sensors["thermometer bias [K]"]
    assert bias["value"] == pytest.approx(15.0, abs=4.0)
    assert bias["expected_sigma"] == 10.0
    flown = profile_of(mission).query("600.0 <= h_m <= 2500.0")
    true_k = temperature_k(flown["h_m"].to_numpy())
    error_k = flown["temperature_k"] - true_k
    in_sigmas = error_k / flown["sigma_temperature_k"]
    assert np.abs(in_sigmas).max() < 3.0


# ---- calibrations of the sensors

CALIBRATION = """
thermometer:
    bias_k: 0.1
    sigma_bias_k: 0.2
    lag_s: 3.0
    sigma_lag_s: 4.0
    transient_k: 5.0
    sigma_transient_k: 6.0
    recovery: 0.7
    sigma_recovery: 0.8
    sigma_drift_k: 0.9
barometer: {offset_hpa: 1.1, sigma_offset_hpa: 1.2, sigma_scale: 0.017}
hygrometer: {bias: 0.13, sigma_bias: 0.14}
gnss: {sigma_height_m: 15.0}
"""


def test_every_key_of_a_calibration_arrives_in_si():
    section = SensorsSection.model_validate(yaml.safe_load(CALIBRATION))
    calibration = section.calibration
    assert {fault: (k.mean, k.sigma) for fault, k in calibration.items()} == {
        SensorFault.THERMOMETER_BIAS: (0.1, 0.2),
        SensorFault.THERMOMETER_LAG: (3.0, 4.0),
        SensorFault.TAKEOFF_TRANSIENT: (5.0, 6.0),
        SensorFault.RECOVERY_FACTOR: (0.7, 0.8),
        SensorFault.THERMOMETER_DRIFT: (None, 0.9),
        SensorFault.HYGROMETER_BIAS: (0.13, 0.14),
        SensorFault.PRESSURE_OFFSET: pytest.approx((110.0, 120.0)),
        SensorFault.GNSS_HEIGHT_OFFSET: (None, 15.0),
        SensorFault.PRESSURE_SCALE: (None, 0.017),
    }
    keys_of_missions = {key.path for key in mission_keys()}
    assert {k.path for k in calibration.values()} <= keys_of_missions
    assert SensorsSection().calibration == {}


def test_what_is_known_of_the_sensors_reaches_the_air(mission, baseline):
    sensors = {
        "thermometer": {"bias_k": 0.5, "sigma_bias_k": 0.05},
        "gnss": {"sigma_height_m": 0.2},
        "barometer": {"sigma_offset_hpa": 0.07},
    }
    mission.config["atmosphere"]["sensors"] = sensors

    manifest = mission.run_to_manifest()

    profile = manifest["profile"]
    expected_sigmas = {row["what"]: row["expected_sigma"] for row in profile["sensors"]}
    assert expected_sigmas["thermometer bias [K]"] == 0.05
    assert expected_sigmas["GNSS height offset [m]"] == 0.2
    assert expected_sigmas["static pressure offset [Pa]"] == pytest.approx(7.0)
    assert "0.5" in entry_of(manifest, "AIR-CALIBRATED")["what"]
    assert profile["effect"] != baseline.manifest()["profile"]["effect"]
    unadjusted = read(mission, adjust=False)
    assert "thermometer bias [K] 0.5 ± 0.05" in line_of(unadjusted, "sensors")
    assert "AIR-SOURCES-UNUSED" in codes_in(unadjusted)


# ---- the record of the profile


def test_the_manifest_tells_the_scale_of_r_and_the_sensors(baseline):
    manifest = baseline.manifest()
    profile = manifest["profile"]
    assert [effect["nadir_angle_deg"] for effect in profile["effect"]] == [45.0, 75.0]
    for effect in profile["effect"]:
        ratio = effect["r_c_arcsec"] / effect["standard_arcsec"]
        assert effect["factor"] == pytest.approx(ratio, abs=2e-4)
        assert 0.0 < effect["sigma_factor"] < 0.02
    assert profile["profiles"] == 1
    assert profile["windows"] == []
    sensors = {row["what"] for row in profile["sensors"]}
    assert sensors >= {"thermometer bias [K]", "thermometer lag [s]"}
    quantities = set()
    unused = set()
    for row in profile["sources"]:
        if not row["used"]:
            unused.add(row["source"])
            assert row["why_not"]
        elif "quantity" in row:
            quantities.add(row["quantity"])
    assert quantities == {"temperature", "pressure", "humidity"}
    assert unused >= {"sounding", "surface report", "us1976"}


# ---- several airs in one mission

SUMMER = "afgl1986_midlatitude_summer"
SUBARCTIC = "afgl1986_subarctic_summer"
CLIMATES = {
    "first": (SUMMER, SUMMER),
    "last": (SUBARCTIC, SUBARCTIC),
    "changing": (SUMMER, SUBARCTIC),
}
"""The climates at the first and at the last image of a run."""


def times_ns(stations):
    return stations["time_utc"].astype("int64")


def corrected_rows(mission):
    table = mission.result_rows()
    return table[table["status"] == "ok"].set_index(["image", "point"])


@pytest.fixture(scope="module")
def changed(mission_factory, baseline, tmp_path_factory):
    """The mission in air that changes from one climate at the first image to another at the last.

    With it the rows in the first air, in the last, and in the air that changes. All airs have the
    flight's pressure at the height of the cameras.
    """
    mission = mission_factory(tmp_path_factory.mktemp("changed") / "mission")
    stations = baseline.station_rows()
    height_m = np.array([stations["h_msl_m"].median()])
    ends_ns = times_ns(stations).agg(["min", "max"]).tolist()

    def windows_of_climates(climates, adjustment, *_):
        profile = adjustment.profile
        latitude_rad = profile.gravity.latitude_rad
        pressure_pa = profile.pressure(height_m)
        windows = []
        for time_ns, name in zip(ends_ns, climates, strict=True):
            climate = climatology(name, latitude_rad=latitude_rad, month=6.0)
            at_cameras = climate.profile.at_level(height_m, pressure_pa)
            air = TimedProfile(time_ns, at_cameras)
            windows.append(TimeWindow(time_ns, time_ns + 1, air, 0.1, 0.01))
        return tuple(windows), ()

    rows = {}
    with pytest.MonkeyPatch.context() as patch, without_plots():
        for name, climates in CLIMATES.items():
            # A flight of minutes measures one climate: these take the place of its estimates.
            windows = partial(windows_of_climates, climates)
            patch.setattr(air_of_mission, "estimate_windows", windows)
            ended = mission.run("--force")
            assert ended.code == 0, ended.text
            rows[name] = corrected_rows(mission)
    return mission, rows


@pytest.mark.parametrize(
    ("angle", "differs_by", "tolerance"),
    [
        ("r_c_rad", 0.01, 8e-4),
        ("r_cc_rad", 0.02, 2e-3),
    ],
)
def test_each_image_is_corrected_in_the_air_of_its_time(changed, angle, differs_by, tolerance):
    """R goes from that of the first air to that of the last, linear in time to 0.05 %.

    The window is in the air of the time too.
    """
    mission, rows = changed
    first = rows["first"][angle]
    last = rows["last"][angle]
    changing = rows["changing"][angle]
    stations = mission.station_rows().set_index("image")
    since_first = times_ns(stations) - times_ns(stations).min()
    share_of_image = since_first / since_first.max()
    images = changing.index.get_level_values("image")
    share = share_of_image.loc[images].to_numpy()
    assert np.abs(last / first - 1.0).max() > differs_by
    expected = (1.0 - share) * first + share * last
    np.testing.assert_allclose(changing, expected, rtol=tolerance)


def test_the_tables_name_the_profile_of_each_image(changed):
    mission, _ = changed
    stations = mission.station_rows().sort_values("time_utc")
    time_of_profile = profile_of(mission).groupby("profile_id")["time_utc"].first()
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


def test_a_changing_run_is_exported_as_it_was(changed, obeyed, tmp_path):
    mission, rows = changed
    lattice = tmp_path / "lattice.parquet"
    obeyed("export", mission.output, "--format", "lattice", "--out", lattice)
    images = pq.read_table(lattice).column("image").to_pylist()
    assert set(images) == set(rows["changing"].index.get_level_values("image"))


def test_the_profile_of_an_image_is_read_back_by_its_name(changed):
    mission, _ = changed
    table = pq.read_table(mission.output / "profile.parquet")
    ids = mission.stations().column("profile_id")
    reversed_ids = pa.chunked_array([ids.to_pylist()[::-1]])
    numbers = air_of(table, reversed_ids).profile_number.tolist()
    assert numbers == air_of(table, ids).profile_number.tolist()[::-1]
    assert len(set(numbers)) > 2


@pytest.mark.parametrize(
    ("reference", "h_g_m"),
    [
        ("msl", 600.0),
        ("relative", 450.0),  # of the field, where it was sampled
    ],
)
def test_the_effect_on_r_is_that_on_the_ground_of_the_mission(mission, reference, h_g_m):
    mission.config["ground"] = {"height": 600.0, "reference": reference}
    effects = read(mission).air.effects
    assert [effect.h_g_m for effect in effects] == pytest.approx([h_g_m] * 2, abs=10.0)
    assert all(effect.h_c_m > 2500.0 for effect in effects)
