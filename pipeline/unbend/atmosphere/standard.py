"""The registry of atmospheres, and the standard atmospheres, each with its own constants.

A new atmosphere is one function and a line in `ATMOSPHERES`. The breakpoints of the standards stand
in ``data/standard_atmospheres.csv``: US Standard Atmosphere 1976 and 1962, ICAO 1993 (ISO 2533),
ARDC Model Atmosphere 1959 (behind the tables of Gyer 1996 and Bertram 1966) and ICAN (Saastamoinen
1974). NRLMSIS 2.1 comes from the package pymsis, temperature only, because it has no water.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from unbend.atmosphere import climate_tables, messages
from unbend.atmosphere.climate_tables import AFGL_ORIGIN, SUPPLEMENTS, SUPPLEMENTS_ORIGIN
from unbend.atmosphere.layers import STANDARD, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import DEFAULT_WAVELENGTH_M, IndexModel
from unbend.geodesy import Gravity, normal_gravity
from unbend.units import DEGREE, STANDARD_GRAVITY

SEA_LEVEL_PA = 101325.0

MSIS = "nrlmsis2.1"
_MSIS_TOP_M = 80_000.0
_MSIS_STEP_M = 500.0
_MSIS_TEMPERATURE = 10  # column of pymsis.Variable.TEMPERATURE
# Solar flux and geomagnetic index have no effect below 80 km: given, so that nothing is downloaded.
_SOLAR_FLUX = 150.0
_GEOMAGNETIC = 4.0

AUTO = "auto"


@dataclass(frozen=True)
class SeasonAndPlace:
    """Where and when a profile is wanted; see `climatology.climatology`.

    ``latitude_rad``: None for a standard without a place.
    """

    latitude_rad: float | None = None
    month: float = 4.0
    longitude_rad: float = 0.0

    @property
    def gravity(self) -> Gravity | None:
        """Normal gravity of the latitude, None without one; `PhysicsError` beyond the pole."""
        if self.latitude_rad is None:
            return None
        if not abs(self.latitude_rad) <= math.pi / 2.0 + 1e-12:
            raise messages.latitude_beyond_pole(latitude_rad=self.latitude_rad)
        return normal_gravity(self.latitude_rad)


@dataclass(frozen=True)
class AtmosphereModel:
    """How the profile of an atmosphere is made, and the ``origin`` of its numbers, in words.

    ``has_humidity``: whether it has water vapour at all. ``needs_place``: whether it needs latitude
    and season.
    """

    profile: Callable[[SeasonAndPlace, IndexModel], Profile]
    origin: str
    has_humidity: bool
    needs_place: bool = False


def _tabulated_profile(name: str, place: SeasonAndPlace, index: IndexModel) -> Profile:
    """The profile of a climate table, or of a dry standard from its breakpoints.

    Without a latitude in ``place`` its gravity is that of its own definition.
    """
    if name in climate_tables.climate_names():
        return climate_tables.climate_profile(name, index, place.gravity)
    rows = climate_tables.read_models("standard_atmospheres.csv")[name]
    first = rows[0]
    gravity = place.gravity or Gravity(first["g0_m_s2"], first["r0_m"])
    edge = np.array([row["geopotential_m"] for row in rows])
    temperature = np.array([row["temperature_k"] for row in rows])
    lapse = (temperature[1] - temperature[0]) / (edge[1] - edge[0])
    # Below the lowest breakpoint the troposphere's lapse rate continues, as in ISO 2533.
    if edge[0] > climate_tables.LOWEST_GEOPOTENTIAL_M:
        rise = climate_tables.LOWEST_GEOPOTENTIAL_M - edge[0]  # negative
        edge = np.append(climate_tables.LOWEST_GEOPOTENTIAL_M, edge)
        temperature = np.append(temperature[0] + lapse * rise, temperature)
    constant = STANDARD_GRAVITY * first["m0_kg_per_kmol"] / first["r_star_j_per_kmol_k"]
    layers = stack_layers(
        edge,
        temperature,
        np.zeros(edge.size),
        (STANDARD,) * (edge.size - 1),
        anchor=(0.0, SEA_LEVEL_PA),
        constant=constant,
    )
    return Profile(layers, gravity, index, name, constant)


def _supplements(place: SeasonAndPlace, index: IndexModel) -> Profile:
    """The Supplements at a latitude and season; at the equator without a latitude."""
    latitude_rad = place.latitude_rad or 0.0
    return climate_tables.supplements_profile(latitude_rad, place.month, index, place.gravity)


def _msis(place: SeasonAndPlace, index: IndexModel) -> Profile:
    """The dry profile of NRLMSIS 2.1 at noon UTC of the day, to 80 km.

    Its pressure at sea level is that of the Supplements. Source: Emmert et al. 2022, NRLMSIS 2.1,
    doi:10.1029/2022JA030896.
    """
    try:
        import pymsis
    except ImportError:
        raise messages.msis_not_installed() from None
    latitude = place.latitude_rad or 0.0
    day = math.floor(((place.month - 1.0) % 12.0) / 12.0 * 365.25) + 14
    noon = np.datetime64("2001-01-01T12:00") + np.timedelta64(day % 365, "D")
    h = np.arange(0.0, _MSIS_TOP_M + 1.0, _MSIS_STEP_M)
    answer = pymsis.calculate(
        noon,
        place.longitude_rad / DEGREE,
        latitude / DEGREE,
        h / 1000.0,
        f107s=[_SOLAR_FLUX],
        f107as=[_SOLAR_FLUX],
        aps=[[_GEOMAGNETIC] * 7],
        version=2.1,
    )
    by_height = np.asarray(answer, dtype=np.float64).reshape(h.size, -1)
    gravity = place.gravity or normal_gravity(latitude)
    return climate_tables.hydrostatic_profile(
        gravity.geopotential_height(h),
        by_height[:, _MSIS_TEMPERATURE],
        np.zeros_like,
        float(_supplements(place, index).pressure(0.0)),
        gravity,
        index=index,
        name=MSIS,
    )


_OF_SEASON = AtmosphereModel(_supplements, SUPPLEMENTS_ORIGIN, has_humidity=True, needs_place=True)

ATMOSPHERES: dict[str, AtmosphereModel] = {
    AUTO: _OF_SEASON,
    SUPPLEMENTS: _OF_SEASON,
    **{
        name: AtmosphereModel(
            partial(_tabulated_profile, name),
            SUPPLEMENTS_ORIGIN if name.startswith(SUPPLEMENTS) else AFGL_ORIGIN,
            has_humidity=True,
        )
        for name in climate_tables.climate_names()
    },
    MSIS: AtmosphereModel(
        _msis,
        "NRLMSIS 2.1 (Emmert et al. 2022), temperature only",
        has_humidity=False,
        needs_place=True,
    ),
    **{
        name: AtmosphereModel(
            partial(_tabulated_profile, name), f"standard atmosphere {name}", has_humidity=False
        )
        for name in climate_tables.read_models("standard_atmospheres.csv")
    },
}
"""All atmospheres by name; `known_names`, mission files and the command line follow from it."""


def known_names() -> tuple[str, ...]:
    """All names of atmospheres, each once.

    >>> known_names()[:2], known_names()[-4:]
    (('auto', 'supplements1966'), ('us1962', 'icao', 'ardc1959', 'ican'))
    """
    return tuple(ATMOSPHERES)


def standard_names() -> tuple[str, ...]:
    """Names for `standard_atmosphere`: dry standards first, then tables with humidity.

    >>> standard_names()[:5], standard_names()[5]
    (('us1976', 'us1962', 'icao', 'ardc1959', 'ican'), 'supplements1966_15n_annual')
    """
    fixed = [name for name, model in ATMOSPHERES.items() if not model.needs_place]
    return tuple(sorted(fixed, key=lambda name: ATMOSPHERES[name].has_humidity))


def standard_atmosphere(
    name: str = "us1976",
    index: str = "ciddor",
    wavelength_m: float = DEFAULT_WAVELENGTH_M,
    latitude: float | None = None,
) -> Profile:
    """A standard atmosphere as a profile.

    ``name``: one of `standard_names`. ``index``: ``ciddor``, or ``gyer`` (Gyer 1996, Eq. 13), which
    is for 0.589 um and ignores the wavelength. ``wavelength_m``: in vacuum [m]. ``latitude``:
    geodetic [rad], for normal gravity as in the profile of a mission. By default a standard has the
    gravity of its own definition, and a climate table that of its latitude.

    Agrees with the tables of its definition to their last printed digit.

    >>> profile = standard_atmosphere("us1976", index="gyer")
    >>> (profile.refractivity(0.0) * 1e6).round(3).item()
    277.201
    """
    model = ATMOSPHERES.get(name)
    if model is None or model.needs_place:
        raise messages.unknown_standard(name=name, names=", ".join(standard_names()))
    return model.profile(SeasonAndPlace(latitude), IndexModel(index, wavelength_m))
