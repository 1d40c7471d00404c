"""The refraction methods of Gyer 1996, Saastamoinen 1974, Bertram 1966 and the Manual.

For comparison and for reproducing older work; `unbend.refraction.refraction_angle` is what one
computes with. Every method in `PUBLISHED` is a function ``(profile, h_c, h_g, zeta_c, radius)``:

profile : the air.
h_c, h_g : heights of camera and ground above sea level [m].
zeta_c : apparent nadir angle at the camera [rad].
radius : of the sphere [m]; the plane forms do not use it.

A plane form is written as R at 45 degrees, a function ``(profile, h_c, h_g)`` that `at_45_degrees`
makes a method of. Arguments broadcast. It returns R_c [rad], NaN where the method is not defined:
for zeta_c >= 90 degrees, a ground above the camera, heights that the profile does not cover, and
beyond narrower limits where the docstring of the function states them.
"""

from unbend.refraction.published.bertram import (
    bertram1966,
    bertram1966_curved,
    bertram1966_from_ground,
    manual,
)
from unbend.refraction.published.column import Method
from unbend.refraction.published.gyer import gyer1996, plane, plane_first_term, plane_moist
from unbend.refraction.published.saastamoinen import (
    compartment,
    quadratic_coefficients,
    saastamoinen1974,
    saastamoinen1974_fitted,
    saastamoinen1974_ican,
    saastamoinen1974_quadratic,
    saastamoinen1974_series,
    saastamoinen1974_weather,
    weather_refraction,
)

PUBLISHED: dict[str, Method] = {
    "plane": plane,
    "plane_first_term": plane_first_term,
    "plane_moist": plane_moist,
    "gyer1996": gyer1996,
    "saastamoinen1974": saastamoinen1974,
    "saastamoinen1974_ican": saastamoinen1974_ican,
    "saastamoinen1974_quadratic": saastamoinen1974_quadratic,
    "saastamoinen1974_fitted": saastamoinen1974_fitted,
    "saastamoinen1974_weather": saastamoinen1974_weather,
    "saastamoinen1974_series": saastamoinen1974_series,
    "bertram1966": bertram1966,
    "bertram1966_from_ground": bertram1966_from_ground,
    "bertram1966_curved": bertram1966_curved,
    "manual": manual,
}
"""Methods by the name that ``refraction.method`` and ``unbend angle --method`` take."""

__all__ = ["PUBLISHED", "Method", "compartment", "quadratic_coefficients", "weather_refraction"]
