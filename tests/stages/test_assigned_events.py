"""Events and images of one camera, without a mission around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.config.event_sources import FirstImage
from unbend.errors import MissionError
from unbend.flight.exposures import Events
from unbend.stages.multi_image.assignment_likelihoods import TIES, TieLikelihood
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.stages.multi_image.image_events import AssignedEvents, assigned_events
from unbend.tables.imports.exif import ImageTimes

NAMES = [f"a_{number}" for number in range(1, 6)]
SECONDS = np.array([0.0, 2.0, 4.5, 6.5, 9.0])


class NeverFits(TieLikelihood):
    """Tie points whose rays meet under no assignment, and which favour none."""

    def __init__(self):
        pass

    def __call__(self, event):
        return 0.0

    def fits(self, event):
        return False

    def share_met(self, events):
        return np.zeros(events.shape[0])


def test_tie_points_that_fit_nothing_change_nothing():
    """Numbers that only count the rows of a file name no event, with or without them."""
    events = Events(
        camera="nadir",
        image=np.array(NAMES, object),
        time_ns=(1e9 * SECONDS).astype(np.int64),
        index=np.arange(1, 6),
        counts="always",
    )
    images = CameraImages(
        name=np.array(NAMES[:4], object),
        number=np.arange(1, 5),
        numbering="index",
        file=np.full(4, -1),
    )
    first = FirstImage(image="a_1", event=1)
    alone, notes = assigned_events(events, images, None, first, {})
    beside, notes_beside = assigned_events(events, images, None, first, {TIES: NeverFits()})
    assert beside.rows.tolist() == alone.rows.tolist()
    assert [note.code for note in notes_beside] == [note.code for note in notes]


EVERY_OTHER_SECOND = 2.0 * np.arange(256)


def numbered_events(numbers: np.ndarray) -> Events:
    """Events of a log every other second, which has these numbers."""
    return Events(
        camera="nadir",
        image=np.array([f"I{number:04d}.jpg" for number in numbers], object),
        time_ns=(1e9 * EVERY_OTHER_SECOND[: numbers.size]).astype(np.int64),
        index=numbers,
    )


def numbered_images(numbers: np.ndarray, *, with_files: bool = False) -> CameraImages:
    """Images that are named by the log's numbers."""
    return CameraImages(
        name=np.array([f"I{number:04d}.jpg" for number in numbers], object),
        number=numbers,
        numbering="index",
        file=np.arange(numbers.size) if with_files else np.full(numbers.size, -1),
    )


def rows_of(assigned: AssignedEvents, numbers: np.ndarray) -> list[int]:
    """The rows of the events that images of some numbers have."""
    row_of_image = dict(zip(assigned.events.image, assigned.rows.tolist(), strict=True))
    return [row_of_image[f"I{number:04d}.jpg"] for number in numbers]


@pytest.mark.parametrize(
    "kept",
    [
        np.arange(61, 257),  # the test shots of the climb were not handed over
        np.arange(2, 257),
        np.arange(1, 201),
        np.arange(101, 141),
        np.concatenate([np.arange(1, 11), np.arange(200, 230)]),
        np.arange(201, 300),  # of 43 the log has no pulse
    ],
)
def test_numbers_of_the_log_hold_where_nothing_speaks_against_them(kept):
    """How usual it is that images are missing at the beginning is no evidence."""
    events = numbered_events(np.arange(1, 257))
    assigned, notes = assigned_events(events, numbered_images(kept), None, None, {})
    there = kept[kept <= 256]
    assert rows_of(assigned, there) == (there - 1).tolist()
    (told,) = [note for note in notes if note.code == "EVENTS-ASSIGNED"]
    assert "names (index)" in told.what


def files_of(time_s: np.ndarray, names: np.ndarray) -> ImageTimes:
    """Files of images with times of the camera's clock, of which nothing is known."""
    return ImageTimes(
        file=names,
        time_ns=(1e9 * time_s).astype(np.int64),
        sigma_s=np.full(time_s.size, 0.01),
        is_utc=False,
        position=np.full((time_s.size, 3), np.nan),
    )


def test_times_at_a_constant_interval_do_not_speak_against_numbers():
    """Every shift fits such times as well as the numbers do."""
    kept = np.arange(61, 257)
    images = numbered_images(kept, with_files=True)
    files = files_of(EVERY_OTHER_SECOND[kept - 1] + 3600.0, images.name)
    assigned, _ = assigned_events(numbered_events(np.arange(1, 257)), images, files, None, {})
    assert rows_of(assigned, kept) == (kept - 1).tolist()


def test_a_rhythm_of_times_contradicts_numbers_by_name():
    """Files that count from the first image kept, taken for the log's numbers: 60 events off."""
    rng = np.random.default_rng(4)
    time_s = np.cumsum(rng.uniform(1.5, 4.0, 256))
    events = replace(numbered_events(np.arange(1, 257)), time_ns=(1e9 * time_s).astype(np.int64))
    images = numbered_images(np.arange(1, 197), with_files=True)
    files = files_of(time_s[60:] - 7200.0, images.name)
    with pytest.raises(MissionError, match="EVENTS-CONTRADICTED") as refusal:
        assigned_events(events, images, files, None, {})
    assert "times contradict the numbers of the log" in str(refusal.value)


def test_a_stated_pair_that_contradicts_stated_numbers_is_refused_by_name():
    images = numbered_images(np.arange(61, 257))
    pair = FirstImage(image="I0061.jpg", event=1)
    with pytest.raises(MissionError, match="first_image contradict the numbers of the log"):
        assigned_events(numbered_events(np.arange(1, 257)), images, None, pair, {})


def test_a_stated_pair_holds_where_only_missing_images_speak_against_it():
    """Names that count by themselves, the pair in the midst of many events without an image."""
    images = replace(numbered_images(np.arange(1, 41)), numbering="sequence")
    pair = FirstImage(image="I0001.jpg", event=150)
    assigned, _ = assigned_events(numbered_events(np.arange(1, 257)), images, None, pair, {})
    assert assigned.rows.tolist() == list(range(149, 189))


def test_many_numbers_are_hypotheses_beside_the_stated_ones():
    """Tie points that favour the stated numbers find them among 1,500 equal shifts."""
    events = replace(
        numbered_events(np.arange(1, 257)),
        image=np.array([f"I{number:04d}.jpg" for number in range(1, 2001)], object),
        time_ns=np.arange(2000, dtype=np.int64) * 2_000_000_000,
        index=np.arange(1, 2001),
    )
    kept = np.arange(901, 1401)

    def by_ties(event: np.ndarray) -> float:
        return -0.5 * float(np.sum(event != kept - 1))

    assigned, notes = assigned_events(events, numbered_images(kept), None, None, {TIES: by_ties})
    assert rows_of(assigned, kept) == (kept - 1).tolist()
    assert "tie points" in notes[0].what
