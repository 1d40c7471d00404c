"""Events and images of one camera, without a mission around them."""

from __future__ import annotations

import numpy as np

from unbend.config.event_sources import FirstImage
from unbend.flight.exposures import Events
from unbend.stages.multi_image.assignment_likelihoods import TIES, TieLikelihood
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.stages.multi_image.image_events import assigned_events

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
