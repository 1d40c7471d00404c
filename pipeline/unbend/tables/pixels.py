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
    """Where the pixels of a table or of a camera are counted from.

    ``origin`` is the point that has the coordinates (0, 0): the outer corner of the upper left
    pixel (COLMAP's system), or its centre.

    >>> PixelSystem("centre").to_colmap(0.0), PixelSystem("centre").from_colmap(0.5)
    (0.5, 0.0)
    """

    origin: PixelOrigin = "corner"

    def to_colmap(self, pixel: Pixels) -> Pixels:
        """COLMAP's coordinates, x or y alike, of coordinates in this system [px]."""
        return pixel + 0.5 if self.origin == "centre" else pixel

    def from_colmap(self, pixel: Pixels) -> Pixels:
        """Coordinates in this system, x or y alike, of COLMAP's coordinates [px]."""
        return pixel - 0.5 if self.origin == "centre" else pixel


COLMAP = PixelSystem("corner")


@dataclass(frozen=True)
class ImageFrame:
    """Coordinates in the frame of a metric camera's image, in millimetres or micrometres.

    ``origin_px`` is where they count from, in COLMAP's pixels; ``px_of_x`` and ``px_of_y`` are the
    steps across and down [px] of a unit of x and of y.

    >>> frame = ImageFrame(origin_px=(50.0, 40.0), px_of_x=(10.0, 0.0), px_of_y=(0.0, -10.0))
    >>> frame.to_colmap(1.0, 2.0)
    (60.0, 20.0)
    """

    origin_px: tuple[float, float]
    px_of_x: tuple[float, float]
    px_of_y: tuple[float, float]

    def to_colmap(self, x: Pixels, y: Pixels) -> tuple[Pixels, Pixels]:
        """COLMAP's pixels, across and down, of coordinates in this frame."""
        origin_across, origin_down = self.origin_px
        x_across, x_down = self.px_of_x
        y_across, y_down = self.px_of_y
        across = origin_across + x_across * x + y_across * y
        down = origin_down + x_down * x + y_down * y
        return across, down
