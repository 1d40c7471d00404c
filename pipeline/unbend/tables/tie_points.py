"""Points that two or more images show, drawn from a table of observations of any size."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from unbend.block.image_rays import ImageRays
from unbend.refraction.camera.camera import Camera
from unbend.tables.name_hashes import hashes_of
from unbend.tables.observations import Batch, Observations
from unbend.units import Array, Integers

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
    batch = observations.rows_of_points(_hash_filter(observations.rows), _MOST_ROWS)
    table = _numbered_rows(batch, observations.images)
    has_point = batch.point.is_valid().to_numpy(zero_copy_only=False)
    has_image = table["image"] >= 0
    table = table[has_image & has_point]
    table = table.dropna(subset=["x", "y"])
    repeats = table.index[table.duplicated(["image", "point"])]
    table = table.drop(repeats)
    table = _spread_points(table, most)
    table = _few_rays_a_point(table)
    _, point = np.unique(
        table["point"].to_numpy(),
        return_inverse=True,
    )
    return TiePoints(
        images=observations.images,
        image=table["image"].to_numpy(np.int64),
        point=point.astype(np.int64),
        x_px=table["x"].to_numpy(),
        y_px=table["y"].to_numpy(),
        ground=table["ground"].to_numpy(),
        repeated=tuple(f"{batch.point[row]} in {batch.image[row]}" for row in repeats.tolist()),
    )


def _hash_filter(rows: int) -> Callable[[NDArray[np.uint64]], Integers]:
    """Which hashes of names are kept of a table of so many rows: those below a limit."""
    rows_read = min(rows, _MOST_ROWS)
    one_in = np.uint64(max(1, rows_read // _ROWS_KEPT))
    largest_kept = np.iinfo(np.uint64).max // one_in

    def kept(hashes: NDArray[np.uint64]) -> Integers:
        return np.flatnonzero(hashes <= largest_kept)

    return kept


def _numbered_rows(batch: Batch, images: tuple[str, ...]) -> pd.DataFrame:
    """Image (row of ``images``, -1 for another), hash of the point, pixels, height of the ground.

    Numbers in the order of names: a table of text takes ten times as long to be sorted.
    """
    image_names = pd.Index(batch.image.to_pandas())
    return pd.DataFrame(
        {
            "image": pd.Index(images).get_indexer(image_names),
            "point": hashes_of(batch.point),
            "x": batch.x_px,
            "y": batch.y_px,
            "ground": np.nan if batch.ground is None else batch.ground,
        }
    )


def _spread_points(table: pd.DataFrame, most: int) -> pd.DataFrame:
    """Rows of up to ``most`` points of two images or more, sorted by point and image.

    In the order of hashes, the first point of an image comes before the second of any.
    """
    images_of_point = table.groupby("point")["image"].transform("size")
    table = table[images_of_point > 1]
    table = table.sort_values(["point", "image"])
    place_in_image = table.groupby("image").cumcount()
    place_of_point = place_in_image.groupby(table["point"]).min()
    first_points = place_of_point.sort_values(kind="stable").index[:most]
    return table[table["point"].isin(first_points)]


def _few_rays_a_point(table: pd.DataFrame) -> pd.DataFrame:
    """Up to four rows of each point, drawn at random with a fixed seed, in the order they had."""
    shuffled = table.sample(frac=1.0, random_state=0)
    is_drawn = shuffled.groupby("point").cumcount() < _MOST_RAYS
    return table[is_drawn.reindex(table.index)]


def tie_rays(
    ties: TiePoints,
    image: NDArray[np.object_],
    camera_of: NDArray[np.object_],
    cameras: Mapping[str, Camera],
    axes: Mapping[str, str] | None = None,
) -> ImageRays:
    """The rays of tie points that two or more of some images show, and their given heights.

    ``image`` and ``camera_of`` (k,) name the images, to whose rows the rays refer, and their
    cameras; ``axes`` are those of a camera's pixels, x and y ``exchanged`` or y ``upward``, where
    they are not as stated. The rays are apparent ones (see `straightened`).
    """
    row_of_name = {name: row for row, name in enumerate(image.tolist())}
    row_of_image = [row_of_name.get(name, -1) for name in ties.images]
    row = np.array(row_of_image, np.int64)[ties.image]
    direction = np.full((row.size, 3), np.nan)
    sigma = np.full(row.size, np.nan)
    for name, camera in cameras.items():
        # The last element, to which -1 points, stands for images that are not among these.
        is_of_camera = np.append(camera_of == name, False)
        points_of_camera = np.flatnonzero(is_of_camera[row])
        direction[points_of_camera] = camera_directions(
            camera,
            ties.x_px[points_of_camera],
            ties.y_px[points_of_camera],
            axes.get(name) if axes else None,
        )
        sigma[points_of_camera] = 1.0 / camera.fx_px
    seen = np.flatnonzero(np.isfinite(sigma))
    rays_of_point = np.bincount(ties.point[seen], minlength=1)
    seen = seen[rays_of_point[ties.point[seen]] > 1]
    length = np.linalg.norm(direction[seen], axis=1)
    return ImageRays(
        row[seen],
        ties.point[seen],
        direction[seen] / length[:, None],
        sigma[seen],
        ties.ground[seen],
    )


def camera_directions(
    camera: Camera,
    x_px: Array,
    y_px: Array,
    axes: str | None,
) -> Array:
    """(n, 3) directions (u, v, 1) of pixels; ``axes`` as `tie_rays` takes them for one camera."""
    if axes == "upward":
        y_px = camera.height_px - y_px
    elif axes == "exchanged":
        x_px, y_px = y_px, x_px
    u, v, _ = camera.rays(x_px, y_px)
    return np.stack(
        [u, v, np.ones(u.size)],
        axis=1,
    )
