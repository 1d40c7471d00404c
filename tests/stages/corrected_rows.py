"""A mission that was read is corrected in memory: its rows as a run writes them, and its record."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from unbend.atmosphere.covariance import ProfileCovariance
from unbend.flight.stations import station_columns
from unbend.library import corrected_table
from unbend.stages.story import PreparedMission


def pressure_alone(profile, ln_p):
    """The covariance of a profile of which the pressure alone is uncertain, by so much of it."""
    size = profile.layers.edge.size
    variances = np.zeros(2 * size + 1)
    variances[size] = ln_p**2
    return ProfileCovariance(profile, 1000.0, np.diag(variances))


def rows_of_camera(mission, camera):
    """The rows of the last run whose images are called like a camera."""
    rows = mission.result_rows()
    return rows[rows["image"].str.startswith(camera)]


def shift(rows, moved="corrected"):
    """(n, 2) in x and y [px]."""
    pixels = rows[[f"x_{moved}_px", f"y_{moved}_px"]].to_numpy()
    return pixels - rows[["x_px", "y_px"]].to_numpy()


@dataclass(frozen=True)
class Corrected:
    """``record`` is what the manifest says of the results."""

    prepared: PreparedMission
    table: pa.Table
    record: dict[str, Any]

    def stations(self):
        return pd.DataFrame(station_columns(self.prepared.stations))

    def rows(self):
        """The rows with a correction, and the columns of their stations that have other names."""
        rows = self.table.to_pandas()
        stations = self.stations().drop(columns="status").set_index("image")
        return rows[rows["status"] == "ok"].join(stations, on="image")


def corrected(prepared):
    """The mission after its correction, in which nothing was lost."""
    table, results = corrected_table(prepared)
    assert not prepared.ledger.has_losses, list(prepared.ledger)
    return Corrected(prepared, table, results.row())
