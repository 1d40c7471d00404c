"""Single images of an oriented block with a wrong position or attitude, by tie points."""

from collections.abc import Iterator

import numpy as np

from unbend.block.image_rays import ImageRays
from unbend.block.intersection import Intersection
from unbend.flight.stations import Stations
from unbend.messages import Message
from unbend.stages.multi_image import messages
from unbend.stages.multi_image.other_readings import intersected
from unbend.units import Array

LEAST_RAYS = 6  # of an image: fewer may be wrong tie points
LEAST_BAD_SHARE = 0.8  # of the rays of an image; of wrong tie points it is some per cent
MOST_IMAGES_SHARE = 0.5  # of the images with rays
MOST_IMAGES = 20  # each costs an intersection of all rays


def misplaced_images(
    intersection: Intersection, stations: Stations, rays: ImageRays, *, where: str
) -> Iterator[Message]:
    """One finding for the images of which most rays miss those of the others (ORIENTATION-OUTLIER).

    It names the worst one. None if more than half of the images are such: the whole block is then
    wrong, or two images contradict each other. A wrong image makes rays of its neighbours seem
    wrong too. So the worst is left out before the next one is looked for, up to `MOST_IMAGES`.
    ``intersection`` : of ``rays``, which are of tie points, with the ``stations``. ``where`` : the
    file of the orientations.
    """
    shares = bad_shares(intersection, stations, rays)
    judged_shares = shares[np.isfinite(shares)]
    is_misplaced = judged_shares >= LEAST_BAD_SHARE
    if not is_misplaced.any() or is_misplaced.mean() >= MOST_IMAGES_SHARE:
        return
    worst = int(np.nanargmax(shares))
    image = str(stations.image[worst])
    bad_percent = 100.0 * shares[worst]
    count = 0
    while np.nanmax(shares, initial=0.0) >= LEAST_BAD_SHARE and count < MOST_IMAGES:
        count += 1
        is_of_worst = rays.image == np.nanargmax(shares)
        rays = rays.rows(~is_of_worst)
        shares = bad_shares(intersected(stations, rays), stations, rays)
    yield messages.images_misplaced(
        where=where,
        count=count,
        is_all=count < MOST_IMAGES,
        image=image,
        bad_percent=float(bad_percent),
    )


def bad_shares(intersection: Intersection, stations: Stations, rays: ImageRays) -> Array:
    """(s,) share of the rays of each image that miss the other rays of their points.

    NaN for images with fewer than `LEAST_RAYS` rays or without an orientation.
    """
    image_count = stations.image.size
    ray_count = np.bincount(rays.image, minlength=image_count)
    bad_count = np.bincount(rays.image, weights=intersection.bad, minlength=image_count)
    is_judged = stations.ok & (ray_count >= LEAST_RAYS)
    shares = np.full(image_count, np.nan)
    shares[is_judged] = bad_count[is_judged] / ray_count[is_judged]
    return shares
