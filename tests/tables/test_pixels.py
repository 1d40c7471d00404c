"""Half a pixel: applied when a table is read, taken back when one is written."""

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

from tests.tables.checks import assert_within
from tests.tables.observed import opened
from unbend.refraction.image import COLUMNS, Corrections
from unbend.tables.pixels import PixelSystem
from unbend.tables.writing import table_of_observations
from unbend.tables.written_columns import DISPLACED_COLUMNS, OBSERVATION_COLUMNS, schema_of

# 0.1 + 0.5 - 0.5 is not 0.1 in binary: the user's own number must come out, not one computed back.
X_PX = [0.1, 100.3, 7.0]
Y_PX = [0.7, -0.1, 11.25]


@pytest.mark.parametrize(("origin", "centre"), [("corner", 0.5), ("centre", 0.0)])
def test_the_centre_of_the_first_pixel_is_half_a_half(origin, centre):
    assert PixelSystem(origin).to_colmap(centre) == 0.5
    assert PixelSystem(origin).from_colmap(0.5) == centre


@pytest.mark.parametrize(
    ("columns", "result"),
    [(OBSERVATION_COLUMNS, "corrected"), (DISPLACED_COLUMNS, "displaced")],
)
@pytest.mark.parametrize(("origin", "half_px"), [("corner", 0.0), ("centre", 0.5)])
def test_a_batch_is_in_colmap_s_pixels_and_its_results_in_the_user_s(
    columns, result, origin, half_px
):
    x_px = np.array(X_PX)
    y_px = np.array(Y_PX)
    names = ["a"] * 3
    content = {
        "image": names,
        "point": names,
        "x_px": x_px,
        "y_px": y_px,
    }
    observations = opened(pa.table(content), pixels=PixelSystem(origin))

    (batch,) = observations.batches(10)

    assert_array_equal(batch.x_px, x_px + half_px)
    assert_array_equal(batch.y_px, y_px + half_px)

    unknown = np.full(3, np.nan)
    corrections = dict.fromkeys(COLUMNS, unknown)
    corrections["status"] = np.zeros(3, np.uint8)
    corrections["x_corrected_px"] = batch.x_px + 2.0
    corrections["y_corrected_px"] = batch.y_px - 3.0

    table = table_of_observations(
        batch,
        Corrections(**corrections),
        np.zeros(3),
        observations.pixels,
        schema_of(columns, {}),
    )

    assert table["x_px"].to_pylist() == X_PX  # to the last bit
    assert table["y_px"].to_pylist() == Y_PX
    assert_within(table[f"x_{result}_px"], x_px + 2.0, 1e-12)
    assert_within(table[f"y_{result}_px"], y_px - 3.0, 1e-12)
