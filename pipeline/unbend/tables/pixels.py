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
