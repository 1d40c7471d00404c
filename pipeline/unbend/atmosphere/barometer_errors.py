"""What a barometer reads at a given pressure, by the errors that a flight has determined."""

from dataclasses import dataclass

from unbend.units import Array


@dataclass(frozen=True)
class BarometerErrors:
    """Errors of a barometer: an offset, and a share of the pressure's change that is lost.

    ``lost_share``: of the change since the highest pressure of the flight, ``highest_pa``.
    """

    offset_pa: float = 0.0
    lost_share: float = 0.0
    highest_pa: float = 0.0

    def reading(self, pressure_pa: Array) -> Array:
        """(n,) what the barometer reads at true pressures (n,) [Pa].

        >>> import numpy as np
        >>> BarometerErrors(20.0, 0.1, 100_000.0).reading(np.array([90_000.0])).tolist()
        [91020.0]
        """
        return pressure_pa + self.offset_pa + self.lost_share * (self.highest_pa - pressure_pa)


NO_ERRORS = BarometerErrors()
