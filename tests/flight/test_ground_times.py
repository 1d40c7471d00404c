"""When an aircraft stands on the ground, and which exposures are of then."""

import numpy as np
import pytest

from tests.flight.made_channels import counted, instants, texts, usable_stations
from tests.helpers import NS_PER_S, channel, refused
from unbend.errors import MissionError
from unbend.flight.exposures import ground_shot_notes
from unbend.flight.ground_times import (
    GroundEvidence,
    LoggedPath,
    home_is_set,
    takeoff_of,
    times_on_the_ground,
)
from unbend.flight.heights import height_system, required_home_m, with_begin_of_log

NAN = float("nan")
PLACE = {"lat_rad": 0.8, "lon_rad": 0.15}


def seconds_on_the_ground(position, *channels):
    """Whole seconds at which the aircraft stands, as a position and further channels say."""
    evidence = GroundEvidence.of([position, *channels])
    return (times_on_the_ground(position, evidence) // NS_PER_S).tolist()


def test_a_log_without_one_home_proposes_where_it_begins():
    """A minute at 400 m; the home of the autopilot jumps by 30 m in the air: it is not used."""
    seconds = np.arange(600)
    h_msl_m = 400.0 + np.clip(seconds - 60, 0, 100)
    home_m = np.where(seconds < 300, 400.0, 430.0)
    gps = channel(
        "GPS",
        seconds,
        **PLACE,
        h_msl_m=h_msl_m,
        h_home_m=h_msl_m - home_m,
    )
    roles = {"position": gps, "height": gps}

    system, (note,) = height_system(roles, None)
    begun = with_begin_of_log(system, roles, GroundEvidence(), 2.0)

    assert system.home_h_msl_m is None
    assert note.code == "HEIGHT-HOME"
    assert begun.begin_h_msl_m == pytest.approx(400.0)
    with refused("HEIGHT-REFERENCE", MissionError, remedy="write ground.home_h_msl_m: 400.0"):
        required_home_m(begun)
    with refused("HEIGHT-REFERENCE", MissionError) as refusal:
        required_home_m(system)
    assert "ground.home_h_msl_m" in refusal.value.remedy
    assert "400" not in refusal.value.remedy
    with_home, _ = height_system(roles, None, stated_home_m=410.0)
    assert with_begin_of_log(with_home, roles, GroundEvidence(), 2.0) == with_home


def test_a_longitude_that_is_unknown_hides_no_landing():
    """A minute on the ground, a flight of ten minutes to the east, a minute on the ground."""
    seconds = np.arange(720)
    flown_s = np.clip(seconds - 60, 0, 600)
    from_an_end_s = np.minimum(flown_s, 600 - flown_s)
    lon_rad = 0.15 + flown_s * 20.0 / 6.37e6
    lon_rad[300] = NAN
    flown = channel(
        "GPS",
        seconds,
        lat_rad=0.8,
        lon_rad=lon_rad,
        h_msl_m=400.0 + np.minimum(from_an_end_s * 2.0, 100.0),
    )
    assert seconds_on_the_ground(flown) == [*range(61), *range(660, 720)]


HOVER_S = np.arange(190)


def hover(**columns):
    """A hover of three minutes 500 m above the take-off, ten seconds 100 m higher at its end."""
    height_m = np.where(HOVER_S < 180, 950.0, 1050.0)
    return channel("POS", HOVER_S, "position", **PLACE | {"h_msl_m": height_m} | columns)


FLYING = channel("STAT", [0], flying=1.0)


@pytest.mark.parametrize(
    ("position", "evidence"),
    [
        (hover(h_home_m=500.0), []),
        (hover(), [channel("vehicle_land_detected", [0], landed=0.0)]),
        (
            hover(),
            [channel("EXTENDED_SYS_STATE", [0, 60], landed_state=[2.0, 4.0])],
        ),
        (hover(), [FLYING]),
        (hover(), [channel("home_position", [0], home_h_msl_m=450.0)]),
        (hover(), [texts("EV", (0, "EV NOT_LANDED"))]),
        # two detectors contradict each other: the height above the take-off decides
        (hover(h_home_m=500.0), [texts("EV", (0, "EV LAND_COMPLETE")), FLYING]),
    ],
)
def test_a_hover_is_no_ground(position, evidence):
    assert seconds_on_the_ground(position, *evidence) == []
    path = LoggedPath(
        position.time_ns,
        position["lat_rad"],
        position["lon_rad"],
        position["h_msl_m"],
    )
    assert takeoff_of(path, None, GroundEvidence.of([position, *evidence])) is None
    assert times_on_the_ground(position).size > 100  # nothing but the motion


def test_a_log_that_never_rises_shows_no_ground():
    assert times_on_the_ground(hover(h_msl_m=950.0)).size == 0


def test_an_aircraft_that_stands_on_a_hill_is_on_the_ground():
    """500 m above the lowest place."""
    height_m = np.where(HOVER_S > 185, 450.0, 950.0)
    landed = channel("vehicle_land_detected", [0, 100], landed=[1.0, 0.0])
    on_a_hill = hover(h_msl_m=height_m, h_home_m=500.0)
    assert seconds_on_the_ground(on_a_hill, landed) == list(range(100))


def test_heights_above_home_that_are_missing_for_a_while_count_where_they_are_known():
    """The home that the autopilot logs is 400 m below the stated heights above it."""
    above_home_m = np.where(HOVER_S < 20, np.nan, 0.0)
    home = channel("ORGN", [0], home_h_msl_m=550.0)
    on_the_ground = seconds_on_the_ground(hover(h_home_m=above_home_m), home)
    assert set(range(20, 180)) <= set(on_the_ground)


def test_an_aircraft_whose_home_is_not_set_yet_may_stand():
    """Until home is set, its height above home is that above the sea."""
    above_home_m = np.where(HOVER_S < 60, 950.0, 0.0)
    on_the_ground = seconds_on_the_ground(hover(h_home_m=above_home_m))
    assert set(range(60)) <= set(on_the_ground)


@pytest.mark.parametrize(
    ("h_msl_m", "above_home_m", "is_set"),
    [
        ([500.0, 520.0, NAN], [500.0, 520.0, NAN], [False] * 3),
        (
            [5.0, 25.0, NAN],
            [5.0, 25.0, NAN],
            [True, True, False],
        ),  # at sea level
        (
            [500.0, 520.0, NAN],
            [0.0, 520.0, NAN],
            [True, False, False],
        ),
        ([NAN] * 3, [1.0, 2.0, 3.0], [True] * 3),
    ],
)
def test_a_home_that_was_never_set_is_no_home_at_sea_level(h_msl_m, above_home_m, is_set):
    assert home_is_set(np.array(h_msl_m), np.array(above_home_m)).tolist() == is_set


@pytest.mark.parametrize(("above_home_m", "flies"), [(19.0, False), (21.0, True)])
def test_it_flies_twenty_metres_above_its_takeoff(above_home_m, flies):
    evidence = GroundEvidence.of([hover(h_home_m=above_home_m)])
    assert evidence.flies(instants(10, 11)).tolist() == [flies, flies]


@pytest.mark.parametrize(("gap_s", "flies"), [(4.9, True), (5.1, False)])
def test_a_height_above_home_reaches_over_gaps_of_five_seconds(gap_s, flies):
    tenths = np.arange(200) / 10.0
    seconds = np.concatenate([tenths, [20.0], 20.0 + gap_s + tenths])
    position = channel(
        "POS",
        seconds,
        "position",
        **PLACE,
        h_msl_m=950.0,
        h_home_m=500.0,
    )
    in_gap_ns = instants(20.0 + gap_s / 2.0)
    assert GroundEvidence.of([position]).flies(in_gap_ns).tolist() == [flies]


def ascent():
    """A minute on the ground, a climb of a minute, and level."""
    seconds = np.arange(0.0, 700.0)
    height_m = np.interp(seconds, [60.0, 120.0], [450.0, 950.0])
    return channel(
        "POS",
        seconds,
        "position",
        "height",
        **PLACE,
        h_msl_m=height_m,
    )


@pytest.mark.parametrize(
    ("flown", "observed", "kind", "says"),
    [
        (5, ["g1"], "warning", "; 1 of them is in the observations"),
        (5, ["g1", "g2", "a3"], "warning", "; 2 of them are in the observations"),
        (5, ["a3"], "note", ""),
        (3, [], "note", ""),  # half of all exposures
        (2, [], "loss", ""),
    ],
)
def test_exposures_on_the_ground_are_counted(flown, observed, kind, says):
    """Three test shots on the ground, the last less than a second behind; others in the air."""
    position = ascent()
    landed = channel("vehicle_land_detected", [0, 60], landed=[1.0, 0.0])
    evidence = GroundEvidence.of([position, landed])
    in_the_air = range(300, 300 + flown)
    names = [f"a{number}" for number in range(flown)]
    time_ns = instants(5, 20, 59.9, *in_the_air)
    stations = usable_stations(time_ns, "g1", "g2", "g3", *names)

    notes = ground_shot_notes(stations, {"height": position}, observed, evidence)

    assert counted(notes) == [(kind, "EVENTS-ON-GROUND", 3)]
    assert notes[0].where == "events"
    assert notes[0].values["in_observations"] == says
    assert notes[0].values["listed"] == "g1, g2, g3"


def test_exposures_in_the_air_are_none_on_the_ground():
    """One a second behind the last instant on the ground."""
    position = ascent()
    last_s = seconds_on_the_ground(position)[-1]
    stations = usable_stations(instants(last_s + 1, 300), "a", "b")
    assert ground_shot_notes(stations, {"height": position}, []) == ()
