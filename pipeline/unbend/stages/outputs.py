"""The outputs of a run beside the observations: stations, profiles and the manifest."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from unbend.atmosphere.estimate.sensors import FAULT_TEXTS
from unbend.config import Mission
from unbend.exit_codes import exit_code_of
from unbend.flight.rotations import matrices_of
from unbend.flight.stations import NO_TIME, Stations
from unbend.messages import Ledger
from unbend.refraction.camera.camera import NO_DISTORTION
from unbend.refraction.effect import FlightAir
from unbend.refraction.kernels.columns import CABIN, WINDOW
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.flight_log import FlightLog
from unbend.stages.multi_image.control import ControlComparison
from unbend.stages.statistics import Statistics
from unbend.tables.refraction_mark import REFRACTION_APPLIED, REFRACTION_KEY, REFRACTION_REMOVED
from unbend.units import ARCSEC, Array

_MEANING = (
    "scale_sigma: standard deviation, for the prior, of the one parameter s of the leading mode of "
    "the air's covariance; the coordinates in the air of s are the corrected ones plus s dx_ds_px, "
    "s dy_ds_px, behind a plane window too. variance_share: of what the air does to these "
    "coordinates (sigma_air) it holds so much. Where there are several profiles, s moves each "
    "along its own leading mode"
)


def observation_metadata(mission: Mission) -> dict[str, str]:
    """What the Parquet metadata of the observations say, beside units and conventions."""
    removed = mission.refraction.direction == "remove"
    return {
        REFRACTION_KEY.decode(): (REFRACTION_REMOVED if removed else REFRACTION_APPLIED).decode(),
        "unbend.mission": mission.mission.name,
        "unbend.pixel_origin": mission.observations.pixel_origin,
        "unbend.ground_reference": mission.ground.reference,
    }


def manifest_of(
    mission: Mission,
    flight: FlightLog,
    stations: Stations,
    air: FlightAir,
    *,
    statistics: Statistics,
    setup: CorrectionSetup,
    causes: Mapping[str, str],
    control: ControlComparison | None,
    ledger: Ledger,
) -> dict[str, Any]:
    """What the manifest says of the results; ``causes`` are those of statuses of rows."""
    log = flight.log
    return {
        "log": log and {
            "format": log.format, "messages": dict(log.messages), "bad_bytes": log.bad_bytes,
            "lost_messages": log.lost_messages, "boots": log.boots,
            "duration_s": round(log.duration_s, 3), "time_base": log.time_base,
        },
        "channels": {role: channel.name for role, channel in sorted(flight.roles.items())},
        "stations": dict(sorted(Counter(stations.status.tolist()).items())),
        "flight": _flight(stations, setup, statistics),
        "heights": _heights(mission, flight, stations),
        "profile": _profile(air, stations),
        "observations": {
            "rows": statistics.rows,
            "parts": statistics.parts,
            "status": statistics.status,
            "causes": {k: v for k, v in causes.items() if statistics.status.get(k)},
        },
        "correction": statistics.correction(),
        "sigma_budget": statistics.sigma_budget(setup.camera_number),
        "ground_heights": statistics.ground_heights(),
        "uncertainty": air_parameter(setup, statistics),
        "cabin_air": cabin_parameters(setup),
        "cabin_sigma_share": statistics.cabin_share.summary(),
        "ledger": ledger.rows(),
        "control": None if control is None else control.manifest(),
        "exit_code": exit_code_of(has_losses=ledger.has_losses),
    }  # fmt: skip


def _flight(stations: Stations, setup: CorrectionSetup, statistics: Statistics) -> dict[str, Any]:
    """When and where the exposures are: lowest, median, highest; ``nadir_px`` of the median."""
    ok = stations.ok

    def spread(values: Array, digits: int) -> list[float] | None:
        known = values[np.isfinite(values)]
        parts = (known.min(), np.median(known), known.max()) if known.size else ()
        return [round(float(part), digits) for part in parts] or None

    time_ns = stations.time_ns[ok & (stations.time_ns != NO_TIME)]
    rows, cameras = statistics.sampled_rows(), {}
    height = np.append(np.where(ok, stations.h_msl_m, np.nan), np.nan)
    above = height[rows.station] - rows.h_g_m
    down = -matrices_of(stations.quaternion)[:, :, 2]
    for number, (name, camera) in enumerate(setup.cameras.items()):
        axis = down[ok & (stations.camera == name)]
        x, y, z = np.median(axis[np.isfinite(axis).all(axis=1)], axis=0) if len(axis) else [0.0] * 3
        nadir = angle = None
        if z > 0.05:
            inside = np.hypot(x, y) < camera.largest_radius * z
            flat = camera if inside else replace(camera, distortion=NO_DISTORTION)
            at = flat.project(np.array([x / z]), np.array([y / z]))
            nadir = [round(float(v[0]), 1) for v in at]
        if (norm := math.hypot(x, y, z)) > 0.0:
            angle = round(float(np.degrees(np.arccos(z / norm))), 2)
        cameras[name] = {
            "exposures": int((stations.camera == name).sum()),
            "format_px": [camera.width_px, camera.height_px],
            "principal_distance_px": float(f"{camera.fx_px:.10g}"),
            "height_above_ground_m": spread(above[setup.camera_number[rows.station] == number], 1),
            "axis_nadir_angle_deg": angle,
            "nadir_px": nadir,
        }
    return {
        "begin_utc": utc_second(int(time_ns.min())) if time_ns.size else None,
        "end_utc": utc_second(int(time_ns.max())) if time_ns.size else None,
        "latitude_deg": spread(np.degrees(stations.lat_rad[ok]), 6),
        "longitude_deg": spread(np.degrees(stations.lon_rad[ok]), 6),
        "h_msl_m": spread(stations.h_msl_m[ok], 1),
        "cameras": cameras,
    }


def _heights(mission: Mission, flight: FlightLog, stations: Stations) -> dict[str, Any]:
    """What all heights count from, what relates them, and how the vertical leans there."""
    ground, height, heights = mission.ground, flight.roles.get("height"), flight.heights
    of_log = [] if height is None else [
        name for name, column in (("msl", "h_msl_m"), ("ellipsoid", "h_ellipsoid_m"))
        if np.isfinite(height.columns.get(column, np.nan)).any()
    ]  # fmt: skip
    ok, orientation = stations.ok, mission.stations.orientation
    undulation = (stations.h_ellipsoid_m - stations.h_msl_m)[ok]
    undulation = undulation[np.isfinite(undulation)]
    geoid, lean = heights.geoid, np.empty((2, 0))
    if geoid is not None:
        lean = np.array(geoid.deflection(stations.lat_rad[ok], stations.lon_rad[ok])) / ARCSEC
        lean = lean[:, np.isfinite(lean).all(axis=0)]
    xi, eta = np.median(lean, axis=1).tolist() if lean.size else (None, None)
    return {
        "all": "above mean sea level",
        "log": of_log,
        "stations": orientation.path if orientation else getattr(height, "name", None),
        "ground": {"reference": ground.reference, "crs": ground.points and ground.points.crs},
        "take_off_h_msl_m": heights.home_h_msl_m,
        "undulation": {
            "source": heights.source,
            "min_m": round(float(undulation.min()), 3) if undulation.size else None,
            "max_m": round(float(undulation.max()), 3) if undulation.size else None,
        },
        "deflection": {
            "geoid": geoid and geoid.name,
            "north_arcsec": xi and round(xi, 2),
            "east_arcsec": eta and round(eta, 2),
            "applies": orientation is None,
        },
    }


def air_parameter(setup: CorrectionSetup, statistics: Statistics) -> dict[str, Any] | None:
    """The parameter of the leading mode of the air; None where no air has a covariance."""
    modes = [u.mode for u in setup.uncertainties if u is not None and u.mode is not None]
    if not modes:
        return None
    sigma, variance = modes[0].sigma, statistics.air_variance
    share = statistics.by_mode * sigma**2 / variance if variance > 0.0 else modes[0].variance_share
    return {
        "scale_sigma": sigma,
        "variance_share": float(f"{share:.4g}"),
        "profiles": len(modes),
        "meaning": _MEANING,
    }


def cabin_parameters(setup: CorrectionSetup) -> dict[str, Any]:
    """Of each camera behind a plane window the refractivity there, and its standard deviation."""
    cameras: dict[str, Any] = {}
    if (made := next(filter(None, setup.uncertainties), None)) is None:
        return cameras
    behind, inside = made.stations[:, WINDOW] >= 0.0, setup.exposures.refractivity_cabin
    for name in setup.cameras:
        rows = (setup.camera_names == name) & setup.exposures.usable & behind
        if bool(rows.any()):
            sigma = np.sqrt(np.mean(np.sum(made.stations[rows, CABIN : CABIN + 2] ** 2, axis=1)))
            cameras[name] = {
                "n_cc": float(f"{inside[rows].mean():.6g}"),
                "sigma_n_cc": float(f"{sigma:.4g}") if np.isfinite(sigma) else None,
            }
    return cameras


def _profile(air: FlightAir, stations: Stations) -> dict[str, Any]:
    """The estimate of the air, its sources, and its difference from the standard atmosphere."""
    adjustment = air.adjustment
    profile, standard = adjustment.profile, adjustment.standard
    heights, latitude = stations.h_msl_m[stations.ok], profile.gravity.latitude_rad
    difference = None
    if heights.size:
        level = float(np.median(heights))
        difference = round(float(profile.temperature(level) - standard.temperature(level)), 3)
    return {
        "basis": adjustment.basis,
        "reason": adjustment.reason,
        "standard": standard.name,
        "layers": dict(sorted(Counter(profile.layers.source).items())),
        "latitude_deg": round(float(np.degrees(latitude)), 6) if latitude is not None else None,
        "departure_at_cameras_k": difference,
        "effect": [effect.row() for effect in air.effects],
        "sources": [use.row() for use in adjustment.sources],
        "sensors": [
            {
                "what": FAULT_TEXTS[fault.fault],
                "value": round(fault.value, 4),
                "sigma": round(fault.sigma, 4),
                "expected_sigma": round(fault.prior_sigma, 4),
            }
            for fault in (estimate.in_units() for estimate in adjustment.faults)
        ],
        "profiles": len(air.series.timed_profiles),
        "windows": [  # change and sigma of R against that of the whole flight
            {
                "start_utc": utc_second(window.start_ns),
                "end_utc": utc_second(window.end_ns),
                "change": round(window.change, 5),
                "sigma": round(window.sigma, 5),
                "why_not": window.why_not,
            }
            for window in air.windows
        ],
    }


def utc_second(time_ns: int) -> str:
    """A time [Unix ns] as ISO 8601, to the second below."""
    return f"{np.datetime64(time_ns, 'ns').astype('datetime64[s]')}Z"
