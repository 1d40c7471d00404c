"""The air in the compartment of a camera at each exposure: its values, its sigmas, what is missing.

Only its pressure has to be known: without a thermometer a pressurised cabin is near 21 degC.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import Profile
from unbend.atmosphere.refractive_index import IndexModel, vapour_pressure
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.flight.channels import Channel
from unbend.flight.station_builder import mark_suspect
from unbend.flight.stations import Stations
from unbend.flight.trajectory import interpolate
from unbend.messages import Ledger, Notes, fallback, finding, loss, warning
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
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K, Array, Mask

USUAL_TEMPERATURE_K = 294.15
SIGMA_PRESSURISED_K, SIGMA_AMBIENT_K = 5.0, 10.0
"""21 degC, and the standard deviation about it of cabins with and without pressurisation."""
PRESSURISED_PA = 20.0 * HECTOPASCAL
"""A cabin with so much more pressure than the air outside is pressurised."""
BOARD_WARMER_K, SIGMA_BOARD_K = 10.0, 6.0
"""A barometer's board against the air about it: 0 to 20 K warmer in autopilots and their simulator,
evenly spread (standard deviation 5.8 K); the same 10 K as `atmosphere.estimate.readings` has."""
_COLUMNS = (
    "cabin_pressure_pa", "cabin_temperature_k", "cabin_vapour_pressure_pa",
    "sigma_cabin_pressure_pa", "sigma_cabin_temperature_k",
)  # fmt: skip


def cabin_from_log(
    stations: Stations, camera: str, cabin: Cabin, channels: Iterable[Channel] = (),
    roles: Mapping[str, Channel] | None = None,
) -> tuple[Stations, Notes]:  # fmt: skip
    """Stations of a camera with what the log has of its cabin, and what it lacks.

    Exposures without the pressure that is to come from the log become suspect (CABIN-MISSING). A
    temperature that is missing is assumed later; a barometer's board is `BOARD_WARMER_K` warmer.
    """
    roles = roles or {}
    notes: Notes = ()

    def could_play(quantity: str) -> str:
        outside = roles.get(quantity)
        names = []
        for channel in channels:
            if outside is None or channel.name != outside.name:
                if channel.fits_role(f"cabin_{quantity}"):
                    names.append(channel.name)
                elif quantity == "temperature" and "board_temperature_k" in channel.columns:
                    names.append(f"{channel.name} (its board, warmer than the air)")
        if not names:
            return f"no channel of the log could play cabin_{quantity}"
        return f"log.channels.cabin_{quantity} could be {', '.join(names)}"

    where = f"camera {camera}"
    if cabin.source == "log":
        missing = np.isnan(stations.cabin_pressure_pa)
        what = "no cabin pressure, without which the window cannot be corrected: "
        what += could_play("pressure")
        stations, count = mark_suspect(stations, camera, missing, what)
        if count:
            lacking = f"{count} exposures have {what}"
            notes = (loss("CABIN-MISSING", lacking, where=where, count=count),)
    of_camera = (stations.camera == camera) & stations.ok
    if cabin.source == "ambient":
        notes += _pressurised_after_all(stations, of_camera, camera, channels, roles)
    stated = cabin.source == "standard_schedule" or np.isfinite(cabin.temperature_k)
    count = int((of_camera & np.isnan(stations.cabin_temperature_k)).sum())
    if count and not stated:
        entry = loss if cabin.temperature_logged else fallback
        able = could_play("temperature")
        notes += (entry("CABIN-TEMPERATURE", where=where, count=count, able=able),)
    thermometer = roles.get("cabin_temperature")
    if stated or thermometer is None or "board_temperature_k" not in thermometer.columns:
        return stations, notes
    mine = (stations.camera == camera) & np.isfinite(stations.cabin_temperature_k)
    notes += (fallback(
        "CABIN-BOARD", where=where, count=int(mine.sum()), name=thermometer.name,
        warmer=BOARD_WARMER_K, sigma=SIGMA_BOARD_K,
    ),)  # fmt: skip
    return replace(
        stations,
        cabin_temperature_k=stations.cabin_temperature_k - BOARD_WARMER_K * mine,
        sigma_cabin_temperature_k=np.where(mine, SIGMA_BOARD_K, stations.sigma_cabin_temperature_k),
    ), notes


def _pressurised_after_all(
    stations: Stations, of_camera: Mask, camera: str, channels: Iterable[Channel],
    roles: Mapping[str, Channel],
) -> Notes:  # fmt: skip
    """A warning where a barometer of the log has much more pressure than the air outside."""
    outside = roles.get("pressure")
    for channel in channels:
        if outside is None or channel.name == outside.name or not channel.fits_role("pressure"):
            continue
        inside = interpolate(channel, "pressure_pa", stations.time_ns[of_camera], 10.0)
        excess = inside - stations.pressure_pa[of_camera]
        excess = excess[np.isfinite(excess)]
        if excess.size and float(np.median(excess)) > PRESSURISED_PA:
            return (finding(
                "CABIN-IMPLAUSIBLE/pressure", where=f"cameras.{camera}.window.cabin.pressure",
                count=excess.size, camera=camera, name=channel.name,
                hpa=np.median(excess) / HECTOPASCAL,
            ),)  # fmt: skip
    return ()


def with_cabin_air(
    stations: Stations, windows: Mapping[str, Window], lenses: Iterable[str],
    profile: Profile | ProfileSeries, ledger: Ledger,
) -> Stations:  # fmt: skip
    """Stations with the air in the cabins, and its sigmas (NaN for numbers that have none).

    It matters behind a plane window and, behind any, to cameras among ``lenses``.
    """
    columns = {name: getattr(stations, name).copy() for name in _COLUMNS}
    h = stations.h_msl_m
    outside = profile.pressure(h), profile.vapour_pressure(h)
    for name, window in windows.items():
        rows, cabin = stations.camera == name, window.cabin
        if cabin is None or not (window.shape == "plane" or name in lenses):
            continue
        logged = tuple(column[rows] for column in columns.values())
        ambient = outside[0][rows], outside[1][rows]
        values = air_in(cabin, logged, ambient)
        for column, value in zip(columns.values(), values, strict=True):
            column[rows] = value
        ok = stations.ok[rows]
        dry = int((~np.isfinite(logged[2]) & ok).sum())
        if cabin.source == "log" and not np.isfinite(cabin.relative_humidity) and dry:
            what = f"no humidity in the cabin for {dry} exposures: its air is taken as dry"
            ledger.fallback("CABIN-DRY", what, where=f"camera {name}", count=dry)
        with np.errstate(invalid="ignore"):
            above = int((ok & (h[rows] > SCHEDULE_CEILING_M)).sum())
        if cabin.source == "standard_schedule":
            where = f"cameras.{name}.window.cabin"
            ledger.note("CABIN-SCHEDULE", where=where)
            if above:
                ledger.warning("CABIN-SCHEDULE-HIGH", where=where, count=above)
        ledger.extend(_implausible_air(name, ok, values, ambient[0]))
    return replace(stations, **columns)


def _implausible_air(name: str, ok: Mask, values: tuple[Array, ...], p_outside: Array) -> Notes:
    """Warnings where pressure or temperature are those of no cabin."""
    p, t = values[:2]
    notes = []
    with np.errstate(invalid="ignore"):
        thin = ok & (p_outside - p > 0.5 * PRESSURISED_PA)
        odd = ok & (np.abs(t - USUAL_TEMPERATURE_K) > 4.0 * _usual_sigma(p, p_outside))
    for wrong, what in (
        (thin, "less pressure than the air outside"),
        (odd, "a temperature far from 21 degC"),
    ):
        if wrong.any():
            first = int(np.argmax(wrong))
            notes.append(warning(
                "CABIN-IMPLAUSIBLE", where=f"cameras.{name}.window.cabin", count=int(wrong.sum()),
                name=name, what_is_odd=what, hpa=p[first] / HECTOPASCAL,
                celsius=t[first] - ZERO_CELSIUS_K,
            ))  # fmt: skip
    return tuple(notes)


def _usual_sigma(p: Array, p_outside: Array) -> Array:
    """(m,) standard deviation of a cabin's temperature about 21 degC [K], by its pressure [Pa]."""
    return np.where(p - p_outside > PRESSURISED_PA, SIGMA_PRESSURISED_K, SIGMA_AMBIENT_K)


def _first_known(*values: ArrayLike) -> Array:
    """Of several numbers or arrays the first that is known, element by element."""
    found, *others = (np.asarray(value, np.float64) for value in values)
    for other in others:
        found = np.where(np.isfinite(found), found, other)
    return found


def air_in(
    cabin: Cabin, logged: tuple[Array, ...], outside: tuple[Array, Array]
) -> tuple[Array, ...]:
    """(m,) pressure [Pa], temperature [K], vapour pressure [Pa], sigmas of the first two."""
    p_logged, t_logged, e_logged, _, sigma_board = logged
    p_outside, e_outside = outside
    blank = np.full(p_logged.shape, np.nan)
    if cabin.source == "standard_schedule":  # whatever is logged, for instance of another cabin
        t_logged, e_logged = np.full(blank.shape, SCHEDULE_TEMPERATURE_K), np.zeros(blank.shape)
    p = {
        "log": p_logged,
        "constant": _first_known(blank, cabin.pressure_pa),
        "ambient": p_outside,
        "standard_schedule": scheduled_pressure(p_outside),
    }[cabin.source]
    t = _first_known(blank, cabin.temperature_k, t_logged, USUAL_TEMPERATURE_K)
    measured = np.isfinite(t_logged) & (cabin.source != "standard_schedule")
    sigma_t = np.where(
        measured, _first_known(sigma_board, SIGMA_THERMOMETER_K), _usual_sigma(p, p_outside)
    )
    if np.isfinite(cabin.temperature_k):
        sigma_t = blank
    sigma_p = SIGMA_BAROMETER_PA if cabin.source in ("log", "ambient") else np.nan
    stated = vapour_pressure(cabin.relative_humidity, t, p)
    e = _first_known(stated, e_logged, e_outside if cabin.source == "ambient" else 0.0)
    sigmas = (cabin.sigma_pressure_pa, sigma_p), (cabin.sigma_temperature_k, sigma_t)
    return p, t, e, *(_first_known(blank, *sigma) for sigma in sigmas)


def cabin_changes(stations: Stations, lenses: Mapping[str, LensInAir], index: IndexModel) -> Array:
    """What one sigma of a cabin's pressure and of its temperature change; (s, 4).

    In the refractivity there (first two), and in the principal distance of a camera that is among
    the ``lenses`` [px]. NaN where neither has a sigma; one without does not count beside one that
    has. Derivatives by central differences over 2 hPa and 2 K, good to 1e-4 of them.
    """
    p, t, e = (
        stations.cabin_pressure_pa, stations.cabin_temperature_k, stations.cabin_vapour_pressure_pa
    )  # fmt: skip
    sigmas = np.stack([stations.sigma_cabin_pressure_pa, stations.sigma_cabin_temperature_k], 1)
    slopes = np.zeros((len(stations), 4))
    slopes[:, 0] = index.refractivity(t, p + 100.0, e) - index.refractivity(t, p - 100.0, e)
    slopes[:, 0] /= 200.0
    slopes[:, 1] = 0.5 * (index.refractivity(t + 1.0, p, e) - index.refractivity(t - 1.0, p, e))
    for name, lens in lenses.items():
        slopes[stations.camera == name, 2:] = lens.px_per_pa, lens.px_per_k
    changes = slopes * np.tile(np.nan_to_num(sigmas), 2)
    changes[np.isnan(sigmas).all(axis=1)] = np.nan
    return np.asarray(changes)
