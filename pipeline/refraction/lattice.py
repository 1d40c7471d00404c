"""Corrections on a regular grid over an image, for programs that interpolate in one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Corrections, Exposures, correct_observations
from pipeline.refraction.ray import PublishedRays, RayTable

Array = NDArray[np.float64]


def lattice_nodes(camera: Camera, columns: int, rows: int) -> tuple[Array, Array]:
    """Pixels of a grid from corner to corner of a camera's format.

    ``columns``, ``rows`` : nodes across and down, 2 or more. Returns x, y (rows * columns,) [px],
    COLMAP's pixels, row by row from the upper left.

    >>> x, y = lattice_nodes(Camera(400, 300, 500.0, 500.0, 200.0, 150.0), 3, 2)
    >>> x.tolist(), y.tolist()
    ([0.0, 200.0, 400.0, 0.0, 200.0, 400.0], [0.0, 0.0, 0.0, 300.0, 300.0, 300.0])
    """
    if columns < 2 or rows < 2:
        raise ValueError("a lattice has at least two columns and two rows")
    x, y = np.meshgrid(
        np.linspace(0.0, camera.width_px, columns), np.linspace(0.0, camera.height_px, rows)
    )
    return x.ravel(), y.ravel()


def lattice_corrections(
    x_px: Array,
    y_px: Array,
    ground_m: Array,
    exposure: NDArray[np.int64],
    exposures: Exposures,
    camera: Camera,
    table: RayTable | PublishedRays,
) -> Corrections:
    """The corrections of `correct_observations` at the same nodes in every one of some images.

    Parameters
    ----------
    x_px, y_px : (k,) nodes, from `lattice_nodes`.
    ground_m : (s,) height of the ground above sea level that each image is computed for [m].
    exposure : (s,) rows of ``exposures``.
    camera, table : as for `correct_observations`.

    Returns (s * k,) rows, image by image. At a node nothing is approximated; between nodes the
    bilinear interpolation errs by an eighth of the curvature of the shift across a cell.
    """
    images, nodes = exposure.size, x_px.size
    return correct_observations(
        np.tile(x_px, images),
        np.tile(y_px, images),
        np.repeat(ground_m, nodes),
        np.repeat(exposure, nodes),
        exposures,
        camera,
        table,
    )
