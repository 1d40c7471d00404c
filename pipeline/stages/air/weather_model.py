"""The air of a flight by a weather model: its column, and how it changes on the way."""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.estimate.external_readings import TimeAndPlace
from pipeline.atmosphere.series.profile_series import Place
from pipeline.atmosphere.series.time_windows import TimeWindow
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.soundings.model_column import model_column
from pipeline.atmosphere.soundings.model_field import ModelField
from pipeline.batch.plan import Plan
from pipeline.errors import InputError
from pipeline.flight.stations import NO_TIME, Stations
from pipeline.geodesy import longitudes_near
from pipeline.ledger import Ledger
from pipeline.tables.weather_files import FlightArea, read_model_field
from pipeline.units import DEGREE, Array, Integers

Track = tuple[Integers, Array, Array]
"""Times [Unix ns], latitudes and longitudes [rad] of a flight as logged."""

_BIN_M = 100.0


@dataclass(frozen=True, eq=False)
class ModelAir:
    """A weather model about a flight: its fields, and its column where the flight met its air."""

    field: ModelField
    column: Sounding
    place: Place
    track: Track | None

    def place_of(self, samples: AirSamples | None, window: TimeWindow) -> Place:
        """Where and when a part of the flight met the air that is used in it."""
        if samples is None or window.why_not:
            return self.place
        return sampled_place(samples, self.track, window.start_ns, window.end_ns) or self.place


def read_model_air(
    plan: Plan,
    stations: Stations,
    samples: AirSamples,
    flight: TimeAndPlace,
    *,
    track: Track | None,
    ground_h_m: float,
    ledger: Ledger,
) -> ModelAir | None:
    """The weather model of a mission, None where it names none.

    ``ground_h_m`` of the true ground [m above sea level], NaN where it is not known. Refuses
    (`InputError`) what `read_model_field` and `model_column` refuse, a flight without a time or
    place, and stations outside the model's area.
    """
    section = plan.mission.atmosphere.model
    if section is None:
        return None
    path = plan.input("weather model").path
    if flight.time_ns is None or not math.isfinite(flight.latitude_rad + flight.longitude_rad):
        raise InputError.of("MODEL-TIME/flight", path.name)
    place = sampled_place(samples, track) or (
        flight.latitude_rad, flight.longitude_rad, flight.time_ns
    )  # fmt: skip
    rows = stations.ok & np.isfinite(stations.lat_rad + stations.lon_rad)
    times = np.where(stations.time_ns[rows] == NO_TIME, place[2], stations.time_ns[rows])
    area = FlightArea(
        np.append(stations.lat_rad[rows], place[0]),
        longitudes_near(np.append(stations.lon_rad[rows], place[1]), place[1]),
        np.append(times, place[2]),
    )
    field = read_model_field(path, area, ledger, member=section.member)
    field.refuse_outside(area.latitude_rad, area.longitude_rad)
    highest = float(stations.h_msl_m[rows].max(initial=0.0))
    column = ledger.take(model_column(field, place, ground_h_m=ground_h_m, highest_h_m=highest))
    hours = TimeAndPlace(place[2]).hours_from(column.time_ns)
    ledger.note(
        "MODEL-COLUMN", where=path.name, count=column.h_m.size, low=column.h_m[0], hours=hours,
        high=column.h_m[-1], north=place[0] / DEGREE, east=place[1] / DEGREE,
    )  # fmt: skip
    # It is the air where the flight met it: no distance adds to its errors.
    column = replace(
        column, latitude_rad=flight.latitude_rad, longitude_rad=flight.longitude_rad
    )  # fmt: skip
    return ModelAir(field, column, place, track)


def sampled_place(
    samples: AirSamples, track: Track | None, start_ns: int = -(2**62), end_ns: int = 2**62
) -> Place | None:
    """Where and when a flight met the air that it measured: latitude, longitude, time.

    The mean over its heights in bins of 100 m, so that a climb counts more than a long level run;
    None where nothing was measured between two times.
    """
    if track is None:
        return None
    time_ns, latitude, longitude = track
    known = np.isfinite(latitude + longitude)
    for sensor in (samples.temperature, samples.pressure):
        if sensor is None or not bool(known.any()):
            continue
        inside = (sensor.time_ns >= start_ns) & (sensor.time_ns < end_ns)
        rows = sensor.accepted & np.isfinite(sensor.h_m) & inside
        if not bool(rows.any()):
            continue
        first = int(time_ns[0])
        _, number = np.unique(np.floor(sensor.h_m[rows] / _BIN_M), return_inverse=True)
        seconds = (sensor.time_ns[rows] - first) * 1e-9
        at = (time_ns[known] - first) * 1e-9
        east = longitudes_near(longitude[known], float(longitude[known][0]))
        values = [np.interp(seconds, at, v) for v in (latitude[known], east)]
        count = np.bincount(number)
        means = [float(np.mean(np.bincount(number, v) / count)) for v in (*values, seconds)]
        return means[0], means[1], first + round(means[2] * 1e9)
    return None
