"""Stations: what flags them, and their table."""

from dataclasses import replace

import numpy as np
import pytest

from tests.flight.made_channels import counted, image_names, instants
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.barometer_errors import BarometerErrors
from unbend.flight.station_builder import flag_missing_aircraft_attitude
from unbend.flight.stations import (
    NO_TIME,
    SigmaLimits,
    append_unmatched_images,
    empty_stations,
    flag_height_misfits,
    sigma_notes,
    station_columns,
    unusable_station_notes,
)
from unbend.refraction.window import Cabin
from unbend.stages.cabin_air import with_logged_cabin

AIR = standard_atmosphere("us1976")
PA_AT_3_KM = 70_121.0  # US 1976, Table I
K_AT_3_KM = 268.659


def with_status(*status, **columns):
    n = len(status)
    names = image_names(*(f"image_{number}" for number in range(n)))
    made = empty_stations(names, np.full(n, "cam", object), "ok")
    usual = {
        "h_msl_m": np.full(n, 3000.0),
        "lat_rad": np.full(n, 0.5),
    }
    arrays = {name: np.array(values) for name, values in columns.items()}
    return replace(
        made,
        status=image_names(*status),
        **usual | arrays,
    )


def stations(n=3, **columns):
    return with_status(*["ok"] * n, **columns)


@pytest.mark.parametrize(
    ("misfit_pa", "flagged"),
    [
        (-1000.0, True),
        (1000.0, True),
        (790.0, False),
        (-790.0, False),
        (np.nan, False),
    ],
)
def test_a_pressure_of_another_height_is_noticed(misfit_pa, flagged):
    pressure_pa = PA_AT_3_KM + np.array([0.0, misfit_pa, 0.0])
    checked, notes = flag_height_misfits(stations(pressure_pa=pressure_pa), AIR)
    status = "suspect" if flagged else "ok"
    assert checked.status.tolist() == ["ok", status, "ok"]
    assert counted(notes) == [("loss", "STATIONS-HEIGHT", 1)] * flagged
    if flagged:
        assert "are 10 hPa apart there, image_1" in notes[0].what
        scale_m = 29.27 * K_AT_3_KM
        off_m = scale_m * 1000.0 / pressure_pa[1]
        assert checked.suspect_m[1] == pytest.approx(off_m, rel=1e-3)


def test_a_leak_that_the_flight_has_found_rejects_no_height():
    """6 % of 302 hPa of change are 18 hPa: the profile is right, and so is the height."""
    leak = BarometerErrors(offset_pa=30.0, lost_share=0.06, highest_pa=101_325.0)
    pressure_pa = PA_AT_3_KM + 30.0 + 0.06 * (101_325.0 - PA_AT_3_KM)
    leaking = stations(pressure_pa=[pressure_pa] * 3)
    assert flag_height_misfits(leaking, AIR, leak) == (leaking, ())
    _, (note,) = flag_height_misfits(leaking, AIR)
    assert note.count == 3
    # A height that is wrong is still seen.
    wrong = replace(leaking, h_msl_m=np.array([3000.0, 3200.0, 3000.0]))
    checked, _ = flag_height_misfits(wrong, AIR, leak)
    assert checked.status.tolist() == ["ok", "suspect", "ok"]


def test_images_without_an_exposure_are_appended_in_order_and_unused_exposures_are_noted():
    images = ("image_1", "zzz", "aaa")
    joined, notes = append_unmatched_images(stations(), images, where="events")
    assert joined.image.tolist() == ["image_0", "image_1", "image_2", "aaa", "zzz"]
    assert joined.status.tolist() == ["ok"] * 3 + ["unmatched"] * 2
    assert counted(notes) == [
        ("note", "STATIONS-UNUSED", 2),
        ("loss", "IMAGES-UNMATCHED", 2),
    ]
    assert "aaa, zzz" in notes[1].what


def test_names_that_are_one_later_than_the_exposures():
    images = ("image_1", "image_2", "image_3")
    _, notes = append_unmatched_images(stations(), images, where="events")
    assert "the numbers of the images look shifted by +1" in notes[1].what


def test_each_reason_is_a_loss_but_unmatched_images_are_entered_elsewhere():
    flagged = with_status("in_gap", "ok", "no_attitude", "in_gap", "unmatched")
    in_gap, no_attitude = unusable_station_notes(flagged)
    assert counted([in_gap]) == [("loss", "STATIONS-FLAGGED", 2)]
    assert in_gap.what == "2 exposures are in_gap: image_0, image_3"
    assert no_attitude.what == "1 exposure is no_attitude: image_2"


def flag_missing_pressure(flown, camera):
    """Without the note on the temperature, which is assumed."""
    return with_logged_cabin(flown, camera, Cabin("log", temperature_k=294.0))


@pytest.mark.parametrize("check", [flag_missing_pressure, flag_missing_aircraft_attitude])
def test_only_usable_stations_of_the_camera_are_flagged(check):
    flagged, (note,) = check(with_status("ok", "in_gap", "ok"), "cam")
    assert flagged.status.tolist() == ["suspect", "in_gap", "suspect"]
    assert (note.kind, note.count, note.where) == ("loss", 2, "camera cam")
    untouched, notes = check(stations(), "other")
    assert untouched.ok.all()
    assert not notes


def test_the_table_is_in_degrees_and_unknown_times_are_null():
    made = stations(
        2,
        time_ns=[NO_TIME, 1_700_000_000_123_456_789],
        lon_rad=[-np.pi / 2, np.nan],
        quaternion=[
            [0.1, 0.2, 0.3, 0.4],
            [np.nan] * 4,
        ],
        aircraft_quaternion=[
            [0.5, 0.6, 0.7, 0.8],
            [np.nan] * 4,
        ],
    )
    columns = station_columns(made)
    assert np.isnat(columns["time_utc"]).tolist() == [True, False]
    assert columns["time_utc"][1] == np.datetime64("2023-11-14T22:13:20.123456789")
    assert columns["lon_deg"][0] == pytest.approx(-90.0)
    assert columns["lat_deg"][0] == pytest.approx(28.64788975654116)
    assert [columns[f"q_{axis}"][0] for axis in "wxyz"] == [0.1, 0.2, 0.3, 0.4]
    assert [columns[f"aircraft_q_{axis}"][0] for axis in "wxyz"] == [0.5, 0.6, 0.7, 0.8]


@pytest.mark.parametrize(
    ("longitude_deg", "middle_deg"),
    [
        ([np.nan, 30.0, 10.0, 20.0], 20.0),
        # The plain median is 0: another ocean.
        ([179.9, 179.95, -179.9, -179.95], 180.0),
        ([np.nan] * 4, np.nan),
    ],
)
def test_the_median_longitude_goes_on_across_the_180th_meridian(longitude_deg, middle_deg):
    middle_rad = stations(4, lon_rad=np.radians(longitude_deg)).median_longitude_rad
    assert abs(np.degrees(middle_rad)) == pytest.approx(middle_deg, nan_ok=True)


@pytest.mark.parametrize(
    ("latitude", "mean"),
    [
        ([0.4, np.nan, 0.6], 0.5),
        ([np.nan] * 3, np.pi / 4),
    ],
)
def test_the_mean_latitude_is_of_the_known_ones(latitude, mean):
    assert stations(lat_rad=latitude).mean_latitude_rad == pytest.approx(mean)


def test_a_suspect_station_does_not_move_the_middle_of_the_flight():
    place = {
        "lat_rad": [0.84, 0.0, 0.84],
        "lon_rad": [0.28, 0.0, 0.28],
    }
    flown = with_status("ok", "suspect", "ok", **place)
    assert flown.mean_latitude_rad == pytest.approx(0.84)
    assert flown.median_longitude_rad == pytest.approx(0.28)


def test_stations_that_are_known_worse_than_needed_are_a_loss_for_each_limit():
    uncertain = with_status(
        *("ok", "ok", "ok", "in_gap"),
        sigma_horizontal_m=[0.5, 2.0, 9.0, 0.5],
        sigma_height_m=[1.0, 1.0, np.nan, 1.0],
        sigma_tilt_rad=np.radians([0.1, 0.2, 0.3, 0.4]),
    )
    level, height, medians = sigma_notes(uncertain, SigmaLimits(1.0, 1.5, np.radians(0.35)))
    assert counted([level]) == [("loss", "STATIONS-SIGMA", 2)]
    assert counted([height]) == [("loss", "STATIONS-SIGMA", 1)]
    assert "the worst is image_2 with 9.00 m" in level.what
    assert "an unknown sigma" in height.what
    assert medians.kind == "note"
    for median in ("2.00 m", "1.00 m", "0.20 deg"):
        assert median in medians.what
    assert [note.kind for note in sigma_notes(uncertain, SigmaLimits())] == ["note"]
    unusable = uncertain.with_status(uncertain.ok, "in_gap")
    assert not list(sigma_notes(unusable, SigmaLimits(1.0, 1.0, 1.0)))


FLOWN = with_status(
    *("ok", "in_gap", "ok"),
    camera=image_names("nadir", "nadir", "oblique"),
    time_ns=instants(1_500_000_000, 1_500_000_060, 1_500_000_002),
    lon_rad=[0.1] * 3,
)


def test_stations_say_how_many_there_are_of_what_and_when():
    assert repr(FLOWN) == (
        "<Stations: 2 nadir, 1 oblique; 2 ok, 1 in_gap; "
        "2017-07-14T02:40:00 to 2017-07-14T02:41:00 UTC>"
    )
    assert repr(stations(1)) == "<Stations: 1 cam; 1 ok; no UTC>"
    page = FLOWN._repr_html_()
    assert page.count("<tr") == 4
    assert "image_2" in page


def test_stations_are_drawn_by_camera_and_usability():
    axis = FLOWN.plot()
    drawn = {line.get_label(): line.get_xdata().tolist() for line in axis.lines}
    one_place = pytest.approx([np.degrees(0.1)])
    assert drawn == {
        "nadir": one_place,
        "oblique": one_place,
        "not usable": one_place,
    }
    assert FLOWN.plot(axis) is axis
