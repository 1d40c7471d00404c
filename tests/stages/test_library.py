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
from tests.helpers import refused
from tests.stages.block_files import CABIN
from tests.stages.oriented_tables import OPK, PINHOLE, PINHOLES, PLACE, QUATERNION, columns_of
from unbend import correct, standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch.results import read_manifest
from unbend.batch.runs import plan_of

pytestmark = [
    pytest.mark.usefixtures("plain_report"),
    pytest.mark.filterwarnings("ignore::UserWarning"),  # pinholes do not fit the points
]

CORRECTED = ["x_corrected_px", "y_corrected_px"]
HEIGHTS = {"heights": "msl"}
PLACE_COLUMNS = ["lat_deg", "lon_deg", "h_msl_m"]


@pytest.fixture(scope="module")
def measured(baseline) -> pa.Table:
    """What was measured, in the rows and columns of the results of a run."""
    names = baseline.measurements().column_names
    names.append(names.pop(names.index("h_g_m")))
    return baseline.results().select(names).replace_schema_metadata(None)


@pytest.fixture
def frame(measured) -> pd.DataFrame:
    return measured.to_pandas()


@pytest.fixture(scope="module")
def profile(baseline) -> pa.Table:
    return pq.read_table(baseline.output / "profile.parquet")


@pytest.fixture
def opk(baseline) -> pd.DataFrame:
    return columns_of(baseline.stations().to_pandas()).rename(columns={"time": "time_utc"})


@pytest.fixture
def simple(frame, opk):
    """Two pinholes over the stations in US 1976; a keyword replaces what is usual."""

    def run(table=frame, **changed):
        usual = {
            "stations": opk,
            "profile": "us1976",
            "cameras": PINHOLES,
            "orientation": HEIGHTS,
        }
        return correct(table, **(usual | changed))

    return run


@pytest.fixture
def as_flown(baseline, measured, profile):
    """The tables of a run with its own stations, air and cameras."""

    def run(observations=measured):
        sections = baseline.config
        stations = baseline.stations()
        return correct(
            observations, stations, profile, sections["cameras"], mount=sections["mount"]
        )

    return run


def test_it_is_among_the_main_names():
    assert "correct" in unbend.__all__
    assert unbend.correct is correct


def test_from_the_tables_of_a_run(as_flown, baseline):
    """Their profile has no covariance; coordinates and sigmas of stations are those of the run."""
    expected = baseline.results()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = as_flown()
    assert result.column_names == expected.column_names
    lost = {"sigma_r_c_rad", "sigma_air_dx_px", "sigma_air_dy_px", "dx_ds_px", "dy_ds_px"}
    for name in set(expected.column_names) - lost - {"r_c_rad"}:
        assert result[name].combine_chunks().equals(expected[name].combine_chunks()), name
    np.testing.assert_allclose(result["r_c_rad"], expected["r_c_rad"], rtol=1e-12)
    assert all(result[name].null_count == len(result) for name in lost)
    assert result.schema.metadata[b"unbend.refraction"] == b"removed"
    assert result.schema.metadata[b"unbend.uncertainty"] == b"null"


def test_angles_of_a_csv_are_the_mission_of_that_csv(opk, mission_factory, tmp_path):
    mission = mission_factory(tmp_path / "mission")
    cameras = {name: PINHOLE | {"window": {"cabin": CABIN}} for name in PINHOLES}
    path = mission.folder / "block.csv"
    opk.to_csv(path, index=False)
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
    given = mission.measurements().to_pandas()
    result = correct(given, pd.read_csv(path), "us1976", cameras, orientation=HEIGHTS)
    pd.testing.assert_frame_equal(result, mission.results().to_pandas(), check_exact=True)
    assert set(result.attrs) == {"uncertainty", "cabin_air", "ledger"}
    assert set(result.attrs["cabin_air"]) == {"nadir", "oblique"}


def test_attitudes_in_other_words(simple, baseline, opk):
    """Quaternions, degrees by name, and roll, pitch and yaw with the mount."""
    expected = simple()
    table = baseline.stations().to_pandas()
    quaternions = table[["image", "camera", *PLACE_COLUMNS, *QUATERNION]]
    names = dict(zip(PLACE, PLACE_COLUMNS, strict=True)) | {name: f"{name}_deg" for name in OPK}
    named = opk.rename(columns=names)
    body = Rotation.from_quat(table[[f"aircraft_q_{axis}" for axis in "xyzw"]]).inv()
    ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) * body
    flown = named[["image", "camera", *PLACE_COLUMNS]].copy()
    flown[["yaw", "pitch", "roll"]] = ned.as_euler("ZYX", degrees=True)
    mount = {"nadir": {}, "oblique": {"roll_deg": -45.0}}
    for stations, sections in ((quaternions, {}), (named, {}), (flown, {"mount": mount})):
        result = simple(stations=stations, orientation={}, **sections)
        assert (result["status"] == expected["status"]).all()
        np.testing.assert_allclose(result[CORRECTED], expected[CORRECTED], rtol=0.0, atol=5e-6)


def test_a_table_is_answered_by_its_kind(simple, frame):
    """Rows, order and the user's columns stay, and what was handed over is not touched."""
    given = frame.iloc[::-1].assign(note="mine", dx_ds_px=7.0)
    kept = given.copy()
    result = simple(table=given)
    pd.testing.assert_frame_equal(given, kept)
    assert result["image"].tolist() == given["image"].tolist()
    assert (result["note"] == "mine").all()
    assert (result["dx_ds_px_input"] == 7.0).all()
    arrow = simple(table=pa.Table.from_pandas(given, preserve_index=False))
    pd.testing.assert_index_equal(result.index, given.index)
    without_index = result.reset_index(drop=True)
    pd.testing.assert_frame_equal(arrow.to_pandas(), without_index, check_exact=True)


def test_pixels_may_count_from_the_centre_of_the_first(simple, frame):
    """The same places in the image, counted from its corner and from the centre of a pixel."""
    camera = PINHOLE | {"pixel_origin": "corner"}  # of the principal point, the same in both
    cameras = {"nadir": camera, "oblique": camera}
    from_corner = simple(cameras=cameras)
    frame[["x_px", "y_px"]] -= 0.5
    from_centre = simple(cameras=cameras, observations={"pixel_origin": "centre"})
    np.testing.assert_allclose(from_centre[CORRECTED] + 0.5, from_corner[CORRECTED], atol=1e-9)


def test_one_height_and_another_method(simple, frame):
    without_heights = frame.drop(columns="h_g_m")
    low = simple(table=without_heights, ground={"height": 100.0, "reference": "msl"})
    high = simple(table=without_heights, ground={"height": 900.0, "reference": "msl"})
    assert (low["h_g_m"] == 100.0).all()
    assert (low["r_c_rad"] > high["r_c_rad"]).all()
    plane = simple(refraction={"method": "plane"})
    assert not np.array_equal(plane["r_c_rad"], simple()["r_c_rad"])


def test_profiles_of_every_kind(simple, opk):
    standard = standard_atmosphere("us1976")
    given = simple(profile=standard)
    # Gravity differs from that of the name.
    np.testing.assert_allclose(simple()["r_c_rad"], given["r_c_rad"], rtol=0.01)
    assert given["dx_ds_px"].isna().all()
    size = standard.layers.edge.size
    matrix = np.zeros((2 * size + 1, 2 * size + 1))
    matrix[size, size] = 0.004**2
    timed = TimedProfile(None, standard, ProfileCovariance(standard, 1000.0, matrix))
    known = simple(profile=timed)
    np.testing.assert_allclose(known.attrs["uncertainty"]["scale_sigma"], 0.004, rtol=1e-3)
    for axis in "xy":
        shift = known[f"{axis}_corrected_px"] - known[f"{axis}_px"]
        np.testing.assert_allclose(known[f"d{axis}_ds_px"], shift, rtol=5e-3, atol=1e-6)
    series = simple(profile=constant_series(timed, len(opk)))
    pd.testing.assert_frame_equal(series, known, check_exact=True)
    estimated = simple(profile={"climatology": "auto"})
    assert 0.01 < estimated.attrs["uncertainty"]["scale_sigma"] < 0.3


def test_what_ends_a_run_with_code_3_is_a_warning(as_flown, frame):
    frame.loc[0, "image"] = "nadir_09999"
    with pytest.warns(UserWarning, match="no exposure|no_station") as warned:
        result = as_flown(frame)
    assert {str(warning.message).split(":")[0] for warning in warned} == {"IMAGES-UNMATCHED"}
    assert {warning.filename for warning in warned} == {__file__}
    (flagged,) = [entry for entry in result.attrs["ledger"] if entry["code"] == "OBS-FLAGGED"]
    assert flagged["kind"] == "note"
    assert flagged["count"] == 1
    assert result["status"].tolist()[:2] == ["no_station", "ok"]
    assert result["x_corrected_px"].isna().tolist()[:2] == [True, False]


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("OBS-COLUMN", {"table": lambda o: o.drop(columns="h_g_m")}),
        ("OBS-EMPTY", {"table": lambda o: o.iloc[:0]}),
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
def test_refusals_are_those_of_a_run(simple, frame, opk, code, change):
    tables = {"table": frame, "stations": opk}
    ((name, value),) = change.items()
    given = value(tables[name]) if callable(value) else value
    with refused(code) as refusal:
        simple(**{name: given})
    assert "/" not in refusal.value.where  # no folder of which the caller knows nothing
    assert "line 1:" not in str(refusal.value)  # of a file that nobody wrote


def test_what_was_corrected_is_refused(as_flown, baseline):
    with refused("OBS-ALREADY-CORRECTED"):
        as_flown(baseline.results())
    with refused("OBS-ALREADY-CORRECTED"):
        as_flown(baseline.results().to_pandas())


def test_what_is_no_table_and_no_air(simple, profile):
    with pytest.raises(TypeError, match="observations must be a pandas DataFrame"):
        simple(table={"image": ["a"]})
    with pytest.raises(TypeError, match="atmosphere: tables in memory replace"):
        simple(atmosphere={"standard": "icao"})
    with pytest.raises(TypeError, match="cannot be a DataFrame"):
        simple(profile=profile.to_pandas())
    series = constant_series(TimedProfile(None, standard_atmosphere("us1976")), 3)
    with pytest.raises(ValueError, match="those of 3 stations"):
        simple(profile=series)
    column = profile.column_names.index("profile_id")
    other = profile.set_column(column, "profile_id", pa.array(["other"] * len(profile)))
    with pytest.raises(ValueError, match="need the stations of their run"):
        simple(profile=pa.concat_tables([profile, other]))


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
def test_a_frame_comes_back_with_its_index(simple, frame, change):
    """After the everyday filter, a column of the result stands beside the filtered frame."""
    good = change(frame[frame["x_px"] > frame["x_px"].median()])
    result = simple(table=good)
    assert result.index.equals(good.index)
    assert result.index.names == good.index.names
    assert result["point"].tolist() == good["point"].tolist()


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
    assert outcome.repeated
    assert outcome.exit_code == 0
    assert read_manifest(mission.output).run.mission_file_sha256 == text_sha256
    assert repr(outcome) == (f"<Outcome {outcome.name}: exit code 0, repeated, {mission.output}>")
    refraction = loaded.refraction.model_copy(update={"radius_m": 6_380_000.0})
    changed = loaded.model_copy(update={"refraction": refraction})
    assert plan_of(changed).inputs == plan.inputs
    assert plan_of(changed).fingerprint != plan.fingerprint
