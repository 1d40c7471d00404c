"""The true air of the simulation, which differs from standard atmospheres.

All quantities are smooth functions of the height above sea level, so that a ray can be integrated
to the last digit. Written from the sources alone; nothing here is shared with `unbend.atmosphere`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline, make_interp_spline

from unbend.simulate import messages
from unbend.units import (
    GAS_CONSTANT_1976,
    MOLAR_MASS_AIR,
    VAPOUR_DEFICIT,
    WGS84_A,
    WGS84_F,
    ZERO_CELSIUS_K,
    Array,
)

WAVELENGTH_UM = 0.55
LOWEST_M = -300.0
HIGHEST_M = 31_000.0
KNOT_STEP_M = 10.0
SPLINE_DEGREE = 7
FIELD_HEIGHT_M = 450.0  # of the airfield, above sea level
FIELD_PRESSURE_PA = 96_850.0

_FIELD_TEMPERATURE_K = 290.0
_LAPSE_K_PER_M = 6.9e-3
_INVERSION_K = 6.5  # step added to the lapse: a rise of about 4 K between 1200 and 1500 m
_INVERSION_M = 1350.0
_INVERSION_WIDTH_M = 90.0
_TROPOPAUSE_M = 11_000.0
_TROPOPAUSE_WIDTH_M = 800.0


def temperature_k(h_m: Array) -> Array:
    """True temperature [K] at heights above sea level (...) [m]: lapse, inversion, tropopause.

    >>> float(temperature_k(np.array(450.0)).round(3))
    290.0
    """
    width = _TROPOPAUSE_WIDTH_M
    below_tropopause = width * np.logaddexp(0.0, (_TROPOPAUSE_M - h_m) / width)
    at_tropopause = _FIELD_TEMPERATURE_K - _LAPSE_K_PER_M * (_TROPOPAUSE_M - FIELD_HEIGHT_M)
    inversion = 0.5 * _INVERSION_K * (1.0 + np.tanh((h_m - _INVERSION_M) / _INVERSION_WIDTH_M))
    return np.asarray(at_tropopause + _LAPSE_K_PER_M * below_tropopause + inversion)


def relative_humidity(h_m: Array) -> Array:
    """True relative humidity over water (0-1) at heights above sea level (...) [m].

    >>> float(relative_humidity(np.array(450.0)).round(3))
    0.65
    """
    above_1400_m = 0.5 * (1.0 + np.tanh((h_m - 1400.0) / 120.0))
    above_7000_m = 0.5 * (1.0 + np.tanh((h_m - 7000.0) / 1500.0))
    return np.asarray(0.65 - 0.40 * above_1400_m - 0.20 * above_7000_m)


def saturation_pressure_pa(temperature: Array) -> Array:
    """Saturation vapour pressure over water [Pa] at temperatures (...) [K], 200-330 K.

    Sonntag (1990), Z. Meteorol. 70, 340-344, on ITS-90; 0.1 % against Wexler above 250 K.

    >>> float(saturation_pressure_pa(np.array(293.15)).round(0))
    2339.0
    """
    t = temperature
    exponent = -6096.9385 / t + 21.2409642 - 2.711193e-2 * t + 1.673952e-5 * t**2
    return np.asarray(np.exp(exponent + 2.433502 * np.log(t)))


def vapour_pressure_pa(h_m: Array) -> Array:
    """True partial pressure of water vapour [Pa] at heights above sea level (...) [m]."""
    return relative_humidity(h_m) * saturation_pressure_pa(temperature_k(h_m))


def normal_gravity(lat_rad: float, h_m: float) -> float:
    """WGS84 normal gravity [m s-2] at a latitude [rad] and height [m], below 50 km.

    Somigliana's formula and the second-order free-air term: NIMA TR8350.2 (2000), Eq. 4-1, 4-3;
    1e-6 relative at 10 km.

    >>> round(normal_gravity(np.radians(45.0), 0.0), 6)
    9.806198
    """
    s2 = float(np.sin(lat_rad)) ** 2
    eccentricity2 = WGS84_F * (2.0 - WGS84_F)
    at_ellipsoid = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / (1.0 - eccentricity2 * s2) ** 0.5
    m = 0.00344978650684
    first = 2.0 / WGS84_A * (1.0 + WGS84_F + m - 2.0 * WGS84_F * s2) * h_m
    return float(at_ellipsoid * (1.0 - first + 3.0 * h_m**2 / WGS84_A**2))


def edlen_index(
    pressure_pa: Array, temperature: Array, vapour_pa: Array, wavelength_um: float = WAVELENGTH_UM
) -> Array:
    """Phase refractive index of moist air with 450 ppm of CO2.

    Arguments (...): pressure [Pa] of the moist air, temperature [K], vapour pressure [Pa];
    vacuum wavelength 0.35-1.7 um. The modified Edlen equation: Birch and Downs (1994), Metrologia
    31, 315, with the temperature-dependent water term of Stone and Zimmerman (NIST Engineering
    Metrology Toolbox); 4e-8 in n over 233-323 K.

    >>> n = edlen_index(np.array(101325.0), np.array(293.15), np.array(0.0), 0.633)
    >>> f"{float(n - 1.0):.4e}"
    '2.7180e-04'
    """
    t = temperature - ZERO_CELSIUS_K
    s = 1.0 / wavelength_um**2
    standard_refractivity = 1e-8 * (8342.54 + 2_406_147.0 / (130.0 - s) + 15_998.0 / (38.9 - s))
    x = (1.0 + 1e-8 * (0.601 - 0.00972 * t) * pressure_pa) / (1.0 + 0.003661 * t)
    dry = pressure_pa * standard_refractivity * x / 96_095.43
    water = 1e-10 * (292.75 / temperature) * (3.7345 - 0.0401 * s) * vapour_pa
    return np.asarray(1.0 + dry - water)


@dataclass(frozen=True, eq=False)
class TrueAir:
    """The true air over one latitude, -300 m to 31 km; heights (...) [m] above sea level.

    Pressure is the solution of dp/dh = -rho g for moist air; the refractive index and its slope
    come from one spline (degree 7, through values every 10 m), so that they agree exactly.
    """

    log_pressure: BSpline
    index: BSpline
    index_slope: BSpline

    def pressure_pa(self, h_m: Array) -> Array:
        """True pressure [Pa]."""
        return np.asarray(np.exp(self.log_pressure(h_m)))

    def n(self, h_m: Array) -> Array:
        """True refractive index."""
        return np.asarray(self.index(h_m))

    def dn_dh(self, h_m: Array) -> Array:
        """Vertical gradient of the refractive index [1/m]."""
        return np.asarray(self.index_slope(h_m))


def true_air(lat_rad: float) -> TrueAir:
    """Integrate the hydrostatic equation at a latitude [rad] and tabulate the index.

    Dry gas constant from R* and M0 of the US Standard Atmosphere 1976, moist air by the virtual
    temperature T / (1 - 0.378 e/p). Integrated by DOP853 at rtol 1e-12.
    """

    def slope(h: float, log_p: Array) -> Array:
        """d(ln p)/dh [1/m] of moist air at a height [m]."""
        height = np.array(h)
        moist = 1.0 - VAPOUR_DEFICIT * vapour_pressure_pa(height) / np.exp(log_p)
        molar_weight = MOLAR_MASS_AIR * normal_gravity(lat_rad, h)
        return np.asarray(-molar_weight * moist / (GAS_CONSTANT_1976 * temperature_k(height)))

    def log_pressure_from_field(heights: Array, end_m: float) -> Array:
        """ln p at ``heights`` [m], in order from the field to ``end_m``, which may be lower."""
        # With steps of at most 100 m, values between steps are as accurate: 1e-13 in ln p.
        solution = solve_ivp(
            slope,
            (FIELD_HEIGHT_M, end_m),
            [np.log(FIELD_PRESSURE_PA)],
            method="DOP853",
            t_eval=heights,
            rtol=1e-12,
            atol=1e-14,
            max_step=100.0,
        )
        if not solution.success:
            raise messages.not_integrated(what="air", answer=solution.message)
        log_p: Array = solution.y[0]
        return log_p

    knots = np.arange(LOWEST_M, HIGHEST_M + 1.0, KNOT_STEP_M)
    below = knots <= FIELD_HEIGHT_M
    above = knots >= FIELD_HEIGHT_M
    log_p = np.empty_like(knots)
    log_p[below] = log_pressure_from_field(knots[below][::-1], LOWEST_M)[::-1]
    log_p[above] = log_pressure_from_field(knots[above], HIGHEST_M)
    n = edlen_index(np.exp(log_p), temperature_k(knots), vapour_pressure_pa(knots))
    # Fitted is n - 1: its slope has twelve digits, that of n would have eight.
    excess = make_interp_spline(knots, n - 1.0, k=SPLINE_DEGREE)
    return TrueAir(
        log_pressure=make_interp_spline(knots, log_p, k=SPLINE_DEGREE),
        index=BSpline(excess.t, excess.c + 1.0, SPLINE_DEGREE),
        index_slope=excess.derivative(),
    )
