"""`unbend stations`: the table, why stations cannot be used, CSV and drawing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.dates import date2num

from unbend.flight.ground_times import LoggedPath
from unbend.flight.stations import NO_TIME, Stations, empty_stations, station_columns
from unbend.report.console import report_console
from unbend.report.figures import flight_figure
from unbend.report.terminal import print_stations
from unbend.tables.writing import rows_of_stations

from .printed import one_line

pytestmark = pytest.mark.usefixtures("eighty_columns")

SECOND = 1_000_000_000
NINE = 1_749_718_800 * SECOND  # 2025-06-12, 09:00 UTC


def flown(n: int = 40) -> Stations:
    """Eastwards along the equator; the 4th to 6th suspect, the 8th outside the log."""
    names = np.array([f"DSC_{i + 1:05d}.tif" for i in range(n)], object)
    status = np.full(n, "ok", object)
    status[3:6] = "suspect"
    status[7] = "outside_log"
    reason = np.full(n, "", object)
    reason[3:6] = "the position steps at 820 m/s"
    off_m = np.full(n, np.nan)
    off_m[3:6] = [13.0, 77.4, 40.0]
    here = np.where(np.arange(n) == 7, np.nan, 1.0)
    return replace(
        empty_stations(names, np.full(n, "nadir", object), "ok"),
        time_ns=NINE + 2 * SECOND * np.arange(n),
        lat_rad=0.5 * here,
        lon_rad=np.radians(179.98 + 0.001 * np.arange(n)) * here,
        h_msl_m=1234.5 * here,
        sigma_horizontal_m=1.25 * here,
        sigma_height_m=2.5 * here,
        sigma_tilt_rad=0.01 * here,
        suspect_reason=reason,
        suspect_m=off_m,
        status=status,
    )


def printed(stations: Stations, capsys) -> list[str]:
    print_stations(report_console(), rows_of_stations(stations))
    return [line.strip() for line in capsys.readouterr().out.splitlines()]


def test_the_table_and_the_reasons(capsys):
    lines = printed(flown(), capsys)
    assert all(len(line) <= 78 for line in lines)
    heads, first, eighth = (one_line(lines[number]) for number in (0, 2, 9))
    assert heads == "image UTC lat lon ± xy h ± h tilt status"
    assert first == "DSC_00001.tif 09:00:00.0 28.64789 179.98000 1.25 1234.5 2.50 0.57 ok"
    assert eighth == "DSC_00008.tif 09:00:14.0 outside_log"
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
    stations = flown(8)
    stations.image[:] = "2025-06-12_block_north_strip_07_oblique_left_00001.jpg"
    (row,) = {line.partition(" ")[0] for line in printed(stations, capsys)[2:10]}
    assert row == "2025-06-…0001.jpg"


def points_of(axis, label: str) -> np.ndarray:
    (line,) = (line for line in axis.get_lines() if str(line.get_label()).endswith(label))
    return np.asarray(line.get_xydata())


def test_the_drawing():
    stations = flown()
    track = LoggedPath(
        time_ns=stations.time_ns[::-1],
        latitude_rad=stations.lat_rad,
        longitude_rad=stations.lon_rad,
        h_msl_m=stations.h_msl_m + 1.0,
    )
    stations.time_ns[9] = NO_TIME
    stations.status[9] = "unmatched"
    begins = [NINE + 5 * SECOND, NINE + 60 * SECOND]
    stretches = [(begins[0], begins[0] + 6 * SECOND), (begins[1], begins[1] + SECOND)]
    figure = flight_figure(stations, track, stretches)
    above, beside = figure.axes
    suspect = points_of(above, "3 suspect")
    np.testing.assert_allclose(suspect[:, 0], [179.983, 179.984, 179.985], atol=1e-9)
    np.testing.assert_allclose(suspect[:, 1], np.degrees(0.5))
    assert points_of(above, "log")[0] == pytest.approx([179.98, np.degrees(0.5)])
    # A point every 2 s: 6, 8 and 10 s lie in the first of the two stretches, none in the other.
    marked = points_of(above, "suspect stretch")
    assert len(marked) == 3
    expected = [date2num(np.datetime64(begin, "ns")) for begin in begins]
    assert [patch.get_x() for patch in beside.patches] == pytest.approx(expected)
    # The flight crosses the 180th meridian, and the drawing does not jump back to -180.
    behind = replace(stations, lon_rad=(stations.lon_rad + np.pi) % (2 * np.pi) - np.pi)
    drawn = points_of(flight_figure(behind, track).axes[0], "ok")
    assert np.ptp(drawn[:, 0]) == pytest.approx(0.039, abs=1e-6)
    # The event outside the log has a time and no height: it stands at the foot.
    foot = [line for line in beside.get_lines() if line.get_transform() != beside.transData]
    assert [len(line.get_xdata()) for line in foot] == [0, 0, 1]
    assert foot[-1].get_xdata()[0] == np.datetime64(NINE + 14 * SECOND, "ns")
    assert above.get_xlabel() == "longitude [deg]"


def test_the_command(obeyed, mission, tmp_path):
    table = tmp_path / "stations.csv"
    plot = tmp_path / "flight.png"
    text = obeyed("stations", mission.save(), "--csv", table, "--plot", plot)
    obeyed("check", mission.file)
    assert plot.read_bytes().startswith(b"\x89PNG")
    rows = pd.read_csv(table, dtype=str)
    mission.run_to_manifest()
    run = mission.stations().to_pandas()
    assert rows["image"].tolist() == run["image"].tolist()
    for name in ("lat_deg", "lon_deg", "h_msl_m", "q_w", "pressure_pa"):
        np.testing.assert_array_equal(rows[name].astype(float), run[name])
    assert set(rows) == set(station_columns(flown()))
    assert set(rows) == set(run) - {"profile_id", "geometry"}
    assert f"nadir: {sum(run['camera'] == 'nadir')} ok" in text


def test_losses_and_refusals_are_those_of_check(unbend, mission, refusal_of):
    """An image without an exposure is a loss; a format that is no picture is refused."""
    rows = mission.measurements().to_pandas()
    rows.loc[0, "image"] = "unknown.tif"
    mission.observe_text(rows.to_csv(index=False))
    ended = unbend("stations", mission.save())
    assert ended.code == unbend("check", mission.save()).code == 3
    assert "IMAGES-UNMATCHED" in ended.out
    assert "no camera: 1 unmatched, unknown.tif" in ended.out
    refusal_of(
        "PLOT-FORMAT", 2, "stations", mission.save(), "--plot", mission.folder / "flight.gif"
    )
