"""Standard atmospheres, each with the constants of its own definition.

The breakpoints stand in ``data/standard_atmospheres.csv``: US Standard Atmosphere 1976 and 1962,
ICAO 1993 (ISO 2533), ARDC Model Atmosphere 1959 (the one behind the tables of Gyer 1996 and
Bertram 1966) and ICAN (Saastamoinen 1974). The US Supplements 1966 and AFGL 1986 are in `climates`.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.atmosphere.climate_tables import (
    LOWEST_GEOPOTENTIAL_M,
    climate_names,
    climate_profile,
    read_models,
)
from pipeline.atmosphere.profile import STANDARD, Profile, stack_layers
from pipeline.atmosphere.refractive_index import DEFAULT_WAVELENGTH_M, IndexModel
from pipeline.errors import PhysicsError
from pipeline.geodesy import Gravity, normal_gravity
from pipeline.units import STANDARD_GRAVITY

SEA_LEVEL_PRESSURE_PA = 101325.0


def _breakpoints() -> dict[str, list[dict[str, float]]]:
    return read_models("standard_atmospheres.csv")


def standard_names() -> tuple[str, ...]:
    """Names that `standard_atmosphere` takes: the standards, then the tables of `climates`.

    >>> standard_names()[:5], standard_names()[5]
    (('us1976', 'us1962', 'icao', 'ardc1959', 'ican'), 'supplements1966_15n_annual')
    """
    return (*_breakpoints(), *climate_names())


def gravity_at(latitude_rad: float) -> Gravity:
    """Normal gravity at a latitude [rad]; raises `PhysicsError` for one beyond the pole."""
    if not abs(latitude_rad) <= math.pi / 2.0 + 1e-12:
        raise PhysicsError(
            "ATMOSPHERE-LATITUDE",
            f"a latitude of {latitude_rad:g} rad lies beyond the pole",
            remedy="give it in radians",
        )
    return normal_gravity(latitude_rad)


def standard_atmosphere(
    name: str = "us1976",
    index: str = "ciddor",
    wavelength_m: float = DEFAULT_WAVELENGTH_M,
    latitude: float | None = None,
) -> Profile:
    """A standard atmosphere as a profile.

    Parameters
    ----------
    name : one of `standard_names`.
    index : ``ciddor`` or ``gyer`` (Eq. 13, 0.589 um whatever the wavelength).
    wavelength_m : wavelength of vacuum [m].
    latitude : [rad] gives normal gravity, as the profile of a mission has; by default the
        standard keeps the gravity of its own definition, a climatology that of its latitude.

    Agrees with the tables of its definition to their last printed digit.

    >>> profile = standard_atmosphere("us1976", index="gyer")
    >>> (profile.refractivity(0.0) * 1e6).round(3).item()
    277.201
    """
    gravity = None if latitude is None else gravity_at(latitude)
    if name in climate_names():
        return climate_profile(name, IndexModel(index, wavelength_m), gravity)
    try:
        rows = _breakpoints()[name]
    except KeyError:
        raise PhysicsError(
            "ATMOSPHERE-NAME",
            f"no standard atmosphere is called {name!r}",
            remedy=f"one of {', '.join(standard_names())}",
        ) from None
    first = rows[0]
    gravity = gravity or Gravity(first["g0_m_s2"], first["r0_m"])
    edge = np.array([row["geopotential_m"] for row in rows])
    temperature = np.array([row["temperature_k"] for row in rows])
    lapse = (temperature[1] - temperature[0]) / (edge[1] - edge[0])
    # The troposphere's lapse rate goes on down, as ISO 2533 tabulates it.
    if edge[0] > LOWEST_GEOPOTENTIAL_M:
        down = LOWEST_GEOPOTENTIAL_M - edge[0]
        edge = np.concatenate([[LOWEST_GEOPOTENTIAL_M], edge])
        temperature = np.concatenate([[temperature[0] + lapse * down], temperature])
    constant = STANDARD_GRAVITY * first["m0_kg_per_kmol"] / first["r_star_j_per_kmol_k"]
    layers = stack_layers(
        edge,
        temperature,
        np.zeros(edge.size),
        (STANDARD,) * (edge.size - 1),
        anchor=(0.0, SEA_LEVEL_PRESSURE_PA),
        constant=constant,
    )
    return Profile(layers, gravity, IndexModel(index, wavelength_m), name, constant)
