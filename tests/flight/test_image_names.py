"""Names that differ in case, ending, folder, digits; events of another time."""

import numpy as np
import pytest

from tests.flight.made_channels import EARTH_M, counted, image_names, instants
from tests.helpers import channel, refused
from unbend.errors import MissionError
from unbend.flight.exposures import Events, span_notes
from unbend.flight.image_names import (
    images_by_name,
    propose_differences,
    refuse_other_names,
    renamed_like_images,
    shift_of_names,
)


@pytest.mark.parametrize(
    ("images", "logged", "differences"),
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
def test_each_difference_matches_and_is_proposed(images, logged, differences):
    matches = dict(zip(logged, images, strict=True))
    assert images_by_name(images, logged, differences) == matches
    text = propose_differences(images, logged)
    assert text.startswith("2 of them")
    assert f"[{', '.join(differences)}]" in text
    for left_out in differences:
        fewer = [difference for difference in differences if difference != left_out]
        assert images_by_name(images, logged, fewer) == {}


@pytest.mark.parametrize(
    ("images", "logged", "difference"),
    [
        (["DSC_1", "DSC_01"], ["DSC1"], "digits"),
        (["DSC_1"], ["DSC1", "DSC01"], "digits"),
        (["1_01"], ["11", "101"], "digits"),
        (["a.JPG", "a"], ["a"], "extension"),  # the exact name is taken
    ],
)
def test_two_names_that_become_one_match_nothing(images, logged, difference):
    assert images_by_name(images, logged, [difference]) == {}


def test_names_change_only_where_that_is_stated():
    names = image_names("dsc1", "other", "")
    assert renamed_like_images(names, ["DSC1"], [], "events") == (names, ())
    changed, notes = renamed_like_images(names, ["DSC1"], ["case"], "events")
    assert changed.tolist() == ["DSC1", "other", ""]
    assert counted(notes) == [("note", "IMAGES-RENAMED", 1)]


COMPOSED = "Fl\u00e4che 1.jpg"
DECOMPOSED = "Fla\u0308che 1.jpg"


@pytest.mark.parametrize(
    ("of_events", "observed"),
    [(COMPOSED, DECOMPOSED), (DECOMPOSED, COMPOSED)],
)
def test_composed_and_decomposed_names_are_the_same_image(of_events, observed):
    """One folder on macOS, one elsewhere; the observations' spelling stays."""
    names = image_names(of_events, "b.jpg")
    images = [observed, "b.jpg"]
    changed, notes = renamed_like_images(names, images, [], "events")
    assert changed.tolist() == images
    assert counted(notes) == [("note", "IMAGES-RENAMED", 1)]
    assert "a\\xcc\\x88" in notes[0].what
    assert renamed_like_images(changed, images, [], "events") == (changed, ())


@pytest.mark.parametrize(
    ("first_image", "images", "shift"),
    [(8, 5, 1), (9, 5, 2), (6, 5, -1), (7, 5, 0), (7, 6, 0), (19, 5, 0)],
    ids=["one later", "two later", "one earlier", "equal", "one more", "nothing in common"],
)
def test_names_that_are_shifted(first_image, images, shift):
    """Exposures 7 to 11 of one camera; a second camera has one more image than exposures."""
    exposures = [f"left/IMG_{number}.tif" for number in range(7, 12)]
    exposures += ["right/IMG_7.tif"]
    observed = [f"left/IMG_{number}.tif" for number in range(first_image, first_image + images)]
    observed += ["right/IMG_7.tif", "right/IMG_8.tif"]
    assert shift_of_names(observed, exposures) == shift


def test_names_that_look_alike_are_shown_with_their_bytes():
    """A Cyrillic letter in one of them."""
    with refused("IMAGES-OTHER", MissionError) as refusal:
        refuse_other_names({"c": ["\u0410_1.jpg"]}, ["A_1.jpg"])
    assert "b'\\xd0\\x90_1.jpg'" in str(refusal.value)
    assert "like 'A_1.jpg'," in str(refusal.value)


IMAGES = [f"IMG_{number:04d}.JPG" for number in range(10)]
OTHER_NAMES = [f"img_{number}.jpg" for number in range(8)]


@pytest.mark.parametrize(
    ("of_cameras", "says"),
    [
        ({"cam": OTHER_NAMES}, ["8 of them", "[case, digits]"]),
        (
            {
                "a": IMAGES[:8],
                "b": [],
            },
            ["0 exposures of b"],
        ),
    ],
    ids=["other names", "no exposures"],
)
def test_a_camera_without_any_of_the_images_is_refused(of_cameras, says):
    with refused("IMAGES-OTHER", MissionError) as refusal:
        refuse_other_names(of_cameras, IMAGES)
    for text in says:
        assert text in refusal.value.what


def test_a_camera_that_was_not_measured_and_a_few_images_without_exposure_are_not_refused():
    of_another = [f"b{number}" for number in range(8)]
    refuse_other_names({"a": IMAGES[:8], "b": of_another}, IMAGES)


BEGIN_S = 1_777_000_000  # 2026-04-24T03:06:40
SECONDS = np.arange(3600)
FLOWN_S = np.clip(SECONDS - 300, 0, 3000)
FLOWN = channel(
    "GPS",
    BEGIN_S + SECONDS,
    lat_rad=0.8 + FLOWN_S * 20.0 / EARTH_M,
    lon_rad=0.1,
)
"""An hour with 50 minutes of flight."""


def notes_of_events(first_s, spacing_s=20.0):
    """What is said of a hundred events, by seconds from the begin of the log."""
    seconds = BEGIN_S + first_s + spacing_s * np.arange(100)
    events = Events("cam", image_names(*[""] * 100), instants(*seconds))
    return span_notes([events], FLOWN, "events.csv.columns.time_utc")


@pytest.mark.parametrize(
    ("late_s", "says"),
    [
        (7200, "-7200 s"),
        (-86400, "+86400 s"),
        (604800, "-604800 s"),
        (-18000, "+18000 s"),
    ],
)
def test_events_of_another_time_are_refused_with_what_would_fit(late_s, says):
    """The log has an hour, the events 33 minutes from its 25th: one zone alone fits."""
    with refused("EVENTS-SPAN", MissionError) as refusal:
        notes_of_events(1500.0 + late_s)
    assert f"{says} would bring all of them" in refusal.value.what
    assert "2026-04-24T0" in refusal.value.what
    assert refusal.value.where == "events.csv.columns.time_utc"


def test_no_offset_is_named_that_brings_nothing():
    """Events for two hours beside a log of one: some lie beyond it wherever they begin."""
    (note,) = notes_of_events(0.2, 72.0)
    assert "nor a week would bring all of them into the flight" in note.what
    assert " +0 s" not in note.what


def test_events_that_begin_before_the_log_are_told_with_eighteen_seconds():
    notes = notes_of_events(-18.0)
    assert counted(notes) == [("warning", "EVENTS-SPAN", 1)]
    assert "+18 s would bring all of them into the flight" in notes[0].what
    assert notes_of_events(0.0) == ()
