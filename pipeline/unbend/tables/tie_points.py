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

MOST_TIE_POINTS = 2000  # enough for all decisions by intersection
_MOST_ROWS = 20_000_000  # read in some seconds; further rows of a larger table are not read
_ROWS_KEPT = 200_000  # about as many rows are left of a larger table
_MOST_RAYS = 4  # of one point: a survey from high up shows a point in a hundred images


@dataclass(frozen=True, eq=False)
class TiePoints:
    """Observations (n,) of points in two or more images, sorted by point, in COLMAP's pixels.

    ``image`` are indices into ``images``, the names of all images; ``point`` are numbers from 0.
    ``ground`` is the stated height of the point [m], NaN without one. ``repeated`` lists repeated
    observations of a point in one image, as "point in image"; they are left out.
    """

    images: tuple[str, ...]
    image: NDArray[np.int64]
    point: NDArray[np.int64]
    x_px: Array
    y_px: Array
    ground: Array
    repeated: tuple[str, ...] = ()


def draw_tie_points(observations: Observations, most: int) -> TiePoints:
    """Draw up to ``most`` points with two to four rays each, spread over the images.

    The same table gives the same points, in any order of its rows. If it has more than 200,000
    rows, only a share of the points is used, chosen by the hashes of their names. At most about 20
    million rows are read.
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
    """A function from hashes (n,) to the indices (k,) of those to keep in a table of ``rows`` rows.

    Hashes are evenly distributed: keeping those below a limit leaves one row in a whole number of
    them, `_ROWS_KEPT` rows or up to twice as many.
    """
    rows_read = min(rows, _MOST_ROWS)
    rows_for_each_kept = np.uint64(max(1, rows_read // _ROWS_KEPT))
    largest_kept = np.iinfo(np.uint64).max // rows_for_each_kept

    def indices_of_kept(hashes: NDArray[np.uint64]) -> Integers:
        return np.flatnonzero(hashes <= largest_kept)

    return indices_of_kept


def _numbered_rows(batch: Batch, images: tuple[str, ...]) -> pd.DataFrame:
    """The rows of a batch with numbers for names: columns image, point, x, y [px] and ground [m].

    ``image`` is the index in ``images``, -1 for a name that is not there; ``point`` is the hash of
    the name. Sorting names as text would take ten times as long.
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
    """The rows of up to ``most`` points that two images or more show, sorted by point and image.

    Points are numbered within each image in the order of their hashes. Those that are first in an
    image are taken before those that are second, and so on: so every image gets some.
    """
    images_of_point = table.groupby("point")["image"].transform("size")
    table = table[images_of_point > 1]
    table = table.sort_values(["point", "image"])
    rank_in_image = table.groupby("image").cumcount()
    best_rank_of_point = rank_in_image.groupby(table["point"]).min()
    first_points = best_rank_of_point.sort_values(kind="stable").index[:most]
    return table[table["point"].isin(first_points)]


def _few_rays_a_point(table: pd.DataFrame) -> pd.DataFrame:
    """Up to four rows of each point, drawn at random with a fixed seed; their order is kept."""
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
    """The rays of the tie points that two or more of the images show, with their stated heights.

    ``image`` (k,) are names of images, and ``camera_of`` (k,) those of their cameras; the rays
    refer to indices into these. ``cameras`` are the interior orientations by name. ``axes`` : name
    of a camera -> how its pixels are read instead of as stated, x and y ``exchanged`` or y
    ``upward``. The rays are unit vectors in the frame of the camera, with a sigma [rad] of one
    pixel; refraction is not removed from them (see `straightened`).
    """
    index_of_name = {name: index for index, name in enumerate(image.tolist())}
    index_of_image = [index_of_name.get(name, -1) for name in ties.images]
    index = np.array(index_of_image, np.int64)[ties.image]  # of each ray's image, -1 if not given
    direction = np.full((index.size, 3), np.nan)
    sigma_rad = np.full(index.size, np.nan)
    for name, camera in cameras.items():
        # The last element is for index -1.
        is_of_camera = np.append(camera_of == name, False)
        rays_of_camera = np.flatnonzero(is_of_camera[index])
        direction[rays_of_camera] = camera_directions(
            camera,
            ties.x_px[rays_of_camera],
            ties.y_px[rays_of_camera],
            axes.get(name) if axes else None,
        )
        sigma_rad[rays_of_camera] = 1.0 / camera.fx_px
    usable = np.flatnonzero(np.isfinite(sigma_rad))
    rays_of_point = np.bincount(ties.point[usable], minlength=1)
    usable = usable[rays_of_point[ties.point[usable]] > 1]
    length = np.linalg.norm(direction[usable], axis=1)
    return ImageRays(
        index[usable],
        ties.point[usable],
        direction[usable] / length[:, None],
        sigma_rad[usable],
        ties.ground[usable],
    )


def camera_directions(
    camera: Camera,
    x_px: Array,
    y_px: Array,
    axes: str | None,
) -> Array:
    """(n, 3) directions (u, v, 1) of pixels (n,) in the frame of the camera, without distortion.

    ``axes`` : None if the pixels are as stated, ``exchanged`` if x is y, ``upward`` if y counts
    from the lower edge of the image.
    """
    if axes == "upward":
        y_px = camera.height_px - y_px
    elif axes == "exchanged":
        x_px, y_px = y_px, x_px
    u, v, _ = camera.rays(x_px, y_px)
    return np.stack(
        [u, v, np.ones(u.size)],
        axis=1,
    )
