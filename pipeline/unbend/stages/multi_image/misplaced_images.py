"""Single images of an oriented block with a wrong position or attitude, by tie points."""

from collections.abc import Iterator

import numpy as np

from unbend.block.image_rays import ImageRays
from unbend.flight.stations import Stations
from unbend.messages import Message
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.other_readings import intersected
from unbend.units import Array

LEAST_RAYS = 6  # of an image: fewer may be wrong tie points
LEAST_BAD_SHARE = 0.8  # of the rays of an image; of wrong tie points it is some per cent
MOST_IMAGES_SHARE = 0.5  # with more images the whole block is wrong, not single ones
MOST_IMAGES = 10  # that are looked for, each by an intersection of all rays


def misplaced_images(stations: Stations, rays: ImageRays, *, where: str) -> Iterator[Message]:
    """A finding if most rays of single images miss those of the others (ORIENTATION-OUTLIER).

    ``rays`` : of tie points. ``where`` : the file of the orientations. The worst image is left out
    before the next one is looked for: the rays of its neighbours miss only those of the worst.
    """
    shares = bad_shares(stations, rays)
    if np.mean(shares >= LEAST_BAD_SHARE) > MOST_IMAGES_SHARE:
        return
    misplaced: list[tuple[str, float]] = []
    while shares.max() >= LEAST_BAD_SHARE and len(misplaced) < MOST_IMAGES:
        worst = int(np.argmax(shares))
        misplaced.append((str(stations.image[worst]), float(shares[worst])))
        rays = rays.rows(rays.image != worst)
        shares = bad_shares(stations, rays)
    if misplaced:
        image, share = misplaced[0]
        yield messages.images_misplaced(
            where=where, count=len(misplaced), image=image, bad_percent=100.0 * share
        )


def bad_shares(stations: Stations, rays: ImageRays) -> Array:
    """(s,) share of the rays of each image that miss the other rays of their points.

    0 for images with fewer than `LEAST_RAYS` rays or without an orientation.
    """
    is_bad = intersected(stations, rays).bad
    image_count = stations.image.size
    ray_count = np.bincount(rays.image, minlength=image_count)
    bad_count = np.bincount(rays.image, weights=is_bad, minlength=image_count)
    is_judged = stations.ok & (ray_count >= LEAST_RAYS)
    return np.where(is_judged, bad_count / np.maximum(ray_count, 1), 0.0)
