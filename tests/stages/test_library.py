"""`correct` on tables in memory: the rows of a run, and its refusals."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

import unbend
from unbend import correct, standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch.results import read_manifest
from unbend.batch.runs import plan_of
from unbend.errors import UnbendError

from .test_oriented_stations import columns_of

pytestmark = pytest.mark.usefixtures("plain_report")

CAMERA = {
    "width_px": 14000,
    "height_px": 10600,
    "f_px": 20000.0,
    "cx_px": 7012.4,
    "cy_px": 5291.7,
    "calibration": "laboratory",
}
CABIN = {"pressure_hpa": 812.0, "temperature_c": 21.0, "relative_humidity": 0.3}
OWN = ["image", "point", "x_px", "y_px", "h_g_m"]


@pytest.fixture(scope="module")
def flight(baseline):
    """Observations and stations of a run, its profile and the sections of its mission file."""
    table = baseline.results()
    given = [name for name in baseline.measurements().column_names if name != "h_g_m"]
    measured = table.select([*given, "h_g_m"]).replace_schema_metadata(None)
    profile = pq.read_table(baseline.output / "profile.parquet")
    return measured, baseline.stations(), profile, baseline.config, table


def opk(flight) -> pd.DataFrame:
    return columns_of(flight[1].to_pandas()).rename(columns={"time": "time_utc"})


def simple(flight, stations=None, observations=None, **more):
    """Two pinholes over the stations in US 1976; a keyword replaces what is usual."""
    stations = opk(flight) if stations is None else stations
    observations = flight[0].to_pandas() if observations is None else observations
    given = {"orientation": {"heights": "msl"}, "profile": "us1976"} | more
    cameras = given.pop("cameras", {"nadir": CAMERA, "oblique": CAMERA})
    return correct(observations, stations, given.pop("profile"), cameras, **given)


def quiet(*args, **more):
    """`simple` where pinholes do not fit the points: what is told of that is not looked at."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return simple(*args, **more)


def test_it_is_among_the_main_names():
    assert "correct" in unbend.__all__
    assert unbend.correct is correct


def test_from_the_tables_of_a_run(flight):
    """Their profile has no covariance; coordinates and sigmas of stations are those of the run."""
    measured, stations, profile, config, expected = flight
    found = correct(measured, stations, profile, config["cameras"], mount=config["mount"])
    assert found.column_names == expected.column_names
    lost = {"sigma_r_c_rad", "sigma_air_dx_px", "sigma_air_dy_px", "dx_ds_px", "dy_ds_px"}
    for name in set(expected.column_names) - lost - {"r_c_rad"}:
        assert found[name].combine_chunks().equals(expected[name].combine_chunks()), name
    np.testing.assert_allclose(found["r_c_rad"], expected["r_c_rad"], rtol=1e-12)
    assert all(found[name].null_count == len(found) for name in lost)
    assert found.schema.metadata[b"unbend.refraction"] == b"removed"
    assert found.schema.metadata[b"unbend.uncertainty"] == b"null"


def test_angles_of_a_csv_are_the_mission_of_that_csv(flight, mission_factory, tmp_path):
    mission = mission_factory(tmp_path / "mission")
    cameras = {name: CAMERA | {"window": {"cabin": CABIN}} for name in ("nadir", "oblique")}
    table = opk(flight)
    table.to_csv(mission.folder / "block.csv", index=False)
    orientation = {
        "path": "block.csv",
        "angles": "omega_phi_kappa",
        "frame": "geographic",
        "heights": "msl",
        "columns": {"camera": "camera", "time_utc": "time_utc"},
    }
    mission.config = {
        "mission": {"name": "block"},
        "observations": mission.config["observations"],
        "cameras": cameras,
        "stations": {"orientation": orientation},
        "ground": mission.config["ground"],
        "atmosphere": {"adjust": False},
        "output": {"path": "results"},
    }
    assert mission.run().code in (0, 3)  # the lenses are not those of the simulation
    read = pd.read_csv(mission.folder / "block.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        found = correct(
            mission.measurements().to_pandas(),
            read,
            "us1976",
            cameras,
            orientation={"heights": "msl"},
        )
    pd.testing.assert_frame_equal(found, mission.results().to_pandas(), check_exact=True)
    assert set(found.attrs) == {"uncertainty", "cabin_air", "ledger"}
    assert set(found.attrs["cabin_air"]) == {"nadir", "oblique"}


def test_attitudes_in_other_words(flight):
    """Quaternions, degrees by name, and roll, pitch and yaw with the mount."""
    given = quiet(flight)
    table = flight[1].to_pandas()
    quaternions = table[
        ["image", "camera", "lat_deg", "lon_deg", "h_msl_m", "q_w", "q_x", "q_y", "q_z"]
    ]
    named = opk(flight).rename(
        columns={
            "latitude": "lat_deg",
            "longitude": "lon_deg",
            "height": "h_msl_m",
            "omega": "omega_deg",
            "phi": "phi_deg",
            "kappa": "kappa_deg",
        }
    )
    body = Rotation.from_quat(table[[f"aircraft_q_{axis}" for axis in "xyzw"]]).inv()
    ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) * body
    angles = ned.as_euler("ZYX", degrees=True)
    flown = named[["image", "camera", "lat_deg", "lon_deg", "h_msl_m"]].assign(
        yaw=angles[:, 0], pitch=angles[:, 1], roll=angles[:, 2]
    )
    mounted = {"mount": {"nadir": {}, "oblique": {"roll_deg": -45.0}}}
    for stations, more in ((quaternions, {}), (named, {}), (flown, mounted)):
        found = quiet(flight, stations, orientation={}, **more)
        assert (found["status"] == given["status"]).all()
        for name in ("x_corrected_px", "y_corrected_px"):
            np.testing.assert_allclose(found[name], given[name], rtol=0.0, atol=5e-6)


def test_a_table_is_answered_by_its_kind(flight):
    """Rows, order and the user's columns stay, and what was handed over is not touched."""
    frame = flight[0].to_pandas().iloc[::-1].assign(note="mine", dx_ds_px=7.0)
    kept = frame.copy()
    found = quiet(flight, observations=frame)
    pd.testing.assert_frame_equal(frame, kept)
    assert found["image"].tolist() == frame["image"].tolist()
    assert (found["note"] == "mine").all()
    assert (found["dx_ds_px_input"] == 7.0).all()
    arrow = quiet(flight, observations=pa.Table.from_pandas(frame, preserve_index=False))
    pd.testing.assert_index_equal(found.index, frame.index)
    without_index = found.reset_index(drop=True)
    pd.testing.assert_frame_equal(arrow.to_pandas(), without_index, check_exact=True)


@pytest.mark.filterwarnings("ignore::UserWarning")  # pinholes do not fit the points
def test_pixels_may_count_from_the_centre_of_the_first(flight):
    """The same places in the image, counted from its corner and from the centre of a pixel."""
    camera = CAMERA | {"pixel_origin": "corner"}  # of the principal point, the same in both
    cameras = {"nadir": camera, "oblique": camera}
    frame = flight[0].to_pandas()
    given = {"orientation": {"heights": "msl"}}
    from_corner = correct(frame, opk(flight), "us1976", cameras, **given)
    frame[["x_px", "y_px"]] -= 0.5
    given["observations"] = {"pixel_origin": "centre"}
    from_centre = correct(frame, opk(flight), "us1976", cameras, **given)
    corrected = ["x_corrected_px", "y_corrected_px"]
    np.testing.assert_allclose(from_centre[corrected] + 0.5, from_corner[corrected], atol=1e-9)


def test_one_height_and_another_method(flight):
    frame = flight[0].to_pandas().drop(columns="h_g_m")
    low, high = (
        quiet(flight, observations=frame, ground={"height": h, "reference": "msl"})
        for h in (100.0, 900.0)
    )
    assert (low["h_g_m"] == 100.0).all()
    assert (low["r_c_rad"] > high["r_c_rad"]).all()
    plane = quiet(flight, refraction={"method": "plane"})
    assert not np.array_equal(plane["r_c_rad"], quiet(flight)["r_c_rad"])


def test_profiles_of_every_kind(flight):
    standard = standard_atmosphere("us1976")
    by_name = quiet(flight)
    given = quiet(flight, profile=standard)
    np.testing.assert_allclose(by_name["r_c_rad"], given["r_c_rad"], rtol=0.01)  # gravity differs
    assert given["dx_ds_px"].isna().all()
    size = standard.layers.edge.size
    matrix = np.zeros((2 * size + 1, 2 * size + 1))
    matrix[size, size] = 0.004**2
    timed = TimedProfile(None, standard, ProfileCovariance(standard, 1000.0, matrix))
    known = quiet(flight, profile=timed)
    sigma = known.attrs["uncertainty"]["scale_sigma"]
    np.testing.assert_allclose(sigma, 0.004, rtol=1e-3)
    for axis in "xy":
        shift = known[f"{axis}_corrected_px"] - known[f"{axis}_px"]
        np.testing.assert_allclose(known[f"d{axis}_ds_px"], shift, rtol=5e-3, atol=1e-6)
    series = quiet(flight, profile=constant_series(timed, len(flight[1])))
    pd.testing.assert_frame_equal(series, known, check_exact=True)
    estimated = quiet(flight, profile={"climatology": "auto"})
    assert 0.01 < estimated.attrs["uncertainty"]["scale_sigma"] < 0.3


def test_what_ends_a_run_with_code_3_is_a_warning(flight):
    frame = flight[0].to_pandas()
    frame.loc[0, "image"] = "nadir_09999"
    _, stations, profile, config, _ = flight
    with pytest.warns(UserWarning, match="no exposure|no_station") as told:
        found = correct(frame, stations, profile, config["cameras"], mount=config["mount"])
    assert {str(w.message).split(":")[0] for w in told} == {"IMAGES-UNMATCHED"}  # one loss
    flagged = [e for e in found.attrs["ledger"] if e["code"] == "OBS-FLAGGED"]
    assert [(entry["kind"], entry["count"]) for entry in flagged] == [("note", 1)]
    assert all(w.filename == __file__ for w in told)
    assert found["status"].tolist()[:2] == ["no_station", "ok"]
    assert found["x_corrected_px"].isna().tolist()[:2] == [True, False]


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("OBS-COLUMN", {"observations": lambda o: o.drop(columns="h_g_m")}),
        ("OBS-EMPTY", {"observations": lambda o: o.iloc[:0]}),
        ("ORIENTATION-REPEATED", {"stations": lambda s: pd.concat([s, s])}),
        ("ORIENTATION-UNIT", {"stations": lambda s: s.assign(kappa=1e4)}),
        ("ORIENTATION-POSITION", {"stations": lambda s: s.assign(latitude=95.0)}),
        ("ORIENTATION-COLUMN", {"stations": lambda s: s.drop(columns="phi")}),
        ("EVENTS-CAMERA", {"stations": lambda s: s.assign(camera="left")}),
        ("CONFIG-INVALID", {"orientation": {}}),  # nothing says what the heights count from
        ("CONFIG-INVALID", {"cameras": {"nadir": {"width_px": 14000}}}),
        ("CONFIG-UNKNOWN-KEY", {"grund": {"height": 100.0}}),
        ("CONFIG-INVALID", {"profile": "us1977"}),
    ],
)
def test_refusals_are_those_of_a_run(flight, code, change):
    given = {"observations": flight[0].to_pandas(), "stations": opk(flight)}
    for name, value in change.items():
        given[name] = value(given[name]) if callable(value) else value
    with pytest.raises(UnbendError) as refused:
        quiet(flight, **given)
    assert refused.value.code == code
    assert "/" not in refused.value.where  # no folder of which the caller knows nothing
    assert refused.value.remedy
    assert "line 1:" not in str(refused.value)  # of a file that nobody wrote


def test_what_was_corrected_is_refused(flight):
    _, stations, profile, config, table = flight
    for again in (table, table.to_pandas()):
        with pytest.raises(UnbendError) as refused:
            correct(again, stations, profile, config["cameras"], mount=config["mount"])
        assert refused.value.code.startswith("OBS-")


def test_what_is_no_table_and_no_air(flight):
    profile = flight[2]
    with pytest.raises(TypeError, match="observations must be a pandas DataFrame"):
        simple(flight, observations={"image": ["a"]})
    with pytest.raises(TypeError, match="atmosphere: tables in memory replace"):
        simple(flight, atmosphere={"standard": "icao"})
    with pytest.raises(TypeError, match="cannot be a DataFrame"):
        quiet(flight, profile=profile.to_pandas())
    series = constant_series(TimedProfile(None, standard_atmosphere("us1976")), 3)
    with pytest.raises(ValueError, match="those of 3 stations"):
        quiet(flight, profile=series)
    two = pa.concat_tables(
        [
            profile,
            profile.set_column(
                profile.column_names.index("profile_id"),
                "profile_id",
                pa.array(["other"] * len(profile)),
            ),
        ]
    )
    with pytest.raises(ValueError, match="need the stations of their run"):
        quiet(flight, profile=two)


def names_of_rows(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.set_index(pd.Index([f"row {number}" for number in range(len(frame))]))


def rows_of_two_levels(frame: pd.DataFrame) -> pd.DataFrame:
    levels = [np.arange(len(frame)) // 7, np.arange(len(frame)) % 7]
    return frame.set_index(pd.MultiIndex.from_arrays(levels, names=["strip", "number"]))


@pytest.mark.parametrize(
    "change",
    [lambda frame: frame[::-1], names_of_rows, rows_of_two_levels],
    ids=["reversed", "names", "two levels"],
)
def test_a_frame_comes_back_with_its_index(flight, change):
    """The everyday filter, then a column of the result beside the filtered frame."""
    frame = flight[0].to_pandas()
    good = change(frame[frame["x_px"] > frame["x_px"].median()])
    found = quiet(flight, observations=good)
    assert found.index.equals(good.index)
    assert found.index.names == good.index.names
    beside = good.assign(xc=found["x_corrected_px"])
    np.testing.assert_array_equal(beside["xc"], found["x_corrected_px"])
    assert beside["point"].tolist() == found["point"].tolist()


def test_a_loaded_mission_is_run_from_the_folder_of_its_file(mission, tmp_path, monkeypatch):
    """Relative paths count from there, wherever the program runs; a changed copy is another run."""
    assert mission.run().code == 0
    text_sha256 = read_manifest(mission.output).run.mission_file_sha256
    monkeypatch.chdir(tmp_path)
    loaded = unbend.load_mission(mission.file)
    plan = plan_of(loaded)
    assert plan.output == mission.output
    assert plan.fingerprint == plan_of(mission.file).fingerprint
    outcome = unbend.run_mission(loaded)
    assert (outcome.repeated, outcome.exit_code) == (True, 0)
    assert read_manifest(mission.output).run.mission_file_sha256 == text_sha256
    assert repr(outcome) == (f"<Outcome {outcome.name}: exit code 0, repeated, {mission.output}>")
    refraction = loaded.refraction.model_copy(update={"radius_m": 6_380_000.0})
    changed = loaded.model_copy(update={"refraction": refraction})
    assert plan_of(changed).inputs == plan.inputs
    assert plan_of(changed).fingerprint != plan.fingerprint
