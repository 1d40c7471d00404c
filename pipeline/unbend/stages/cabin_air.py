"""The air in the compartment of a camera at each exposure: values, sigmas, and what is missing.

Only the pressure has to be known. Without a thermometer the temperature is assumed: 21 degC.
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
PRESSURISED_PA = 20.0 * HECTOPASCAL  # above the air outside: a cabin with more is pressurised
THIN_PA = 0.5 * PRESSURISED_PA  # below the air outside: no cabin has so little pressure
ODD_SIGMAS = 4.0  # of the usual temperature: no cabin is farther away from it
MAX_GAP_S = 10.0  # between samples of a barometer that is compared with the air outside

BOARD_WARMER_K = 10.0
SIGMA_BOARD_K = 6.0
"""A barometer's circuit board is 0 to 20 K warmer than the air around it, in autopilots and their
simulator: evenly spread, standard deviation 5.8 K. The 10 K are those of
`atmosphere.estimate.readings`."""

# Half the steps of central differences; the derivatives are good to 1e-4 of their values.
_STEP_PA = 100.0
_STEP_K = 1.0


class CabinAir(NamedTuple):
    """The air in a cabin, (m,): pressure, vapour pressure [Pa], temperature [K], and two sigmas."""

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


def with_logged_cabin(
    stations: Stations,
    camera: str,
    cabin: Cabin,
    channels: Iterable[Channel] = (),
    roles: Mapping[str, Channel] | None = None,
) -> tuple[Stations, Notes]:
    """The stations with the logged air of a camera's cabin checked, and notes on what is missing.

    ``channels`` are those of the log, ``roles`` the channel of each role. Pressure, by the source
    that the mission file states:

    * log: exposures without a pressure become suspect (CABIN-MISSING);
    * ambient, the air outside: a barometer of the log that reads much more is reported;
    * constant or standard_schedule: the log is not used.

    Temperature, unless mission file or schedule states it:

    * a note counts the exposures without a logged temperature; `air_in_cabin` assumes one later;
    * the temperature of a circuit board is converted to that of the air.
    """
    roles = roles or {}
    channels = tuple(channels)
    notes: list[Message] = []
    if cabin.source == "log":
        candidates = candidates_for_cabin("pressure", channels, roles)
        stations, losses = suspect_without_pressure(stations, camera, candidates)
        notes += losses
    of_camera = (stations.camera == camera) & stations.ok  # those just made suspect are not ok
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
    """The stations with `BOARD_WARMER_K` subtracted from a camera's cabin temperatures, and a note.

    The logged temperatures are those of a circuit board. ``thermometer`` is the name of their
    channel, for the note.
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
    """The stations, with those of a camera that have no cabin pressure marked as suspect.

    The list has the loss that counts them; it is empty if none is marked. ``candidates`` is the
    text of `candidates_for_cabin`. Marked stations are not used, and how far off they are is
    unknown (NaN).
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

    ``quantity`` is "pressure" or "temperature"; ``roles`` has the sensor outside under the same
    name. The sensor outside is not a candidate.
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
    """A list with a finding, if a barometer of the log reads far more than the air outside.

    Compared is the median over the stations in the mask ``of_camera``; the first such barometer is
    reported. The list is empty without one, or if the log has no pressure of the air outside.
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
    """The stations with complete air in the cabins, and its sigmas (NaN if unknown).

    Cabins are completed behind plane windows, which bend rays, and behind any window of the cameras
    in ``lenses``, because their principal distance depends on the air. The cabins of other cameras
    keep the logged values. ``profile`` is the air outside.
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
        air = air_in_cabin(cabin, logged, ambient)
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
    """Report exposures with logged cabin pressure, but neither logged nor stated humidity."""
    count = int((~np.isfinite(logged.vapour_pressure_pa) & ok).sum())
    if cabin.source == "log" and not np.isfinite(cabin.relative_humidity) and count:
        ledger.add(messages.cabin_dry(where=f"camera {name}", count=count))


def report_schedule(name: str, cabin: Cabin, h_m: Array, ok: Mask, ledger: Ledger) -> None:
    """Report a cabin with scheduled air, and exposures above the height where the schedule ends."""
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
    sigma_k = sigma_of_usual_temperature(air.pressure_pa, outside.pressure_pa)
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


def sigma_of_usual_temperature(pressure_pa: Array, outside_pa: Array) -> Array:
    """(m,) standard deviation [K] of cabin temperatures about the usual 21 degC.

    It is smaller in a pressurised cabin: its pressure is well above that outside (``outside_pa``).
    """
    pressurised = pressure_pa - outside_pa > PRESSURISED_PA
    return np.where(pressurised, SIGMA_PRESSURISED_K, SIGMA_AMBIENT_K)


def first_known(*values: ArrayLike) -> Array:
    """Element by element the first of several numbers or arrays that is finite; else NaN."""
    first, *later_values = (np.asarray(value, np.float64) for value in values)
    result = first
    for other in later_values:
        result = np.where(np.isfinite(result), result, other)
    return result


def air_in_cabin(cabin: Cabin, logged: CabinAir, outside: OutsideAir) -> CabinAir:
    """The air in a cabin, each quantity from the first source below that has it.

    * Pressure: the source that is stated.
    * Temperature: stated; with a schedule that of the schedule, else logged; 21 degC.
    * Humidity: stated; with a schedule dry, else logged; with the source ambient that of the air
      outside; dry.
    * Sigmas: stated; of the sensors if they measured the quantity; of the usual temperature. A
      temperature that is stated without a sigma has the sigma NaN.

    An opening has the air of `air_in_opening`.
    """
    if cabin.source == "opening":
        return air_in_opening(cabin, outside)
    blank = np.full(logged.pressure_pa.shape, np.nan)  # gives results of first_known the shape (m,)
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
        assumed = sigma_of_usual_temperature(pressure, outside.pressure_pa)
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
    """The air before a lens in an opening: that outside, plus stated differences.

    The ratio of vapour pressure to pressure is that outside. The sigmas are those of the
    differences only: an error of the air outside is the same on both sides of the opening, so it
    does not bend rays there.
    """
    pressure = outside.pressure_pa + opening.excess_pa
    pressure_ratio = pressure / outside.pressure_pa
    return CabinAir(
        pressure_pa=pressure,
        temperature_k=outside.temperature_k + opening.warmer_k,
        vapour_pressure_pa=outside.vapour_pressure_pa * pressure_ratio,
        sigma_pressure_pa=np.full(pressure.shape, opening.sigma_pressure_pa),
        sigma_temperature_k=np.full(pressure.shape, opening.sigma_temperature_k),
    )


def cabin_changes(
    stations: Stations, lenses: Mapping[str, AnyLens], air: Profile | ProfileSeries
) -> Array:
    """(s, 4) effects of one sigma of the pressure and of the temperature in a cabin.

    Columns: change of the refractivity in the cabin by the pressure, by the temperature; change of
    the principal distance [px] by the pressure, by the temperature, 0 for cameras that are not in
    ``lenses``. A row is NaN if neither sigma is known; if one is known, the other counts as 0.
    ``air`` is that outside; its formula of the index has the wavelength of each camera.
    """
    p = stations.cabin_pressure_pa
    t = stations.cabin_temperature_k
    e = stations.cabin_vapour_pressure_pa
    sigmas = np.stack([stations.sigma_cabin_pressure_pa, stations.sigma_cabin_temperature_k], 1)
    slopes = np.zeros((len(stations), 4))
    for name in dict.fromkeys(stations.camera.tolist()):
        rows = stations.camera == name
        index = index_of_rows(air, rows)
        slopes[rows, :2] = index_slopes(index, p[rows], t[rows], e[rows])
        lens = lenses.get(name)
        if isinstance(lens, TypicalLens):
            slopes[rows, 2:] = CHANGE_PER_INDEX * lens.principal_distance_px * slopes[rows, :2]
        elif lens is not None:
            slopes[rows, 2:] = lens.px_per_pa, lens.px_per_k
    # The two sigmas twice: for the refractivity, and for the principal distance.
    changes = slopes * np.tile(np.nan_to_num(sigmas), 2)
    changes[np.isnan(sigmas).all(axis=1)] = np.nan
    return np.asarray(changes)


def index_slopes(index: IndexModel, p: Array, t: Array, e: Array) -> Array:
    """(m, 2) derivatives of n - 1 by pressure [1/Pa] and by temperature [1/K].

    ``p``, ``t``, ``e`` (m,): pressure [Pa], temperature [K] and vapour pressure [Pa].
    """
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
    """(s, 4) ``changes`` of `cabin_changes`, with the uncertainty of typical lenses added.

    ``change_px`` (s,) is what the air in the lens adds to the principal distance. The uncertainty
    of a typical lens, a lens without measured derivatives, is added in squares to the effect of the
    temperature on the principal distance (column 3).

    * A camera not in ``windows`` has its lens in the air outside: its row has this part only.
    * Behind a window with unknown sigmas the row stays NaN: the lens alone would be too little.
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
