"""`unbend stations`: the table, why stations cannot be used, CSV and drawing."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.dates import date2num

from tests.helpers import one_line
from unbend.flight.ground_times import LoggedPath
from unbend.flight.stations import NO_TIME, Stations, empty_stations, station_columns
from unbend.report.command_plots import flight_figure
from unbend.report.console import report_console
from unbend.report.terminal import print_stations
from unbend.tables.writing import rows_of_stations

pytestmark = pytest.mark.usefixtures("eighty_columns")

SECOND = 1_000_000_000
LATITUDE_DEG = 28.64788975654116  # 0.5 rad
NINE = 1_749_718_800 * SECOND  # 2025-06-12, 09:00 UTC


def flown(n=40) -> Stations:
    """Eastwards along the equator; the 4th to 6th suspect, the 8th outside the log."""
    number = np.arange(n)
    images = np.array([f"DSC_{i + 1:05d}.tif" for i in number], object)
    cameras = np.full(n, "nadir", object)
    in_log = np.where(number == 7, np.nan, 1.0)
    longitude_deg = 179.98 + 0.001 * number
    stations = replace(
        empty_stations(images, cameras, "ok"),
        time_ns=NINE + 2 * SECOND * number,
        lat_rad=0.5 * in_log,
        lon_rad=np.radians(longitude_deg) * in_log,
        h_msl_m=1234.5 * in_log,
        sigma_horizontal_m=1.25 * in_log,
        sigma_height_m=2.5 * in_log,
        sigma_tilt_rad=0.01 * in_log,
    )
    stations.status[3:6] = "suspect"
    stations.suspect_reason[3:6] = "the position steps at 820 m/s"
    stations.suspect_m[3:6] = [13.0, 77.4, 40.0]
    stations.status[7] = "outside_log"
    return stations


def printed(stations, capsys):
    rows = rows_of_stations(stations)
    print_stations(report_console(), rows)
    text = capsys.readouterr().out
    return [line.strip() for line in text.splitlines()]


def test_the_table_and_the_reasons(capsys):
    lines = printed(flown(), capsys)
    assert max(map(len, lines)) <= 78
    first = "DSC_00001.tif 09:00:00.0 28.64789 179.98000 1.25 1234.5 2.50 0.57 ok"
    assert one_line(lines[0]) == "image UTC lat lon ± xy h ± h tilt status"
    assert one_line(lines[2]) == first
    assert one_line(lines[9]) == "DSC_00008.tif 09:00:14.0 outside_log"
    assert "DSC_00025.tif" in lines[26]
    assert lines[27] == "..."
    assert lines[28].startswith("DSC_00036.tif")
    assert lines[33:] == [
        "10 rows are not shown: all of them with --csv FILE",
        "nadir: 36 ok",
        "nadir: 3 suspect, DSC_00004.tif to DSC_00006.tif: the position steps at 820",
        "m/s (up to 77 m off)",
        "nadir: 1 outside_log, DSC_00008.tif",
    ]
    assert "..." not in printed(flown(30), capsys)


def test_a_long_name_is_shortened(capsys):
    stations = flown(8)
    stations.image[:] = "2025-06-12_block_north_strip_07_oblique_left_00001.jpg"
    rows = printed(stations, capsys)[2:10]
    assert len(rows) == 8
    for row in rows:
        assert row.startswith("2025-06-…0001.jpg ")


def points_of(axis, label):
    lines = [line for line in axis.get_lines() if str(line.get_label()).endswith(label)]
    assert len(lines) == 1
    return np.asarray(lines[0].get_xydata())


@pytest.fixture(scope="module")
def track() -> LoggedPath:
    """A metre above the stations."""
    stations = flown()
    return LoggedPath(
        time_ns=stations.time_ns[::-1],
        latitude_rad=stations.lat_rad,
        longitude_rad=stations.lon_rad,
        h_msl_m=stations.h_msl_m + 1.0,
    )


def test_the_drawing(track):
    stations = flown()
    stations.time_ns[9] = NO_TIME
    stations.status[9] = "unmatched"
    first = NINE + 5 * SECOND
    second = NINE + 60 * SECOND
    stretches = [
        (first, first + 6 * SECOND),
        (second, second + SECOND),
    ]

    above, beside = flight_figure(stations, track, stretches).axes

    suspect = points_of(above, "3 suspect")
    longitude, latitude = suspect.T
    assert longitude == pytest.approx([179.983, 179.984, 179.985], rel=0, abs=1e-9)
    assert latitude == pytest.approx(LATITUDE_DEG, rel=1e-7)
    assert points_of(above, "log")[0] == pytest.approx([179.98, LATITUDE_DEG])
    # A point every 2 s: 6, 8 and 10 s are in the first of the two stretches, none in the other.
    assert len(points_of(above, "suspect stretch")) == 3
    edges = [patch.get_x() for patch in beside.patches]
    begins = np.array([first, second], "datetime64[ns]")
    assert edges == pytest.approx(date2num(begins))
    # The event outside the log has a time and no height: it is at the foot.
    at_foot = []
    for line in beside.get_lines():
        if line.get_transform() != beside.transData:
            at_foot.append(list(line.get_xdata()))
    outside = np.datetime64(NINE + 14 * SECOND, "ns")
    assert at_foot == [[], [], [outside]]  # the last are those outside the log
    assert above.get_xlabel() == "longitude [deg]"


def test_the_drawing_does_not_jump_at_the_180th_meridian(track):
    stations = flown()
    east = stations.lon_rad + np.pi
    behind = replace(stations, lon_rad=east % (2 * np.pi) - np.pi)
    above, _ = flight_figure(behind, track).axes
    longitude = points_of(above, "ok")[:, 0]
    assert np.ptp(longitude) == pytest.approx(0.039, abs=1e-6)


def test_the_command(obeyed, mission, tmp_path):
    table = tmp_path / "stations.csv"
    plot = tmp_path / "flight.png"
    text = obeyed("stations", mission.save(), "--csv", table, "--plot", plot)
    obeyed("check", mission.file)
    assert plot.read_bytes().startswith(b"\x89PNG")
    rows = pd.read_csv(table, dtype=str)
    mission.run_to_manifest()
    run = mission.station_rows()
    nadir = run["camera"] == "nadir"
    assert rows["image"].tolist() == run["image"].tolist()
    numbers = "lat_deg lon_deg h_msl_m q_w pressure_pa"
    for name in numbers.split():
        np.testing.assert_array_equal(rows[name].astype(float), run[name])
    assert set(rows) == set(station_columns(flown()))
    assert set(rows) == set(run) - {"profile_id", "geometry"}
    assert f"nadir: {nadir.sum()} ok" in text


def test_losses_and_refusals_are_those_of_check(unbend, mission, refusal_of):
    """An image without an exposure is a loss; a format that is no picture is refused."""
    rows = mission.measured_rows()
    rows.loc[0, "image"] = "unknown.tif"
    mission.observe_text(rows.to_csv(index=False))
    ended = unbend("stations", mission.save())
    checked = unbend("check", mission.file)
    assert ended.code == checked.code == 3
    assert "IMAGES-UNMATCHED" in ended.out
    assert "no camera: 1 unmatched, unknown.tif" in ended.out
    picture = mission.folder / "flight.gif"
    words = ("stations", mission.file, "--plot", picture)
    refusal_of("PLOT-FORMAT", 2, *words)
