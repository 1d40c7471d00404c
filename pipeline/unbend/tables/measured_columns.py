"""Columns of observations as numbers: what is none, and what nobody measured, is NaN."""

import numpy as np
import pyarrow as pa

from unbend.tables.text_columns import is_text, numbers_in_text
from unbend.units import LARGEST_NUMBER, Array, measured


def measured_floats(column: pa.Array) -> Array:
    """float64 with NaN for null, for what is no number, and for numbers beyond all measures.

    >>> measured_floats(pa.array(["1,5", "x", None, "1e308"])).tolist()
    [1.5, nan, nan, nan]
    """
    return measured(_stated_floats(column))


def _stated_floats(column: pa.Array) -> Array:
    """float64 with NaN for null and for text that is no number, with point or comma."""
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        values = numbers_in_text(column.to_pandas())
    else:
        values = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    return np.asarray(values, np.float64)


def at_least_zero(column: pa.Array, *, above: bool = False) -> tuple[Array, int]:
    """Measured values from 0 on (``above``: greater), else NaN; how many but for nulls are not.

    >>> at_least_zero(pa.array([0.0, -1.0, None, 1e308]))
    (array([ 0., nan, nan, nan]), 2)
    """
    values = _stated_floats(column)
    is_positive = values > 0.0 if above else values >= 0.0
    sound = is_positive & (values <= LARGEST_NUMBER)
    absent = column.is_null().to_numpy(zero_copy_only=False)
    if not is_text(column.type):
        absent = absent | np.isnan(values)
    return np.where(sound, values, np.nan), int(np.count_nonzero(~sound & ~absent))
