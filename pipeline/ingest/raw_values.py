"""Raw bytes and raw times of any log -> numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import TimeArray
from pipeline.flight.clock import LAST_US


def gathered(data: NDArray[np.uint8], places: NDArray[Any], size: int) -> NDArray[Any]:
    """So many bytes from each place on, one void item a row; all must lie in the data.

    >>> gathered(np.frombuffer(b"abcdef", np.uint8), np.array([3, 0]), 2).view("S2")
    array([b'de', b'ab'], dtype='|S2')
    """
    every: NDArray[Any] = np.ndarray((max(data.shape[0] - size + 1, 0),), f"V{size}", data, 0, (1,))
    found: NDArray[Any] = every[places]
    return found


def microseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields of any type as a new int64 array [us]; what no log can last is cut at `LAST_US`.

    >>> microseconds(np.array([7, 2**64 - 1], np.uint64)).tolist() == [7, 2**52]
    True
    """
    if raw.dtype.kind == "f":
        return np.asarray(np.nan_to_num(raw, nan=LAST_US).clip(0, LAST_US), np.int64)
    # what is below 0 becomes huge
    cut: NDArray[np.uint64] = np.minimum(raw.astype(np.uint64, copy=False), np.uint64(LAST_US))
    return cut.view(np.int64)
