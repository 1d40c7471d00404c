"""Which readings are of the free air, and at which height."""

from dataclasses import replace

import numpy as np
import pytest

from tests.flight.made_channels import (
    FLIGHT_HEIGHT_M,
    FLIGHT_S,
    counted,
    instants,
    located,
)
from tests.helpers import NS_PER_S, channel
from unbend.atmosphere.rejection import Reason
from unbend.flight.evidence.stretches import HEIGHT, Stretch
from unbend.flight.heights import HeightSystem
from unbend.flight.outside_air import outside_air_samples

PLACE = {"lat_rad": 0.8, "lon_rad": 0.1}
GPS = channel(
    "GPS",
    FLIGHT_S,
    "height",
    h_msl_m=FLIGHT_HEIGHT_M,
    **PLACE,
)
BARO = channel("BARO", FLIGHT_S, pressure_pa=9e4)
HYGR = channel("HYGR", FLIGHT_S, temperature_k=280.0, relative_humidity=0.5)
ARSP = channel("ARSP", FLIGHT_S, airspeed_m_s=60.0)


def samples_of(height, *stretches, **sensors):
    """The samples of the sensors of these roles, and their messages."""
    roles = {"height": height, **sensors}
    return outside_air_samples(roles, HeightSystem(), 5.0, stretches)


def test_the_ground_and_the_first_two_minutes_are_not_the_air():
    """Off the ground at 60 s, and on it again at 860 s."""
    samples, notes = samples_of(
        GPS,
        temperature=HYGR,
        humidity=HYGR,
        pressure=BARO,
        airspeed=ARSP,
    )

    for soaked in (samples.temperature, samples.humidity):
        used_s = FLIGHT_S[soaked.accepted]
        assert used_s.min() == pytest.approx(60.0 + 120.0, abs=3.0)
        assert used_s.max() == pytest.approx(860.0, abs=3.0)
    assert samples.pressure.accepted.all()
    assert samples.airspeed.accepted.all()
    soak = samples.temperature.count(Reason.GROUND_SOAK)
    assert soak == np.count_nonzero(~samples.temperature.accepted)
    assert counted(notes) == [("note", "AIR-GROUND-SOAK", soak)] * 2
    # After the landing the log ends on the ground.
    assert samples.takeoff_ns / NS_PER_S == pytest.approx([60.0, 899.0], abs=4.0)


def test_a_log_that_begins_in_the_air_has_no_take_off():
    climb_m = 2000.0 + 3.0 * FLIGHT_S
    flying = channel(
        "GPS",
        FLIGHT_S,
        "height",
        h_msl_m=climb_m,
        **PLACE,
    )
    samples, notes = samples_of(flying, temperature=HYGR)
    assert samples.temperature.accepted.all()
    assert notes == ()


def test_the_ground_between_two_flights_is_not_the_air():
    seconds = np.arange(1800.0)
    gps = channel(
        "GPS",
        seconds,
        h_msl_m=np.tile(FLIGHT_HEIGHT_M, 2),
        **PLACE,
    )
    warm = channel("HYGR", seconds, temperature_k=280.0)

    samples, _ = samples_of(gps, temperature=warm)

    accepted = samples.temperature.accepted
    assert not accepted[865:1070].any()
    assert accepted[1085:1750].all()


def test_a_height_that_is_fused_with_the_barometer_says_nothing_of_temperatures():
    """Only pressures of the lowest 30 m are used, which give the level."""
    fused = replace(
        GPS,
        name="POS",
        roles=("position",),
    )
    samples, notes = samples_of(fused, pressure=BARO)
    assert np.array_equal(samples.pressure.accepted, FLIGHT_HEIGHT_M < 480.0)
    assert set(samples.pressure.rejected) == {Reason.USED, Reason.FUSED_HEIGHT}
    assert located(notes) == [("warning", "AIR-HEIGHT-FUSED", "POS")]


def test_readings_without_height_or_at_a_suspect_one_say_so():
    """Heights that another source replaces are not suspect."""
    short = GPS.rows(FLIGHT_S < 700.0)
    suspect = Stretch(*instants(300, 309).tolist(), HEIGHT, "it steps")
    replaced = Stretch(
        *instants(400, 409).tolist(),
        HEIGHT,
        "it steps",
        9.0,
        "GPS[1]",
    )

    samples, notes = samples_of(short, suspect, replaced, pressure=BARO)

    rejected = samples.pressure.rejected
    assert np.flatnonzero(rejected == Reason.SUSPECT_HEIGHT).tolist() == list(range(300, 310))
    assert np.flatnonzero(rejected == Reason.NO_HEIGHT).tolist() == list(range(700, 900))
    assert counted(notes) == [("warning", "AIR-SUSPECT-HEIGHT", 10)]
