"""Points that two or more images show, drawn from a table of observations of any size."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from unbend.block.image_rays import ImageRays
from unbend.refraction.camera.camera import Camera
from unbend.tables.observations import Observations
from unbend.tables.text_columns import hashes_of
from unbend.units import Array

MOST_TIE_POINTS = 2000  # that serve all that is decided by intersection
_MOST_ROWS = 20_000_000  # read in some seconds; the rest of a larger table is not looked at
_ROWS_KEPT = 200_000
_MOST_RAYS = 4  # of one point: a survey from high up shows a point in a hundred images


@dataclass(frozen=True, eq=False)
class TiePoints:
    """Observations of points in two or more images, (n,): in COLMAP's pixels, by point.

    ``image`` are rows of ``images``; ``point`` counts from 0. ``ground`` is the given
    height of the point [m], NaN where none is. ``repeated`` names a point and its image for each
    row read that repeats one.
    """

    images: tuple[str, ...]
    image: NDArray[np.int64]
    point: NDArray[np.int64]
    x_px: Array
    y_px: Array
    ground: Array
    repeated: tuple[str, ...] = ()


def draw_tie_points(observations: Observations, most: int) -> TiePoints:
    """Up to ``most`` points with two to four rays, spread over the images: each has its first few.

    The same table gives the same points, whatever the order of its rows. Of more than 200,000 rows
    those of one point in k are kept, by the hash of its name; 20 million rows are read at most.
    """
    every = np.uint64(max(1, min(observations.rows, _MOST_ROWS) // _ROWS_KEPT))
    lowest = np.iinfo(np.uint64).max // every
    batch = observations.of_points(lambda hashes: np.flatnonzero(hashes <= lowest), _MOST_ROWS)
    given = np.nan if batch.ground is None else batch.ground
    # Numbers in the order of names: a table of text takes ten times as long to be sorted.
    image = pd.Index(observations.images).get_indexer(pd.Index(batch.image.to_pandas()))
    point = hashes_of(batch.point)
    columns = {"image": image, "point": point, "x": batch.x_px, "y": batch.y_px, "ground": given}
    table = pd.DataFrame(columns)
    known = (image >= 0) & batch.point.is_valid().to_numpy(zero_copy_only=False)
    table = table[known].dropna(subset=["x", "y"])
    again = table.index[table.duplicated(["image", "point"])]
    repeated = tuple(f"{batch.point[row]} in {batch.image[row]}" for row in again.tolist())
    table = table.drop(again)
    table = table[table.groupby("point")["image"].transform("size") > 1]
    # In the order of hashes, the first point of an image comes before the second of any.
    table = table.sort_values(["point", "image"])
    place = table.groupby("image").cumcount()
    first = place.groupby(table["point"]).min().sort_values(kind="stable").index[:most]
    table = table[table["point"].isin(first)]
    drawn = table.sample(frac=1.0, random_state=0).groupby("point").cumcount() < _MOST_RAYS
    table = table[drawn.reindex(table.index)]
    number = np.unique(table["point"].to_numpy(), return_inverse=True)[1].astype(np.int64)
    x, y, height = (table[name].to_numpy() for name in ("x", "y", "ground"))
    shown = table["image"].to_numpy(np.int64)
    return TiePoints(observations.images, shown, number, x, y, height, repeated)


def tie_rays(
    ties: TiePoints, image: NDArray[np.object_], camera_of: NDArray[np.object_], cameras:
    Mapping[str, Camera], axes: Mapping[str, str] | None = None,
) -> ImageRays:  # fmt: skip
    """The rays of tie points that two or more of some images show, and their given heights.

    ``image`` and ``camera_of`` (k,) name the images, to whose rows the rays refer, and their
    cameras; ``axes`` are those of a camera's pixels, x and y ``exchanged`` or y ``upward``, where
    they are not as stated. The rays are apparent ones (see `straightened`).
    """
    row_of = {name: row for row, name in enumerate(image.tolist())}
    row = np.array([row_of.get(name, -1) for name in ties.images], np.int64)[ties.image]
    direction, sigma = np.full((row.size, 3), np.nan), np.full(row.size, np.nan)
    for name, camera in cameras.items():
        rows = np.flatnonzero(np.append(camera_of == name, False)[row])
        x, y, read = ties.x_px[rows], ties.y_px[rows], (axes or {}).get(name)
        y = camera.height_px - y if read == "upward" else y
        u, v, _ = camera.rays(*((y, x) if read == "exchanged" else (x, y)))
        direction[rows], sigma[rows] = np.stack([u, v, np.ones(u.size)], 1), 1.0 / camera.fx_px
    seen = np.flatnonzero(np.isfinite(sigma))
    seen = seen[np.bincount(ties.point[seen], minlength=1)[ties.point[seen]] > 1]
    direction = direction[seen] / np.linalg.norm(direction[seen], axis=1)[:, None]
    return ImageRays(row[seen], ties.point[seen], direction, sigma[seen], ties.ground[seen])
