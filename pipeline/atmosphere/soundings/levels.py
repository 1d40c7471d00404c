"""The levels of a balloon sounding, as the estimator takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sounding:
    """Levels of one ascent, from the ground up.

    Parameters
    ----------
    h_m : (n,) geometric heights above mean sea level [m], strictly increasing.
    pressure_pa : (n,) [Pa], strictly decreasing.
    temperature_k : (n,) temperature of the thermometer [K].
    vapour_pressure_pa : (n,) partial pressure of water [Pa]; NaN where it was not measured.
    time_ns : release of the balloon, or the hour of the observation [Unix ns]; None if not told.
    station : identifier or name as the file has it, may be empty.
    latitude_rad, longitude_rad : [rad], NaN where the file has none.
    origin : which format it was read as, for the manifest.
    """

    h_m: Array
    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array
    time_ns: int | None = None
    station: str = ""
    latitude_rad: float = float("nan")
    longitude_rad: float = float("nan")
    origin: str = ""

    @property
    def name(self) -> str:
        """For a person: which sounding, and of when."""
        when = ""
        if self.time_ns is not None:
            when = str(np.datetime64(self.time_ns, "ns").astype("datetime64[m]"))
        return " ".join(word for word in ("sounding", self.station, when) if word)

    def __post_init__(self) -> None:
        shape = self.h_m.shape
        columns = (self.pressure_pa, self.temperature_k, self.vapour_pressure_pa)
        if len(shape) != 1 or any(column.shape != shape for column in columns):
            raise ValueError("the columns of a sounding are vectors of one length")
        if not bool(np.all(np.diff(self.h_m) > 0.0) and np.all(np.diff(self.pressure_pa) < 0.0)):
            raise ValueError("a sounding rises, and its pressure falls")
