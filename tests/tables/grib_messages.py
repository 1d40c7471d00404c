"""GRIB of messages that tests state by ecCodes' keys."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np


def write_grib(
    path: Path, messages: Iterable[str], edition: int = 2, values: np.ndarray | None = None
) -> None:
    """Messages on pressure levels from ecCodes' sample, each with these keys, as "level=850"."""
    import eccodes

    with path.open("wb") as file:
        for keys in messages:
            message = eccodes.codes_grib_new_from_samples(f"regular_ll_pl_grib{edition}")
            eccodes.codes_set_key_vals(message, keys)
            if values is not None:
                eccodes.codes_set_values(message, values)
            eccodes.codes_write(message, file)
            eccodes.codes_release(message)
