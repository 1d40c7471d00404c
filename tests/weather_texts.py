"""Texts of weather for tests: the simulator's own air, as other programs list it."""

import numpy as np
import pandas as pd

from unbend.simulate.mission import FIELD_LAT_RAD
from unbend.simulate.true_air import (
    saturation_pressure_pa,
    temperature_k,
    true_air,
    vapour_pressure_pa,
)


def sounding_text(offset_k=0.0, **columns):
    """The simulator's air as a balloon would list it, from the ground up."""
    h_m = np.arange(450.0, 9000.0, 150.0)
    air_k = temperature_k(h_m) + offset_k
    vapour_pa = np.maximum(vapour_pressure_pa(h_m), 1.0)
    dew_points_k = np.linspace(190.0, 320.0, 4000)
    saturated_pa = saturation_pressure_pa(dew_points_k)
    dew_point_k = np.interp(vapour_pa, saturated_pa, dew_points_k)
    table = pd.DataFrame({"h_m": h_m})
    table["pressure_hpa"] = true_air(FIELD_LAT_RAD).pressure_pa(h_m) / 100.0
    table["temperature_c"] = air_k - 273.15
    table["dew_point_c"] = np.minimum(dew_point_k, air_k) - 273.15
    table = table.assign(**columns)
    return table.to_csv(index=False, float_format="%.2f")
