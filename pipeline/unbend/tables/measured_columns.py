"""Columns of observations as numbers; NaN for other text and for impossible values."""

import numpy as np
import pyarrow as pa

from unbend.tables.text_columns import is_text, numbers_in_text
from unbend.units import Array, measured


def measured_floats(column: pa.Array) -> Array:
    """(n,) a column as float64; NaN for null, other text, and numbers too large to be measured.

    Text may have decimal points or commas.

    >>> measured_floats(pa.array(["1,5", "x", None, "1e308"])).tolist()
    [1.5, nan, nan, nan]
    """
    if is_text(column.type):
        return numbers_in_text(column.to_pandas())
    floats = column.cast(pa.float64(), safe=False)
    return measured(floats.to_numpy(zero_copy_only=False))


def valid_magnitudes(
    column: pa.Array,
    *,
    zero_is_valid: bool = True,
) -> tuple[Array, int]:
    """(n,) values of a column of distances or sigmas, NaN if invalid; and how many are invalid.

    Valid are finite numbers above 0, and 0 itself if ``zero_is_valid``. Null and NaN are absent:
    they become NaN and are not counted.

    >>> valid_magnitudes(pa.array([0.0, -1.0, None, float("nan"), 1e308]))
    (array([ 0., nan, nan, nan, nan]), 2)
    """
    if not is_text(column.type):
        column = column.cast(pa.float64(), safe=False)
    values = measured_floats(column)
    is_valid = values > 0.0
    if zero_is_valid:
        is_valid = values >= 0.0
    nulls = column.is_null(nan_is_null=True)
    is_absent = nulls.to_numpy(zero_copy_only=False)
    is_invalid = ~(is_valid | is_absent)
    invalid_count = int(np.count_nonzero(is_invalid))
    valid_values = np.where(is_valid, values, np.nan)
    return valid_values, invalid_count
