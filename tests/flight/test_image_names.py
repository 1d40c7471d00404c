"""Names that differ in case, ending, folder, digits; events of another time or on the ground."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.exposures import Events, ground_shot_notes, span_notes
from unbend.flight.image_names import other_names, proposal, refuse_other_names, renamed
from unbend.flight.stations import STATION_OK, empty_stations

SECOND = 10**9
T0 = 1_777_000_000 * SECOND


@pytest.mark.parametrize(
    ("images", "known", "differences"),
    [
        (["A.JPG", "B.JPG"], ["a.jpg", "b.jpg"], ["case"]),
        (["A.tif", "B.tif"], ["A.NEF", "B"], ["extension"]),
        (["f1/A", "f1/B"], ["A", "x\\B"], ["folder"]),
        (["DSC_0001", "DSC_0012"], ["DSC1", "DSC-12"], ["digits"]),
        (
            ["L/DSC_0001.JPG", "L/DSC_0012.JPG"],
            ["dsc1.tif", "dsc012"],
            ["case", "extension", "folder", "digits"],
        ),
    ],
)
def test_each_difference_matches_and_is_proposed(images, known, differences):
    expected = dict(zip(known, images, strict=True))
    assert other_names(images, known, differences) == expected
    text = proposal(images, known)
    assert text.startswith("2 of them")
    assert f"[{', '.join(differences)}]" in text
    for left_out in differences:
        assert other_names(images, known, [d for d in differences if d != left_out]) == {}


def test_two_names_that_become_one_match_nothing():
    assert other_names(["DSC_1", "DSC_01"], ["DSC1"], ["digits"]) == {}
    assert other_names(["DSC_1"], ["DSC1", "DSC01"], ["digits"]) == {}
    assert other_names(["1_01"], ["11", "101"], ["digits"]) == {}
    assert other_names(["a.JPG", "a"], ["a"], ["extension"]) == {}  # the exact name is taken


def test_names_change_only_where_that_is_stated():
    names = np.array(["dsc1", "other", ""], object)
    same, notes = renamed(names, ["DSC1"], [], "events")
    assert same is names
    assert notes == ()
    changed, (entry,) = renamed(names, ["DSC1"], ["case"], "events")
    assert changed.tolist() == ["DSC1", "other", ""]
    assert (entry.code, entry.count) == ("IMAGES-RENAMED", 1)


def test_composed_and_decomposed_names_are_the_same_image():
    """One folder on macOS, one elsewhere; the observations' spelling stays."""
    decomposed = "Fla\u0308che 1.jpg"
    names = np.array([decomposed, "b.jpg"], object)
    changed, (entry,) = renamed(names, ["Fl\u00e4che 1.jpg", "b.jpg"], [], "events")
    assert changed.tolist() == ["Fl\u00e4che 1.jpg", "b.jpg"]
    assert (entry.code, entry.count) == ("IMAGES-RENAMED", 1)
    assert "a\\xcc\\x88" in entry.what
    back, _ = renamed(changed, [decomposed], [], "events")
    assert back.tolist() == [decomposed, "b.jpg"]
    assert renamed(names, [decomposed, "b.jpg"], [], "events") == (names, ())


def test_names_that_look_alike_are_shown_with_their_bytes():
    """A Cyrillic letter in one of them."""
    with pytest.raises(MissionError) as refused:
        refuse_other_names({"c": ["\u0410_1.jpg"]}, ["A_1.jpg"])
    assert "b'\\xd0\\x90_1.jpg'" in str(refused.value)
    assert "like 'A_1.jpg'," in str(refused.value)


def test_a_camera_without_any_of_the_images_is_refused():
    images = [f"IMG_{k:04d}.JPG" for k in range(10)]
    with pytest.raises(MissionError) as caught:
        refuse_other_names({"cam": [f"img_{k}.jpg" for k in range(8)]}, images)
    assert caught.value.code == "IMAGES-OTHER"
    assert "8 of them" in caught.value.what
    assert "[case, digits]" in caught.value.what
    # One camera was not measured, and a few images have no exposure.
    refuse_other_names({"a": images[:8], "b": [f"b{k}" for k in range(8)]}, images)
    with pytest.raises(MissionError, match="0 exposures of b"):
        refuse_other_names({"a": images[:8], "b": []}, images)


def flown(seconds: int = 3600) -> Channel:
    """Five minutes on the ground, a flight of 300 m height, five minutes on the ground."""
    t = np.arange(seconds)
    up = np.interp(t, [300, 400, seconds - 400, seconds - 300], [0.0, 300.0, 300.0, 0.0])
    along = np.clip(t - 300, 0, seconds - 600) * 20.0
    columns = {"lat_rad": 0.8 + along / 6.37e6, "lon_rad": np.full(t.size, 0.1), "h_msl_m": up}
    return Channel("GPS", T0 + t * SECOND, columns, Source("GPS"))


def events(first_s: float, shift_s: float) -> list[Events]:
    time = first_s + np.arange(100) * 20.0 + shift_s
    names = np.array([f"i{k}" for k in range(100)], object)
    return [Events("cam", names, T0 + np.rint(time * 1e9).astype(np.int64))]


@pytest.mark.parametrize(
    ("late_s", "words"),
    [(7200, "-7200 s"), (-86400, "+86400 s"), (604800, "-604800 s"), (-18000, "+18000 s")],
)
def test_events_of_another_time_are_refused_with_what_would_fit(late_s, words):
    """The log has an hour, the events 33 minutes from its eleventh: one zone alone fits."""
    with pytest.raises(MissionError) as caught:
        span_notes(events(1500.0, late_s), flown(), "events.csv.columns.time_utc")
    assert caught.value.code == "EVENTS-SPAN"
    assert words in caught.value.what
    assert "2026-04-24T0" in caught.value.what
    assert caught.value.where == "events.csv.columns.time_utc"


def test_no_offset_is_named_that_brings_nothing():
    """Events for two hours beside a log of one: some lie beyond it wherever they begin."""
    time = np.linspace(0.2, 7200.0, 100)
    names = np.array([f"i{k}" for k in range(100)], object)
    long = [Events("cam", names, T0 + np.rint(time * 1e9).astype(np.int64))]
    (entry,) = span_notes(long, flown(), "events")
    assert "nor a week would bring all of them into the flight" in entry.what
    assert " +0 s" not in entry.what


def test_events_that_begin_before_the_log_are_told_with_eighteen_seconds():
    (entry,) = span_notes(events(0.0, -18.0), flown(), "events")
    assert (entry.kind, entry.count) == ("warning", 1)
    assert "+18 s would bring all of them into the flight" in entry.what
    assert span_notes(events(0.0, 0.0), flown(), "events") == ()


@pytest.mark.parametrize(
    ("first_s", "measured", "kind", "count"),
    [
        (230.0, ["i50"], "note", 4),
        (230.0, ["i2", "i50"], "warning", 4),
    ],
)
def test_shots_on_the_ground_are_named(first_s, measured, kind, count):
    """Exposures every 20 s from 70 s before the take-off: four stand."""
    of = events(first_s, 0.0)[0]
    stations = empty_stations(of.image, np.full(100, "cam", object), STATION_OK)
    object.__setattr__(stations, "time_ns", of.time_ns)
    (entry,) = ground_shot_notes(stations, {"height": flown()}, measured)
    assert (entry.code, entry.kind, entry.count) == ("EVENTS-ON-GROUND", kind, count)
    assert "i0, i1, i2, i3" in entry.what
    later = empty_stations(of.image, np.full(100, "cam", object), STATION_OK)
    object.__setattr__(later, "time_ns", of.time_ns + 200 * SECOND)
    assert ground_shot_notes(later, {"height": flown()}, measured) == ()


def test_a_flight_whose_events_are_all_on_the_ground_is_a_loss():
    of = events(0.0, 0.0)[0]
    stations = empty_stations(of.image[:12], np.full(12, "cam", object), STATION_OK)
    object.__setattr__(stations, "time_ns", of.time_ns[:12])
    (entry,) = ground_shot_notes(stations, {"height": flown()}, [])
    assert entry.kind == "loss"
