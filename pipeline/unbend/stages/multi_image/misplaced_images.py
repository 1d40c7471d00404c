"""Single images of an oriented block with a wrong position or attitude, by tie points."""

from collections.abc import Iterator

import numpy as np

from unbend.block.image_rays import ImageRays
from unbend.flight.stations import Stations
from unbend.messages import Message
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.other_readings import intersected

LEAST_RAYS = 6  # of an image: fewer may be wrong tie points
LEAST_BAD_SHARE = 0.8  # of the rays of an image; of wrong tie points it is some per cent
MOST_IMAGES_SHARE = 0.2  # with more images the whole block is wrong, not single ones


def misplaced_images(stations: Stations, rays: ImageRays, *, where: str) -> Iterator[Message]:
    """A finding if most rays of few images miss those of the others (ORIENTATION-OUTLIER).

    ``rays`` : of tie points. ``where`` : the file of the orientations. The finding names the image
    with the largest share of such rays.
    """
    is_bad = intersected(stations, rays).bad
    image_count = stations.image.size
    ray_count = np.bincount(rays.image, minlength=image_count)
    bad_count = np.bincount(rays.image, weights=is_bad, minlength=image_count)
    is_observed = ray_count >= LEAST_RAYS
    bad_share = np.where(is_observed, bad_count / np.maximum(ray_count, 1), 0.0)
    misplaced = np.count_nonzero(bad_share >= LEAST_BAD_SHARE)
    if 0 < misplaced <= MOST_IMAGES_SHARE * np.count_nonzero(is_observed):
        worst = int(np.argmax(bad_share))
        yield messages.images_misplaced(
            where=where,
            count=int(misplaced),
            image=str(stations.image[worst]),
            bad=int(bad_count[worst]),
            rays=int(ray_count[worst]),
        )
