"""Trajectories and camera events from elsewhere: what becomes of the stations.

Truth is that of the simulated flight; the files are written from it, as other programs do.
"""

import re

import numpy as np
import pandas as pd
import pytest

from tests.helpers import channel, refused, with_code
from tests.stages.flown_files import (
    CAMERAS,
    NEAR_M,
    assert_true,
    errors,
    gps_time,
    offsets,
)
from tests.stages.mistaken import evaluated
from tests.stages.other_logs import message_of, read_folder
from unbend.messages import Ledger
from unbend.simulate.flight import UNDULATION_M
from unbend.stages.flight_log import with_trajectory

approx = pytest.approx


OFFSET_MM = (1500, -700, 300)
MOVED_M = [1.5, -0.7, -0.3]


@pytest.fixture
def by_trajectory(mission):
    """Reads the mission with a section of a trajectory."""

    def read(section):
        mission.config["stations"] = {"trajectory": section}
        return read_folder(mission)

    return read


def test_a_trajectory_replaces_the_positions_of_the_log(mission, by_trajectory, files):
    """Of a trajectory 3 m north of the true one and 2 m above, the stations are too."""
    before = errors(read_folder(mission), files)

    prepared = by_trajectory(files.pos(shift_m=3.0, up_m=2.0))

    after = errors(prepared, files)
    assert after.place_m == approx(3.0, abs=NEAR_M)
    assert after.height_m == approx(2.0, abs=0.05)
    assert after.attitude_deg == approx(before.attitude_deg, abs=0.02)
    assert prepared.flight.roles["position"].name == "flight.pos"
    assert prepared.flight.air_roles["height"].name != "flight.pos"
    # The exposures are on the clock of the log, whose UTC is good to 15 ms, at 49.5 m/s.
    expected_m = np.hypot(0.0092, 0.015 * 49.5)
    sigma_m = prepared.stations.sigma_horizontal_m
    assert sigma_m[0] == approx(expected_m, rel=0.01)
    assert "position of" in message_of(prepared, "TRAJECTORY-REPLACES").what
    assert message_of(prepared, "TRAJECTORY-AGREES").kind == "note"


def test_an_sbet_replaces_all_and_its_week_is_that_of_the_log(by_trajectory, files):
    assert_true(by_trajectory(files.sbet()), files)


def test_a_csv_of_heights_above_the_sea_and_angles(by_trajectory, files):
    assert_true(by_trajectory(files.csv(files.table())), files)


PLACES = {"lat_rad": 0.8, "lon_rad": 0.1, "h_msl_m": 1.0}
TRAJECTORY = channel("flight.pos", np.arange(10), **PLACES)
GPS = channel("GPS", np.arange(10), **PLACES)


@pytest.mark.parametrize(
    ("logged", "height", "roles_of_trajectory"),
    [
        ({}, "flight.pos", "position, height"),
        ({"height": GPS}, "GPS", "position"),
    ],
)
def test_heights_of_the_trajectory_are_named_where_the_log_has_none(
    logged, height, roles_of_trajectory
):
    """Positions alone are to be replaced: heights come along only where the log has none."""
    ledger = Ledger()
    roles = with_trajectory(logged, TRAJECTORY, ("position",), ledger)
    assert roles["position"].name == "flight.pos"
    assert roles["height"].name == height
    (entry,) = ledger
    assert entry.what == f"flight.pos gives {roles_of_trajectory}, which the log does not have"


def test_attitude_alone_leaves_the_positions_of_the_log(mission, by_trajectory, files):
    before = errors(read_folder(mission), files)

    prepared = by_trajectory(files.sbet() | {"replaces": ["attitude"]})

    after = errors(prepared, files)
    assert after.place_m == approx(before.place_m, abs=0.01)
    assert after.height_m == approx(before.height_m, abs=0.05)
    assert after.attitude_deg < 0.02
    assert prepared.flight.roles["position"].name != "sbet.out"


def test_the_lever_arm_of_the_trajectory_adds_to_that_of_the_mount(mission, by_trajectory, files):
    """The mounts say where the cameras are from a point 2 m behind the trajectory's."""
    for mount in mission.config["mount"].values():
        forward, right, down = mount["lever_arm_m"]
        mount["lever_arm_m"] = [forward + 2.0, right, down]
    sbet = files.sbet()
    sbet["lever_arm_m"] = [-2.0, 0.0, 0.0]
    prepared = by_trajectory(sbet)
    assert errors(prepared, files).place_m < NEAR_M

    sbet["lever_arm_m"] = [2.0, 0.0, 0.0]
    wrong = by_trajectory(sbet)
    assert errors(wrong, files).place_m == approx(4.0, abs=NEAR_M)


def test_a_gap_of_the_trajectory_is_no_station_though_the_log_has_one(by_trajectory, files):
    files.t = files.t[~files.near_second_exposure(5.0)]
    prepared = by_trajectory(files.pos())
    status = prepared.stations.status.tolist()
    assert status.count("in_gap") == 2
    assert status.count("ok") == len(status) - 2
    assert prepared.ledger.has_losses


def test_single_fixes_make_the_sigma_of_their_stations(by_trajectory, files):
    quality = np.where(files.near_second_exposure(3.0), 5, 1)
    prepared = by_trajectory(files.pos(quality=quality))
    sigma_m = prepared.stations.sigma_horizontal_m
    assert (sigma_m > 2.0).sum() == 2
    # The others have what 15 ms of the clock are at 49.5 m/s.
    assert (sigma_m < 0.75).sum() == sigma_m.size - 2
    assert message_of(prepared, "TRAJECTORY-SINGLE").kind == "warning"


def test_a_stretch_of_a_trajectory_that_is_off_makes_its_stations_suspect(by_trajectory, files):
    shift_m = np.where(files.near_second_exposure(4.0), 40.0, 0.0)
    prepared = by_trajectory(files.pos(shift_m=shift_m))
    suspect = prepared.stations.status == "suspect"
    assert suspect.sum() == 2
    assert prepared.stations.suspect_m[suspect] == approx(40.0, abs=2.0)
    assert with_code(prepared.ledger, "STATIONS-SUSPECT")[0].kind == "loss"


@pytest.mark.parametrize(
    ("mistake", "code", "words"),
    [
        ({"late_s": 7200.0}, "TRAJECTORY-TIME", "time zone"),
        ({"late_s": 86_400.0}, "TRAJECTORY-OVERLAP", "covers"),
        ({"shift_m": 5_000.0}, "TRAJECTORY-PLACE", "4999 m"),
        ({"up_m": -UNDULATION_M}, "TRAJECTORY-HEIGHT", "msl"),
    ],
)
def test_a_trajectory_that_cannot_be_of_the_flight_is_refused(
    by_trajectory, files, mistake, code, words
):
    with refused(code, what=words):
        by_trajectory(files.pos(**mistake))


@pytest.mark.parametrize(
    ("difference", "code", "kind"),
    [
        ({"shift_m": 10.0}, "TRAJECTORY-AGREES", "warning"),
        ({"shift_m": 50.0}, "TRAJECTORY-AGREES", "loss"),
        ({"up_m": 15.0}, "TRAJECTORY-HEIGHT-AGREES", "warning"),
        ({"late_s": 0.2}, "TRAJECTORY-AGREES", "warning"),
    ],
)
def test_what_differs_more_than_autopilots_err_is_told(
    by_trajectory, files, difference, code, kind
):
    prepared = by_trajectory(files.pos(**difference))
    assert with_code(prepared.ledger, code)[0].kind == kind


def test_the_yaw_of_an_sbet_against_the_log(by_trajectory, files):
    prepared = by_trajectory(files.sbet(yaw_deg=15.0))
    message = message_of(prepared, "TRAJECTORY-ANGLES-AGREE")
    assert message.kind == "warning"
    tilt, yaw = re.findall(r"([-+]?[0-9.]+) deg", message.what)
    assert float(tilt) < 0.5
    assert float(yaw) == approx(15.0, abs=1.0)


@pytest.mark.parametrize(
    ("mistake", "code", "words"),
    [
        (
            "first = latitude; latitude = longitude; longitude = first; drop first",
            "TRAJECTORY-PLACE",
            "exchanged",
        ),
        (
            "latitude = latitude * 0.0174532925; longitude = longitude * 0.0174532925",
            "TRAJECTORY-PLACE",
            "radians",
        ),
        (
            "longitude = -longitude",
            "TRAJECTORY-PLACE",
            "sign",
        ),
        (
            "yaw = (540 - yaw) % 360 - 180",  # of the other sign, between -180 and 180
            "TRAJECTORY-ANGLES",
            "yaw",
        ),
        (
            "roll = roll * 0.0174532925; pitch = pitch * 0.0174532925; yaw = yaw * 0.0174532925",
            "TRAJECTORY-ANGLES",
            "radians",
        ),
        (
            "yaw = (630 - yaw) % 360 - 180",  # from the east to the north
            "TRAJECTORY-ANGLES",
            "east to north",
        ),
    ],
    ids=[
        "exchanged",
        "place in radians",
        "longitude",
        "yaw",
        "angles in radians",
        "from east",
    ],
)
def test_mistakes_about_columns_are_recognised(by_trajectory, files, mistake, code, words):
    with refused(code, what=words):
        by_trajectory(files.csv(evaluated(files.table(), mistake)))


@pytest.mark.parametrize("order", ["XYZ", "YXZ"])
def test_another_order_of_the_angles_is_recognised(by_trajectory, files, order):
    """The file has rotations about z, y and x in this order."""
    section = files.csv(files.table())
    section["angle_order"] = order
    with refused("TRAJECTORY-ANGLES") as refusal:
        by_trajectory(section)
    assert refusal.value.remedy == "state angle_order: ZYX"


def test_grads_that_do_not_pass_the_circle_are_recognised_by_the_log(by_trajectory, files):
    """As a file of a flight to the south has them: all below 360."""
    table = files.table()
    table[["roll", "pitch", "yaw"]] /= 0.9
    with refused("TRAJECTORY-ANGLES", says="grads"):
        by_trajectory(files.csv(table[table["yaw"] < 360.0]))

    section = files.csv(table)
    section["angle_unit"] = "grad"
    assert_true(by_trajectory(section), files)


def test_an_order_with_one_axis_twice_is_refused(by_trajectory, files):
    with refused("CONFIG-INVALID", says="angle_order"):
        by_trajectory(files.pos() | {"angle_order": "ZYZ"})


def test_attitudes_of_a_file_of_positions_are_refused(by_trajectory, files):
    with refused("TRAJECTORY-REPLACES"):
        by_trajectory(files.pos() | {"replaces": ["attitude"]})


def test_inputs_are_hashed_and_stand_in_the_manifest(mission, files):
    mission.config["stations"] = {"trajectory": files.pos()}

    manifest = mission.run_to_manifest()

    roles = [item["role"] for item in manifest["inputs"]]
    assert "trajectory" in roles
    assert manifest["channels"]["position"] == "flight.pos"
    files.pos(up_m=0.5)
    assert mission.run_to_manifest()["fingerprint"] != manifest["fingerprint"]


# Camera events with positions


def with_events(mission, files, **changed):
    """The mission with the exposures of an MRK for each camera; the sections of the cameras."""
    sources = {}
    for camera in CAMERAS:
        files.mrk(camera)
        source = {"path": camera + ".MRK", "image": camera + "_{index:05d}"}
        sources[camera] = source | changed
    mission.config["events"] = {"positions": sources}
    return sources


def nadir_offsets(prepared, files):
    """North, east, up [m] of the stations of the nadir camera from the truth."""
    stations = prepared.stations
    is_nadir = (stations.camera == "nadir") & stations.ok
    nadir = stations.rows(np.flatnonzero(is_nadir))
    return offsets(nadir, files.stations_of("nadir"))


def test_positions_of_an_mrk_are_those_of_the_camera(mission, files):
    with_events(mission, files)
    prepared = read_folder(mission)
    assert np.abs(nadir_offsets(prepared, files)).max() < 0.002
    messages = with_code(prepared.ledger, "EVENTS-POSITIONS")
    assert [message.what for message in messages].count(
        "nadir.MRK has the times of the exposures of nadir, and the positions of the camera"
    )
    stations = prepared.stations
    assert stations.image[stations.ok][0] == "nadir_00001"


def test_events_of_rtklib_are_of_the_antenna_from_which_the_mount_counts(mission, files):
    sources = with_events(mission, files)
    for source in sources.values():
        source["path"] = "flight.pos"
    files.t = np.sort(files.flight.exposure_s)
    files.pos()
    error = errors(read_folder(mission), files)
    assert error.place_m < 0.01
    assert error.height_m < 0.01


def test_an_antenna_is_moved_to_the_camera_by_the_offsets_of_the_mrk(mission, files):
    """At each exposure by its own."""
    with_events(mission, files, point="antenna")
    files.mrk("nadir", offset_mm=[OFFSET_MM, (-400, 900, 0), (0, 0, -250)])
    moved = nadir_offsets(read_folder(mission), files)
    expected = [MOVED_M, [-0.4, 0.9, 0.0], [0.0, 0.0, 0.25]]
    np.testing.assert_allclose(moved, expected, atol=0.01)


def test_ppk_of_the_antenna_with_times_and_offsets_of_the_mrk(mission, by_trajectory, files):
    """The trajectory is that of the mounts' point: the offsets replace their lever arm."""
    with_events(mission, files, times_only=True)
    files.mrk("nadir", offset_mm=OFFSET_MM)
    antenna = files.pos() | {"point": "antenna"}
    by_mount = nadir_offsets(by_trajectory(antenna), files)
    assert np.abs(by_mount).max() < NEAR_M

    antenna["lever_arm_m"] = "from_events"
    by_events = nadir_offsets(by_trajectory(antenna), files)
    # The lever arm of the mount is 0.7 m long, and not added.
    assert 0.3 < np.abs(by_events - MOVED_M).max() < 0.9


def test_offsets_of_the_antenna_must_be_there(mission, by_trajectory, files):
    with_events(mission, files, path="flight.pos", times_only=True)
    section = files.pos()
    section["point"] = "antenna"
    section["lever_arm_m"] = "from_events"
    with refused("EVENTS-OFFSETS"):
        by_trajectory(section)


def test_images_by_name_need_a_file_with_names(mission, files):
    with_events(mission, files, image="{name}")
    with refused("EVENTS-NAMELESS"):
        read_folder(mission)


# The second of three exposures of the nadir camera has no row.
LOST = [0, 2]


def test_lost_numbers_of_an_mrk_never_shift_images(mission, files):
    with_events(mission, files)
    files.mrk("nadir", rows=LOST)
    prepared = read_folder(mission)
    assert message_of(prepared, "EVENTS-LOST").kind == "loss"
    assert message_of(prepared, "IMAGES-UNMATCHED").count == 1
    assert errors(prepared, files).place_m < 0.002
    stations = prepared.stations
    assert "nadir_00002" not in stations.image[stations.ok]


def counted_images(files, sources):
    files.mrk("nadir", rows=LOST)
    sources["nadir"]["image"] = "nadir_{n:05d}"


def rows_counted_anew(files, sources):
    files.mrk("nadir", rows=LOST, numbers=[1, 2])


def rows_without_numbers(files, sources):
    _, seconds = gps_time(files.stations_of("nadir")["time_utc"].iloc[LOST])
    _, start = gps_time(pd.Series([files.start]))
    files.t = seconds.to_numpy() - start[0]
    files.pos()
    sources["nadir"]["path"] = "flight.pos"


@pytest.mark.parametrize("lose_a_row", [counted_images, rows_counted_anew, rows_without_numbers])
def test_rows_are_no_numbers_of_images_where_nothing_shows_the_loss(mission, files, lose_a_row):
    lose_a_row(files, with_events(mission, files))
    with refused("EVENTS-AMBIGUOUS", what="some events were lost"):
        read_folder(mission)


def test_rows_against_the_order_of_time_are_refused_or_told(mission, files):
    sources = with_events(mission, files)
    files.mrk("nadir", numbers=[3, 2, 1])
    with refused("EVENTS-ORDER"):
        read_folder(mission)
    sources["nadir"]["image"] = "nadir_{n:05d}"
    assert with_code(read_folder(mission).ledger, "EVENTS-ORDER")[0].kind == "warning"
