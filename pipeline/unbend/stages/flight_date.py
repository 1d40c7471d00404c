"""When a mission was flown: by its exposures, or as the mission file states."""

from collections.abc import Sequence

import numpy as np

from unbend.atmosphere.soundings import Sounding
from unbend.config import Mission
from unbend.config.atmosphere import AtmosphereSection
from unbend.flight.stations import Stations, middle_time_ns
from unbend.messages import Ledger
from unbend.stages import messages
from unbend.units import NANOSECONDS_PER_SECOND

FARTHEST_FROM_DATE_NS = 36 * 3600 * NANOSECONDS_PER_SECOND
"""Of the exposures from a stated date: its noon, and the day line."""


def flight_date_ns(mission: Mission, stations: Stations, ledger: Ledger) -> int | None:
    """When a mission was flown [Unix ns]: the middle exposure, else as the mission file states.

    None where neither is known. A stated date that the exposures contradict is a finding.
    """
    stated_ns = mission.mission.date_ns
    orientation = mission.stations.orientation
    if orientation is not None and orientation.date_ns is not None:
        stated_ns = orientation.date_ns
    flown_ns = middle_time_ns(stations.utc_ns)
    if flown_ns is None:
        if stated_ns is None and mission.atmosphere.adjust:
            ledger.add(messages.flight_undated())
        return stated_ns
    if stated_ns is not None and abs(flown_ns - stated_ns) > FARTHEST_FROM_DATE_NS:
        ledger.add(
            messages.date_contradicted(
                stated=str(np.datetime64(stated_ns, "ns").astype("datetime64[D]")),
                flown=str(np.datetime64(flown_ns, "ns").astype("datetime64[D]")),
            )
        )
    return flown_ns


def refuse_dated_sources(soundings: Sequence[Sounding], section: AtmosphereSection) -> None:
    """Refuse (InputError FLIGHT-UNDATED) sources that have a time, where the flight has none.

    How old they are is unknown, and a guess would make them near.
    """
    dated = [sounding.name for sounding in soundings if sounding.time_ns is not None]
    for number, station in enumerate(section.surface):
        if station.metar is not None or station.time_ns is not None:
            dated.append(f"atmosphere.surface[{number}]")
    if dated:
        raise messages.sources_of_undated_flight(where=", ".join(dated))
