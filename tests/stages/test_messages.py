"""Messages that no mission of the other tests has: when they are sent, and what they say."""

import numpy as np

from tests.helpers import entry_of
from unbend.block.assignment import Assignment
from unbend.flight.exposures import Events
from unbend.messages import Kind
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.stages.multi_image.image_events import notes_of_assignment


def test_images_of_which_the_evidence_disagrees_are_a_loss():
    number = np.arange(3)
    names = np.array(["a", "b", "c"], object)
    no_image = np.zeros(3, bool)
    assignment = Assignment(
        event=number,
        residual_s=np.full(3, np.nan),
        ambiguous=no_image,
        repeated=no_image,
        runner_up=number[:0],
        log_ratio=np.inf,
        reason="",
        evidence=("counts",),
    )
    exposed = Events("nadir", names, number * 1_000_000_000)
    images = CameraImages(names, number, "sequence", np.full(3, -1))
    undecided = names == "b"
    event = np.where(undecided, -1, number)

    assigned, loss = notes_of_assignment(assignment, event, undecided, images, exposed)

    assert assigned.code == "EVENTS-ASSIGNED"
    assert loss.code == "EVENTS-UNDECIDED"
    assert loss.kind is Kind.LOSS
    assert loss.values == {"images": "b"}
    assert loss.what.startswith("the evidence gives different events for 1 image")


def test_the_ledger_has_the_values_of_its_messages(baseline):
    """How far rays of tie points miss each other; since version 2 of the manifest."""
    manifest = baseline.manifest()
    assert manifest["manifest_version"] == 2
    entry = entry_of(manifest, "TIES-RESIDUALS")
    assert entry["kind"] == "note"
    assert entry["values"] == {"misses": entry["what"]}
