"""The columns of every table that leaves the package: types, units, conventions."""

import json
from collections.abc import Mapping

import pyarrow as pa

SCHEMA_VERSION = "1"

_F = pa.float64()
_F4 = pa.float32()
_S = pa.string()

_COMMON = (
    "common to the block, to be removed by one scale factor, never to be added to the weights of "
    "observations; null where unknown"
)
_STATION = "attitude and height, common to an image; null where the attitude has no sigma"
_GROUND = "the same for each image of the point; null where the height has no sigma"
_CABIN = (
    "common to a camera, never to be added to the weights of observations; null without a window "
    "and where the cabin has no sigma"
)

_MODE = (
    "s is the parameter of the leading mode of the air's covariance, one for the block, with the "
    "prior uncertainty.scale_sigma of the manifest; null where the air has no covariance"
)
_NCC = (
    "n_cc is the refractivity behind the window, one parameter a camera, with the prior cabin_air "
    "of the manifest; null without a plane window"
)

OBSERVATION_COLUMNS: Mapping[str, tuple[pa.DataType, str, str]] = {
    "image": (_S, "", "name of the image"),
    "point": (_S, "", "name of the point"),
    "x_px": (_F, "px", "as measured"),
    "y_px": (_F, "px", "as measured"),
    "x_corrected_px": (_F, "px", "projection of the straight chord, in the pixels of x_px"),
    "y_corrected_px": (_F, "px", "projection of the straight chord, in the pixels of y_px"),
    "zeta_c_rad": (_F, "rad", "apparent nadir angle outside the window"),
    "r_c_rad": (_F, "rad", "refraction angle, positive: apparent ray farther from the nadir"),
    "r_cc_rad": (_F, "rad", "window, positive: the cabin moved the image point inward"),
    "sigma_r_c_rad": (_F, "rad", f"standard deviation of r_c_rad by the air; {_COMMON}"),
    "sigma_air_dx_px": (_F4, "px", f"of the shift in x, by the air; {_COMMON}"),
    "sigma_air_dy_px": (_F4, "px", f"of the shift in y, by the air; {_COMMON}"),
    "sigma_station_dx_px": (_F4, "px", f"of the shift in x, by the station; {_STATION}"),
    "sigma_station_dy_px": (_F4, "px", f"of the shift in y, by the station; {_STATION}"),
    "sigma_ground_dx_px": (_F4, "px", f"of the shift in x, by the height of the point; {_GROUND}"),
    "sigma_ground_dy_px": (_F4, "px", f"of the shift in y, by the height of the point; {_GROUND}"),
    "sigma_r_cc_rad": (_F4, "rad", f"standard deviation of r_cc_rad by the cabin's air; {_CABIN}"),
    "sigma_cabin_dx_px": (_F4, "px", f"of the shift in x, by the cabin's air; {_CABIN}"),
    "sigma_cabin_dy_px": (_F4, "px", f"of the shift in y, by the cabin's air; {_CABIN}"),
    "dx_ds_px": (_F4, "px", f"derivative of the corrected (displaced) x by s; {_MODE}"),
    "dy_ds_px": (_F4, "px", f"derivative of the corrected (displaced) y by s; {_MODE}"),
    "dx_dncc_px": (_F4, "px", f"derivative of the corrected (displaced) x by n_cc; {_NCC}"),
    "dy_dncc_px": (_F4, "px", f"derivative of the corrected (displaced) y by n_cc; {_NCC}"),
    "h_g_m": (_F, "m", "height of the point above mean sea level that was used"),
    "status": (_S, "", "ok, or why there is no correction"),
}

# What takes the place of some columns where ideal observations were displaced.
_DISPLACED: Mapping[str, tuple[str, tuple[pa.DataType, str, str]]] = {
    "x_px": ("x_px", (_F, "px", "ideal, free of refraction, as given")),
    "y_px": ("y_px", (_F, "px", "ideal, free of refraction, as given")),
    "x_corrected_px": (
        "x_displaced_px",
        (_F, "px", "what a camera in this air measures, in the pixels of x_px"),
    ),
    "y_corrected_px": (
        "y_displaced_px",
        (_F, "px", "what a camera in this air measures, in the pixels of y_px"),
    ),
    "status": ("status", (_S, "", "ok, or why there is no displacement")),
}

DISPLACED_COLUMNS: Mapping[str, tuple[pa.DataType, str, str]] = dict(
    _DISPLACED.get(name, (name, column)) for name, column in OBSERVATION_COLUMNS.items()
)

STATION_COLUMNS: Mapping[str, tuple[pa.DataType, str, str]] = {
    "image": (_S, "", "name of the image"),
    "camera": (_S, "", "name of the camera in the mission file"),
    "profile_id": (_S, "", "profile of the air used for the image"),
    "time_utc": (pa.timestamp("ns", "UTC"), "", "time of the exposure"),
    "lat_deg": (_F, "deg", "geodetic latitude of the projection centre, WGS84"),
    "lon_deg": (_F, "deg", "longitude of the projection centre, WGS84"),
    "h_msl_m": (_F, "m", "height of the projection centre above mean sea level"),
    "h_ellipsoid_m": (_F, "m", "height of the projection centre above the ellipsoid"),
    "q_w": (_F, "", "v_camera = R(q) v_enu, Hamilton, q_w >= 0"),
    "q_x": (_F, "", "camera x right, y down, z forward"),
    "q_y": (_F, "", "east, north, up at the station, up along the ellipsoid normal"),
    "q_z": (_F, "", ""),
    "aircraft_q_w": (_F, "", "v_body = R(q) v_enu, body x forward, y right, z down"),
    "aircraft_q_x": (_F, "", "of the aircraft where the camera has a mount of its own"),
    "aircraft_q_y": (_F, "", ""),
    "aircraft_q_z": (_F, "", ""),
    "pressure_pa": (_F, "Pa", "static pressure outside, as logged"),
    "temperature_k": (_F, "K", "temperature outside, as logged"),
    "vapour_pressure_pa": (_F, "Pa", "water vapour outside, as logged"),
    "cabin_pressure_pa": (_F, "Pa", "in the compartment, as logged, stated or assumed"),
    "cabin_temperature_k": (_F, "K", "in the compartment, as logged, stated or assumed"),
    "cabin_vapour_pressure_pa": (_F, "Pa", "in the compartment"),
    "sigma_cabin_pressure_pa": (_F, "Pa", "standard deviation; null without a window"),
    "sigma_cabin_temperature_k": (_F, "K", "standard deviation; null without a window"),
    "sigma_horizontal_m": (_F, "m", "standard deviation per axis, as the receiver gave it"),
    "sigma_height_m": (_F, "m", "standard deviation, as the receiver gave it"),
    "sigma_tilt_deg": (_F, "deg", "standard deviation about each of the body's level axes"),
    "sigma_yaw_deg": (_F, "deg", "standard deviation about the body's vertical axis"),
    "suspect_reason": (_S, "", "which evidence contradicts the station; null where none does"),
    "suspect_m": (_F, "m", "how far off a suspect position may be"),
    "status": (_S, "", "ok, or what is missing"),
    "geometry": (
        pa.binary(),
        "",
        "WKB point of the projection centre: longitude, latitude [deg], height above the ellipsoid "
        "[m] where it is known",
    ),
}

PROFILE_COLUMNS: Mapping[str, tuple[pa.DataType, str, str]] = {
    "profile_id": (_S, "", ""),
    "time_utc": (pa.timestamp("ns", "UTC"), "", "of this air; of one profile, middle of samples"),
    "h_m": (_F, "m", "height above mean sea level"),
    "geopotential_m": (_F, "m'", "H = r_phi h g_phi / ((r_phi + h) G)"),
    "temperature_k": (_F, "K", ""),
    "virtual_temperature_k": (_F, "K", "T_M = T / (1 - 0.378 e / p)"),
    "pressure_pa": (_F, "Pa", "by the row's equation from its base values"),
    "vapour_pressure_pa": (_F, "Pa", ""),
    "refractivity": (_F, "", "n - 1"),
    "layer": (pa.int32(), "", "number of the layer, from the ground up"),
    "equation": (pa.int16(), "", "52 or 53 of Gyer 1996"),
    "h_base_m": (_F, "m", "height of the layer's base"),
    "geopotential_base_m": (_F, "m'", "geopotential height of the layer's base, H_b"),
    "t_base_k": (_F, "K", "T_M at the base, T_b"),
    "p_base_pa": (_F, "Pa", "pressure at the base, p_b"),
    "lapse_k_per_m": (_F, "K/m'", "gradient of T_M per geopotential metre, L_b"),
    "source": (_S, "", "measured | barometric | relaxed | standard"),
    "standard_temperature_k": (_F, "K", "of the standard atmosphere at the same height"),
    "standard_pressure_pa": (_F, "Pa", "of the standard atmosphere at the same height"),
    "standard_vapour_pressure_pa": (_F, "Pa", "of the standard atmosphere at the same height"),
    "standard_refractivity": (_F, "", "n - 1 of the standard atmosphere at the same height"),
    "sigma_temperature_k": (_F, "K", "one standard deviation; null for a standard atmosphere"),
    "sigma_refractivity": (_F, "", "one standard deviation; null for a standard atmosphere"),
}

CONVENTIONS: Mapping[str, str] = {
    "pixels": "COLMAP: the centre of the upper left pixel is (0.5, 0.5); x right, y down, unless "
    "pixel_origin says centre",
    "camera": "x right, y down, z forward; v_camera = R(q) v_enu, Hamilton quaternion, q_w >= 0",
    "frame": "east, north, up at each station, up along the normal of the WGS84 ellipsoid",
    "refraction": "corrected coordinates are the projection of the straight chord to the point; "
    "switch refraction off in the adjustment and never correct twice; displaced coordinates are "
    "what a camera in the air of the profile measures",
    "signs": "net shift r_c - r_cc; r_c > 0: the apparent ray is farther from the nadir",
    "not_corrected": "earth curvature, map projection, displacement by the window glass, "
    "aberration; change of the principal distance with the air in the lens, except of cameras with "
    "a principal_distance section in the mission file",
}


def schema_of(
    columns: Mapping[str, tuple[pa.DataType, str, str]],
    extra: Mapping[str, str],
    users: list[pa.Field] | None = None,
) -> pa.Schema:
    """An Arrow schema with units and meanings in the fields and conventions in the metadata.

    ``extra`` joins the metadata; ``users`` are the user's own columns, after ours.
    """
    fields = [
        pa.field(name, kind, metadata={"unit": unit, "meaning": meaning})
        for name, (kind, unit, meaning) in columns.items()
    ]
    metadata = {
        "unbend.schema": SCHEMA_VERSION,
        "unbend.conventions": json.dumps(dict(CONVENTIONS), sort_keys=True),
    } | dict(extra)
    return pa.schema(fields + (users or []), metadata=metadata)
