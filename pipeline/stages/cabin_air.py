"""The air in the pressurised compartment of a camera at each exposure, and where it is missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.refractive_index import vapour_pressure
from pipeline.flight.station_builder import mark_suspect
from pipeline.flight.stations import Stations
from pipeline.ledger import Ledger, Notes
from pipeline.refraction.window import (
    SCHEDULE_CEILING_M,
    SCHEDULE_TEMPERATURE_K,
    Cabin,
    scheduled_pressure,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AirAtExposures:
    """(m,) pressure [Pa], temperature [K] and vapour pressure [Pa] at m exposures."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array


def flag_missing_cabin_air(stations: Stations, camera: str) -> tuple[Stations, Notes]:
    """Mark exposures of a camera behind a window whose cabin air is unknown as suspect."""
    known = np.isfinite(stations.cabin_pressure_pa) & np.isfinite(stations.cabin_temperature_k)
    what = "no cabin pressure or temperature: the window cannot be corrected"
    return mark_suspect(stations, camera, ~known, "CABIN-MISSING", what)


def cabin_air(
    cabin: Cabin,
    outside: AirAtExposures,
    stations: Stations,
    rows: Mask,
    *,
    name: str,
    ledger: Ledger,
) -> AirAtExposures:
    """The air in the compartment at the exposures ``rows`` (s,) of a camera."""
    if cabin.source == "log":
        e = stations.cabin_vapour_pressure_pa[rows]
        dry = int((~np.isfinite(e) & stations.ok[rows]).sum())
        if dry:
            ledger.fallback(
                "CABIN-DRY",
                f"no humidity in the cabin for {dry} exposures: its air is taken as dry",
                where=f"camera {name}",
                count=dry,
            )
        p, t = stations.cabin_pressure_pa[rows], stations.cabin_temperature_k[rows]
        return AirAtExposures(p, t, np.where(np.isfinite(e), e, 0.0))
    m = int(rows.sum())
    if cabin.source == "constant":
        e = vapour_pressure(cabin.relative_humidity, cabin.temperature_k, cabin.pressure_pa)
        constant = (cabin.pressure_pa, cabin.temperature_k, float(e))
        return AirAtExposures(*(np.full(m, value) for value in constant))
    where = f"cameras.{name}.window.cabin"
    ledger.note(
        "CABIN-SCHEDULE",
        "the cabin's air is Gyer's schedule, dry and not measured: as outside to 3 km pressure "
        "altitude, then 701.2 hPa; 21.1 degC",
        where=where,
    )
    with np.errstate(invalid="ignore"):
        above = int((stations.ok & rows & (stations.h_msl_m > SCHEDULE_CEILING_M)).sum())
    if above:
        ledger.warning(
            "CABIN-SCHEDULE-HIGH",
            f"{above} exposures lie above 10 km, where the schedule of the cabin's pressure ends; "
            "701.2 hPa are taken there too",
            where=where,
            count=above,
        )
    pressure = scheduled_pressure(outside.pressure_pa)
    return AirAtExposures(pressure, np.full(m, SCHEDULE_TEMPERATURE_K), np.zeros(m))
