"""The air between the elements of a lens that nobody measured.

A lens is weaker in denser air, because its glass stands out less: its principal distance c follows
n, the refractive index of the air in it, dc/c = K dn. For a thin lens whose image plane follows the
focus K is n_glass / (n_glass - 1), 2.5 to 2.9. For mapping cameras, whose plane is fixed, there are
the figures of Meier (Zeiss), of a 153 mm lens at 6 km against one calibrated on the ground:
-0.020 mm behind a pressurised window (701 hPa, 21 degC), -0.036 and -0.047 mm in the air outside.
There n is less by 85e-6 and by 123e-6: K is 1.5, 1.9 and 2.5.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere.refractive_index import IndexModel
from unbend.refraction.camera.camera import LensInAir, principal_change
from unbend.units import Array

CHANGE_PER_INDEX = 2.0
"""K: the middle of the three of Meier."""

SIGMA_PER_INDEX = 0.5
"""Of K: the farthest of the three of Meier from their middle."""

LABORATORY_PRESSURE_PA = 101_325.0
LABORATORY_TEMPERATURE_K = 293.15
"""Of the air in which laboratories calibrate, where nothing is stated: 1013.25 hPa, 20 degC."""


@dataclass(frozen=True)
class TypicalLens:
    """A lens whose derivatives nobody measured, calibrated in air of a known state.

    ``principal_distance_px`` was calibrated at ``reference_pressure_pa`` and
    ``reference_temperature_k``.
    """

    principal_distance_px: float
    reference_pressure_pa: float = LABORATORY_PRESSURE_PA
    reference_temperature_k: float = LABORATORY_TEMPERATURE_K

    def change_px(
        self, pressure_pa: ArrayLike, temperature_k: ArrayLike, index: IndexModel
    ) -> Array:
        """What the air in the lens adds to the calibrated principal distance [px].

        ``pressure_pa``, ``temperature_k`` of the air in the lens broadcast; NaN gives NaN. Its
        standard deviation is a quarter of it. Without humidity, which is 1 ppm in the tropics.

        >>> lens = TypicalLens(20000.0)
        >>> at_6_km = lens.change_px([101325.0, 47218.0], [293.15, 249.19], IndexModel())
        >>> at_6_km.round(2).tolist()
        [0.0, -4.93]
        """
        reference = index.refractivity(
            self.reference_temperature_k, self.reference_pressure_pa, 0.0
        )
        in_lens = index.refractivity(temperature_k, pressure_pa, 0.0)
        return np.asarray(CHANGE_PER_INDEX * self.principal_distance_px * (in_lens - reference))


AnyLens = LensInAir | TypicalLens


def lens_change(
    lens: AnyLens, pressure_pa: ArrayLike, temperature_k: ArrayLike, index: IndexModel
) -> Array:
    """What the air in a lens, measured or typical, adds to its principal distance [px]."""
    if isinstance(lens, TypicalLens):
        return lens.change_px(pressure_pa, temperature_k, index)
    return principal_change(lens, pressure_pa, temperature_k)


def sigma_of_change(lens: AnyLens, change_px: Array) -> Array:
    """The standard deviation [px] of changes of a principal distance by what the lens is.

    A lens with derivatives of its own has none.
    """
    if isinstance(lens, TypicalLens):
        return np.asarray(np.abs(change_px) * (SIGMA_PER_INDEX / CHANGE_PER_INDEX))
    return np.zeros(np.shape(change_px))
