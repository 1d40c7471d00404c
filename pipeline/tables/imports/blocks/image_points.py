"""Image points of a block as rows of a table, whatever the program calls them.

Columns are ``image``, ``point``, ``x_px``, ``y_px`` in COLMAP's pixels, and ``keypoint``, the
place of the row among those of its image, from 0. ``point`` is what the program calls the point;
an image point that belongs to none is called ``image:keypoint``, so that every row has a name by
which it goes back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike, NDArray

from pipeline.refraction.camera.camera import Camera

Array = NDArray[np.float64]
CameraMakers = dict[str, Callable[[], Camera]]

ROWS = pa.schema(
    [
        ("image", pa.string()),
        ("point", pa.string()),
        ("x_px", pa.float64()),
        ("y_px", pa.float64()),
        ("keypoint", pa.int64()),
    ]
)
"""Columns of every format; some have more behind these."""


def rows_of_image(
    image: str,
    xy: ArrayLike,
    point: Sequence[str] | NDArray[np.int64] | None = None,
    *,
    keypoint: ArrayLike | None = None,
    more: Mapping[str, pa.Array] | None = None,
) -> pa.RecordBatch:
    """The rows of one image: (n, 2) pixels, names of points or numbers, of which -1 is none.

    >>> rows_of_image("a.jpg", [[1, 2], [3, 4]], np.array([17, -1]))["point"].to_pylist()
    ['17', 'a.jpg:1']
    """
    x, y = np.asarray(xy, np.float64).reshape(-1, 2).T
    index = pa.array(np.arange(x.size) if keypoint is None else np.asarray(keypoint, np.int64))
    names = pa.repeat(pa.scalar(image, pa.string()), x.size)
    own = pc.binary_join_element_wise(names, index.cast(pa.string()), ":")
    if point is None:
        point = own
    elif isinstance(point, np.ndarray):
        point = pc.if_else(pa.array(point >= 0), pa.array(point).cast(pa.string()), own)
    columns = [names, pa.array(point, pa.string()), pa.array(x), pa.array(y), index]
    more = more or {}
    return pa.RecordBatch.from_arrays([*columns, *more.values()], names=[*ROWS.names, *more])
