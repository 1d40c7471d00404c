"""Stations: what flags them, and their table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.barometer_errors import BarometerErrors
from unbend.flight.station_builder import flag_missing_aircraft_attitude
from unbend.flight.stations import (
    NO_TIME,
    SigmaLimits,
    Stations,
    append_unmatched_images,
    empty_stations,
    flag_height_misfits,
    sigma_notes,
    station_columns,
    unusable_station_notes,
)
from unbend.refraction.window import Cabin
from unbend.stages.cabin_air import cabin_from_log

AIR = standard_atmosphere("us1976")


def stations(n: int = 3, camera: str = "cam") -> Stations:
    names = np.array([f"image_{i}" for i in range(n)], object)
    made = empty_stations(names, np.full(n, camera, object), "ok")
    return replace(made, h_msl_m=np.full(n, 3000.0), lat_rad=np.full(n, 0.5))


@pytest.mark.parametrize(
    ("misfit_pa", "flagged"),
    [(-1000.0, True), (1000.0, True), (790.0, False), (-790.0, False), (np.nan, False)],
)
def test_a_misfit_of_ten_hectopascal_is_noticed_and_one_of_less_than_eight_is_not(
    misfit_pa, flagged
):
    pressure = np.full(3, 70_121.0)  # US 1976, Table I: 701.21 hPa at 3 km
    pressure[1] += misfit_pa
    checked, notes = flag_height_misfits(replace(stations(), pressure_pa=pressure), AIR)
    assert checked.status.tolist() == ["ok", "suspect" if flagged else "ok", "ok"]
    assert [(e.kind, e.code, e.count) for e in notes] == [("loss", "STATIONS-HEIGHT", 1)] * flagged
    if flagged:
        assert "are 10 hPa apart" in notes[0].what
        assert "apart there, image_1" in notes[0].what


def test_a_leak_that_the_flight_has_found_rejects_no_height():
    """6 % of 302 hPa of change are 18 hPa: the profile is right, and so is the height."""
    leak = BarometerErrors(offset_pa=30.0, lost_share=0.06, highest_pa=101_325.0)
    pressure = np.full(3, 70_121.0 + 30.0 + 0.06 * (101_325.0 - 70_121.0))
    read = replace(stations(), pressure_pa=pressure)
    assert flag_height_misfits(read, AIR, leak) == (read, ())
    _, notes = flag_height_misfits(read, AIR)
    assert [entry.count for entry in notes] == [3]
    # A height that is wrong is still seen.
    wrong = replace(read, h_msl_m=np.array([3000.0, 3200.0, 3000.0]))
    checked, _ = flag_height_misfits(wrong, AIR, leak)
    assert checked.status.tolist() == ["ok", "suspect", "ok"]


def test_images_without_an_exposure_are_appended_in_order_and_unused_exposures_are_noted():
    joined, notes = append_unmatched_images(stations(), ("image_1", "zzz", "aaa"))
    assert joined.image.tolist() == ["image_0", "image_1", "image_2", "aaa", "zzz"]
    assert joined.status.tolist() == ["ok"] * 3 + ["unmatched"] * 2
    assert [(e.kind, e.code, e.count) for e in notes] == [
        ("note", "STATIONS-UNUSED", 2),
        ("loss", "IMAGES-UNMATCHED", 2),
    ]
    assert "aaa, zzz" in notes[1].what


def test_each_reason_is_a_loss_but_unmatched_images_are_entered_elsewhere():
    status = np.array(["in_gap", "ok", "no_attitude", "in_gap", "unmatched"], object)
    notes = unusable_station_notes(replace(stations(5), status=status))
    assert [(e.code, e.count, e.what) for e in notes] == [
        ("STATIONS-FLAGGED", 2, "2 exposures are in_gap: image_0, image_3"),
        ("STATIONS-FLAGGED", 1, "1 exposure is no_attitude: image_2"),
    ]


def flag_missing_pressure(stations, camera):
    """Without the note on the temperature, which is assumed."""
    return cabin_from_log(stations, camera, Cabin("log", temperature_k=294.0))


@pytest.mark.parametrize("check", [flag_missing_pressure, flag_missing_aircraft_attitude])
def test_only_usable_stations_of_the_camera_are_flagged(check):
    status = np.array(["ok", "in_gap", "ok"], object)
    flagged, (entry,) = check(replace(stations(), status=status), "cam")
    assert flagged.status.tolist() == ["suspect", "in_gap", "suspect"]
    assert (entry.kind, entry.count, entry.where) == ("loss", 2, "camera cam")
    untouched, notes = check(stations(), "other")
    assert untouched.ok.all()
    assert not notes


def test_the_table_is_in_degrees_and_unknown_times_are_null():
    made = replace(
        stations(2),
        time_ns=np.array([NO_TIME, 1_700_000_000_123_456_789]),
        lon_rad=np.array([-np.pi / 2, np.nan]),
        quaternion=np.array([[0.1, 0.2, 0.3, 0.4], [np.nan] * 4]),
        aircraft_quaternion=np.array([[0.5, 0.6, 0.7, 0.8], [np.nan] * 4]),
    )
    columns = station_columns(made)
    assert np.isnat(columns["time_utc"]).tolist() == [True, False]
    assert columns["time_utc"][1] == np.datetime64("2023-11-14T22:13:20.123456789")
    assert columns["lon_deg"][0] == pytest.approx(-90.0)
    assert columns["lat_deg"][0] == pytest.approx(28.64788975654116)
    assert [columns[f"q_{a}"][0] for a in "wxyz"] == [0.1, 0.2, 0.3, 0.4]
    assert [columns[f"aircraft_q_{a}"][0] for a in "wxyz"] == [0.5, 0.6, 0.7, 0.8]


def test_the_median_longitude_goes_on_across_the_180th_meridian():
    """The plain median of 179.9, 179.95, -179.9 and -179.95 degrees is 0: another ocean."""
    lon = np.radians([179.9, 179.95, -179.9, -179.95])
    across = replace(stations(4), lon_rad=lon).median_longitude_rad
    assert abs(np.degrees(across)) == pytest.approx(180.0)
    east = np.array([np.nan, 0.3, 0.1, 0.2])
    assert replace(stations(4), lon_rad=east).median_longitude_rad == 0.2
    assert np.isnan(replace(stations(4), lon_rad=np.full(4, np.nan)).median_longitude_rad)


def test_the_mean_latitude_is_of_the_known_ones():
    lat = np.array([0.4, np.nan, 0.6])
    assert replace(stations(), lat_rad=lat).mean_latitude_rad == pytest.approx(0.5)
    assert empty_stations(np.empty(0, object), np.empty(0, object), "ok").mean_latitude_rad == (
        pytest.approx(np.pi / 4)
    )


def test_stations_that_are_known_worse_than_needed_are_a_loss_for_each_limit():
    known = replace(
        stations(4),
        sigma_horizontal_m=np.array([0.5, 2.0, 9.0, 0.5]),
        sigma_height_m=np.array([1.0, 1.0, np.nan, 1.0]),
        sigma_tilt_rad=np.radians([0.1, 0.2, 0.3, 0.4]),
        status=np.array(["ok", "ok", "ok", "in_gap"], object),
    )
    far, high, said = sigma_notes(known, SigmaLimits(1.0, 1.5, np.radians(0.35)))
    assert (far.kind, far.code, far.count) == ("loss", "STATIONS-SIGMA", 2)
    assert f"the worst is {known.image[2]} with 9.00 m" in far.what
    assert high.count == 1
    assert "an unknown sigma" in high.what
    assert said.kind == "note"
    for median in ("2.00 m", "1.00 m", "0.20 deg"):
        assert median in said.what
    assert [entry.kind for entry in sigma_notes(known, SigmaLimits())] == ["note"]
    assert not list(sigma_notes(known.with_status(known.ok, "in_gap"), SigmaLimits(1.0, 1.0, 1.0)))


def test_a_suspect_station_does_not_move_the_middle_of_the_flight():
    flown = replace(
        stations(),
        lat_rad=np.array([0.84, 0.0, 0.84]),
        lon_rad=np.array([0.28, 0.0, 0.28]),
        status=np.array(["ok", "suspect", "ok"], object),
    )
    assert flown.mean_latitude_rad == pytest.approx(0.84)
    assert flown.median_longitude_rad == pytest.approx(0.28)


def test_stations_say_how_many_there_are_of_what_and_when():
    two = replace(
        stations(3),
        camera=np.array(["nadir", "nadir", "oblique"], object),
        status=np.array(["ok", "in_gap", "ok"], object),
        time_ns=np.array([1_500_000_000, 1_500_000_060, 1_500_000_002]) * 10**9,
        lon_rad=np.full(3, 0.1),
    )
    assert repr(two) == (
        "<Stations: 2 nadir, 1 oblique; 2 ok, 1 in_gap; "
        "2017-07-14T02:40:00 to 2017-07-14T02:41:00 UTC>"
    )
    assert repr(stations(1)) == "<Stations: 1 cam; 1 ok; no UTC>"
    page = two._repr_html_()
    assert page.count("<tr") == 4
    assert "image_2" in page
    axis = two.plot()
    drawn = {line.get_label(): line.get_xdata().tolist() for line in axis.lines}
    assert drawn["nadir"] == pytest.approx([np.degrees(0.1)])
    assert {label: len(x) for label, x in drawn.items()} == {
        "nadir": 1,
        "oblique": 1,
        "not usable": 1,
    }
    assert two.plot(axis) is axis
