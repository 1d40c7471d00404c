"""The air that a caller in Python gives, for the stations of the caller."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from unbend.atmosphere import Profile
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile, constant_series
from unbend.batch.finished_run.read_back import air_of
from unbend.flight.stations import Stations
from unbend.refraction.effect import FlightAir

Air: TypeAlias = Profile | TimedProfile | ProfileSeries | pa.Table | str | Mapping[str, Any]


def air_of_stations(profile: Air, station_table: pa.Table, stations: Stations) -> FlightAir:
    """The air of a flight, from the profile or profiles that the caller gives.

    ``station_table`` is the caller's table of stations. ``stations`` has the same stations in the
    same order and, after them, images without an exposure, which get the first profile.
    """
    series = series_of_stations(profile, station_table, len(stations))
    profile_number = np.zeros(len(stations), np.int64)
    profile_number[: series.profile_number.size] = series.profile_number
    first = series.timed_profiles[0]
    adjustment = unadjusted(first.profile, "it is given")
    adjustment = replace(adjustment, covariance=first.covariance)
    series_of_all = ProfileSeries(series.timed_profiles, profile_number)
    return FlightAir(adjustment, series_of_all)


def series_of_stations(profile: Air, station_table: pa.Table, count: int) -> ProfileSeries:
    """The profiles that the caller gives, and the number of the profile of each station.

    A single profile is that of all ``count`` stations. Several profiles are assigned to the rows of
    ``station_table``, the caller's table of stations: a table of profiles by the column
    ``profile_id``, a `ProfileSeries` by the order of the rows.
    """
    if isinstance(profile, Profile):
        return constant_series(TimedProfile(None, profile), count)
    if isinstance(profile, TimedProfile):
        return constant_series(profile, count)
    # The metadata of profile.parquet have the gravity at the latitude of the profile, g_phi.
    if isinstance(profile, pa.Table) and b"g_phi" in (profile.schema.metadata or {}):
        ids = pa.nulls(0)
        if "profile_id" in station_table.column_names:
            ids = station_table["profile_id"]
        profile_count = pc.count_distinct(profile["profile_id"]).as_py()
        if profile_count > 1 and not len(ids):
            raise ValueError("several profiles need the stations of their run, with profile_id")
        return air_of(profile, ids.cast(pa.string()))
    if isinstance(profile, ProfileSeries):
        size = profile.profile_number.size
        rows = station_table.num_rows
        if size != rows:
            raise ValueError(f"the profiles are those of {size} stations, but {rows} are given")
        return profile
    raise TypeError(
        f"a profile cannot be a {type(profile).__name__}; it must be a Profile, TimedProfile, "
        "ProfileSeries, the Arrow table of profile.parquet, a name, or a section"
    )
