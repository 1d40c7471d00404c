"""Trajectories of other programs: what was written is read, and what is wrong is told."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.imports import TRAJECTORIES, format_of
from unbend.tables.imports.rtklib import read_pos
from unbend.tables.imports.sbet import read_sbet
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_trajectories import read_trajectory_csv

GPST = Stated(time_system="gpst", heights="ellipsoid")
WEEK = 2417


def metres(channel, flight, column="h_ellipsoid_m"):
    """Largest difference in place and height [m] from the truth."""
    north = (channel["lat_rad"] - np.radians(flight.lat)) * 6.37e6
    east = (channel["lon_rad"] - np.radians(flight.lon)) * 6.38e6 * np.cos(np.radians(flight.lat))
    up = channel[column] - flight.height
    return max(np.abs(north).max(), np.abs(east).max(), np.abs(up).max())


def degrees(channel, flight):
    """Largest angle between the attitudes [deg]."""
    read = Rotation.from_quat(np.stack([channel[f"q_{a}"] for a in "xyzw"], axis=1))
    return np.degrees((read.inv() * flight.attitude).magnitude().max())


def entries(ledger, code):
    return [entry for entry in ledger if entry.code == code]


def refused(reader, path, stated=GPST):
    with pytest.raises(InputError) as caught:
        reader(path, stated, Ledger())
    assert caught.value.remedy
    return caught.value


# RTKLIB


def test_a_pos_file_is_read_to_its_last_digit(flight):
    ledger = Ledger()
    channel = read_pos(flight.pos(), Stated(), ledger)
    assert np.array_equal(channel.time_ns, flight.utc_ns)
    assert metres(channel, flight) < 2e-4
    assert channel["sigma_h_m"][0] == pytest.approx(np.hypot(0.011, 0.007) / np.sqrt(2))
    assert channel["sigma_v_m"][0] == 0.021
    assert "100.0 % fixed" in entries(ledger, "TRAJECTORY-QUALITY")[0].what
    assert not ledger.has_losses


def test_a_published_file_in_earth_centred_coordinates(flight):
    """RTKPOST 2.4.3 on the EPN station WUTR, 2024-05-18."""
    path = flight.put(
        "wutr.pos",
        "% (x/y/z-ecef=WGS84,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)\n"
        "%  GPST                      x-ecef(m)      y-ecef(m)      z-ecef(m)   Q  ns   sdx(m)   "
        "sdy(m)   sdz(m)  sdxy(m)  sdyz(m)  sdzx(m) age(s)  ratio\n"
        "2024/05/18 00:00:00.000   3655334.3694   1403901.2189   5018038.3221   2   8   1.1580   "
        "0.6265   1.2637   0.5497   0.4747   0.9638   0.00    2.2\n"
        "2024/05/18 00:00:30.000   3655333.8112   1403901.0398   5018037.9883   1   8   0.0117   "
        "0.0063   0.0128   0.0056   0.0048   0.0097   0.00    2.6\n",
    )
    ledger = Ledger()
    channel = read_pos(path, Stated(), ledger)
    import pyproj

    lon, lat, height = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(
        3655333.8112, 1403901.0398, 5018037.9883
    )
    assert np.degrees(channel["lat_rad"][1]) == pytest.approx(lat, abs=1e-10)
    assert np.degrees(channel["lon_rad"][1]) == pytest.approx(lon, abs=1e-10)
    assert channel["h_ellipsoid_m"][1] == pytest.approx(height, abs=1e-5)
    # The covariance of the second row, turned to east, north, up by hand.
    p, e = np.radians([lat, lon])
    axes = np.array(
        [
            [-np.sin(e), np.cos(e), 0.0],
            [-np.sin(p) * np.cos(e), -np.sin(p) * np.sin(e), np.cos(p)],
            [np.cos(p) * np.cos(e), np.cos(p) * np.sin(e), np.sin(p)],
        ]
    )
    root = np.array([[0.0117, 0.0056, 0.0097], [0.0056, 0.0063, 0.0048], [0.0097, 0.0048, 0.0128]])
    local = axes @ root**2 @ axes.T
    assert channel["sigma_v_m"][1] == pytest.approx(np.sqrt(local[2, 2]), rel=1e-6)
    assert channel["sigma_h_m"][1] == pytest.approx(np.sqrt((local[0, 0] + local[1, 1]) / 2))
    assert str(np.datetime64(int(channel.time_ns[1]), "ns")) == "2024-05-18T00:00:12.000000000"


def test_week_and_seconds_commas_and_minutes(flight):
    """The same solution as dates, and as week and seconds with commas, degrees and minutes."""
    title = "%  UTC,latitude(d'\"),longitude(d'\"),height(m),Q,ns,sdn(m),sde(m),sdu(m)\n"
    surface = "% (lat/lon/height=WGS84/geodetic,Q=1:fix)\n"
    path = flight.put(
        "a.pos", surface + title + "2417,302400.250,-47,18,30.6,-0,30,0.36,1453.1,1,9,0.1,0.2,0.3\n"
    )
    channel = read_pos(path, Stated(), Ledger())
    assert np.degrees(channel["lat_rad"][0]) == pytest.approx(-(47 + 18 / 60 + 30.6 / 3600))
    assert np.degrees(channel["lon_rad"][0]) == pytest.approx(-(0.5 + 0.36 / 3600))
    assert channel["h_msl_m"][0] == 1453.1
    assert channel["sigma_h_m"][0] == pytest.approx(np.sqrt((0.01 + 0.04) / 2))
    assert channel.time_ns[0] == flight.utc_ns[0] + 18 * 10**9 + 250_000_000  # seconds of UTC


@pytest.mark.parametrize(
    "place", [" 47.300000000    8.500000000", "   47 18 00.00000     8 30 00.00000"]
)
def test_baselines_start_at_the_base(flight, place):
    import pyproj

    base = (
        f"% ref pos   :{place}  1500.0000\n"
        "% (e/n/u-baseline=WGS84,Q=1:fix,ns=# of satellites)\n"
        "%  JST  e-baseline(m) n-baseline(m) u-baseline(m)  Q  ns  sde(m)  sdn(m)  sdu(m)\n"
    )
    row = "2026/05/06 21:00:00.000  1000.0000  -2000.0000  30.0000  1  9  0.2  0.1  0.3\n"
    channel = read_pos(flight.put("a.pos", base + row), Stated(), Ledger())
    local = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 "
        "+step +proj=topocentric +ellps=WGS84 +lon_0=8.5 +lat_0=47.3 +h_0=1500"
    )
    enu = local.transform(
        channel["lon_rad"][0], channel["lat_rad"][0], channel["h_ellipsoid_m"][0], radians=True
    )
    assert enu == pytest.approx((1000.0, -2000.0, 30.0), abs=1e-4)
    assert str(np.datetime64(int(channel.time_ns[0]), "ns")).startswith("2026-05-06T12:00:00.0")
    without = base.split("\n", 1)[1] + row
    assert "ref pos" in refused(read_pos, flight.put("b.pos", without), Stated()).what
    for wrong in ("47 75 00.0 8 30 00.0", "97.3 8.5", "47.3", "north east"):
        spoilt = base.replace(place, f" {wrong}") + row
        assert "ref pos" in refused(read_pos, flight.put("c.pos", spoilt), Stated()).what


def test_velocities_of_a_pos_file_point_down(flight):
    path = flight.put(
        "v.pos",
        "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix)\n"
        "%  GPST latitude(deg) longitude(deg) height(m) Q ns vn(m/s) ve(m/s) vu(m/s)\n"
        "2026/05/06 12:00:00.000 47.3 8.5 1500.0 1 9 3.0 4.0 -1.5\n",
    )
    channel = read_pos(path, Stated(), Ledger())
    assert [channel[f"v_{a}_m_s"][0] for a in ("north", "east", "down")] == [3.0, 4.0, 1.5]


def test_single_point_fixes_get_their_sigma_and_are_told(flight):
    quality = np.ones(flight.t.size, int)
    quality[100:130] = 5
    ledger = Ledger()
    channel = read_pos(flight.pos(quality=quality), Stated(), ledger)
    (told,) = entries(ledger, "TRAJECTORY-SINGLE")
    assert (told.kind, told.count) == ("warning", 30)
    assert channel["sigma_h_m"][99] < 0.02 < 2.0 < channel["sigma_h_m"][100]
    assert channel["sigma_v_m"][129] >= 5.0 > channel["sigma_v_m"][130]


def test_damaged_and_repeated_rows_are_counted(flight):
    path = flight.pos()
    lines = path.read_text().splitlines(keepends=True)
    lines[10] = lines[10][:30] + "\n"
    lines[20] = lines[20].replace("2026/05/06", "2026/15/66")
    lines.append(lines[30])
    path.write_text("".join(lines))
    ledger = Ledger()
    channel = read_pos(path, Stated(), ledger)
    assert len(channel) == flight.t.size - 2
    assert [(e.kind, e.count) for e in entries(ledger, "IMPORT-ROWS")] == [("loss", 2), ("loss", 1)]


def test_a_pos_file_without_its_header_and_one_whose_header_is_wrong(flight):
    path = flight.pos()
    bare = "".join(x for x in path.read_text().splitlines(keepends=True) if x[0] != "%")
    assert refused(read_pos, flight.put("bare.pos", bare)).code == "IMPORT-FORMAT"
    head = "".join(x for x in path.read_text().splitlines(keepends=True) if x[0] == "%")
    assert refused(read_pos, flight.put("head.pos", head)).code == "IMPORT-FORMAT"
    ledger = Ledger()
    channel = read_pos(path, Stated(time_system="utc", heights="msl"), ledger)
    told = entries(ledger, "IMPORT-CONTRADICTED")
    assert [entry.kind for entry in told] == ["warning", "warning"]
    assert "time.system is gpst in its header and utc in the mission file" in told[0].what
    assert np.abs(channel.time_ns - flight.utc_ns - 18 * 10**9).max() < 2e6
    assert channel["h_msl_m"] == pytest.approx(flight.height, abs=1e-3)


# SBET


@pytest.mark.parametrize("wander_deg", [0.0, 1.3, -40.0])
def test_an_sbet_and_its_sigmas_are_read(flight, wander_deg):
    ledger = Ledger()
    stated = Stated("gpst", WEEK, heights="ellipsoid", accuracy=flight.smrmsg())
    channel = read_sbet(flight.sbet(wander_deg=wander_deg), stated, ledger)
    assert np.abs(channel.time_ns - flight.utc_ns).max() < 100
    assert metres(channel, flight) < 1e-4
    assert degrees(channel, flight) < 1e-6
    assert channel["sigma_h_m"] == pytest.approx(0.05 / np.sqrt(2))
    assert channel["sigma_v_m"] == pytest.approx(0.05)
    assert np.degrees(channel["sigma_tilt_rad"]) == pytest.approx(1.0 / 60.0 / np.sqrt(2))
    assert np.degrees(channel["sigma_yaw_rad"]) == pytest.approx(0.05)
    assert np.abs(channel["v_north_m_s"] - flight.velocity[:, 0]).max() < 0.05
    assert np.abs(channel["v_east_m_s"] - flight.velocity[:, 1]).max() < 0.05
    assert np.abs(channel["v_down_m_s"] - flight.velocity[:, 2]).max() < 0.05
    assert not [e for e in ledger if e.kind != "note"]


def test_the_other_sign_of_the_wander_angle_is_recognised_by_the_velocities(flight):
    ledger = Ledger()
    path = flight.sbet(wander_deg=5.0, sign=-1.0)
    channel = read_sbet(path, Stated("gpst", WEEK, heights="ellipsoid"), ledger)
    assert degrees(channel, flight) < 1e-6
    (told,) = entries(ledger, "IMPORT-WANDER")
    assert told.kind == "warning"
    assert "plus wander angle" in told.what


def test_without_velocities_the_course_decides_the_sign(flight):
    rows = flight.sbet_rows(wander_deg=30.0, sign=-1.0)
    rows[:, 4:7] = 0.0
    ledger = Ledger()
    channel = read_sbet(flight.sbet(rows=rows), Stated("gpst", WEEK, heights="ellipsoid"), ledger)
    assert degrees(channel, flight) < 1e-6
    assert "v_north_m_s" not in channel.columns
    assert "heading and course" in entries(ledger, "IMPORT-WANDER")[0].what


def test_where_neither_sign_fits_it_is_told(flight):
    rows = flight.sbet_rows(wander_deg=20.0)
    rows[:, 4:7] = 0.0
    rows[:, 9] += np.radians(90.0)
    ledger = Ledger()
    read_sbet(flight.sbet(rows=rows), Stated("gpst", WEEK, heights="ellipsoid"), ledger)
    (told,) = entries(ledger, "IMPORT-WANDER")
    assert told.kind == "warning"
    assert "do not decide" in told.what


def test_velocities_and_rates_of_another_frame_are_left_out(flight):
    rows = flight.sbet_rows()
    rows[:, 4], rows[:, 5] = 40.0, 0.0  # forward, as some programs write it
    rows[:, 14:17] = 0.0
    ledger = Ledger()
    channel = read_sbet(flight.sbet(rows=rows), Stated("gpst", WEEK, heights="ellipsoid"), ledger)
    assert entries(ledger, "IMPORT-VELOCITY")[0].kind == "warning"
    assert "v_north_m_s" not in channel.columns
    assert "rate_x_rad_s" not in channel.columns
    full = read_sbet(flight.sbet(), Stated("gpst", WEEK, heights="ellipsoid"), Ledger())
    assert "rate_z_rad_s" in full.columns


@pytest.mark.parametrize("days", [0, 3])
def test_the_week_is_that_of_the_log_and_midnight_of_saturday_is_passed(flight, days):
    ends = int(flight.utc_ns[-1])
    rows = flight.sbet_rows()
    rows[:, 0] = (rows[:, 0] + 302_300.0) % 604_800.0  # the week ends after 100 s
    late = 302_300 * 10**9
    around = int(flight.utc_ns[0]) + late - days * 86_400 * 10**9, ends + late
    stated = Stated("gpst", around_ns=around, heights="ellipsoid")
    channel = read_sbet(flight.sbet(rows=rows), stated, Ledger())
    assert np.abs(channel.time_ns - flight.utc_ns - late).max() < 100
    assert refused(read_sbet, flight.sbet(rows=rows)).code == "IMPORT-WEEK"


def test_seconds_of_the_week_in_utc_have_no_leap_seconds(flight):
    utc = read_sbet(flight.sbet(), Stated("utc", WEEK, heights="ellipsoid"), Ledger())
    assert np.abs(utc.time_ns - flight.utc_ns - 18 * 10**9).max() < 100


def test_a_cut_sbet_is_a_loss_of_its_last_row(flight):
    path = flight.sbet()
    path.write_bytes(path.read_bytes()[:-40])
    ledger = Ledger()
    channel = read_sbet(path, Stated("gpst", WEEK, heights="ellipsoid"), ledger)
    assert len(channel) == flight.t.size - 1
    assert [(e.kind, e.count) for e in entries(ledger, "IMPORT-CUT")] == [("loss", 96)]


@pytest.mark.parametrize(
    ("spoil", "code", "words"),
    [
        (lambda f, rows: rows.astype(">f8").tobytes(), "IMPORT-FORMAT", "big-endian"),
        (lambda f, rows: f.smrmsg().read_bytes(), "IMPORT-FORMAT", "smrmsg"),
        (
            lambda f, rows: np.where(np.arange(17) == 1, np.degrees(rows), rows).tobytes(),
            "IMPORT-FORMAT",
            "degrees",
        ),
        (
            lambda f, rows: np.where(np.arange(17) == 9, np.degrees(rows), rows).tobytes(),
            "IMPORT-FORMAT",
            "heading",
        ),
        (
            lambda f, rows: (rows * np.where(np.arange(17) == 1, 1.5, 1.0)).tobytes(),
            "IMPORT-SPEED",
            "columns are different",
        ),
        (
            lambda f, rows: np.where(np.arange(17) == 3, 1e6, rows).tobytes(),
            "IMPORT-FORMAT",
            "heights",
        ),
        (
            lambda f, rows: np.where(np.arange(17) == 0, 7.0, rows).tobytes(),
            "IMPORT-FORMAT",
            "time",
        ),
        (
            lambda f, rows: np.where(np.arange(17) == 12, np.nan, rows).tobytes(),
            "IMPORT-FORMAT",
            "numbers",
        ),
        (lambda f, rows: rows.tobytes()[:200], "IMPORT-FORMAT", "1 row"),
        (lambda f, rows: b"time,lat,lon\n" * 1000, "IMPORT-FORMAT", "SBET"),
    ],
)
def test_what_is_no_sbet_is_refused_with_what_it_is(flight, spoil, code, words):
    path = flight.put("bad.out", spoil(flight, flight.sbet_rows()))
    error = refused(read_sbet, path, Stated("gpst", WEEK, heights="ellipsoid"))
    assert error.code == code
    assert words in error.what


def test_sigmas_of_another_flight_and_no_sigmas_are_refused(flight):
    from dataclasses import replace

    path = flight.sbet()
    other = replace(flight, t=flight.t + 5000.0).smrmsg("other.out")
    stated = Stated("gpst", WEEK, heights="ellipsoid", accuracy=other)
    assert "seconds of the week" in refused(read_sbet, path, stated).what
    stated = Stated("gpst", WEEK, heights="ellipsoid", accuracy=path)
    assert "not a smrmsg" in refused(read_sbet, path, stated).what


def test_what_an_sbet_does_not_say_must_be_stated(flight):
    assert refused(read_sbet, flight.sbet(), Stated(heights="msl")).code == "IMPORT-UNSTATED"
    assert refused(read_sbet, flight.sbet(), Stated("gpst", WEEK)).code == "IMPORT-UNSTATED"


# CSV

NAMES = {"time": "t", "latitude": "lat", "longitude": "lon", "height": "h"}


def table(flight, times, *, header="t,lat,lon,h", extra=None, mark=",", name="t.csv"):
    extra = [""] * flight.t.size if extra is None else extra
    rows = [
        f"{time},{flight.lat[k]:.9f},{flight.lon[k]:.9f},{flight.height[k]:.4f}{extra[k]}"
        for k, time in enumerate(times)
    ]
    return flight.put(name, "\n".join([header, *rows]).replace(",", mark) + "\n")


@pytest.mark.parametrize(
    ("times", "stated"),
    [
        (lambda f: [f.gpst(k) for k in range(f.t.size)], Stated("gpst", heights="ellipsoid")),
        (
            lambda f: [f"{np.datetime64(int(t), 'ns')}Z" for t in f.utc_ns],
            Stated("utc", heights="ellipsoid"),
        ),
        (
            lambda f: [f"{302_400.0 + t:.3f}" for t in f.t],
            Stated("gpst", WEEK, heights="ellipsoid"),
        ),
        (
            lambda f: [f"{2417 * 604_800 + 302_400.0 + t:.3f}" for t in f.t],
            Stated("gpst", heights="ellipsoid"),
        ),
        (lambda f: [f"{t / 1e9:.3f}" for t in f.utc_ns], Stated("utc", heights="ellipsoid")),
    ],
)
@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_a_csv_has_its_times_in_any_of_five_forms(flight, times, stated, mark):
    from dataclasses import replace

    path = table(flight, times(flight), mark=mark)
    channel = read_trajectory_csv(path, replace(stated, columns=NAMES), Ledger())
    assert np.abs(channel.time_ns - flight.utc_ns).max() < 1000
    assert metres(channel, flight) < 2e-4


@pytest.mark.parametrize("unit", ["deg", "rad", "grad"])
@pytest.mark.parametrize("order", ["ZYX", "XYZ", "YXZ"])
def test_angles_are_read_in_their_unit_and_order(flight, unit, order):
    turned = flight.attitude.as_euler(order)  # in the order of the letters
    by_letter = {axis: turned[:, k] for k, axis in enumerate(order)}
    circle = {"deg": 360.0, "rad": 2 * np.pi, "grad": 400.0}[unit]
    extra = [
        ",".join(["", *(f"{by_letter[axis][k] * circle / (2 * np.pi):.9f}" for axis in "XYZ")])
        for k in range(flight.t.size)
    ]
    path = table(
        flight,
        [f.gpst(k) for f in [flight] for k in range(f.t.size)],
        header="t,lat,lon,h,r,p,y",
        extra=extra,
    )
    columns = NAMES | {"roll": "r", "pitch": "p", "yaw": "y"}
    stated = Stated(
        "gpst", heights="ellipsoid", columns=columns, angle_unit=unit, angle_order=order
    )
    assert degrees(read_trajectory_csv(path, stated, Ledger()), flight) < 1e-6


def test_a_projection_and_its_north(flight):
    """Lambert-93 far from its meridian: grid north is 4 degrees off, by PROJ's own geodesic."""
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:2154", always_xy=True)
    x, y = to_grid.transform(flight.lon, flight.lat)
    south, north = (to_grid.transform(x, y + d, direction="INVERSE") for d in (-5.0, 5.0))
    turn = np.radians(pyproj.Geod(ellps="GRS80").inv(*south, *north)[0])
    assert np.degrees(turn).min() > 3.5
    yaw = np.degrees(flight.yaw - turn) % 360.0
    v_north = np.cos(turn) * flight.velocity[:, 0] + np.sin(turn) * flight.velocity[:, 1]
    v_east = np.cos(turn) * flight.velocity[:, 1] - np.sin(turn) * flight.velocity[:, 0]
    rows = "\n".join(
        f"{flight.gpst(k)},{x[k]:.5f},{y[k]:.5f},{flight.height[k]:.4f},"
        f"{np.degrees(flight.roll[k]):.9f},{np.degrees(flight.pitch[k]):.9f},{yaw[k]:.9f},"
        f"{v_north[k]:.9f},{v_east[k]:.9f}"
        for k in range(flight.t.size)
    )
    path = flight.put("grid.csv", "t,x,y,z,roll,pitch,yaw,vn,ve\n" + rows)
    names = {name: name for name in ("x", "y", "z", "roll", "pitch", "yaw")}
    columns = {"time": "t", "v_north_m_s": "vn", "v_east_m_s": "ve"} | names
    ledger = Ledger()
    stated = Stated("gpst", heights="ellipsoid", columns=columns, crs="EPSG:2154")
    channel = read_trajectory_csv(path, stated, ledger)
    assert metres(channel, flight) < 2e-4
    assert degrees(channel, flight) < 1e-4
    found = np.stack([channel["v_north_m_s"], channel["v_east_m_s"]], axis=1)
    np.testing.assert_allclose(found, flight.velocity[:, :2], atol=1e-4)
    assert "CRS-DATUM" in {entry.code for entry in ledger}
    unstated = Stated("gpst", columns=columns, crs="EPSG:2154")
    assert refused(read_trajectory_csv, path, unstated).code == "IMPORT-UNSTATED"


def test_grads_are_more_than_a_circle_of_degrees(flight):
    extra = [f",0,0,{np.degrees(y) % 360.0 / 0.9:.5f}" for y in flight.yaw]
    path = table(
        flight,
        [flight.gpst(k) for k in range(flight.t.size)],
        header="t,lat,lon,h,r,p,y",
        extra=extra,
    )
    columns = NAMES | {"roll": "r", "pitch": "p", "yaw": "y"}
    if np.degrees(flight.yaw % (2 * np.pi)).max() / 0.9 <= 360.0:
        extra[5] = ",0,0,399.0"
        path = table(
            flight,
            [flight.gpst(k) for k in range(flight.t.size)],
            header="t,lat,lon,h,r,p,y",
            extra=extra,
        )
    error = refused(read_trajectory_csv, path, Stated("gpst", heights="ellipsoid", columns=columns))
    assert error.code == "IMPORT-ANGLES"
    assert "360 deg" in error.what


def test_earth_centred_coordinates(flight):
    import pyproj

    x, y, z = pyproj.Transformer.from_crs(4979, 4978, always_xy=True).transform(
        flight.lon, flight.lat, flight.height
    )
    rows = "".join(f"{flight.gpst(k)},{x[k]:.4f},{y[k]:.4f},{z[k]:.4f}\n" for k in range(x.size))
    path = flight.put("xyz.csv", "t,x,y,z\n" + rows)
    columns = {"time": "t", "x": "x", "y": "y", "z": "z"}
    channel = read_trajectory_csv(path, Stated("gpst", columns=columns), Ledger())
    assert metres(channel, flight) < 3e-4
    wrong = Stated("gpst", columns=columns | {"z": "x"})
    assert refused(read_trajectory_csv, path, wrong).code == "IMPORT-RANGE"


def test_swapped_columns_missing_columns_and_zones_are_refused(flight):
    path = table(flight, [flight.gpst(k) for k in range(flight.t.size)])
    stated = Stated("gpst", heights="ellipsoid", columns=NAMES | {"height": "alt"})
    assert refused(read_trajectory_csv, path, stated).code == "IMPORT-COLUMN"
    far = flight.put("far.csv", "t,lat,lon,h\n2026-05-06T12:00:00,139.7,35.7,100\n")
    stated = Stated("gpst", heights="ellipsoid", columns=NAMES)
    assert refused(read_trajectory_csv, far, stated).code == "IMPORT-RANGE"
    zoned = flight.put("z.csv", "t,lat,lon,h\n2026-05-06T12:00:00Z,35.7,139.7,100\n")
    assert refused(read_trajectory_csv, zoned, stated).code == "IMPORT-TIME-SYSTEM"
    stated = Stated(heights="ellipsoid", columns=NAMES)
    assert refused(read_trajectory_csv, zoned, stated).code == "IMPORT-UNSTATED"
    assert "columns" in refused(read_trajectory_csv, zoned, GPST).what
    empty = flight.put("e.csv", "t,lat,lon,h\nnever,35.7,139.7,100\n")
    stated = Stated("utc", heights="ellipsoid", columns=NAMES)
    assert refused(read_trajectory_csv, empty, stated).code == "IMPORT-FORMAT"


def test_a_format_is_known_by_its_name_or_its_ending(tmp_path):
    assert format_of(TRAJECTORIES, tmp_path / "a.POS", None) == "rtklib"
    assert format_of(TRAJECTORIES, tmp_path / "a.xyz", "csv") == "csv"
    with pytest.raises(InputError) as caught:
        format_of(TRAJECTORIES, tmp_path / "a.xyz", None)
    assert caught.value.code == "IMPORT-FORMAT"
