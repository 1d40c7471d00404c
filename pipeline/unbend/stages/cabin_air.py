"""The air in the compartment of a camera at each exposure: its values, its sigmas, what is missing.

Only its pressure has to be known: without a thermometer a pressurised cabin is near 21 degC.
"""

from collections.abc import Container, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import Profile
from unbend.atmosphere.refractive_index import IndexModel, vapour_pressure
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.flight.channels import Channel
from unbend.flight.stations import Stations
from unbend.flight.trajectory import interpolate
from unbend.messages import Kind, Ledger, Message, Notes
from unbend.refraction.camera.camera import LensInAir
from unbend.refraction.window import (
    SCHEDULE_CEILING_M,
    SCHEDULE_TEMPERATURE_K,
    SIGMA_BAROMETER_PA,
    SIGMA_THERMOMETER_K,
    Cabin,
    Window,
    scheduled_pressure,
)
from unbend.stages import messages
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K, Array, Mask

USUAL_TEMPERATURE_K = 294.15  # 21 degC
SIGMA_PRESSURISED_K = 5.0  # of the usual temperature, in cabins with pressurisation
SIGMA_AMBIENT_K = 10.0  # of the usual temperature, in cabins without pressurisation
PRESSURISED_PA = 20.0 * HECTOPASCAL  # a cabin with so much more than the air outside is pressurised
THIN_PA = 0.5 * PRESSURISED_PA  # no cabin has so much less pressure than the air outside
ODD_SIGMAS = 4.0  # no cabin's temperature is so many sigmas away from the usual one
MAX_GAP_S = 10.0  # between samples of a barometer that is compared with the air outside

BOARD_WARMER_K = 10.0
SIGMA_BOARD_K = 6.0
"""A barometer's board against the air about it: 0 to 20 K warmer in autopilots and their simulator,
evenly spread (standard deviation 5.8 K); the same 10 K as `atmosphere.estimate.readings` has."""

# Half the steps of the central differences, which are good to 1e-4 of the derivatives.
_STEP_PA = 100.0
_STEP_K = 1.0


class CabinAir(NamedTuple):
    """The air in a cabin, (m,): pressure [Pa], temperature [K], vapour pressure [Pa], sigmas."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array
    sigma_pressure_pa: Array
    sigma_temperature_k: Array


class OutsideAir(NamedTuple):
    """The air outside, (m,): pressure [Pa], vapour pressure [Pa]."""

    pressure_pa: Array
    vapour_pressure_pa: Array


def cabin_from_log(
    stations: Stations,
    camera: str,
    cabin: Cabin,
    channels: Iterable[Channel] = (),
    roles: Mapping[str, Channel] | None = None,
) -> tuple[Stations, Notes]:
    """The stations with the logged air in the cabin of a camera, and notes on what the log lacks.

    If the pressure is to come from the log, exposures without it become suspect (CABIN-MISSING); if
    it is to be that of the air outside, a barometer that reads much more is reported. A temperature
    that neither mission file nor schedule states comes from the log: exposures without it are
    counted here and get one in `air_in`; that of a circuit board is made that of the air.
    """
    roles = roles or {}
    channels = tuple(channels)
    notes: list[Message] = []
    if cabin.source == "log":
        candidates = candidates_for_cabin("pressure", channels, roles)
        stations, losses = suspect_without_pressure(stations, camera, candidates)
        notes += losses
    of_camera = (stations.camera == camera) & stations.ok
    if cabin.source == "ambient":
        notes += barometer_in_cabin(stations, of_camera, camera, channels, roles)

    is_temperature_stated = cabin.source == "standard_schedule" or np.isfinite(cabin.temperature_k)
    if is_temperature_stated:
        return stations, tuple(notes)
    count = int((of_camera & np.isnan(stations.cabin_temperature_k)).sum())
    if count:
        notes.append(
            messages.cabin_temperature_assumed(
                kind=Kind.LOSS if cabin.temperature_logged else Kind.FALLBACK,
                where=f"camera {camera}",
                count=count,
                able=candidates_for_cabin("temperature", channels, roles),
            )
        )
    thermometer = roles.get("cabin_temperature")
    if thermometer is None or "board_temperature_k" not in thermometer.columns:
        return stations, tuple(notes)
    stations, board_note = with_air_of_board(stations, camera, thermometer.name)
    return stations, (*notes, board_note)


def with_air_of_board(
    stations: Stations, camera: str, thermometer: str
) -> tuple[Stations, Message]:
    """The stations of a camera with `BOARD_WARMER_K` taken off the temperature of a circuit board.

    ``thermometer`` is the name of the channel, for the note.
    """
    rows = (stations.camera == camera) & np.isfinite(stations.cabin_temperature_k)
    note = messages.cabin_board(
        where=f"camera {camera}",
        count=int(rows.sum()),
        name=thermometer,
        warmer=BOARD_WARMER_K,
        sigma=SIGMA_BOARD_K,
    )
    stations = replace(
        stations,
        cabin_temperature_k=stations.cabin_temperature_k - BOARD_WARMER_K * rows,
        sigma_cabin_temperature_k=np.where(rows, SIGMA_BOARD_K, stations.sigma_cabin_temperature_k),
    )
    return stations, note


def suspect_without_pressure(
    stations: Stations, camera: str, candidates: str
) -> tuple[Stations, list[Message]]:
    """The stations, in which those of a camera are suspect if the pressure in its cabin is unknown.

    Also the loss that counts these suspect stations, if there are any. ``candidates`` says in words
    which channels of the log could have the pressure.
    """
    missing = np.isnan(stations.cabin_pressure_pa) & (stations.camera == camera) & stations.ok
    count = int(missing.sum())
    if count == 0:
        return stations, []
    reason = f"no cabin pressure, without which the window cannot be corrected: {candidates}"
    lost = messages.cabin_pressure_missing(where=f"camera {camera}", count=count, reason=reason)
    return stations.as_suspect(missing, reason, np.nan, use=False), [lost]


def candidates_for_cabin(
    quantity: str, channels: Iterable[Channel], roles: Mapping[str, Channel]
) -> str:
    """Which channels of the log could give a quantity of the air in a cabin, in words.

    ``quantity`` is pressure or temperature, which is also the role of the air outside.
    """
    outside = roles.get(quantity)
    names = []
    for channel in channels:
        if outside is not None and channel.name == outside.name:
            continue
        if channel.fits_role(f"cabin_{quantity}"):
            names.append(channel.name)
        elif quantity == "temperature" and "board_temperature_k" in channel.columns:
            names.append(f"{channel.name} (its board, warmer than the air)")
    if not names:
        return f"no channel of the log could play cabin_{quantity}"
    return f"log.channels.cabin_{quantity} could be {', '.join(names)}"


def barometer_in_cabin(
    stations: Stations,
    of_camera: Mask,
    camera: str,
    channels: Iterable[Channel],
    roles: Mapping[str, Channel],
) -> list[Message]:
    """A finding if a barometer of the log reads far more than the pressure of the air outside.

    The first such barometer is reported. None is where the log gives no pressure outside.
    """
    outside = roles.get("pressure")
    if outside is None:
        return []
    time_ns = stations.time_ns[of_camera]
    for channel in channels:
        if channel.name == outside.name or not channel.fits_role("pressure"):
            continue
        inside_pa = interpolate(channel, "pressure_pa", time_ns, MAX_GAP_S)
        excess_pa = inside_pa - stations.pressure_pa[of_camera]
        excess_pa = excess_pa[np.isfinite(excess_pa)]
        if excess_pa.size and float(np.median(excess_pa)) > PRESSURISED_PA:
            finding = messages.cabin_pressurised(
                where=f"cameras.{camera}.window.cabin.pressure",
                count=int(excess_pa.size),
                camera=camera,
                name=channel.name,
                hpa=float(np.median(excess_pa)) / HECTOPASCAL,
            )
            return [finding]
    return []


def with_cabin_air(
    stations: Stations,
    windows: Mapping[str, Window],
    lenses: Container[str],
    profile: Profile | ProfileSeries,
    ledger: Ledger,
) -> Stations:
    """Stations with the air in the cabins, and its sigmas (NaN for numbers that have none).

    The air in a cabin counts if the window is plane, because the window then bends the rays, and
    behind any window if the camera is among ``lenses``, whose principal distance depends on it.
    Other stations keep what the log says.
    """
    columns = CabinAir(  # copies, which are filled camera by camera
        pressure_pa=stations.cabin_pressure_pa.copy(),
        temperature_k=stations.cabin_temperature_k.copy(),
        vapour_pressure_pa=stations.cabin_vapour_pressure_pa.copy(),
        sigma_pressure_pa=stations.sigma_cabin_pressure_pa.copy(),
        sigma_temperature_k=stations.sigma_cabin_temperature_k.copy(),
    )
    h = stations.h_msl_m
    outside = OutsideAir(profile.pressure(h), profile.vapour_pressure(h))
    for name, window in windows.items():
        cabin = window.cabin
        if cabin is None or not (window.shape == "plane" or name in lenses):
            continue
        rows = stations.camera == name
        logged = CabinAir(*(column[rows] for column in columns))
        ambient = OutsideAir(*(values[rows] for values in outside))
        air = air_in(cabin, logged, ambient)
        for column, values in zip(columns, air, strict=True):
            column[rows] = values
        report_humidity(name, cabin, logged, stations.ok[rows], ledger)
        report_schedule(name, cabin, h[rows], stations.ok[rows], ledger)
        report_implausible(name, air, ambient, stations.ok[rows], ledger)
    return replace(
        stations,
        cabin_pressure_pa=columns.pressure_pa,
        cabin_temperature_k=columns.temperature_k,
        cabin_vapour_pressure_pa=columns.vapour_pressure_pa,
        sigma_cabin_pressure_pa=columns.sigma_pressure_pa,
        sigma_cabin_temperature_k=columns.sigma_temperature_k,
    )


def report_humidity(name: str, cabin: Cabin, logged: CabinAir, ok: Mask, ledger: Ledger) -> None:
    """Report a cabin whose pressure is logged, but whose humidity is neither logged nor stated."""
    count = int((~np.isfinite(logged.vapour_pressure_pa) & ok).sum())
    if cabin.source == "log" and not np.isfinite(cabin.relative_humidity) and count:
        ledger.add(messages.cabin_dry(where=f"camera {name}", count=count))


def report_schedule(name: str, cabin: Cabin, h_m: Array, ok: Mask, ledger: Ledger) -> None:
    """Report a cabin whose air is that of the schedule, and exposures above its highest height."""
    if cabin.source != "standard_schedule":
        return
    where = f"cameras.{name}.window.cabin"
    ledger.add(messages.cabin_schedule(where=where))
    with np.errstate(invalid="ignore"):
        count = int((ok & (h_m > SCHEDULE_CEILING_M)).sum())
    if count:
        ledger.add(messages.cabin_schedule_high(where=where, count=count))


def report_implausible(
    name: str, air: CabinAir, outside: OutsideAir, ok: Mask, ledger: Ledger
) -> None:
    """Warn of a pressure well below that outside, and of a temperature far from the usual one."""
    sigma_k = usual_sigma(air.pressure_pa, outside.pressure_pa)
    with np.errstate(invalid="ignore"):
        thin = ok & (outside.pressure_pa - air.pressure_pa > THIN_PA)
        odd = ok & (np.abs(air.temperature_k - USUAL_TEMPERATURE_K) > ODD_SIGMAS * sigma_k)
    oddities = {
        "less pressure than the air outside": thin,
        "a temperature far from 21 degC": odd,
    }
    for oddity, rows in oddities.items():
        if not rows.any():
            continue
        first = int(np.argmax(rows))
        ledger.add(
            messages.cabin_implausible(
                where=f"cameras.{name}.window.cabin",
                count=int(rows.sum()),
                name=name,
                oddity=oddity,
                hpa=float(air.pressure_pa[first]) / HECTOPASCAL,
                celsius=float(air.temperature_k[first]) - ZERO_CELSIUS_K,
            )
        )


def usual_sigma(pressure_pa: Array, outside_pa: Array) -> Array:
    """(m,) standard deviation [K] of a cabin's temperature about 21 degC.

    It is smaller in a pressurised cabin, whose pressure is well above that of the air outside.
    """
    pressurised = pressure_pa - outside_pa > PRESSURISED_PA
    return np.where(pressurised, SIGMA_PRESSURISED_K, SIGMA_AMBIENT_K)


def first_known(*values: ArrayLike) -> Array:
    """Element by element the first of several numbers or arrays that is known; NaN without any."""
    first, *others = (np.asarray(value, np.float64) for value in values)
    result = first
    for other in others:
        result = np.where(np.isfinite(result), result, other)
    return result


def air_in(cabin: Cabin, logged: CabinAir, outside: OutsideAir) -> CabinAir:
    """The air in a cabin: its pressure by the source that is stated, the rest by what is known.

    The temperature is the stated one, else the schedule's or the logged one, else 21 degC. The
    humidity is the stated one, else the logged one, else that of the air outside if the cabin has
    that air, else none. Stated sigmas come first; a stated temperature has no other.
    """
    blank = np.full(logged.pressure_pa.shape, np.nan)  # makes a column of a number in first_known
    temperature_logged = logged.temperature_k
    vapour_logged = logged.vapour_pressure_pa
    scheduled = cabin.source == "standard_schedule"
    if scheduled:  # what is logged may be of another cabin
        temperature_logged = np.full(blank.shape, SCHEDULE_TEMPERATURE_K)
        vapour_logged = np.zeros(blank.shape)

    pressure = {
        "log": logged.pressure_pa,
        "constant": first_known(blank, cabin.pressure_pa),
        "ambient": outside.pressure_pa,
        "standard_schedule": scheduled_pressure(outside.pressure_pa),
    }[cabin.source]
    sigma_p = SIGMA_BAROMETER_PA if cabin.source in ("log", "ambient") else np.nan

    temperature = first_known(blank, cabin.temperature_k, temperature_logged, USUAL_TEMPERATURE_K)
    if np.isfinite(cabin.temperature_k):
        sigma_t = blank
    else:
        measured = np.isfinite(temperature_logged) & (not scheduled)
        of_thermometer = first_known(logged.sigma_temperature_k, SIGMA_THERMOMETER_K)
        assumed = usual_sigma(pressure, outside.pressure_pa)
        sigma_t = np.where(measured, of_thermometer, assumed)

    vapour_outside = outside.vapour_pressure_pa if cabin.source == "ambient" else 0.0
    stated = vapour_pressure(cabin.relative_humidity, temperature, pressure)
    return CabinAir(
        pressure_pa=pressure,
        temperature_k=temperature,
        vapour_pressure_pa=first_known(stated, vapour_logged, vapour_outside),
        sigma_pressure_pa=first_known(blank, cabin.sigma_pressure_pa, sigma_p),
        sigma_temperature_k=first_known(blank, cabin.sigma_temperature_k, sigma_t),
    )


def cabin_changes(stations: Stations, lenses: Mapping[str, LensInAir], index: IndexModel) -> Array:
    """(s, 4) what one sigma of the pressure and of the temperature in a cabin change.

    The columns are the change of the refractivity in the cabin by the pressure and by the
    temperature, then the change of the principal distance [px] by the pressure and by the
    temperature, which is 0 for cameras that are not among the ``lenses``. NaN where neither
    pressure nor temperature has a sigma; if one has, the unknown other sigma counts as 0.
    """
    p = stations.cabin_pressure_pa
    t = stations.cabin_temperature_k
    e = stations.cabin_vapour_pressure_pa
    sigmas = np.stack([stations.sigma_cabin_pressure_pa, stations.sigma_cabin_temperature_k], 1)
    slopes = np.zeros((len(stations), 4))
    by_pressure = index.refractivity(t, p + _STEP_PA, e) - index.refractivity(t, p - _STEP_PA, e)
    by_temperature = index.refractivity(t + _STEP_K, p, e) - index.refractivity(t - _STEP_K, p, e)
    slopes[:, 0] = by_pressure / (2.0 * _STEP_PA)
    slopes[:, 1] = by_temperature / (2.0 * _STEP_K)
    for name, lens in lenses.items():
        slopes[stations.camera == name, 2:] = lens.px_per_pa, lens.px_per_k
    changes = slopes * np.tile(np.nan_to_num(sigmas), 2)
    changes[np.isnan(sigmas).all(axis=1)] = np.nan
    return np.asarray(changes)
