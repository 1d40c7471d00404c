"""Trajectories of other programs: what was written is read, and what is wrong is told."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pyproj
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused, with_code
from tests.tables.checks import assert_within
from tests.tables.exports.export_runs import TO_ECEF, enu_axes
from tests.tables.imports.flights import (
    TOW,
    WEEK,
    Flight,
    assert_place,
    degrees_off,
    metres_off,
    ns_off,
    read,
    refusal_of,
    utc_text,
)
from unbend.tables.imports import TRAJECTORIES, format_of
from unbend.tables.imports.camera_events import read_mrk
from unbend.tables.imports.rtklib import read_pos
from unbend.tables.imports.sbet import read_sbet
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_trajectories import read_trajectory_csv

OF_WEEK = Stated("gpst", WEEK, heights="ellipsoid")
GPST = Stated("gpst", heights="ellipsoid")
LEAP_NS = 18 * 10**9

SIGMA_OF_HORIZONTAL = 1.0 / np.sqrt(2)  # of one axis, from that of both

# RTKLIB


def test_a_pos_file_is_read_to_its_last_digit(flight):
    channel, ledger = read(read_pos, flight.pos())

    assert_array_equal(channel.time_ns, flight.utc_ns)
    assert metres_off(channel, flight) < 2e-4
    sigma_m = np.hypot(0.011, 0.007) * SIGMA_OF_HORIZONTAL
    assert channel["sigma_h_m"][0] == pytest.approx(sigma_m)
    assert channel["sigma_v_m"][0] == 0.021
    assert "100.0 % fixed" in with_code(ledger, "TRAJECTORY-QUALITY")[0].what
    assert not ledger.has_losses


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_published_file_in_earth_centred_coordinates(flight, sign):
    """RTKPOST 2.4.3 on the EPN station WUTR, 2024-05-18; roots have the sign of the covariance."""
    text = (
        "% (x/y/z-ecef=WGS84,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)\n"
        "%  GPST                      x-ecef(m)      y-ecef(m)      z-ecef(m)   Q  ns   sdx(m)   "
        "sdy(m)   sdz(m)  sdxy(m)  sdyz(m)  sdzx(m) age(s)  ratio\n"
        "2024/05/18 00:00:00.000   3655334.3694   1403901.2189   5018038.3221   2   8   1.1580   "
        "0.6265   1.2637   0.5497   0.4747   0.9638   0.00    2.2\n"
        "2024/05/18 00:00:30.000   3655333.8112   1403901.0398   5018037.9883   1   8   0.0117   "
        "0.0063   0.0128   0.0056   0.0048   0.0097   0.00    2.6\n"
    )
    xy = sign * 0.0056
    path = flight.put("wutr.pos", text.replace("0.0056", f"{xy:.4f}"))

    channel, _ = read(read_pos, path)

    ecef = (3655333.8112, 1403901.0398, 5018037.9883)
    lon, lat, height = TO_ECEF.transform(*ecef, direction="INVERSE")
    assert_place(channel, 1, lat, lon)
    assert channel["h_ellipsoid_m"][1] == pytest.approx(height, abs=1e-5)
    # The covariance of the second row, turned to east, north, up.
    root = np.array(
        [
            [0.0117, xy, 0.0097],
            [xy, 0.0063, 0.0048],
            [0.0097, 0.0048, 0.0128],
        ]
    )
    covariance = root * np.abs(root)
    axes = enu_axes(lon, lat)
    east, north, up = np.diag(axes @ covariance @ axes.T)
    assert channel["sigma_v_m"][1] ** 2 == pytest.approx(up, rel=2e-6)
    assert channel["sigma_h_m"][1] ** 2 == pytest.approx((east + north) / 2)
    assert utc_text(channel, 1) == "2024-05-18T00:00:12.000000000"


def test_week_and_seconds_commas_and_minutes(flight):
    """Week and seconds of UTC with commas, degrees and minutes, heights above the sea."""
    path = flight.put(
        "a.pos",
        "% (lat/lon/height=WGS84/geodetic,Q=1:fix)\n"
        "%  UTC,latitude(d'\"),longitude(d'\"),height(m),Q,ns,sdn(m),sde(m),sdu(m)\n"
        "2417,302400.250,-47,18,30.6,-0,30,0.36,1453.1,1,9,0.1,0.2,0.3\n",
    )

    channel, _ = read(read_pos, path)

    lat = 47 + 18 / 60 + 30.6 / 3600
    lon = 0.5 + 0.36 / 3600
    assert_place(channel, 0, -lat, -lon)
    assert channel["h_msl_m"][0] == 1453.1
    assert channel["sigma_h_m"][0] ** 2 == pytest.approx((0.01 + 0.04) / 2)
    assert channel.time_ns[0] == flight.utc_ns[0] + LEAP_NS + 250_000_000


BASELINE = (
    "% ref pos   : {}  1500.0000\n"
    "% (e/n/u-baseline=WGS84,Q=1:fix,ns=# of satellites)\n"
    "%  JST  e-baseline(m) n-baseline(m) u-baseline(m)  Q  ns  sde(m)  sdn(m)  sdu(m)\n"
    "2026/05/06 21:00:00.000  1000.0000  -2000.0000  30.0000  1  9  0.2  0.1  0.3\n"
)


@pytest.mark.parametrize(
    "base",
    [
        "47.300000000    8.500000000",
        "47 18 00.00000     8 30 00.00000",
    ],
)
def test_baselines_start_at_the_base(flight, base):
    path = flight.put("a.pos", BASELINE.format(base))

    channel, _ = read(read_pos, path)

    start = np.array(TO_ECEF.transform(8.5, 47.3, 1500.0))
    end = start + [1000.0, -2000.0, 30.0] @ enu_axes(8.5, 47.3)
    lon, lat, height = TO_ECEF.transform(*end, direction="INVERSE")
    assert_place(channel, 0, lat, lon)
    assert channel["h_ellipsoid_m"][0] == pytest.approx(height, abs=1e-4)
    assert utc_text(channel, 0).startswith("2026-05-06T12:00:00.0")


@pytest.mark.parametrize(
    "base",
    [
        "",
        "47 75 00.0 8 30 00.0",
        "97.3 8.5",
        "47.3",
        "north east",
    ],
)
def test_baselines_without_a_base_are_refused(flight, base):
    path = flight.put("b.pos", BASELINE.format(base))
    assert "ref pos" in refusal_of(read_pos, path).what


def test_velocities_of_a_pos_file_point_down(flight):
    path = flight.put(
        "v.pos",
        "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix)\n"
        "%  GPST latitude(deg) longitude(deg) height(m) Q ns vn(m/s) ve(m/s) vu(m/s)\n"
        "2026/05/06 12:00:00.000 47.3 8.5 1500.0 1 9 3.0 4.0 -1.5\n",
    )

    channel, _ = read(read_pos, path)

    assert channel["v_north_m_s"].tolist() == [3.0]
    assert channel["v_east_m_s"].tolist() == [4.0]
    assert channel["v_down_m_s"].tolist() == [1.5]


def test_single_point_fixes_get_their_sigma_and_are_told(flight):
    quality = np.ones(flight.t.size, int)
    quality[100:130] = 5

    channel, ledger = read(read_pos, flight.pos(quality=quality))

    (single,) = with_code(ledger, "TRAJECTORY-SINGLE")
    assert single.kind == "warning"
    assert single.count == 30
    assert channel["sigma_h_m"][99] < 0.02 < 2.0 < channel["sigma_h_m"][100]
    assert channel["sigma_v_m"][129] >= 5.0 > channel["sigma_v_m"][130]


def test_damaged_and_repeated_rows_are_counted(flight):
    path = flight.pos()
    lines = path.read_text().splitlines(keepends=True)
    lines[10] = lines[10][:30] + "\n"
    lines[20] = lines[20].replace("2026/05/06", "2026/15/66")
    lines.append(lines[30])
    path.write_text("".join(lines))

    channel, ledger = read(read_pos, path)

    assert len(channel) == flight.t.size - 2
    damaged, repeated = with_code(ledger, "IMPORT-ROWS")
    assert damaged.kind == repeated.kind == "loss"
    assert damaged.count == 2
    assert repeated.count == 1


@pytest.mark.parametrize("is_head", [True, False])
def test_a_pos_file_without_its_header_or_its_rows_is_refused(flight, is_head):
    lines = flight.pos().read_text().splitlines(keepends=True)
    half = [line for line in lines if line.startswith("%") == is_head]
    path = flight.put("half.pos", "".join(half))
    assert refusal_of(read_pos, path).code == "IMPORT-FORMAT"


@pytest.mark.parametrize(
    ("reader", "write", "limit_ns"),
    [
        (read_pos, Flight.pos, 1),
        (read_mrk, Flight.mrk, 1000),
    ],
    ids=["pos", "mrk"],
)
def test_what_is_stated_against_a_file_holds_and_is_told(flight, reader, write, limit_ns):
    settings = Stated(time_system="utc", heights="msl")

    channel, ledger = read(reader, write(flight), settings)

    of_time, of_height = with_code(ledger, "IMPORT-CONTRADICTED")
    assert of_time.kind == of_height.kind == "warning"
    assert "time.system is gpst in its header and utc in the mission file" in of_time.what
    assert ns_off(channel, flight, LEAP_NS) < limit_ns
    assert channel["h_msl_m"] == pytest.approx(flight.height, abs=1e-3)


# SBET


@pytest.mark.parametrize("wander_deg", [0.0, 1.3, -40.0])
def test_an_sbet_and_its_sigmas_are_read(flight, wander_deg):
    settings = replace(OF_WEEK, accuracy=flight.smrmsg())

    channel, ledger = read(read_sbet, flight.sbet(wander_deg=wander_deg), settings)

    assert {entry.kind for entry in ledger} == {"note"}
    assert ns_off(channel, flight) < 100
    assert metres_off(channel, flight) < 1e-4
    assert degrees_off(channel, flight) < 1e-6
    assert channel["sigma_h_m"] == pytest.approx(0.05 * SIGMA_OF_HORIZONTAL)
    assert channel["sigma_v_m"] == pytest.approx(0.05)
    sigma_tilt_deg = 1.0 / 60.0 * SIGMA_OF_HORIZONTAL
    assert np.degrees(channel["sigma_tilt_rad"]) == pytest.approx(sigma_tilt_deg)
    assert np.degrees(channel["sigma_yaw_rad"]) == pytest.approx(0.05)
    velocity = [channel[f"v_{axis}_m_s"] for axis in ("north", "east", "down")]
    assert_within(velocity, flight.velocity.T, 1e-9)
    rates = [channel[f"rate_{axis}_rad_s"] for axis in "xyz"]
    assert_array_equal(rates, flight.sbet_rows()[:, 14:17].T)


def test_the_other_sign_of_the_wander_angle_is_recognised_by_the_velocities(flight):
    path = flight.sbet(wander_deg=5.0, sign=-1.0)

    channel, ledger = read(read_sbet, path, OF_WEEK)

    assert degrees_off(channel, flight) < 1e-6
    (wander,) = with_code(ledger, "IMPORT-WANDER")
    assert wander.kind == "warning"
    assert "plus wander angle" in wander.what


def test_without_velocities_the_course_decides_the_sign(flight):
    rows = flight.sbet_rows(wander_deg=30.0, sign=-1.0)
    rows[:, 4:7] = 0.0

    channel, ledger = read(read_sbet, flight.sbet(rows=rows), OF_WEEK)

    assert degrees_off(channel, flight) < 1e-6
    assert "v_north_m_s" not in channel.columns
    assert "heading and course" in with_code(ledger, "IMPORT-WANDER")[0].what


def test_where_neither_sign_fits_it_is_told(flight):
    rows = flight.sbet_rows(wander_deg=20.0)
    rows[:, 4:7] = 0.0
    rows[:, 9] += np.radians(90.0)

    _, ledger = read(read_sbet, flight.sbet(rows=rows), OF_WEEK)

    (wander,) = with_code(ledger, "IMPORT-WANDER")
    assert wander.kind == "warning"
    assert "do not decide" in wander.what


def test_velocities_and_rates_of_another_frame_are_left_out(flight):
    rows = flight.sbet_rows()
    rows[:, 4] = 40.0  # forward, as some programs write it
    rows[:, 5] = 0.0
    rows[:, 14:17] = 0.0

    channel, ledger = read(read_sbet, flight.sbet(rows=rows), OF_WEEK)

    assert with_code(ledger, "IMPORT-VELOCITY")[0].kind == "warning"
    assert "v_north_m_s" not in channel.columns
    assert "rate_x_rad_s" not in channel.columns


@pytest.mark.parametrize("days", [0, 3])
def test_the_week_is_that_of_the_log_and_midnight_of_saturday_is_passed(flight, days):
    rows = flight.sbet_rows()
    rows[:, 0] = (rows[:, 0] + 302_300.0) % 604_800.0  # the week ends after 100 s
    path = flight.sbet(rows=rows)
    later_ns = 302_300 * 10**9
    begin_ns, *_, end_ns = (flight.utc_ns + later_ns).tolist()
    begin_ns -= days * 86_400 * 10**9
    settings = replace(GPST, around_ns=(begin_ns, end_ns))

    channel, _ = read(read_sbet, path, settings)

    assert ns_off(channel, flight, later_ns) < 100
    assert refusal_of(read_sbet, path, GPST).code == "IMPORT-WEEK"


def test_seconds_of_the_week_in_utc_have_no_leap_seconds(flight):
    settings = replace(OF_WEEK, time_system="utc")
    channel, _ = read(read_sbet, flight.sbet(), settings)
    assert ns_off(channel, flight, LEAP_NS) < 100


def test_a_cut_sbet_is_a_loss_of_its_last_row(flight):
    path = flight.sbet()
    path.write_bytes(path.read_bytes()[:-40])

    channel, ledger = read(read_sbet, path, OF_WEEK)

    assert len(channel) == flight.t.size - 1
    (cut,) = with_code(ledger, "IMPORT-CUT")
    assert cut.kind == "loss"
    assert cut.count == 96


SPOILT_SBETS = {
    "big-endian": lambda rows: rows.astype(">f8").tobytes(),
    "1 row": lambda rows: rows.tobytes()[:200],
    "SBET": lambda rows: b"time,lat,lon\n" * 1000,
}


@pytest.mark.parametrize("words", SPOILT_SBETS)
def test_what_is_no_sbet_is_refused_with_what_it_is(flight, words):
    spoil = SPOILT_SBETS[words]
    path = flight.put("bad.out", spoil(flight.sbet_rows()))
    error = refusal_of(read_sbet, path, OF_WEEK)
    assert error.code == "IMPORT-FORMAT"
    assert words in error.what


@pytest.mark.parametrize(
    ("column", "change", "code", "words"),
    [
        (0, lambda seconds: 7.0, "IMPORT-FORMAT", "time"),
        (1, np.degrees, "IMPORT-FORMAT", "degrees"),
        (2, lambda longitude: 2.0 * longitude, "IMPORT-SPEED", "columns are different"),
        (3, lambda height: 1e6, "IMPORT-FORMAT", "heights"),
        (9, np.degrees, "IMPORT-FORMAT", "heading"),
        (12, lambda acceleration: np.nan, "IMPORT-FORMAT", "numbers"),
    ],
)
def test_columns_that_no_sbet_has_are_refused(flight, column, change, code, words):
    rows = flight.sbet_rows()
    rows[:, column] = change(rows[:, column])
    error = refusal_of(read_sbet, flight.sbet(rows=rows), OF_WEEK)
    assert error.code == code
    assert words in error.what


def test_sigmas_are_no_sbet_and_those_of_another_flight_and_none_are_refused(flight):
    path = flight.sbet()
    assert "smrmsg" in refusal_of(read_sbet, flight.smrmsg(), OF_WEEK).what

    later = flight.at_times(flight.t + 5000.0).smrmsg()
    with_later_sigmas = replace(OF_WEEK, accuracy=later)
    assert "seconds of the week" in refusal_of(read_sbet, path, with_later_sigmas).what

    with_itself = replace(OF_WEEK, accuracy=path)
    assert "not a smrmsg" in refusal_of(read_sbet, path, with_itself).what


@pytest.mark.parametrize(
    "settings",
    [
        Stated(heights="msl"),
        Stated("gpst", WEEK),
    ],
)
def test_what_an_sbet_does_not_say_must_be_stated(flight, settings):
    assert refusal_of(read_sbet, flight.sbet(), settings).code == "IMPORT-UNSTATED"


# CSV

PLACES = {"time": "t", "latitude": "lat", "longitude": "lon", "height": "h"}
ANGLES = {"roll": "r", "pitch": "p", "yaw": "y"}
OF_PLACES = replace(GPST, columns=PLACES)
OF_ANGLES = replace(GPST, columns=PLACES | ANGLES)


def gps_times(flight):
    return [flight.gpst(k) for k in range(flight.t.size)]


def write_csv(flight, header, *columns, times=None):
    """A CSV of times, without any those of the flight in GPS time, and numbers."""
    rows = [header]
    for time, *numbers in zip(times or gps_times(flight), *columns, strict=True):
        words = [f"{number:.9f}" for number in numbers]
        rows.append(",".join([time, *words]))
    return flight.put("t.csv", "\n".join(rows) + "\n")


def utc_dates(flight):
    return [f"{np.datetime64(int(time), 'ns')}Z" for time in flight.utc_ns]


def seconds_of_week(flight):
    return [f"{TOW + t:.3f}" for t in flight.t]


def seconds_since_1980(flight):
    return [f"{WEEK * 604_800 + TOW + t:.3f}" for t in flight.t]


def seconds_since_1970(flight):
    return [f"{time / 1e9:.3f}" for time in flight.utc_ns]


UTC = Stated("utc", heights="ellipsoid")


@pytest.mark.parametrize(
    ("times", "settings", "mark"),
    [
        (gps_times, GPST, ","),
        (utc_dates, UTC, ";"),
        (seconds_of_week, OF_WEEK, "\t"),
        (seconds_since_1980, GPST, ","),
        (seconds_since_1970, UTC, ";"),
    ],
)
def test_a_csv_has_its_times_in_any_of_five_forms(flight, times, settings, mark):
    path = write_csv(flight, "t,lon,lat,h", *flight.places, times=times(flight))
    path.write_text(path.read_text().replace(",", mark))

    channel, _ = read(read_trajectory_csv, path, replace(settings, columns=PLACES))

    assert ns_off(channel, flight) < 1000
    assert metres_off(channel, flight) < 2e-4


def assert_alone_unknown(row, flight, channel, ledger):
    """The other rows have their times."""
    known_ns = np.delete(flight.utc_ns, row)
    assert np.abs(channel.time_ns - known_ns).max() < 1000
    assert [entry.count for entry in with_code(ledger, "IMPORT-ROWS")] == [1]


@pytest.mark.parametrize(
    ("times", "settings"),
    [
        (seconds_of_week, OF_WEEK),
        (seconds_since_1980, GPST),
        (seconds_since_1970, UTC),
    ],
)
def test_a_time_of_minus_one_is_unknown_and_moves_no_other(flight, times, settings):
    """From Wednesday noon on, the step back to -1 looks as if a new week began."""
    flight = flight.at_times(flight.t + 1000.0)
    stated_times = times(flight)
    unknown_row = 1
    stated_times[unknown_row] = "-1"
    path = write_csv(flight, "t,lon,lat,h", *flight.places, times=stated_times)

    channel, ledger = read(read_trajectory_csv, path, replace(settings, columns=PLACES))

    assert_alone_unknown(unknown_row, flight, channel, ledger)


@pytest.mark.parametrize(
    ("week", "seconds"),
    [("-1", "302400"), (f"{WEEK}", "-1"), ("-1", "-1"), ("520", "302400")],
    ids=["no week", "no seconds", "neither", "a week of 1989, or one modulo 1024"],
)
def test_a_time_that_no_survey_has_is_unknown(flight, week, seconds):
    rows = [
        f"{WEEK},{time},{flight.lon[k]},{flight.lat[k]},{flight.height[k]}"
        for k, time in enumerate(seconds_of_week(flight))
    ]
    unknown_row = 1
    place = rows[unknown_row].split(",", 2)[2]
    rows[unknown_row] = f"{week},{seconds},{place}"
    path = flight.put("t.csv", "\n".join(["w,t,lon,lat,h", *rows]) + "\n")

    settings = replace(GPST, columns=PLACES | {"week": "w"})
    channel, ledger = read(read_trajectory_csv, path, settings)

    assert_alone_unknown(unknown_row, flight, channel, ledger)


@pytest.mark.parametrize(
    ("unit", "circle", "order"),
    [
        ("deg", 360.0, "ZYX"),
        ("rad", 2 * np.pi, "XYZ"),
        ("grad", 400.0, "YXZ"),
    ],
)
def test_angles_are_read_in_their_unit_and_order(flight, unit, circle, order):
    turns = flight.attitude.as_euler(order) / (2 * np.pi)
    angles = [turns[:, order.index(axis)] * circle for axis in "XYZ"]
    path = write_csv(flight, "t,lon,lat,h,r,p,y", *flight.places, *angles)
    settings = replace(OF_ANGLES, angle_unit=unit, angle_order=order)

    channel, _ = read(read_trajectory_csv, path, settings)

    assert degrees_off(channel, flight) < 1e-6


def test_grads_are_more_than_a_circle_of_degrees(flight):
    yaw_grad = np.degrees(flight.yaw) % 360.0 / 0.9
    level = np.zeros(yaw_grad.size)
    path = write_csv(flight, "t,lon,lat,h,r,p,y", *flight.places, level, level, yaw_grad)

    error = refusal_of(read_trajectory_csv, path, OF_ANGLES)
    assert error.code == "IMPORT-ANGLES"
    assert "360 deg" in error.what


def test_a_projection_and_its_north(flight):
    """Lambert-93 far from its meridian: grid north is 4 degrees off, by PROJ's own geodesic."""
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:2154", always_xy=True)
    x, y = to_grid.transform(flight.lon, flight.lat)
    below = to_grid.transform(x, y - 5.0, direction="INVERSE")
    above = to_grid.transform(x, y + 5.0, direction="INVERSE")
    turn_deg, *_ = pyproj.Geod(ellps="GRS80").inv(*below, *above)
    north, east, _ = flight.velocity.T
    in_grid = (north + 1j * east) * np.exp(-1j * np.radians(turn_deg))
    columns = {
        "time": gps_times(flight),
        "x": x,
        "y": y,
        "z": flight.height,
        "roll": np.degrees(flight.roll),
        "pitch": np.degrees(flight.pitch),
        "yaw": (np.degrees(flight.yaw) - turn_deg) % 360.0,
        "v_north_m_s": in_grid.real,
        "v_east_m_s": in_grid.imag,
    }
    table = pd.DataFrame(columns).add_suffix("_of_user")
    path = flight.folder / "t.csv"
    table.to_csv(path, index=False, float_format="%.9f")
    names = dict(zip(columns, table.columns, strict=True))
    settings = replace(GPST, columns=names, crs="EPSG:2154")

    channel, ledger = read(read_trajectory_csv, path, settings)

    assert metres_off(channel, flight) < 2e-4
    assert degrees_off(channel, flight) < 1e-4
    assert_within(channel["v_north_m_s"], north, 1e-4)
    assert_within(channel["v_east_m_s"], east, 1e-4)
    assert with_code(ledger, "CRS-DATUM")
    unstated = replace(settings, heights=None)
    assert refusal_of(read_trajectory_csv, path, unstated).code == "IMPORT-UNSTATED"


def test_earth_centred_coordinates(flight):
    path = write_csv(flight, "t,x,y,z", *TO_ECEF.transform(*flight.places))
    columns = {"time": "t", "x": "x", "y": "y", "z": "z"}

    channel, _ = read(read_trajectory_csv, path, Stated("gpst", columns=columns))

    assert metres_off(channel, flight) < 3e-4
    wrong = Stated("gpst", columns=columns | {"z": "x"})
    assert refusal_of(read_trajectory_csv, path, wrong).code == "IMPORT-RANGE"


NOON = "2026-05-06T12:00:00"


@pytest.mark.parametrize(
    ("row", "settings", "code"),
    [
        pytest.param(
            f"{NOON},35.7,139.7,100",
            replace(GPST, columns=PLACES | {"height": "alt"}),
            "IMPORT-COLUMN",
            id="column missing",
        ),
        pytest.param(
            f"{NOON},35.7,139.7,100",
            GPST,
            "IMPORT-FORMAT",
            id="no columns",
        ),
        pytest.param(
            f"{NOON},139.7,35.7,100",
            OF_PLACES,
            "IMPORT-RANGE",
            id="swapped",
        ),
        pytest.param(
            f"{NOON}Z,35.7,139.7,100",
            OF_PLACES,
            "IMPORT-TIME-SYSTEM",
            id="zone",
        ),
        pytest.param(
            f"{NOON}Z,35.7,139.7,100",
            replace(OF_PLACES, time_system=None),
            "IMPORT-UNSTATED",
            id="no system",
        ),
        pytest.param(
            "never,35.7,139.7,100",
            replace(OF_PLACES, time_system="utc"),
            "IMPORT-FORMAT",
            id="no time",
        ),
    ],
)
def test_a_csv_that_cannot_be_read_is_refused(flight, row, settings, code):
    path = flight.put("t.csv", f"t,lat,lon,h\n{row}\n")
    assert refusal_of(read_trajectory_csv, path, settings).code == code


def test_the_worst_latitude_is_said_with_its_sign(flight):
    path = flight.put("t.csv", f"t,lat,lon,h\n{NOON},139.7,35.7,100\n{NOON},-170.25,35.7,100\n")
    error = refusal_of(read_trajectory_csv, path, OF_PLACES)
    assert error.values["worst_deg"] == pytest.approx(-170.25)


def test_a_format_is_known_by_its_name_or_its_ending(tmp_path):
    assert format_of(TRAJECTORIES, tmp_path / "a.POS", None) == "rtklib"
    assert format_of(TRAJECTORIES, tmp_path / "a.xyz", "csv") == "csv"
    with refused("IMPORT-FORMAT"):
        format_of(TRAJECTORIES, tmp_path / "a.xyz", None)
