"""Change of a principal distance by the air in the lens, where no derivatives were measured.

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
"""K = (dc / c) / dn [1]: the middle of the range of Meier's three figures, 1.5 to 2.5."""

SIGMA_PER_INDEX = 0.5
"""Standard deviation of K: half of the range of Meier's three figures."""

LABORATORY_PRESSURE_PA = 101_325.0
LABORATORY_TEMPERATURE_K = 293.15
"""Assumed air of a calibration in a laboratory: 1013.25 hPa, 20 degC."""


@dataclass(frozen=True)
class TypicalLens:
    """A lens without measured derivatives, calibrated in air of a known state.

    ``principal_distance_px`` was calibrated at ``reference_pressure_pa`` and
    ``reference_temperature_k``.
    """

    principal_distance_px: float
    reference_pressure_pa: float = LABORATORY_PRESSURE_PA
    reference_temperature_k: float = LABORATORY_TEMPERATURE_K

    def change_px(
        self, pressure_pa: ArrayLike, temperature_k: ArrayLike, index: IndexModel
    ) -> Array:
        """Change [px] of the calibrated principal distance c by the air in the lens: K c dn.

        ``pressure_pa``, ``temperature_k`` of the air in the lens broadcast; NaN gives NaN. The
        standard deviation of the change is a quarter of it. Humidity is neglected: in the tropics
        it changes n by 1 ppm.

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
    """Change [px] of a principal distance by the air in the lens, with derivatives or without.

    ``pressure_pa``, ``temperature_k`` of the air in the lens broadcast; NaN gives NaN. ``index`` is
    used for a `TypicalLens` only.
    """
    if isinstance(lens, TypicalLens):
        return lens.change_px(pressure_pa, temperature_k, index)
    return principal_change(lens, pressure_pa, temperature_k)


def sigma_of_change(lens: AnyLens, change_px: Array) -> Array:
    """Standard deviations [px] of changes from `lens_change`.

    A quarter of the change for a `TypicalLens`; 0 for a lens with measured derivatives.
    """
    if isinstance(lens, TypicalLens):
        return np.asarray(np.abs(change_px) * (SIGMA_PER_INDEX / CHANGE_PER_INDEX))
    return np.zeros(np.shape(change_px))
