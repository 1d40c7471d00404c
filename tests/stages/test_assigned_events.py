"""Events and images of one camera, without a mission around them."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.helpers import refused, with_code
from unbend.config.event_sources import FirstImage
from unbend.flight.exposures import Events
from unbend.stages.multi_image.assignment_likelihoods import TIES, TieLikelihood
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.stages.multi_image.image_events import assigned_events
from unbend.tables.imports.exif import ImageTimes

EVERY_OTHER_SECOND = 2.0 * np.arange(2000)


def name_of(number):
    return f"I{number:04d}.jpg"


def names_of(numbers):
    return np.array([name_of(number) for number in numbers], object)


def numbers_of(first, last):
    return np.arange(first, last + 1)


LOGGED = numbers_of(1, 256)
AFTER_THE_CLIMB = numbers_of(61, 256)


def numbered_events(numbers=LOGGED, time_s=EVERY_OTHER_SECOND):
    """Events of a log every other second, which has these numbers."""
    time_ns = 1e9 * time_s[: numbers.size]
    return Events(
        "nadir",
        names_of(numbers),
        time_ns.astype(np.int64),
        index=numbers,
    )


def numbered_images(numbers, numbering="index"):
    """Images that are named by the log's numbers, each with a file."""
    rows = np.arange(numbers.size)
    return CameraImages(
        names_of(numbers),
        numbers,
        numbering=numbering,
        file=rows,
    )


def assigned(events, images, *, files=None, pair=None, ties=None):
    """Events of the images, and what is said of them."""
    if files is None:
        images = replace(images, file=np.full_like(images.file, -1))
    likelihoods = {}
    if ties is not None:
        likelihoods[TIES] = ties
    return assigned_events(events, images, files, pair, likelihoods)


def assert_rows(events, numbers):
    """Images of some numbers have the events of these numbers, which count from one."""
    row_of_image = pd.Series(events.rows, index=events.events.image)
    rows = row_of_image[names_of(numbers)]
    assert rows.tolist() == (numbers - 1).tolist()


@pytest.mark.parametrize(("logged", "rows"), [("", []), ("I0001.jpg", [0, 1, 2])])
def test_without_observed_images_events_are_those_with_a_name(logged, rows):
    events = Events("nadir", np.full(3, logged, object), np.arange(3) * 10**9)
    no_images = numbered_images(numbers_of(1, 0))
    taken, notes = assigned(events, no_images)
    assert taken.rows.tolist() == rows
    assert notes == ()


class NeverFits(TieLikelihood):
    """Tie points whose rays meet under no assignment, and which favour none."""

    def __init__(self):
        pass

    def __call__(self, event):
        return 0.0

    def fits(self, event):
        return False

    def share_met(self, events):
        return np.zeros(len(events))


def test_tie_points_that_fit_nothing_change_nothing():
    """Numbers that only count the rows of a file name no event, with or without them."""
    rhythm_s = np.array([0.0, 2.0, 4.5, 6.5, 9.0])
    events = numbered_events(numbers_of(1, 5), rhythm_s)
    events = replace(events, counts="always")
    images = numbered_images(numbers_of(1, 4))
    pair = FirstImage(image=name_of(1), event=1)

    alone, notes = assigned(events, images, pair=pair)
    beside, notes_beside = assigned(events, images, pair=pair, ties=NeverFits())

    assert beside.rows.tolist() == alone.rows.tolist()
    assert codes(notes_beside) == codes(notes)


def codes(notes):
    return [note.code for note in notes]


@pytest.mark.parametrize(
    "numbers",
    [
        AFTER_THE_CLIMB,  # whose test shots were not handed over
        numbers_of(2, 256),
        numbers_of(1, 200),
        numbers_of(101, 140),
        np.append(numbers_of(1, 10), numbers_of(200, 229)),
        numbers_of(201, 299),  # of 43 the log has no pulse
    ],
)
def test_numbers_of_the_log_hold_where_nothing_speaks_against_them(numbers):
    """How usual it is that images are missing at the beginning is no evidence."""
    events, notes = assigned(numbered_events(), numbered_images(numbers))
    assert_rows(events, numbers[numbers <= 256])
    (note,) = with_code(notes, "EVENTS-ASSIGNED")
    assert "names (index)" in note.what


def files_of(images, time_s):
    """Files of images with times of the camera's clock, of which nothing is known."""
    return ImageTimes(
        file=images.name,
        time_ns=(1e9 * time_s).astype(np.int64),
        sigma_s=np.full(time_s.size, 0.01),
        is_utc=False,
        position=np.full((time_s.size, 3), np.nan),
    )


def test_times_at_a_constant_interval_do_not_speak_against_numbers():
    """Every shift fits such times as well as the numbers do."""
    images = numbered_images(AFTER_THE_CLIMB)
    time_s = EVERY_OTHER_SECOND[60:256] + 3600.0
    files = files_of(images, time_s)
    events, _ = assigned(numbered_events(), images, files=files)
    assert_rows(events, AFTER_THE_CLIMB)


def test_a_rhythm_of_times_contradicts_numbers_by_name():
    """Files that count from the first image kept, taken for the log's numbers: 60 events off."""
    gaps_s = np.random.default_rng(4).uniform(1.5, 4.0, 256)
    time_s = np.cumsum(gaps_s)
    images = numbered_images(numbers_of(1, 196))
    files = files_of(images, time_s[60:] - 7200.0)
    events = numbered_events(time_s=time_s)
    with refused("EVENTS-CONTRADICTED", says="times contradict the numbers of the log"):
        assigned(events, images, files=files)


def test_a_stated_pair_that_contradicts_stated_numbers_is_refused_by_name():
    pair = FirstImage(image=name_of(61), event=1)
    images = numbered_images(AFTER_THE_CLIMB)
    with refused("EVENTS-CONTRADICTED", says="first_image contradict the numbers of the log"):
        assigned(numbered_events(), images, pair=pair)


def test_a_stated_pair_holds_where_only_missing_images_speak_against_it():
    """Names that count by themselves, the pair in the midst of many events without an image."""
    images = numbered_images(numbers_of(1, 40), "sequence")
    pair = FirstImage(image=name_of(1), event=150)
    events, _ = assigned(numbered_events(), images, pair=pair)
    assert events.rows.tolist() == [*range(149, 189)]


def test_many_numbers_are_hypotheses_beside_the_stated_ones():
    """Tie points that favour the stated numbers find them among 1,500 equal shifts."""
    numbers = numbers_of(901, 1400)

    def by_ties(event):
        return -0.5 * np.count_nonzero(event != numbers - 1)

    all_events = numbered_events(numbers_of(1, 2000))
    images = numbered_images(numbers)
    events, (note, *_) = assigned(all_events, images, ties=by_ties)
    assert_rows(events, numbers)
    assert "tie points" in note.what
