"""Camera events with positions: .MRK, RTKLIB's events, POSPac's EO text."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.imports import CAMERA_EVENTS, format_of
from unbend.tables.imports.camera_events import read_eo_text, read_mrk
from unbend.tables.imports.rtklib import read_pos
from unbend.tables.imports.stated import Stated

WEEK = 2417


def metres(channel, flight):
    north = (channel["lat_rad"] - np.radians(flight.lat)) * 6.37e6
    east = (channel["lon_rad"] - np.radians(flight.lon)) * 6.38e6 * np.cos(np.radians(flight.lat))
    up = channel["h_ellipsoid_m"] - flight.height
    return max(np.abs(north).max(), np.abs(east).max(), np.abs(up).max())


def entries(ledger, code):
    return [entry for entry in ledger if entry.code == code]


def refused(reader, path, stated):
    with pytest.raises(InputError) as caught:
        reader(path, stated, Ledger())
    assert caught.value.remedy
    return caught.value


def test_a_published_line_of_an_mrk(flight):
    path = flight.put(
        "one.MRK",
        "1\t400373.488877\t[2264]\t   -40,N\t     0,E\t    86,V\t44.42824637,Lat\t1.26196331,Lon\t"
        "359.494,Ellh\t0.028, 0.031, 0.055\t16,Q\n",
    )
    ledger = Ledger()
    channel = read_mrk(path, Stated(), ledger)
    assert channel["event_index"].tolist() == [1.0]
    offsets = [channel[f"offset_{axis}_m"][0] for axis in ("north", "east", "down")]
    assert offsets == pytest.approx([-0.040, 0.0, 0.086])
    assert np.degrees(channel["lat_rad"][0]) == pytest.approx(44.42824637, abs=1e-11)
    assert np.degrees(channel["lon_rad"][0]) == pytest.approx(1.26196331, abs=1e-11)
    assert channel["h_ellipsoid_m"][0] == 359.494
    assert channel["sigma_h_m"][0] == pytest.approx(np.hypot(0.028, 0.031) / np.sqrt(2))
    assert channel["sigma_v_m"][0] == 0.055
    # Week 2264 began on Sunday 2023-05-28; 400,373.488877 s later less 18 s.
    assert str(np.datetime64(int(channel.time_ns[0]), "ns")) == "2023-06-01T15:12:35.488877000"
    assert entries(ledger, "TRAJECTORY-SINGLE")[0].count == 1


def test_an_mrk_is_read_to_its_last_digit(exposures):
    ledger = Ledger()
    channel = read_mrk(exposures.mrk(), Stated(), ledger)
    assert np.abs(channel.time_ns - exposures.utc_ns).max() < 1000
    assert metres(channel, exposures) < 2e-3
    assert channel["event_index"].tolist() == list(range(1, 31))
    assert not list(ledger)


def test_images_without_a_position_keep_their_time_and_are_told(exposures):
    path = exposures.mrk()
    lines = path.read_text().splitlines(keepends=True)
    lines[3] = lines[3].replace("50,Q", "0,Q")
    lines[5] = "garbage\n"
    path.write_text("".join(lines))
    ledger = Ledger()
    channel = read_mrk(path, Stated(), ledger)
    assert len(channel) == 29
    assert np.flatnonzero(np.isnan(channel["lat_rad"])).tolist() == [3]
    assert (entries(ledger, "IMPORT-NO-POSITION")[0].kind, ledger.has_losses) == ("loss", True)
    assert [entry.count for entry in entries(ledger, "IMPORT-ROWS")] == [1]


def test_what_is_stated_against_an_mrk_holds_and_is_told(exposures):
    ledger = Ledger()
    channel = read_mrk(exposures.mrk(), Stated("utc", heights="msl"), ledger)
    assert [e.kind for e in entries(ledger, "IMPORT-CONTRADICTED")] == ["warning"] * 2
    assert np.abs(channel.time_ns - exposures.utc_ns - 18 * 10**9).max() < 1000
    assert channel["h_msl_m"] == pytest.approx(exposures.height, abs=1e-3)


def test_what_is_no_mrk_is_refused(exposures):
    text = exposures.put("x.MRK", "image,lat,lon\n")
    assert refused(read_mrk, text, Stated()).code == "IMPORT-FORMAT"
    binary = exposures.put("y.MRK", bytes(range(256)))
    assert refused(read_mrk, binary, Stated()).code == "IMPORT-FORMAT"


def test_events_of_rtklib_are_counted_by_their_rows(exposures):
    path = exposures.pos("flight_events.pos")
    lines = path.read_text().splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if line[0] != "%")
    lines[first + 4] = "damaged\n"
    path.write_text("".join(lines))
    channel = read_pos(path, Stated(), Ledger())
    assert channel["event_index"].tolist() == [k for k in range(1, 31) if k != 5]
    assert format_of(CAMERA_EVENTS, path, None) == "rtklib"


def test_an_eo_text_with_names(exposures):
    ledger = Ledger()
    channel = read_eo_text(exposures.eo(), Stated("gpst", WEEK), ledger)
    assert np.abs(channel.time_ns - exposures.utc_ns).max() < 1000
    assert metres(channel, exposures) < 1e-3
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
    channel = read_eo_text(path, Stated("gpst", WEEK), Ledger())
    assert channel.labels["name"] == ("196493710",)
    assert channel["event_index"].tolist() == [3.0]
    assert channel["h_ellipsoid_m"].tolist() == [2088.37]
    assert np.degrees([channel["lat_rad"][0], channel["lon_rad"][0]]) == pytest.approx(
        [27.98, -82.36]
    )


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda text: text.replace("\tLAT\tLONG", ""), "only in a grid"),
        (lambda text: text.replace("lat, long in Deg", "lat, long in Rad"), "in Deg"),
        (lambda text: text.replace("TIME (s)", "WHEN"), "names the columns"),
        (lambda text: text[: text.index("img_000")], "none of its rows"),
    ],
)
def test_an_eo_text_in_other_units_is_refused(exposures, spoil, words):
    path = exposures.put("b.txt", spoil(exposures.eo().read_text()))
    error = refused(read_eo_text, path, Stated("gpst", WEEK))
    assert error.code == "IMPORT-FORMAT"
    assert words in error.what


@pytest.mark.parametrize(
    ("unit", "per_rad"),
    [("Degrees", 180.0 / np.pi), ("Radians", 1.0), ("Grads", 200.0 / np.pi)],
)
def test_an_eo_text_with_roll_pitch_and_heading_in_each_unit(exposures, unit, per_rad):
    """They turn a body against north, east and down, whatever the grid."""
    head = exposures.eo().read_text().split("img_000")[0]
    head = head.replace("orientation in Degrees", f"orientation in {unit}")
    head = head.replace("OMEGA\tPHI\tKAPPA", "ROLL\tPITCH\tHEADING")
    angles = np.stack([exposures.roll, exposures.pitch, exposures.yaw], axis=1) * per_rad
    path = exposures.put(
        "rph.txt",
        head
        + "".join(
            f"img_{k:03d}\t{k + 1}\t{302_400.0 + exposures.t[k]:.6f}\t465000.1\t5238000.2\t"
            f"{exposures.height[k]:.3f}\t{roll:.9f}\t{pitch:.9f}\t{heading:.9f}\t"
            f"{exposures.lat[k]:.9f}\t{exposures.lon[k]:.9f}\n"
            for k, (roll, pitch, heading) in enumerate(angles)
        ),
    )
    ledger = Ledger()
    channel = read_eo_text(path, Stated("gpst", WEEK), ledger)
    q = np.stack([channel[f"q_{axis}"] for axis in "xyzw"], axis=1)
    apart = (Rotation.from_quat(q) * exposures.attitude.inv()).magnitude()
    assert apart.max() < 1e-8
    assert not entries(ledger, "IMPORT-EO-ANGLES")


def test_an_eo_text_that_does_not_say_the_unit_of_its_angles_gives_none(exposures):
    text = exposures.eo().read_text().replace("orientation in Degrees", "orientation")
    ledger = Ledger()
    channel = read_eo_text(exposures.put("no.txt", text), Stated("gpst", WEEK), ledger)
    assert not channel.fits_role("attitude")
    assert entries(ledger, "IMPORT-EO-ANGLES")[0].kind == "fallback"


def test_an_eo_text_does_not_say_its_time_system(exposures):
    assert refused(read_eo_text, exposures.eo(), Stated(week=WEEK)).code == "IMPORT-UNSTATED"
    utc = read_eo_text(exposures.eo(), Stated("utc", WEEK), Ledger())
    assert np.abs(utc.time_ns - exposures.utc_ns - 18 * 10**9).max() < 1000


def test_a_damaged_time_moves_no_other_by_a_week(exposures):
    """Seconds of the week that begin anew are of the next one; a field that is none is not."""
    lines = exposures.eo().read_text().splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if line.startswith("img_000"))
    fields = lines[first + 5].split("\t")
    lines[first + 5] = "\t".join([*fields[:2], "never", *fields[3:]])
    path = exposures.put("damaged.txt", "".join(lines))
    channel = read_eo_text(path, Stated("gpst", WEEK), Ledger())
    assert np.abs(channel.time_ns - np.delete(exposures.utc_ns, 5)).max() < 1000


THIRD = "Third rotation is about the 'z' axis by the 'kappa' angle.\n"


def eo_with_head(exposures, head: str, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    """The text with its head, easting, northing and height shifted; latitude is not."""
    east, north = pyproj.Proj("EPSG:32632")(exposures.lon, exposures.lat)
    text = head + "Zone: UTM North 32; lat, long in Deg; orientation in Degrees\n"
    text += "EVENT TIME (s) EASTING NORTHING ELLIPSOID HEIGHT OMEGA PHI KAPPA LAT LONG\n"
    for k in range(exposures.t.size):
        text += (
            f"{k + 1} {302_400.0 + exposures.t[k]:.4f} {east[k] + shift[0]:.3f} "
            f"{north[k] + shift[1]:.3f} {exposures.height[k] + shift[2]:.3f} 0.5 -0.5 30 "
            f"{exposures.lat[k]:.9f} {exposures.lon[k]:.9f}\n"
        )
    return exposures.put("head.txt", text)


def test_a_shift_that_latitudes_do_not_have_is_taken_from_the_heights(exposures):
    head = "Shift values: X = 12.000 m, Y = -30.000 m, Z = 48.500 m\n"
    ledger = Ledger()
    path = eo_with_head(exposures, head, (12.0, -30.0, 48.5))
    channel = read_eo_text(path, Stated("gpst", WEEK), ledger)
    assert np.abs(channel["h_ellipsoid_m"] - exposures.height).max() < 1e-3
    assert "subtracted from the heights" in entries(ledger, "IMPORT-EO-HEAD")[0].what


@pytest.mark.parametrize("shift", ["X = 12.0 m, Y = -30.0 m, Z = 48.5 m", "X=0, Y=0, Z=48.5"])
def test_a_shift_that_nothing_shows_is_a_warning(exposures, shift):
    ledger = Ledger()
    path = eo_with_head(exposures, f"Shift values: {shift}\n")
    channel = read_eo_text(path, Stated("gpst", WEEK), ledger)
    assert np.abs(channel["h_ellipsoid_m"] - exposures.height).max() < 1e-3
    told = entries(ledger, "IMPORT-EO-HEAD")
    assert told[0].kind == "warning"
    assert "are read without a change" in told[0].what


@pytest.mark.parametrize(
    "rotations",
    [
        "First rotation is about the 'z' axis by the 'kappa' angle.\n"
        "Second rotation is about the 'y' axis by the 'phi' angle.\n"
        "Third rotation is about the 'x' axis by the 'omega' angle.\n",
        "First rotation is about the 'y' axis by the 'omega' angle.\n"
        "Second rotation is about the 'x' axis by the 'phi' angle.\n" + THIRD,
    ],
)
def test_an_order_that_no_photogrammetric_angles_have_is_refused(exposures, rotations):
    error = refused(read_eo_text, eo_with_head(exposures, rotations), Stated("gpst", WEEK))
    assert error.code == "IMPORT-EO-HEAD"


def test_an_order_that_is_not_stated_stands_in_the_ledger(exposures):
    ledger = Ledger()
    read_eo_text(eo_with_head(exposures, ""), Stated("gpst", WEEK), ledger)
    assert "states no order" in entries(ledger, "IMPORT-EO-HEAD")[0].what
