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
LOGGED = np.arange(1, 257)
AFTER_THE_CLIMB = np.arange(61, 257)


def names_of(numbers):
    return np.array([f"I{number:04d}.jpg" for number in numbers], object)


def numbered_events(numbers=LOGGED, time_s=EVERY_OTHER_SECOND):
    """Events of a log every other second, which has these numbers."""
    time_ns = (1e9 * time_s[: numbers.size]).astype(np.int64)
    return Events("nadir", names_of(numbers), time_ns, index=numbers)


def numbered_images(numbers, *, numbering="index", files=-1):
    """Images that are named by the log's numbers."""
    rows = np.broadcast_to(files, numbers.shape)
    return CameraImages(names_of(numbers), numbers, numbering=numbering, file=rows)


def assigned(events, images, *, files=None, pair=None, ties=None):
    """Events of the images, and what is said of them."""
    likelihoods = {}
    if ties is not None:
        likelihoods[TIES] = ties
    return assigned_events(events, images, files, pair, likelihoods)


def assert_rows(events, numbers):
    """Images of some numbers have the events of these numbers, which count from one."""
    row_of_image = pd.Series(events.rows, index=events.events.image)
    assert row_of_image[names_of(numbers)].tolist() == (numbers - 1).tolist()


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
    rhythm = np.array([0.0, 2.0, 4.5, 6.5, 9.0])
    events = replace(numbered_events(np.arange(1, 6), rhythm), counts="always")
    images = numbered_images(np.arange(1, 5))
    pair = FirstImage(image="I0001.jpg", event=1)
    alone, notes = assigned(events, images, pair=pair)
    beside, notes_beside = assigned(events, images, pair=pair, ties=NeverFits())
    assert beside.rows.tolist() == alone.rows.tolist()
    assert [note.code for note in notes_beside] == [note.code for note in notes]


@pytest.mark.parametrize(
    "kept",
    [
        AFTER_THE_CLIMB,  # whose test shots were not handed over
        np.arange(2, 257),
        np.arange(1, 201),
        np.arange(101, 141),
        np.concatenate([np.arange(1, 11), np.arange(200, 230)]),
        np.arange(201, 300),  # of 43 the log has no pulse
    ],
)
def test_numbers_of_the_log_hold_where_nothing_speaks_against_them(kept):
    """How usual it is that images are missing at the beginning is no evidence."""
    events, notes = assigned(numbered_events(), numbered_images(kept))
    assert_rows(events, kept[kept <= 256])
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
    kept = AFTER_THE_CLIMB
    images = numbered_images(kept, files=np.arange(kept.size))
    time_s = EVERY_OTHER_SECOND[kept - 1] + 3600.0
    events, _ = assigned(numbered_events(), images, files=files_of(images, time_s))
    assert_rows(events, kept)


def test_a_rhythm_of_times_contradicts_numbers_by_name():
    """Files that count from the first image kept, taken for the log's numbers: 60 events off."""
    time_s = np.cumsum(np.random.default_rng(4).uniform(1.5, 4.0, 256))
    images = numbered_images(np.arange(1, 197), files=np.arange(196))
    files = files_of(images, time_s[60:] - 7200.0)
    events = numbered_events(time_s=time_s)
    with refused("EVENTS-CONTRADICTED") as refusal:
        assigned(events, images, files=files)
    assert "times contradict the numbers of the log" in str(refusal.value)


def test_a_stated_pair_that_contradicts_stated_numbers_is_refused_by_name():
    pair = FirstImage(image="I0061.jpg", event=1)
    images = numbered_images(AFTER_THE_CLIMB)
    with refused("EVENTS-CONTRADICTED") as refusal:
        assigned(numbered_events(), images, pair=pair)
    assert "first_image contradict the numbers of the log" in str(refusal.value)


def test_a_stated_pair_holds_where_only_missing_images_speak_against_it():
    """Names that count by themselves, the pair in the midst of many events without an image."""
    images = numbered_images(np.arange(1, 41), numbering="sequence")
    pair = FirstImage(image="I0001.jpg", event=150)
    events, _ = assigned(numbered_events(), images, pair=pair)
    assert events.rows.tolist() == [*range(149, 189)]


def test_many_numbers_are_hypotheses_beside_the_stated_ones():
    """Tie points that favour the stated numbers find them among 1,500 equal shifts."""
    kept = np.arange(901, 1401)

    def by_ties(event):
        return -0.5 * float(np.sum(event != kept - 1))

    all_events = numbered_events(np.arange(1, 2001))
    events, (note, *_) = assigned(all_events, numbered_images(kept), ties=by_ties)
    assert_rows(events, kept)
    assert "tie points" in note.what
