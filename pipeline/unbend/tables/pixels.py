"""Pixel systems. Half a pixel is applied here, where tables are read and written, and nowhere else.

Inside the package a pixel is COLMAP's: the centre of the upper left pixel is (0.5, 0.5).
"""

from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

PixelOrigin = Literal["corner", "centre"]

Pixels = TypeVar("Pixels", float, NDArray[np.float64])


@dataclass(frozen=True)
class PixelSystem:
    """The pixel system of a table or a camera: the point with the coordinates (0, 0).

    ``origin`` is ``corner``, the outer corner of the upper left pixel (COLMAP's system), or
    ``centre``, the centre of that pixel.

    >>> PixelSystem("centre").to_colmap(0.0), PixelSystem("centre").from_colmap(0.5)
    (0.5, 0.0)
    """

    origin: PixelOrigin = "corner"

    def to_colmap(self, pixel: Pixels) -> Pixels:
        """Convert x or y [px] from this system to COLMAP's."""
        return pixel + 0.5 if self.origin == "centre" else pixel

    def from_colmap(self, pixel: Pixels) -> Pixels:
        """Convert x or y [px] from COLMAP's system to this one."""
        return pixel - 0.5 if self.origin == "centre" else pixel


COLMAP = PixelSystem("corner")


@dataclass(frozen=True)
class ImageFrame:
    """The frame of coordinates in a metric camera's image, in millimetres or micrometres.

    ``origin_px`` is the origin of the frame in COLMAP's pixels. ``px_of_x`` and ``px_of_y`` are the
    steps to the right and down [px] for one unit of x, and for one of y.

    >>> frame = ImageFrame(origin_px=(50.0, 40.0), px_of_x=(10.0, 0.0), px_of_y=(0.0, -10.0))
    >>> frame.to_colmap(1.0, 2.0)
    (60.0, 20.0)
    """

    origin_px: tuple[float, float]
    px_of_x: tuple[float, float]
    px_of_y: tuple[float, float]

    def to_colmap(self, x: Pixels, y: Pixels) -> tuple[Pixels, Pixels]:
        """Convert x and y from this frame to COLMAP's pixels, to the right and down."""
        origin_across, origin_down = self.origin_px
        x_across, x_down = self.px_of_x
        y_across, y_down = self.px_of_y
        across = origin_across + x_across * x + y_across * y
        down = origin_down + x_down * x + y_down * y
        return across, down
