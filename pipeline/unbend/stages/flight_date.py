"""Date and hour of a flight, from its exposures or from the mission file."""

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from unbend.atmosphere.air_variation import solar_hour
from unbend.atmosphere.metar import decode_metar, time_of_metar
from unbend.atmosphere.soundings import Sounding
from unbend.config import Mission
from unbend.config.atmosphere import AtmosphereSection
from unbend.config.dates import is_day_alone, nanoseconds_of_date
from unbend.flight.stations import Stations, middle_time_ns
from unbend.messages import Ledger
from unbend.stages import messages
from unbend.units import NANOSECONDS_PER_SECOND

FARTHEST_FROM_DATE_NS = 36 * 3600 * NANOSECONDS_PER_SECOND
"""Most time from the stated date (without an hour, from its noon). 36 h also allow the local date
of a place at the date line."""

MONTHS = 12


def flight_date_ns(mission: Mission, stations: Stations, ledger: Ledger) -> int | None:
    """When a mission was flown [Unix ns]: UTC of the middle exposure, else the stated date.

    None if neither is known. Warns of a stated date that the exposures contradict.
    """
    stated_ns = nanoseconds_of_date(stated_date(mission))
    flown_ns = middle_time_ns(stations.utc_ns)
    if flown_ns is None:
        if mission.atmosphere.adjust:
            _note_unknown_time(mission, ledger)
        return stated_ns
    if stated_ns is not None and abs(flown_ns - stated_ns) > FARTHEST_FROM_DATE_NS:
        ledger.add(
            messages.date_contradicted(
                where=key_of_date(mission),
                stated=str(np.datetime64(stated_ns, "ns").astype("datetime64[D]")),
                flown=str(np.datetime64(flown_ns, "ns").astype("datetime64[D]")),
            )
        )
    return flown_ns


def _note_unknown_time(mission: Mission, ledger: Ledger) -> None:
    """Report that a flight without UTC has no stated date, or one without an hour."""
    date = stated_date(mission)
    if date is None:
        ledger.add(messages.flight_undated())
    elif is_day_alone(date):
        ledger.add(messages.flight_of_unknown_hour(where=key_of_date(mission), date=date))


def stated_date(mission: Mission) -> str | None:
    """The date that a mission file states, for its orientations or else for the mission."""
    orientation = mission.stations.orientation
    if orientation is not None and orientation.date is not None:
        return orientation.date
    return mission.mission.date


def key_of_date(mission: Mission) -> str:
    """The key of the mission file from which `stated_date` takes the date."""
    orientation = mission.stations.orientation
    if orientation is not None and orientation.date is not None:
        return "stations.orientation.date"
    return "mission.date"


def flight_hour(mission: Mission, stations: Stations, flight_ns: int | None) -> float | None:
    """The local mean solar time [h] at which a mission was flown; ``flight_ns`` is its UTC.

    None if the exposures have no UTC and the stated date has no time of the day, or if the date or
    the longitude is unknown.
    """
    date = stated_date(mission)
    have_utc = middle_time_ns(stations.utc_ns) is not None
    if not have_utc and date is not None and is_day_alone(date):
        return None
    return solar_hour(flight_ns, stations.median_longitude_rad)


def doubt_of_date(mission: Mission, stations: Stations, soundings: Sequence[Sounding]) -> str:
    """Why the stated date of a flight may be wrong, as text for messages on sources far from it.

    Doubted is a date from which all dated soundings and surface reports are far. The text is empty
    if one of them is near, if none has a date, or if the exposures have UTC.
    """
    date = stated_date(mission)
    if date is None or middle_time_ns(stations.utc_ns) is not None:
        return ""
    sources_near = _sources_near(date, mission.atmosphere, soundings)
    if not sources_near or any(sources_near):
        return ""
    key = key_of_date(mission)
    day = datetime.fromisoformat(date).date().isoformat()
    exchanged = with_day_and_month_exchanged(date)
    if exchanged is not None and all(_sources_near(exchanged, mission.atmosphere, soundings)):
        exchanged_day = datetime.fromisoformat(exchanged).date().isoformat()
        return messages.stated_date_exchanged(date=day, key=key, exchanged=exchanged_day)
    return messages.stated_date_in_doubt(date=day, key=key)


def with_day_and_month_exchanged(date: str) -> str | None:
    """A stated date with day and month exchanged; None if the day is no month, or equals it.

    >>> with_day_and_month_exchanged("2025-12-06T09:40:00Z")
    '2025-06-12T09:40:00+00:00'
    >>> with_day_and_month_exchanged("2025-12-16"), with_day_and_month_exchanged("2025-06-06")
    (None, None)
    """
    time = datetime.fromisoformat(date)
    if time.day > MONTHS or time.day == time.month:
        return None
    exchanged = time.replace(month=time.day, day=time.month)
    if is_day_alone(date):
        return exchanged.date().isoformat()
    return exchanged.isoformat()


def _sources_near(
    date: str, section: AtmosphereSection, soundings: Sequence[Sounding]
) -> list[bool]:
    """Whether each sounding and surface report is near a date; those without a time are left out.

    A METAR has only the day of the month: it is dated in the month that is nearest to the date.
    """
    date_ns = nanoseconds_of_date(date)
    times_ns = [sounding.time_ns for sounding in soundings]
    for station in section.surface:
        time_ns = station.time_ns
        if station.metar is not None:
            report = decode_metar(station.metar, "atmosphere.surface")
            time_ns = time_of_metar(report, date_ns, "atmosphere.surface")
        times_ns.append(time_ns)
    is_near = []
    for time_ns in times_ns:
        if date_ns is not None and time_ns is not None:
            is_near.append(abs(time_ns - date_ns) <= FARTHEST_FROM_DATE_NS)
    return is_near


def refuse_dated_sources(soundings: Sequence[Sounding], section: AtmosphereSection) -> None:
    """Refuse (InputError FLIGHT-UNDATED) soundings and surface reports that have a time.

    Called for a flight without a time: how old these sources are is unknown then.
    """
    dated = [sounding.name for sounding in soundings if sounding.time_ns is not None]
    for number, station in enumerate(section.surface):
        if station.metar is not None or station.time_ns is not None:
            dated.append(f"atmosphere.surface[{number}]")
    if dated:
        raise messages.sources_of_undated_flight(where=", ".join(dated))
