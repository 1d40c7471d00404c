"""Columns of observations as numbers: what is none, and what nobody measured, is NaN."""

import numpy as np
import pyarrow as pa

from unbend.tables.text_columns import is_text, numbers_in_text
from unbend.units import Array, measured


def measured_floats(column: pa.Array) -> Array:
    """float64 with NaN for null, for what is no number, and for numbers beyond all measures.

    Text may have decimal points or commas.

    >>> measured_floats(pa.array(["1,5", "x", None, "1e308"])).tolist()
    [1.5, nan, nan, nan]
    """
    if is_text(column.type):
        return numbers_in_text(column.to_pandas())
    floats = column.cast(pa.float64(), safe=False)
    return measured(floats.to_numpy(zero_copy_only=False))


def at_least_zero(
    column: pa.Array,
    *,
    above: bool = False,
) -> tuple[Array, int]:
    """Measured values from 0 on (``above``: greater), else NaN; how many but for nulls are not.

    NaN among numbers counts as null.

    >>> at_least_zero(pa.array([0.0, -1.0, None, float("nan"), 1e308]))
    (array([ 0., nan, nan, nan, nan]), 2)
    """
    if not is_text(column.type):
        column = column.cast(pa.float64(), safe=False)
    values = measured_floats(column)
    is_sound = values >= 0.0
    if above:
        is_sound = values > 0.0
    nulls = column.is_null(nan_is_null=True)
    is_absent = nulls.to_numpy(zero_copy_only=False)
    is_unsound = ~(is_sound | is_absent)
    count = int(np.count_nonzero(is_unsound))
    sound_values = np.where(is_sound, values, np.nan)
    return sound_values, count
