"""The air: its refractive index, standard atmospheres, and the profile of a flight."""

from unbend.atmosphere.covariance import air_jacobian
from unbend.atmosphere.layers import pressure_gradient_layer, pressure_isothermal_layer
from unbend.atmosphere.profile import Profile, profile_from_table, profile_table
from unbend.atmosphere.standard import standard_atmosphere, standard_names

__all__ = [
    "Profile",
    "air_jacobian",
    "pressure_gradient_layer",
    "pressure_isothermal_layer",
    "profile_from_table",
    "profile_table",
    "standard_atmosphere",
    "standard_names",
]
