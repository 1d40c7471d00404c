"""`correct` on tables in memory: the rows of a run, and its refusals."""

import json
import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal, assert_index_equal
from pyproj import Proj
from scipy.spatial.transform import Rotation

import unbend
from tests.helpers import NED_FROM_ENU, codes_of, entry_of, refused
from tests.small_block import enu_axes
from tests.stages.block_files import CABIN
from tests.stages.corrected_rows import pressure_alone
from tests.stages.oriented_tables import (
    OPK,
    PINHOLE,
    PINHOLES,
    PLACE,
    QUATERNION,
    attitudes,
    columns_of,
)
from unbend import correct, standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch.results import read_manifest
from unbend.batch.runs import plan_of
from unbend.errors import ConfigError

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # pinholes do not fit the points

CORRECTED = ["x_corrected_px", "y_corrected_px"]
HEIGHTS = {"heights": "msl"}
GROUND = {"height": {"column": "h_g_m"}, "reference": "msl"}
PLACE_COLUMNS = ["lat_deg", "lon_deg", "h_msl_m"]
US1976 = standard_atmosphere("us1976")


@pytest.fixture(scope="module")
def measured(baseline):
    """What was measured, in the rows and columns of the results of a run."""
    names = baseline.measurements().column_names
    names.remove("h_g_m")
    return baseline.results().select([*names, "h_g_m"]).replace_schema_metadata(None)


@pytest.fixture
def frame(measured):
    return measured.to_pandas()


@pytest.fixture(scope="module")
def profile(baseline):
    return pq.read_table(baseline.output / "profile.parquet")


@pytest.fixture
def opk(baseline):
    stations = baseline.station_rows()
    return columns_of(stations).rename(columns={"time": "time_utc"})


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
        cameras = baseline.config["cameras"]
        mount = baseline.config["mount"]
        return correct(observations, baseline.stations(), profile, cameras, mount=mount)

    return run


def test_from_the_tables_of_a_run(as_flown, baseline):
    """Their profile has no covariance; coordinates and sigmas of stations are those of the run."""
    expected = baseline.results()

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = as_flown()

    assert result.column_names == expected.column_names
    lost = {"sigma_r_c_rad", "sigma_air_dx_px", "sigma_air_dy_px", "dx_ds_px", "dy_ds_px"}
    assert lost < set(expected.column_names)
    for name in expected.column_names:
        if name in lost:
            assert result[name].null_count == len(result)
        elif name == "r_c_rad":
            assert_allclose(result[name], expected[name], rtol=1e-12)
        else:
            assert result[name].equals(expected[name]), name
    metadata = result.schema.metadata
    assert json.loads(metadata[b"unbend.profile"])["standard"] == "adjusted"
    assert metadata[b"unbend.refraction"] == b"removed"
    assert metadata[b"unbend.uncertainty"] == b"null"


def test_angles_of_a_csv_are_the_mission_of_that_csv(opk, mission):
    camera = PINHOLE | {"window": {"cabin": CABIN}}
    cameras = dict.fromkeys(PINHOLES, camera)
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

    rows = mission.measured_rows()
    result = correct(rows, pd.read_csv(path), "us1976", cameras, orientation=HEIGHTS)

    assert_frame_equal(result, mission.result_rows(), check_exact=True)
    assert set(result.attrs) == {"uncertainty", "profile", "cabin_air", "ledger"}
    assert set(result.attrs["cabin_air"]) == {"nadir", "oblique"}


def test_attitudes_in_other_words(simple, baseline, opk):
    """Quaternions, degrees by name, and roll, pitch and yaw with the mount."""
    table = baseline.station_rows()
    columns = ["image", "camera", *PLACE_COLUMNS]
    by_quaternion = table[columns + QUATERNION]
    with_units = dict(zip(PLACE, PLACE_COLUMNS, strict=True))
    for angle in OPK:
        with_units[angle] = f"{angle}_deg"
    in_degrees = opk.rename(columns=with_units)
    body = Rotation.from_quat(table[[f"aircraft_q_{axis}" for axis in "xyzw"]]).inv()
    ned = Rotation.from_matrix(NED_FROM_ENU) * body
    angles = ned.as_euler("ZYX", degrees=True)
    by_body = in_degrees[columns].copy()
    by_body[["yaw", "pitch", "roll"]] = angles
    mount = {"nadir": {}, "oblique": {"roll_deg": -45.0}}

    results = [
        simple(stations=by_quaternion, orientation={}),
        simple(stations=in_degrees, orientation={}),
        simple(stations=by_body, orientation={}, mount=mount),
    ]

    expected = simple()
    for result in results:
        assert (result["status"] == expected["status"]).all()
        assert_allclose(result[CORRECTED], expected[CORRECTED], rtol=0.0, atol=5e-6)


@pytest.fixture
def in_other_frame(baseline):
    """Stations whose attitudes count from axes (n, 3, 3), rows in east, north, up of each place."""

    def turned(axes_in_enu):
        table = baseline.station_rows()
        enu_from_frame = axes_in_enu.transpose(0, 2, 1)
        camera_from_frame = Rotation.from_matrix(attitudes(table) @ enu_from_frame)
        rows = table[["image", "camera", *PLACE_COLUMNS]].copy()
        rows[QUATERNION] = camera_from_frame.as_quat(scalar_first=True)
        return rows

    return turned


@pytest.fixture
def projected(in_other_frame, baseline):
    """Stations in UTM that keep their latitudes and longitudes too."""
    projection = Proj("EPSG:32632")
    latitude, longitude = baseline.station_rows()[["lat_deg", "lon_deg"]].to_numpy().T
    convergence = projection.get_factors(longitude, latitude).meridian_convergence
    about_z = Rotation.from_euler("z", convergence[:, None], degrees=True)
    stations = in_other_frame(about_z.as_matrix())
    stations["x"], stations["y"] = projection(longitude, latitude)
    return stations


IN_UTM = {"frame": "projected", "crs": "EPSG:32632"}


def test_stations_in_a_projection_have_a_height_of_that_name(simple, projected):
    stations = projected.drop(columns=["lat_deg", "lon_deg"])

    result = simple(stations=stations, orientation=IN_UTM)

    expected = simple()
    assert_allclose(result[CORRECTED], expected[CORRECTED], rtol=0.0, atol=5e-6)


def test_map_coordinates_need_their_frame(simple, projected):
    stations = projected.drop(columns=["lat_deg", "lon_deg"])
    with refused("TABLES-FRAME", ConfigError, remedy="'crs': 'EPSG:...'"):
        simple(stations=stations)


def test_latitudes_beside_map_coordinates_are_compared_with_them(simple, projected):
    elsewhere = projected.assign(lat_deg=46.0)

    confirmed = simple(stations=projected, orientation=IN_UTM)
    contradicted = simple(stations=elsewhere, orientation=IN_UTM)

    entry = entry_of(confirmed.attrs, "FRAME-CONFIRMED")
    assert "in the table of stations" in entry["what"]
    assert "FRAME-UNVERIFIED" not in codes_of(confirmed.attrs)
    assert "FRAME-PLACES" in codes_of(contradicted.attrs)


@pytest.mark.parametrize("kind", [pd.DataFrame, pa.Table.from_pandas])
def test_known_positions_may_be_a_table_in_memory(simple, projected, kind):
    known = projected[["image", "lat_deg", "lon_deg"]].copy()
    known["height"] = projected["h_msl_m"]
    stations = projected.drop(columns=["lat_deg", "lon_deg"])
    with_positions = {**IN_UTM, "known_positions": kind(known)}

    alone = simple(stations=stations, orientation=IN_UTM)
    result = simple(stations=stations, orientation=with_positions)

    assert "FRAME-UNVERIFIED" in codes_of(alone.attrs)
    entry = entry_of(result.attrs, "FRAME-CONFIRMED")
    assert "known_positions of" in entry["what"]
    assert_frame_equal(result[CORRECTED], alone[CORRECTED])


def test_stations_in_degrees_may_have_angles_of_one_local_frame(simple, in_other_frame, baseline):
    table = baseline.station_rows()
    origin_from_ecef = enu_axes(46.9, 7.4)
    axes = []
    for latitude, longitude in zip(table["lat_deg"], table["lon_deg"], strict=True):
        axes.append(origin_from_ecef @ enu_axes(latitude, longitude).T)
    stations = in_other_frame(np.array(axes))
    origin = {"lat_deg": 46.9, "lon_deg": 7.4, "h_ellipsoid_m": 500.0}

    result = simple(stations=stations, orientation={"frame": {"enu": origin}})

    expected = simple()
    assert_allclose(result[CORRECTED], expected[CORRECTED], rtol=0.0, atol=5e-6)


def test_a_table_is_answered_by_its_kind(simple, frame):
    """Rows, order and the user's columns stay, and what was handed over is not touched."""
    table = frame.iloc[::-1].assign(note="mine", dx_ds_px=7.0)
    before = table.copy()

    result = simple(table)
    arrow = pa.Table.from_pandas(table, preserve_index=False)
    result_of_arrow = simple(arrow).to_pandas()

    assert_frame_equal(table, before)
    assert_index_equal(result.index, table.index)
    assert (result["image"] == table["image"]).all()
    assert (result["note"] == "mine").all()
    assert (result["dx_ds_px_input"] == 7.0).all()
    without_index = result.reset_index(drop=True)
    assert_frame_equal(result_of_arrow, without_index, check_exact=True)


def test_pixels_may_count_from_the_centre_of_the_first(simple, frame):
    """The same places in the image, counted from its corner and from the centre of a pixel."""
    camera = PINHOLE | {"pixel_origin": "corner"}  # of the principal point, the same in both
    cameras = dict.fromkeys(PINHOLES, camera)
    from_corner = simple(cameras=cameras)
    frame[["x_px", "y_px"]] -= 0.5
    from_centre = simple(cameras=cameras, observations={"pixel_origin": "centre"})
    assert_allclose(from_centre[CORRECTED] + 0.5, from_corner[CORRECTED], atol=1e-9)


def test_one_height_for_all(simple, frame):
    del frame["h_g_m"]
    low = simple(ground={"height": 100.0, "reference": "msl"})
    high = simple(ground={"height": 900.0, "reference": "msl"})
    assert (low["h_g_m"] == 100.0).all()
    assert (low["r_c_rad"] > high["r_c_rad"]).all()


def test_a_part_of_the_ground_leaves_the_other_defaults(simple, frame):
    usual = simple(frame)
    with_sigma = simple(frame, ground={"sigma_m": 5.0})

    assert_frame_equal(with_sigma[CORRECTED], usual[CORRECTED], check_exact=True)
    for result in (usual, with_sigma):
        default = entry_of(result.attrs, "TABLES-DEFAULT")
        assert default["kind"] == "note"
        assert "ground={'height': {'column': 'h_g_m'}, 'reference': 'msl'}" in default["what"]

    high = simple(frame, ground={"height": 900.0})
    stated = simple(frame, ground={"height": 900.0, "reference": "msl"})
    assert_frame_equal(high[CORRECTED], stated[CORRECTED], check_exact=True)
    assert "TABLES-DEFAULT" in codes_of(high.attrs)
    assert "TABLES-DEFAULT" not in codes_of(stated.attrs)


@pytest.mark.parametrize(
    "height",
    [
        {"column": "terrain_m"},
        {"dem": "dem.tif"},
        {"points": "points.csv", "columns": {}},
    ],
    ids=["column", "dem", "points"],
)
def test_heights_of_another_column_or_a_file_need_a_reference(simple, frame, height):
    frame["terrain_m"] = frame["h_g_m"]
    with refused("CONFIG-INVALID", says="ground.reference: is missing"):
        simple(frame, ground={"height": height})


def test_heights_of_another_column_are_used_as_stated(simple, frame):
    usual = simple(frame)
    frame["terrain_m"] = frame["h_g_m"]
    stated = simple(frame, ground={"height": {"column": "terrain_m"}, "reference": "msl"})
    assert_frame_equal(stated[CORRECTED], usual[CORRECTED], check_exact=True)


@pytest.fixture
def heights_that_differ(opk):
    """Stations with both heights, a kilometre apart."""
    stations = opk.rename(columns={"height": "h_msl_m"})
    return stations.assign(h_ellipsoid_m=stations["h_msl_m"] + 1000.0)


def test_of_two_columns_of_heights_that_of_the_stated_reference_is_used(
    simple, heights_that_differ
):
    orientation = {"heights": "ellipsoid", "angles": "omega_phi_kappa"}
    alone = heights_that_differ.drop(columns="h_msl_m")

    result = simple(stations=heights_that_differ, orientation=orientation)

    expected = simple(stations=alone, orientation=orientation)
    assert_frame_equal(result[CORRECTED], expected[CORRECTED], check_exact=True)


def test_a_stated_column_of_heights_needs_its_own_reference(refuse, heights_that_differ):
    columns = {"columns": {"height": "h_ellipsoid_m"}}
    refuse("CONFIG-INVALID", stations=heights_that_differ, orientation=columns)


def test_what_is_chosen_among_columns_is_said(simple, frame, opk):
    several = opk.rename(columns={"height": "h_msl_m"}).assign(
        h_ellipsoid_m=opk["height"] + 47.0,
        roll=0.0,
        pitch=0.0,
        yaw=0.0,
    )

    angles = {"angles": "omega_phi_kappa"}
    result = simple(frame, stations=several, orientation=angles, ground=GROUND)

    texts = []
    for entry in result.attrs["ledger"]:
        if entry["code"] == "TABLES-DEFAULT":
            texts.append(entry["what"])
    assert len(texts) == 2
    assert any("omega is used, but not roll" in text for text in texts)
    assert any("h_msl_m is used, but not h_ellipsoid_m" in text for text in texts)


def test_a_date_goes_before_the_times_and_says_so(simple, frame):
    orientation = HEIGHTS | {"date": "2025-06-12"}
    result = simple(frame, orientation=orientation, ground=GROUND)

    entry = entry_of(result.attrs, "TABLES-DEFAULT")
    assert entry["kind"] == "warning"
    assert "the column time_utc is not used" in entry["what"]


def test_an_orientation_beside_the_stations_of_a_run_is_not_used(baseline, frame, profile):
    result = correct(
        frame,
        baseline.stations(),
        profile,
        baseline.config["cameras"],
        orientation=HEIGHTS,
        mount=baseline.config["mount"],
        ground=GROUND,
    )

    entry = entry_of(result.attrs, "TABLES-DEFAULT")
    assert entry["kind"] == "warning"
    assert "heights of orientation is not used" in entry["what"]


@pytest.mark.parametrize(
    ("air", "text"),
    [("us1976", "the standard atmosphere us1976"), (US1976, "a profile")],
    ids=["name", "profile"],
)
def test_air_that_is_given_on_purpose_is_a_note(simple, frame, air, text):
    entry = entry_of(simple(frame, profile=air).attrs, "AIR-NOT-ADJUSTED")
    assert entry["kind"] == "note"
    assert entry["what"] == f"the air is {text}, as given to correct(): it is used as it is"


def test_sigmas_of_the_attitude_that_are_not_known_are_named(simple, frame, opk):
    with_tilt = HEIGHTS | {"sigma_tilt_deg": 0.02}

    result = simple(frame, orientation=with_tilt)

    what = entry_of(result.attrs, "SIGMA-UNKNOWN")["what"]
    assert "stations.orientation.sigma_yaw_deg" in what
    assert "sigma_tilt_deg" not in what
    assert "stations.orientation.sigma_height_m" in what


def test_another_method(simple):
    plane = simple(refraction={"method": "plane"})
    sphere = simple()
    assert (plane["r_c_rad"] != sphere["r_c_rad"]).any()


def test_a_profile_without_a_covariance(simple):
    result = simple(profile=US1976)
    # Gravity differs from that of the name.
    by_name = simple()
    assert_allclose(by_name["r_c_rad"], result["r_c_rad"], rtol=0.01)
    assert result["dx_ds_px"].isna().all()


def test_a_profile_with_a_covariance_and_a_series_of_it(simple, opk):
    timed = TimedProfile(None, US1976, pressure_alone(US1976, 0.004))

    result = simple(profile=timed)
    series = simple(profile=constant_series(timed, len(opk)))

    scale_sigma = result.attrs["uncertainty"]["scale_sigma"]
    assert scale_sigma == pytest.approx(0.004, rel=1e-3)
    for axis in "xy":
        shift = result[f"{axis}_corrected_px"] - result[f"{axis}_px"]
        assert_allclose(result[f"d{axis}_ds_px"], shift, rtol=5e-3, atol=1e-6)
    assert_frame_equal(series, result, check_exact=True)


def test_the_air_of_a_climatology(simple):
    result = simple(profile={"climatology": "auto"})
    assert 0.01 < result.attrs["uncertainty"]["scale_sigma"] < 0.3


def test_a_report_of_a_station_that_was_used_is_named(simple):
    metar = {
        "metar": "LSZH 120950Z 24006KT 9999 FEW045 17/10 Q1021 NOSIG",
        "h_msl_m": 432,
        "distance_km": 9,
    }
    result = simple(profile={"surface": [metar]})
    what = entry_of(result.attrs, "AIR-NO-BAROMETER")["what"]
    assert what.endswith("taken from surface report METAR LSZH (9 km from the flight)")
    used = set()
    for source in result.attrs["profile"]["sources"]:
        if source["used"]:
            used.add(source["source"])
    assert "surface report METAR LSZH" in used


def test_what_ends_a_run_with_code_3_is_a_warning(as_flown, frame):
    frame.loc[0, "image"] = "nadir_09999"

    with pytest.warns(UserWarning, match="no exposure|no_station") as warned:
        result = as_flown(frame)

    for warning in warned:
        assert str(warning.message).startswith("IMAGES-UNMATCHED:")
        assert warning.filename == __file__
    flagged = entry_of(result.attrs, "OBS-FLAGGED")
    assert flagged["kind"] == "note"
    assert flagged["count"] == 1
    first_rows = result.iloc[:2]
    assert first_rows["status"].tolist() == ["no_station", "ok"]
    assert first_rows["x_corrected_px"].isna().tolist() == [True, False]


@pytest.fixture
def refuse(simple):
    """Corrects with other arguments than usual, which must be refused with a code."""

    def check(code, **arguments):
        with refused(code) as refusal:
            simple(**arguments)
        assert "/" not in refusal.value.where  # no folder of which the caller knows nothing
        assert "line 1:" not in str(refusal.value)  # of a file that nobody wrote

    return check


def test_tables_that_a_run_refuses(refuse, frame, opk):
    refuse("OBS-COLUMN", table=frame.drop(columns="h_g_m"))
    refuse("OBS-EMPTY", table=frame.iloc[:0])
    refuse("ORIENTATION-REPEATED", stations=pd.concat([opk, opk]))
    refuse("ORIENTATION-COLUMN", stations=opk.drop(columns="phi"))


def test_known_positions_in_memory_are_refused_as_those_of_a_file(refuse, opk):
    known = pd.DataFrame(
        {
            "image": ["a"],
            "latitude": [47.0],
            "longitude": [8.0],
        }
    )
    orientation = {**HEIGHTS, "known_positions": known}
    refuse("ORIENTATION-COLUMN", orientation=orientation)


@pytest.mark.parametrize(
    ("column", "value", "code"),
    [
        ("kappa", 1e4, "ORIENTATION-UNIT"),
        ("latitude", 95.0, "ORIENTATION-POSITION"),
        ("camera", "left", "EVENTS-CAMERA"),
    ],
)
def test_values_of_stations_that_a_run_refuses(refuse, opk, column, value, code):
    opk[column] = value
    refuse(code, stations=opk)


@pytest.mark.parametrize(
    ("section", "value", "code"),
    [
        ("orientation", {}, "CONFIG-INVALID"),  # nothing says what the heights count from
        ("cameras", {"nadir": {"width_px": 14000}}, "CONFIG-INVALID"),
        ("grund", {"height": 100.0}, "CONFIG-UNKNOWN-KEY"),
        ("profile", "us1977", "CONFIG-INVALID"),
    ],
)
def test_sections_that_a_run_refuses(refuse, section, value, code):
    refuse(code, **{section: value})


def test_what_was_corrected_is_refused(as_flown, baseline):
    corrected = baseline.results()
    with refused("OBS-ALREADY-CORRECTED"):
        as_flown(corrected)
    with refused("OBS-ALREADY-CORRECTED"):
        as_flown(corrected.to_pandas())


def test_arguments_of_a_wrong_type(simple, profile):
    with pytest.raises(TypeError, match="observations must be a pandas DataFrame"):
        simple({"image": ["a"]})
    with pytest.raises(TypeError, match="atmosphere: tables in memory replace"):
        simple(atmosphere={"standard": "icao"})
    with pytest.raises(TypeError, match="cannot be a DataFrame"):
        simple(profile=profile.to_pandas())
    with pytest.raises(TypeError, match="by the name of a camera"):
        simple(cameras=PINHOLES["nadir"])


def test_exchanged_tables_are_said_to_be_so(simple, frame, opk):
    with pytest.raises(TypeError, match="seem exchanged"):
        simple(opk, stations=frame)


def test_profiles_of_other_stations(simple, profile):
    series = constant_series(TimedProfile(None, US1976), 3)
    with pytest.raises(ValueError, match="those of 3 stations"):
        simple(profile=series)

    column = profile.column_names.index("profile_id")
    names = pa.array(["other"] * len(profile))
    other = profile.set_column(column, "profile_id", names)
    with pytest.raises(ValueError, match="need the stations of their run"):
        simple(profile=pa.concat_tables([profile, other]))


def names_of_rows(frame):
    return frame.set_index("row " + frame.index.astype(str))


def rows_of_two_levels(frame):
    strip, number = divmod(frame.index, 7)
    return frame.set_index([strip.rename("strip"), number.rename("number")])


@pytest.mark.parametrize("change", [names_of_rows, rows_of_two_levels])
def test_a_frame_comes_back_with_its_index(simple, frame, change):
    """After the everyday filter, a column of the result stands beside the filtered frame."""
    filtered = frame[frame["x_px"] > frame["x_px"].median()]
    table = change(filtered)

    result = simple(table)

    assert_index_equal(result.index, table.index)
    assert (result["point"] == table["point"]).all()


def test_a_loaded_mission_is_run_from_the_folder_of_its_file(mission, tmp_path, monkeypatch):
    """Relative paths count from there, wherever the program runs."""
    assert mission.run().code == 0
    first = read_manifest(mission.output).run
    monkeypatch.chdir(tmp_path)
    loaded = unbend.load_mission(mission.file)
    plan = plan_of(loaded)

    outcome = unbend.run_mission(loaded)

    assert plan.output == mission.output
    assert plan.fingerprint == plan_of(mission.file).fingerprint
    assert outcome.repeated
    assert outcome.exit_code == 0
    second = read_manifest(mission.output).run
    assert second.mission_file_sha256 == first.mission_file_sha256
    assert repr(outcome) == f"<Outcome {outcome.name}: exit code 0, repeated, {mission.output}>"


def test_a_changed_copy_of_a_loaded_mission_is_another_run(mission):
    loaded = unbend.load_mission(mission.save())
    refraction = loaded.refraction.model_copy(update={"radius_m": 6_380_000.0})
    changed = loaded.model_copy(update={"refraction": refraction})

    plan = plan_of(loaded)
    changed_plan = plan_of(changed)

    assert changed_plan.inputs == plan.inputs
    assert changed_plan.fingerprint != plan.fingerprint
