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
from unbend.flight.interpolation import interpolate
from unbend.flight.stations import Stations
from unbend.messages import Kind, Ledger, Message, Notes
from unbend.refraction.lens_air import (
    CHANGE_PER_INDEX,
    AnyLens,
    TypicalLens,
    sigma_of_change,
)
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
from unbend.stages.wavelengths import index_of_rows
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
    """The air outside, (m,): pressure [Pa], temperature [K], vapour pressure [Pa]."""

    pressure_pa: Array
    temperature_k: Array
    vapour_pressure_pa: Array


def cabin_from_log(
    stations: Stations,
    camera: str,
    cabin: Cabin,
    channels: Iterable[Channel] = (),
    roles: Mapping[str, Channel] | None = None,
) -> tuple[Stations, Notes]:
    """The stations with the logged air in the cabin of a camera, and notes on what the log lacks.

    Pressure, by the source that the mission file states:

    * log: exposures without a pressure become suspect (CABIN-MISSING);
    * ambient, the air outside: a barometer of the log that reads much more is reported;
    * constant or standard_schedule: the log is not asked.

    Temperature, unless mission file or schedule states it:

    * a note counts the exposures without a logged temperature; `air_in` gives them the usual one;
    * the temperature of a circuit board is made that of the air.
    """
    roles = roles or {}
    channels = tuple(channels)
    notes: list[Message] = []
    if cabin.source == "log":
        candidates = candidates_for_cabin("pressure", channels, roles)
        stations, losses = suspect_without_pressure(stations, camera, candidates)
        notes += losses
    of_camera = (stations.camera == camera) & stations.ok  # without those that are suspect now
    if cabin.source == "ambient":
        notes += barometer_in_cabin(stations, of_camera, camera, channels, roles)

    is_temperature_stated = cabin.source == "standard_schedule" or np.isfinite(cabin.temperature_k)
    if is_temperature_stated:
        return stations, tuple(notes)
    without_temperature = int((of_camera & np.isnan(stations.cabin_temperature_k)).sum())
    if without_temperature:
        notes.append(
            messages.cabin_temperature_assumed(
                kind=Kind.LOSS if cabin.temperature_logged else Kind.FALLBACK,
                where=f"camera {camera}",
                count=without_temperature,
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
    """The stations, those of a camera as suspect at which the pressure in its cabin is unknown.

    Returned with them is the loss that counts these, if there are any. ``candidates`` says in words
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
    """A finding of the first barometer of the log that reads far more than the air outside has.

    The list is empty without such a barometer, or if the log gives no pressure of the air outside.
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
    outside = OutsideAir(profile.pressure(h), profile.temperature(h), profile.vapour_pressure(h))
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
        if not window.is_opening:
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
    first, *later_values = (np.asarray(value, np.float64) for value in values)
    result = first
    for other in later_values:
        result = np.where(np.isfinite(result), result, other)
    return result


def air_in(cabin: Cabin, logged: CabinAir, outside: OutsideAir) -> CabinAir:
    """The air in a cabin: its pressure by the source that is stated, the rest by what is known.

    * Temperature: the stated one; else with a schedule that of the schedule, otherwise the logged
      one; else 21 degC.
    * Humidity: the stated one; else with a schedule none, otherwise the logged one; else that of
      the air outside if the cabin has that air; else none.
    * Sigmas: the stated ones; else those of the sensors, or of the usual temperature. A temperature
      that is stated without a sigma has none (NaN).

    The air in an opening is by `air_in_opening`.
    """
    if cabin.source == "opening":
        return air_in_opening(cabin, outside)
    blank = np.full(logged.pressure_pa.shape, np.nan)  # makes a column of a number in first_known
    is_scheduled = cabin.source == "standard_schedule"
    temperature_if_unstated = logged.temperature_k
    vapour_if_unstated = logged.vapour_pressure_pa
    if is_scheduled:  # what is logged may be of another cabin
        temperature_if_unstated = np.full(blank.shape, SCHEDULE_TEMPERATURE_K)
        vapour_if_unstated = np.zeros(blank.shape)

    pressure = {
        "log": logged.pressure_pa,
        "constant": first_known(blank, cabin.pressure_pa),
        "ambient": outside.pressure_pa,
        "standard_schedule": scheduled_pressure(outside.pressure_pa),
    }[cabin.source]
    sigma_p = SIGMA_BAROMETER_PA if cabin.source in ("log", "ambient") else np.nan

    temperature = first_known(
        blank, cabin.temperature_k, temperature_if_unstated, USUAL_TEMPERATURE_K
    )
    if np.isfinite(cabin.temperature_k):
        sigma_t = blank
    else:
        is_measured = np.isfinite(temperature_if_unstated) & (not is_scheduled)
        of_thermometer = first_known(logged.sigma_temperature_k, SIGMA_THERMOMETER_K)
        assumed = usual_sigma(pressure, outside.pressure_pa)
        sigma_t = np.where(is_measured, of_thermometer, assumed)

    vapour_stated = vapour_pressure(cabin.relative_humidity, temperature, pressure)
    vapour_if_unknown = outside.vapour_pressure_pa if cabin.source == "ambient" else 0.0
    return CabinAir(
        pressure_pa=pressure,
        temperature_k=temperature,
        vapour_pressure_pa=first_known(vapour_stated, vapour_if_unstated, vapour_if_unknown),
        sigma_pressure_pa=first_known(blank, cabin.sigma_pressure_pa, sigma_p),
        sigma_temperature_k=first_known(blank, cabin.sigma_temperature_k, sigma_t),
    )


def air_in_opening(opening: Cabin, outside: OutsideAir) -> CabinAir:
    """The air before a lens in an opening: that outside, warmer and under another pressure.

    Its share of vapour is that outside. The sigmas are those of the differences: an error of the
    air outside is one of this air too, and bends nothing here.
    """
    pressure = outside.pressure_pa + opening.excess_pa
    share = pressure / outside.pressure_pa
    return CabinAir(
        pressure_pa=pressure,
        temperature_k=outside.temperature_k + opening.warmer_k,
        vapour_pressure_pa=outside.vapour_pressure_pa * share,
        sigma_pressure_pa=np.full(pressure.shape, opening.sigma_pressure_pa),
        sigma_temperature_k=np.full(pressure.shape, opening.sigma_temperature_k),
    )


def cabin_changes(
    stations: Stations, lenses: Mapping[str, AnyLens], air: Profile | ProfileSeries
) -> Array:
    """(s, 4) what one sigma of the pressure and of the temperature in a cabin change.

    The columns are the change of the refractivity in the cabin by the pressure and by the
    temperature, then the change of the principal distance [px] by the pressure and by the
    temperature, which is 0 for cameras that are not among the ``lenses``. NaN where neither
    pressure nor temperature has a sigma; if one has, the unknown other sigma counts as 0. ``air``
    is that outside, with the formula of the index and the light of each camera.
    """
    p = stations.cabin_pressure_pa
    t = stations.cabin_temperature_k
    e = stations.cabin_vapour_pressure_pa
    sigmas = np.stack([stations.sigma_cabin_pressure_pa, stations.sigma_cabin_temperature_k], 1)
    slopes = np.zeros((len(stations), 4))
    # Both sigmas side by side twice: for the refractivity, and for the principal distance.
    for name in dict.fromkeys(stations.camera.tolist()):
        rows = stations.camera == name
        index = index_of_rows(air, rows)
        slopes[rows, :2] = index_slopes(index, p[rows], t[rows], e[rows])
        lens = lenses.get(name)
        if isinstance(lens, TypicalLens):
            slopes[rows, 2:] = CHANGE_PER_INDEX * lens.principal_distance_px * slopes[rows, :2]
        elif lens is not None:
            slopes[rows, 2:] = lens.px_per_pa, lens.px_per_k
    changes = slopes * np.tile(np.nan_to_num(sigmas), 2)
    changes[np.isnan(sigmas).all(axis=1)] = np.nan
    return np.asarray(changes)


def index_slopes(index: IndexModel, p: Array, t: Array, e: Array) -> Array:
    """(m, 2) derivatives of n - 1 by pressure [1/Pa] and by temperature [1/K]."""
    by_pressure = index.refractivity(t, p + _STEP_PA, e) - index.refractivity(t, p - _STEP_PA, e)
    by_temperature = index.refractivity(t + _STEP_K, p, e) - index.refractivity(t - _STEP_K, p, e)
    return np.stack([by_pressure / (2.0 * _STEP_PA), by_temperature / (2.0 * _STEP_K)], axis=1)


def with_errors_of_lenses(
    changes: Array,
    stations: Stations,
    lenses: Mapping[str, AnyLens],
    windows: Container[str],
    change_px: Array,
) -> Array:
    """(s, 4) ``changes`` of `cabin_changes`, with the errors of lenses that nobody measured.

    ``change_px`` (s,) is what the air in the lens adds to the principal distance. What is unknown
    of a typical lens counts as an error of the temperature in it, to which it is added in squares.
    It is alone for a camera that has no ``windows``, whose lens is in the air outside; behind one
    of which no error is known, that of the lens alone would be too small, and none stays known.
    """
    changed = changes.copy()
    for name, lens in lenses.items():
        if not isinstance(lens, TypicalLens):
            continue
        rows = stations.camera == name
        of_camera = changed[rows]
        if name not in windows:
            of_camera = np.zeros(of_camera.shape)
        by_lens = sigma_of_change(lens, change_px[rows])
        # The sign of the temperature's part stays: it acts through the window as well.
        of_camera[:, 3] = -np.hypot(of_camera[:, 3], by_lens)
        changed[rows] = of_camera
    return changed
