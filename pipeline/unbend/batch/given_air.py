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


def air_of_stations(profile: Air, placed: pa.Table, stations: Stations) -> FlightAir:
    """The air that the caller gives, for all stations.

    ``placed`` is the caller's table of stations; ``stations`` are these and, after them, images
    without an exposure, which get the first profile.
    """
    series = series_of_stations(profile, placed, len(stations))
    profile_number = np.zeros(len(stations), np.int64)
    profile_number[: series.profile_number.size] = series.profile_number
    first = series.timed_profiles[0]
    adjustment = unadjusted(first.profile, "it is given")
    adjustment = replace(adjustment, covariance=first.covariance)
    of_stations = ProfileSeries(series.timed_profiles, profile_number)
    return FlightAir(adjustment, of_stations)


def series_of_stations(profile: Air, placed: pa.Table, count: int) -> ProfileSeries:
    """The profiles of stations, by whatever the caller gives as the air.

    A single profile is that of all ``count`` stations; several belong to the rows of ``placed``,
    the caller's table of stations.
    """
    if isinstance(profile, Profile):
        return constant_series(TimedProfile(None, profile), count)
    if isinstance(profile, TimedProfile):
        return constant_series(profile, count)
    if isinstance(profile, pa.Table) and b"g_phi" in (profile.schema.metadata or {}):
        ids = pa.nulls(0)
        if "profile_id" in placed.column_names:
            ids = placed["profile_id"]
        profile_count = pc.count_distinct(profile["profile_id"]).as_py()
        if profile_count > 1 and not len(ids):
            raise ValueError("several profiles need the stations of their run, with profile_id")
        return air_of(profile, ids.cast(pa.string()))
    if isinstance(profile, ProfileSeries):
        size = profile.profile_number.size
        given = placed.num_rows
        if size != given:
            raise ValueError(f"the profiles are those of {size} stations, but {given} are given")
        return profile
    raise TypeError(
        f"a profile cannot be a {type(profile).__name__}; it must be a Profile, TimedProfile, "
        "ProfileSeries, the Arrow table of profile.parquet, a name, or a section"
    )
