"""Camera events with positions: .MRK, RTKLIB's events, POSPac's EO text."""

import re

import numpy as np
import pytest

from tests.helpers import with_code
from tests.tables.checks import assert_within
from tests.tables.imports.flights import (
    TOW,
    WEEK,
    assert_place,
    degrees_off,
    metres_off,
    ns_off,
    read,
    refusal_of,
    utc_text,
)
from unbend.tables.imports import CAMERA_EVENTS, format_of
from unbend.tables.imports.camera_events import read_eo_text, read_mrk
from unbend.tables.imports.rtklib import read_pos
from unbend.tables.imports.stated import Stated

OF_WEEK = Stated("gpst", WEEK)
LEAP_NS = 18 * 10**9


def test_a_published_line_of_an_mrk(flight):
    path = flight.put(
        "one.MRK",
        "1\t400373.488877\t[2264]\t   -40,N\t     0,E\t    86,V\t44.42824637,Lat\t1.26196331,Lon\t"
        "359.494,Ellh\t0.028, 0.031, 0.055\t16,Q\n",
    )

    channel, ledger = read(read_mrk, path)

    (row,) = channel.to_pandas().to_dict("records")
    assert row["event_index"] == 1.0
    assert row["offset_north_m"] == pytest.approx(-0.040)
    assert row["offset_east_m"] == pytest.approx(0.0)
    assert row["offset_down_m"] == pytest.approx(0.086)
    assert_place(channel, 0, 44.42824637, 1.26196331, tolerance_deg=1e-11)
    assert row["h_ellipsoid_m"] == 359.494
    assert row["sigma_h_m"] == pytest.approx(np.hypot(0.028, 0.031) / np.sqrt(2))
    assert row["sigma_v_m"] == 0.055
    # Week 2264 began on Sunday 2023-05-28; 400,373.488877 s later less 18 s.
    assert utc_text(channel, 0) == "2023-06-01T15:12:35.488877000"
    assert with_code(ledger, "TRAJECTORY-SINGLE")[0].count == 1


def test_an_mrk_is_read_to_its_last_digit(exposures):
    channel, ledger = read(read_mrk, exposures.mrk())

    assert ns_off(channel, exposures) < 1000
    assert metres_off(channel, exposures) < 2e-3
    assert channel["event_index"].tolist() == list(range(1, 31))
    assert not list(ledger)


def test_images_without_a_position_keep_their_time_and_are_told(exposures):
    path = exposures.mrk()
    lines = path.read_text().splitlines(keepends=True)
    lines[3] = lines[3].replace("50,Q", "0,Q")
    lines[5] = "garbage\n"
    path.write_text("".join(lines))

    channel, ledger = read(read_mrk, path)

    assert len(channel) == 29
    assert np.flatnonzero(np.isnan(channel["lat_rad"])).tolist() == [3]
    (lost,) = with_code(ledger, "IMPORT-NO-POSITION")
    assert lost.kind == "loss"
    assert lost.count == 1
    (damaged,) = with_code(ledger, "IMPORT-ROWS")
    assert damaged.count == 1


@pytest.mark.parametrize("content", ["image,lat,lon\n", bytes(range(256))])
def test_what_is_no_mrk_is_refused(exposures, content):
    path = exposures.put("x.MRK", content)
    assert refusal_of(read_mrk, path).code == "IMPORT-FORMAT"


def test_events_of_rtklib_are_counted_by_their_rows(exposures):
    path = exposures.pos("flight_events.pos")
    head, title, rows = path.read_text().rpartition("ratio\n")
    lines = rows.splitlines(keepends=True)
    lines[4] = "damaged\n"
    path.write_text(head + title + "".join(lines))

    channel, _ = read(read_pos, path)

    assert channel["event_index"].tolist() == [1, 2, 3, 4, *range(6, 31)]
    assert format_of(CAMERA_EVENTS, path, None) == "rtklib"


def test_an_eo_text_with_names(exposures):
    channel, _ = read(read_eo_text, exposures.eo(), OF_WEEK)

    assert ns_off(channel, exposures) < 1000
    assert metres_off(channel, exposures) < 1e-3
    assert channel.labels["name"][:2] == ("img_000", "img_001")
    assert channel["event_index"].tolist() == list(range(1, 31))
    assert channel.fits_role("attitude")


def test_the_published_example_of_an_eo_text(exposures):
    """ArcGIS' help of the Applanix exterior orientation file, tab separated."""
    path = exposures.put(
        "a.txt",
        "(position in Meters, orientation in Degrees, lat, long in Deg)\n"
        "ID\t# EVENT\tTIME(s)\tEASTING\tNORTHING\tELLIPSOID HEIGHT\tOMEGA\tPHI\tKAPPA\tLAT\tLONG\n"
        "196493710\t3\t564155.65\t365324.63\t3096141.49\t2088.37\t-1.05\t0.32\t179.18\t27.98\t-82.36\n",
    )

    channel, _ = read(read_eo_text, path, OF_WEEK)

    assert channel.labels["name"] == ("196493710",)
    assert channel["event_index"].tolist() == [3.0]
    assert channel["h_ellipsoid_m"].tolist() == [2088.37]
    assert_place(channel, 0, 27.98, -82.36)


@pytest.mark.parametrize(
    ("pattern", "text", "words"),
    [
        ("\tLAT\tLONG", "", "only in a grid"),
        ("lat, long in Deg", "lat, long in Rad", "in Deg"),
        (r"TIME \(s\)", "WHEN", "names the columns"),
        ("(?s)img_000.*", "", "none of its rows"),
    ],
)
def test_an_eo_text_in_other_units_is_refused(exposures, pattern, text, words):
    path = exposures.eo()
    content = re.sub(pattern, text, path.read_text())
    path.write_text(content)

    error = refusal_of(read_eo_text, path, OF_WEEK)
    assert error.code == "IMPORT-FORMAT"
    assert words in error.what


@pytest.mark.parametrize(
    ("unit", "circle"),
    [
        ("Degrees", 360.0),
        ("Radians", 2.0 * np.pi),
        ("Grads", 400.0),
    ],
)
def test_an_eo_text_with_roll_pitch_and_heading_in_each_unit(exposures, unit, circle):
    """They turn a body against north, east and down, whatever the grid."""
    angles = np.stack([exposures.roll, exposures.pitch, exposures.yaw], axis=1)
    path = exposures.eo(angles * circle / (2.0 * np.pi))
    text = path.read_text().replace("orientation in Degrees", f"orientation in {unit}")
    path.write_text(text.replace("OMEGA\tPHI\tKAPPA", "ROLL\tPITCH\tHEADING"))

    channel, ledger = read(read_eo_text, path, OF_WEEK)

    assert degrees_off(channel, exposures) < 1e-6
    assert not with_code(ledger, "IMPORT-EO-ANGLES")


def test_an_eo_text_that_does_not_say_the_unit_of_its_angles_gives_none(exposures):
    text = exposures.eo().read_text()
    path = exposures.put("no.txt", text.replace("orientation in Degrees", "orientation"))

    channel, ledger = read(read_eo_text, path, OF_WEEK)

    assert not channel.fits_role("attitude")
    assert with_code(ledger, "IMPORT-EO-ANGLES")[0].kind == "fallback"


def test_an_eo_text_does_not_say_its_time_system(exposures):
    path = exposures.eo()
    assert refusal_of(read_eo_text, path, Stated(week=WEEK)).code == "IMPORT-UNSTATED"
    channel, _ = read(read_eo_text, path, Stated("utc", WEEK))
    assert ns_off(channel, exposures, LEAP_NS) < 1000


def test_a_damaged_time_moves_no_other_by_a_week(exposures):
    """Seconds of the week that begin anew are of the next one; a field that is none is not."""
    time = f"{TOW + exposures.t[5]:.6f}"
    path = exposures.eo()
    path.write_text(path.read_text().replace(time, "never"))

    channel, _ = read(read_eo_text, path, OF_WEEK)

    undamaged = exposures.at_times(np.delete(exposures.t, 5))
    assert ns_off(channel, undamaged) < 1000


def test_a_shift_that_latitudes_do_not_have_is_taken_from_the_heights(exposures):
    head = "Shift values: X = 12.000 m, Y = -30.000 m, Z = 48.500 m\n"
    path = exposures.eo(head=head, shift=(12.0, -30.0, 48.5))

    channel, ledger = read(read_eo_text, path, OF_WEEK)

    assert_within(channel["h_ellipsoid_m"], exposures.height, 1e-3)
    assert "subtracted from the heights" in with_code(ledger, "IMPORT-EO-HEAD")[0].what


@pytest.mark.parametrize("shift", ["X = 12.0 m, Y = -30.0 m, Z = 48.5 m", "X=0, Y=0, Z=48.5"])
def test_a_shift_that_nothing_shows_is_a_warning(exposures, shift):
    path = exposures.eo(head=f"Shift values: {shift}\n")

    channel, ledger = read(read_eo_text, path, OF_WEEK)

    assert_within(channel["h_ellipsoid_m"], exposures.height, 1e-3)
    warning = with_code(ledger, "IMPORT-EO-HEAD")[0]
    assert warning.kind == "warning"
    assert "are read without a change" in warning.what


@pytest.mark.parametrize(
    "head",
    [
        pytest.param(
            "First rotation is about the 'z' axis by the 'kappa' angle.\n"
            "Second rotation is about the 'y' axis by the 'phi' angle.\n"
            "Third rotation is about the 'x' axis by the 'omega' angle.\n",
            id="about z first",
        ),
        pytest.param(
            "First rotation is about the 'y' axis by the 'omega' angle.\n"
            "Second rotation is about the 'x' axis by the 'phi' angle.\n"
            "Third rotation is about the 'z' axis by the 'kappa' angle.\n",
            id="omega about y",
        ),
    ],
)
def test_an_order_that_no_photogrammetric_angles_have_is_refused(exposures, head):
    path = exposures.eo(head=head)
    assert refusal_of(read_eo_text, path, OF_WEEK).code == "IMPORT-EO-HEAD"


def test_an_order_that_is_not_stated_stands_in_the_ledger(exposures):
    path = exposures.eo()
    _, ledger = read(read_eo_text, path, OF_WEEK)
    assert "states no order" in with_code(ledger, "IMPORT-EO-HEAD")[0].what
