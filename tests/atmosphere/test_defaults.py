"""Defaults that change numbers, each with the reason for its value."""

import math

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate import external_readings, normal_equations
from unbend.atmosphere.estimate.candidates import SMALLEST_CLIMB_M
from unbend.atmosphere.estimate.sensors import (
    BAROMETER_FAULTS,
    DYNAMIC_PRESSURE_ERROR,
    FAULT_TEXTS,
    HYGROMETER_BIAS,
    RECOVERY_FACTOR,
    THERMOMETER_FAULTS,
    SensorSettings,
)
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.config.atmosphere import AtmosphereSection


def test_the_light_is_green_and_the_air_of_today():
    # Aerial cameras are most sensitive about 0.55 um; the papers' 0.589 um has 0.4 % less.
    assert IndexModel() == IndexModel("ciddor", 0.55e-6, 450.0)
    # Ciddor's own reference of CO2 is 450 ppm, and the air of the 2020s has 420: 2e-5 of N.
    section = AtmosphereSection()
    assert (section.wavelength_m, section.co2_ppm, section.index) == (0.55e-6, 450.0, "ciddor")
    # Refractivity at 15 C and 1013.25 hPa of dry air (Edlen 1966: 277.8e-6 at 0.55 um).
    assert standard_atmosphere().refractivity(0.0) == pytest.approx(277.8e-6, rel=5e-4)


def test_the_air_is_adjusted_and_shown_beside_us1976():
    section = AtmosphereSection()
    # The standard that every reader knows; the climatology knows place and season.
    assert (section.standard, section.climatology) == ("us1976", "auto")
    # Measured air beats any standard (PHYSICS: 12 % against 0.5 % of R).
    assert section.adjust
    # The temperature of a board is never the air's unless the user insists.
    assert not section.board_temperature
    assert SensorSettings() == SensorSettings(board_temperature=False, calibration={})
    assert standard_atmosphere().name == "us1976"
    assert climatology(latitude_rad=0.8, month=1.0).profile.name == "supplements1966"


def test_sensors_without_calibration_are_cheap_ones():
    expected = {
        # A small radiation shield in an aircraft's airflow: 3 K, 5 K from the sun on the ground.
        "thermometer_bias": (0.0, 3.0),
        "takeoff_transient": (0.0, 5.0),
        # The transient decays in about a minute: 40 to 90 s.
        "transient_decay": (math.log(60.0), 0.4),
        # Thermistors in an airflow of 20 to 60 m/s: 2 to 22 s.
        "thermometer_lag": (12.0, 10.0),
        # A probe that is no total-air-temperature probe recovers 0.6 to 0.9 of the heating.
        "recovery_factor": (0.7, 0.3),
        # Absolute accuracy of MEMS barometers: 0.5 hPa.
        "pressure_offset": (0.0, 50.0),
        # A static pressure loses 0.1 % of its change; one of ten loses more (`hypotheses`).
        "pressure_scale": (0.0, 0.001),
        # Usual thermometers are outside, and as warm in the climb as in the descent (`hypotheses`).
        "bay_share": (0.0, 0.002),
        "climb_warmth": (0.0, 0.2),
        # GNSS height and undulation: 2.5 m that all epochs share.
        "gnss_height_offset": (0.0, 2.5),
        # A static port reads within 3 % of the dynamic pressure.
        "dynamic_pressure_error": (0.0, 0.03),
        # Capacitive hygrometers: 3 %.
        "hygrometer_bias": (0.0, 0.03),
    }
    every = (
        *THERMOMETER_FAULTS,
        RECOVERY_FACTOR,
        *BAROMETER_FAULTS,
        DYNAMIC_PRESSURE_ERROR,
        HYGROMETER_BIAS,
    )
    assert {fault.name: (fault.mean, fault.sigma) for fault in every} == expected
    # No lag is negative, no decay shorter than 15 s, no recovery above that of a stagnation point.
    limits = {fault.name: (fault.low, fault.high) for fault in every if np.isfinite(fault.low)}
    assert limits == {
        "transient_decay": (math.log(15.0), 6.0),
        "thermometer_lag": (0.0, 90.0),
        "recovery_factor": (0.0, 1.1),
    }
    assert set(FAULT_TEXTS) == set(SensorFault)
    assert len(set(FAULT_TEXTS.values())) == len(FAULT_TEXTS)


def test_gates_of_the_estimate():
    # 300 m of temperatures halve the error of the standard at 1 km.
    assert SMALLEST_CLIMB_M == 300.0
    # Student's t with 4 degrees of freedom: a bin 5 sigma off weighs (4 + 1)/(4 + 25) of one.
    assert normal_equations.FREEDOM == 4.0
    # Radiosondes start every twelve hours: six at most from one; stations report every hour, and
    # one that is not dated may be three old.
    assert external_readings.UNDATED_SOUNDING_H == 6.0
    assert external_readings.UNDATED_REPORT_H == 3.0


def test_a_report_errs_by_its_digits():
    # Whole degrees and the rounding of QNH to whole hPa.
    report = SurfaceReport(0.0, 101_325.0, 288.15, math.nan)
    assert (report.sigma_temperature_k, report.sigma_pressure_pa) == (0.5, 50.0)
