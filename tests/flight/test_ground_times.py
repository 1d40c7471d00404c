"""When an aircraft stands on the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.exposures import ground_shot_notes
from unbend.flight.ground_times import (
    GroundEvidence,
    LoggedPath,
    home_is_set,
    takeoff_of,
    times_on_the_ground,
)
from unbend.flight.heights import height_system, known_home_m, with_begin_of_log
from unbend.flight.stations import STATION_OK, empty_stations
from unbend.messages import Kind

SECOND_NS = 1_000_000_000


def test_a_log_without_one_home_proposes_where_it_begins():
    """A minute at 400 m; the home of the autopilot jumps by 30 m in the air: it is not used."""
    seconds = np.arange(600)
    h_msl_m = 400.0 + np.clip(seconds - 60, 0, 100)
    home_m = np.where(seconds < 300, 400.0, 430.0)
    columns = {
        "lat_rad": np.full(600, 0.8),
        "lon_rad": np.full(600, 0.15),
        "h_msl_m": h_msl_m,
        "h_home_m": h_msl_m - home_m,
    }
    channel = Channel("GPS", seconds * SECOND_NS, columns, Source("GPS"))
    roles = {"position": channel, "height": channel}
    system, notes = height_system(roles, None)
    assert system.home_h_msl_m is None
    assert [note.code for note in notes] == ["HEIGHT-HOME"]
    begun = with_begin_of_log(system, roles, GroundEvidence(), 2.0)
    assert begun.begin_h_msl_m == pytest.approx(400.0)
    with pytest.raises(MissionError, match="HEIGHT-REFERENCE") as caught:
        known_home_m(begun)
    assert "write ground.home_h_msl_m: 400.0" in caught.value.remedy
    with pytest.raises(MissionError) as caught:
        known_home_m(system)
    assert "ground.home_h_msl_m" in caught.value.remedy
    assert "400" not in caught.value.remedy
    steady, _ = height_system(roles, None, stated_home_m=410.0)
    assert with_begin_of_log(steady, roles, GroundEvidence(), 2.0) == steady


def test_a_longitude_that_is_unknown_hides_no_landing():
    """A minute on the ground, a flight of ten minutes to the east, a minute on the ground."""
    seconds = np.arange(720)
    flown_s = np.clip(seconds - 60, 0, 600)
    height_m = 400.0 + np.minimum(np.minimum(flown_s, 600 - flown_s) * 2.0, 100.0)
    lon_rad = 0.15 + flown_s * 20.0 / 6.37e6
    lon_rad[300] = np.nan
    columns = {"lat_rad": np.full(720, 0.8), "lon_rad": lon_rad, "h_msl_m": height_m}
    position = Channel("GPS", seconds * SECOND_NS, columns, Source("GPS"))
    on_the_ground_s = times_on_the_ground(position) // SECOND_NS
    assert set(range(61)) <= set(on_the_ground_s.tolist())
    assert set(range(661, 720)) <= set(on_the_ground_s.tolist())
    assert not set(range(70, 650)) & set(on_the_ground_s.tolist())


HOVER_S = np.arange(190)
POSITION = ("position",)


def hover(**columns: object) -> Channel:
    """A hover of three minutes 500 m above the take-off, ten seconds 100 m higher at its end."""
    height_m = np.where(HOVER_S < 180, 950.0, 1050.0)
    arrays = {"lat_rad": 0.8, "lon_rad": 0.15, "h_msl_m": height_m} | columns
    arrays = {
        name: np.broadcast_to(np.asarray(value, float), HOVER_S.shape)
        for name, value in arrays.items()
    }
    return Channel("POS", HOVER_S * SECOND_NS, arrays, Source("POS"), roles=POSITION)


def said(name: str, seconds: list[int], column: str, *values: float) -> Channel:
    times_ns = np.array(seconds) * SECOND_NS
    return Channel(name, times_ns, {column: np.array(values)}, Source(name))


def words(seconds: list[int], *texts: str) -> Channel:
    times_ns = np.array(seconds) * SECOND_NS
    return Channel("EV", times_ns, {}, Source("EV"), labels={"text": texts})


FLIES = [
    (hover(h_home_m=500.0), []),
    (hover(), [said("vehicle_land_detected", [0], "landed", 0.0)]),
    (hover(), [said("EXTENDED_SYS_STATE", [0, 60], "landed_state", 2.0, 4.0)]),
    (hover(), [said("STAT", [0], "flying", 1.0)]),
    (hover(), [said("home_position", [0], "home_h_msl_m", 450.0)]),
    (hover(), [words([0], "EV NOT_LANDED")]),
    # two detectors contradict each other: the height above the take-off decides
    (
        hover(h_home_m=500.0),
        [words([0], "EV LAND_COMPLETE"), said("STAT", [0], "flying", 1.0)],
    ),
]


@pytest.mark.parametrize(("position", "others"), FLIES)
def test_a_hover_is_no_ground(position: Channel, others: list[Channel]) -> None:
    evidence = GroundEvidence.of([position, *others])
    assert times_on_the_ground(position, evidence).size == 0
    track = tuple(position[name] for name in ("lat_rad", "lon_rad", "h_msl_m"))
    assert takeoff_of(LoggedPath(position.time_ns, *track), None, evidence) is None
    assert times_on_the_ground(position).size > 100  # nothing but the motion


def test_a_log_that_never_rises_shows_no_ground() -> None:
    assert times_on_the_ground(hover(h_msl_m=950.0)).size == 0


def test_what_the_log_says_of_standing_holds_where_it_stands_still() -> None:
    """It stands on a hill, 500 m above the lowest place; or at a home that is not set yet."""
    lowest = np.where(HOVER_S > 185, 450.0, 950.0)
    on_a_hill = hover(h_msl_m=lowest, h_home_m=500.0)
    landed = said("vehicle_land_detected", [0, 100], "landed", 1.0, 0.0)
    evidence = GroundEvidence.of([on_a_hill, landed])
    on_ground_s = times_on_the_ground(on_a_hill, evidence) // SECOND_NS
    assert on_ground_s.tolist() == list(range(100))
    home_m = np.where(HOVER_S < 60, 950.0, 0.0)  # above the sea until home is set
    unset = hover(h_home_m=home_m)
    on_ground_s = times_on_the_ground(unset, GroundEvidence.of([unset])) // SECOND_NS
    assert set(range(60)) <= set(on_ground_s.tolist())


def test_a_home_that_was_never_set_is_no_home_at_sea_level():
    h_msl_m = np.array([500.0, 520.0, np.nan])
    assert not home_is_set(h_msl_m, h_msl_m).any()
    assert home_is_set(h_msl_m - 495.0, h_msl_m - 495.0).tolist() == [True, True, False]
    assert home_is_set(h_msl_m, h_msl_m - [500.0, 0.0, 0.0]).tolist() == [True, False, False]
    assert home_is_set(np.full(3, np.nan), np.array([1.0, 2.0, 3.0])).all()


@pytest.mark.parametrize(("above_home_m", "flies"), [(19.0, False), (21.0, True)])
def test_it_flies_twenty_metres_above_its_takeoff(above_home_m: float, flies: bool) -> None:
    position = hover(h_home_m=above_home_m)
    evidence = GroundEvidence.of([position])
    assert evidence.flies(position.time_ns[10:12]).tolist() == [flies, flies]


@pytest.mark.parametrize(("gap_s", "flies"), [(4.9, True), (5.1, False)])
def test_a_height_above_home_reaches_over_gaps_of_five_seconds(gap_s: float, flies: bool) -> None:
    seconds = np.concatenate([np.arange(0.0, 20.1, 0.1), 20.0 + gap_s + np.arange(0.0, 20.0, 0.1)])
    time_ns = np.round(seconds * SECOND_NS).astype(np.int64)
    values = {"lat_rad": 0.8, "lon_rad": 0.15, "h_msl_m": 950.0, "h_home_m": 500.0}
    columns = {name: np.full(seconds.shape, value) for name, value in values.items()}
    position = Channel("POS", time_ns, columns, Source("POS"), roles=POSITION)
    inside_ns = np.array([round((20.0 + gap_s / 2.0) * SECOND_NS)])
    assert GroundEvidence.of([position]).flies(inside_ns).tolist() == [flies]


@pytest.mark.parametrize(
    ("flown", "images", "kind", "words"),
    [
        (5, ["g1"], Kind.WARNING, "; 1 of them is in the observations"),
        (5, ["g1", "g2", "a3"], Kind.WARNING, "; 2 of them are in the observations"),
        (5, ["a3"], Kind.NOTE, ""),
        (3, [], Kind.NOTE, ""),  # half of all exposures
        (2, [], Kind.LOSS, ""),
    ],
)
def test_exposures_on_the_ground_are_counted(
    flown: int, images: list[str], kind: Kind, words: str
) -> None:
    """Three test shots within 60 s on the ground, and one second behind; the others in the air."""
    seconds = np.arange(0.0, 700.0)
    height_m = np.interp(seconds, [60.0, 120.0], [450.0, 950.0])
    position = Channel(
        "POS",
        (seconds * SECOND_NS).astype(np.int64),
        {"lat_rad": np.full(700, 0.8), "lon_rad": np.full(700, 0.15), "h_msl_m": height_m},
        Source("POS"),
        roles=("position", "height"),
    )
    landed = said("vehicle_land_detected", [0, 60], "landed", 1.0, 0.0)
    count = 3 + flown
    stations = replace(
        empty_stations(
            np.array(["g1", "g2", "g3", *(f"a{k}" for k in range(flown))], dtype=object),
            np.full(count, "nadir", dtype=object),
            STATION_OK,
        ),
        time_ns=np.array([5, 20, 40, *range(300, 300 + flown)], np.int64) * SECOND_NS,
    )
    evidence = GroundEvidence.of([position, landed])
    (message,) = ground_shot_notes(stations, {"height": position}, images, evidence)
    assert (message.kind, message.count, message.where) == (kind, 3, "events")
    assert message.values["in_observations"] == words
    assert message.values["listed"] == "g1, g2, g3"
