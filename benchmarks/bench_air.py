"""The air of four hours at ten readings a second: its time, and how it grows with the readings."""

import numpy as np
from survey import air

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.solver import estimate

ROWS = 144_000
FLIGHT_S = 4 * 3600.0


def flown(rows: int) -> AirSamples:
    """A thermometer, a barometer and a hygrometer going up and down between 200 and 2700 m."""
    rng = np.random.default_rng(1)
    seconds = np.arange(rows) * (FLIGHT_S / rows)
    time_ns = np.round(seconds * 1e9).astype(np.int64)
    phase = (seconds / 900.0) % 2.0
    h = 200.0 + np.abs(phase - 1.0) * 2500.0
    truth = air()

    def sensor(name: str, values: np.ndarray, sigma: float) -> SensorSamples:
        noise = sigma * rng.normal(size=rows)
        return SensorSamples(
            time_ns,
            h,
            values + noise,
            name=name,
        )

    temperature = sensor("t", truth.temperature(h), 0.2)
    pressure = sensor("p", truth.pressure(h), 5.0)
    humidity = sensor("rh", np.full(rows, 0.5), 0.02)
    return AirSamples(temperature, pressure, humidity)


def test_four_hours_at_ten_hertz(ratios):
    """Beside sorting the same readings, and beside a quarter of them.

    Each estimate goes several times over the readings and solves systems of some hundred unknowns,
    whose number does not depend on that of the readings.
    """
    background = climatology(latitude_rad=0.8, month=7.0)
    samples = flown(ROWS)
    quarter = flown(ROWS // 4)

    def of_all():
        estimate(samples, background)

    def of_a_quarter():
        estimate(quarter, background)

    def sort():
        np.sort(samples.temperature.value)
        np.sort(samples.pressure.value)
        np.sort(samples.humidity.value)

    growth = 1.0 / ratios.of_times(of_all, of_a_quarter)
    cost = 1.0 / ratios.of_times(of_all, sort)
    name = "air of 144,000 readings a sensor"
    ratios.check(f"{name}, times that of 36,000", growth, at_most=4.0)
    ratios.check(f"{name}, times sorting them", cost, at_most=50.0)
