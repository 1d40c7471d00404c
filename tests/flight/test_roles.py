"""Which channel plays which role, and which barometers are outside."""

import numpy as np
import pytest

from tests.flight.made_channels import (
    FLIGHT_HEIGHT_M,
    FLIGHT_S,
    ranked,
    standard_pressure_pa,
)
from tests.helpers import refused, with_code
from unbend.errors import MissionError
from unbend.flight.channels import ROLE_COLUMNS
from unbend.flight.roles import assign_roles, follows_height
from unbend.messages import Kind

PLACE = {"lat_rad": 0.8, "lon_rad": 0.1}
LEVEL = {
    "q_w": 1,
    "q_x": 0,
    "q_y": 0,
    "q_z": 0,
}


def sensor(name, rank, *roles, **columns):
    return ranked(name, FLIGHT_S, rank, *roles, **columns)


def barometer(name, pressure_pa, **columns):
    return sensor(
        name,
        10,
        "pressure",
        "cabin_pressure",
        pressure_pa=pressure_pa,
        **columns,
    )


def receiver(name, height_m):
    return sensor(
        name,
        20,
        "height",
        "position",
        h_msl_m=height_m,
        **PLACE,
    )


POS = sensor("POS", 10, "position", **PLACE)
GPS = receiver("GPS[0]", FLIGHT_HEIGHT_M)
GPS2 = receiver("GPS[1]", FLIGHT_HEIGHT_M)
ATT = sensor("ATT", 10, "attitude", **LEVEL)
ATT_OF_MOUNT = sensor("ATT[1]", 20, "attitude", **LEVEL)
FREE_AIR_PA = standard_pressure_pa(FLIGHT_HEIGHT_M)
BARO = barometer("BARO[0]", FREE_AIR_PA)
BOARD = barometer("BARO[0]", FREE_AIR_PA, board_temperature_k=310)
CABIN_HEIGHT_M = np.minimum(FLIGHT_HEIGHT_M, 1200.0)
CABIN = barometer("BARO[1]", standard_pressure_pa(CABIN_HEIGHT_M))
SEALED = barometer("BARO[2]", 100_000.0)
OF_AIR = ("temperature", "humidity", "cabin_temperature", "cabin_humidity")
OUT = sensor(
    "HYGR[0]",
    10,
    *OF_AIR,
    temperature_k=280.0,
    relative_humidity=0.5,
)
IN = sensor(
    "HYGR[1]",
    10,
    *OF_AIR,
    temperature_k=294.0,
    relative_humidity=0.3,
)
ARSP = sensor(
    "ARSP[0]",
    30,
    "temperature",
    "airspeed",
    temperature_k=281.0,
    airspeed_m_s=60,
)
FLIGHT = (POS, GPS, ATT)
IN_IS_INSIDE = {"cabin_temperature": "HYGR[1]", "cabin_humidity": "HYGR[1]"}


def assigned(sensors, named, cabin):
    """Roles of a flight with these sensors, and the messages."""
    return assign_roles((*FLIGHT, *sensors), named, needs_cabin=cabin)


@pytest.mark.parametrize(
    ("sensors", "cabin", "named", "expected"),
    [
        (
            (GPS2, BARO),
            False,
            {},
            {"position": "POS", "height": "GPS[0]", "attitude": "ATT"},
        ),
        ((CABIN, BARO), True, {}, {"pressure": "BARO[0]", "cabin_pressure": "BARO[1]"}),
        ((BARO, CABIN, SEALED), True, {}, {"pressure": "BARO[0]", "cabin_pressure": None}),
        ((OUT, IN, ARSP), False, {}, {"temperature": "ARSP[0]", "humidity": None}),
        ((OUT, ARSP), False, {}, {"temperature": "HYGR[0]", "humidity": "HYGR[0]"}),
        ((BARO, CABIN, OUT, IN), True, {}, dict.fromkeys(OF_AIR)),
        (
            (BARO, CABIN, OUT, IN),
            True,
            IN_IS_INSIDE,
            {"temperature": "HYGR[0]", "humidity": "HYGR[0]", **IN_IS_INSIDE},
        ),
        ((IN,), True, IN_IS_INSIDE, {"temperature": None, "humidity": None, **IN_IS_INSIDE}),
        ((BOARD,), False, {}, {"pressure": "BARO[0]", "temperature": None}),
        ((ATT_OF_MOUNT,), False, {}, {"attitude": "ATT", "aircraft_attitude": None}),
        (
            (ATT_OF_MOUNT,),
            False,
            {"attitude": "ATT[1]", "aircraft_attitude": "ATT"},
            {"attitude": "ATT[1]", "aircraft_attitude": "ATT"},
        ),
    ],
    ids=[
        "a filter for position, the first receiver for height",
        "barometers are told apart by what they measure",
        "two cabins are not guessed between",
        "two thermometers of one rank are not guessed between",
        "one hygrometer is outside",
        "outside or cabin is not guessed",
        "the other one is outside",
        "inside is never outside",
        "the temperature of a board is never the air's",
        "the attitude of the aircraft is only ever named",
        "the attitude of the aircraft is named",
    ],
)
def test_a_role_is_played_by_the_one_channel_that_can(sensors, cabin, named, expected):
    roles, notes = assigned(sensors, named, cabin)
    for role, name in expected.items():
        assert (role in roles) == (name is not None)
        assert name is None or roles[role].name == name
    assert not [note for note in notes if note.kind is Kind.LOSS]
    chosen = {note.where: note.what for note in with_code(notes, "ROLE")}
    assert chosen["height"] == "height: GPS[0]"


@pytest.mark.parametrize(
    ("sensors", "cabin", "ambiguous_roles", "candidates"),
    [
        ((OUT, IN, ARSP), False, ["temperature", "humidity"], ["HYGR[0]", "HYGR[1]"]),
        ((BARO, CABIN, OUT, IN), True, ["temperature", "humidity"], ["HYGR[0]", "HYGR[1]"]),
        ((BARO, CABIN, SEALED), True, ["cabin_pressure"], ["BARO[1]", "BARO[2]"]),
    ],
)
def test_candidates_that_are_not_guessed_between_are_listed(
    sensors, cabin, ambiguous_roles, candidates
):
    _, notes = assigned(sensors, {}, cabin)
    ambiguous = with_code(notes, "ROLE-AMBIGUOUS")
    roles = [note.where.removeprefix("log.channels.") for note in ambiguous]
    assert roles == ambiguous_roles
    for note in ambiguous:
        for candidate in candidates:
            assert candidate in note.what


def test_a_barometer_inside_is_reported():
    _, notes = assigned([CABIN, BARO], {}, True)
    (note,) = with_code(notes, "BARO-NOT-OUTSIDE")
    assert note.where == "BARO[1]"


@pytest.mark.parametrize("role", [role for role in ROLE_COLUMNS if role != "events"])
def test_a_role_that_is_stated_as_null_is_played_by_no_channel(role):
    channels = (*FLIGHT, BARO, CABIN, OUT, ARSP)
    roles, notes = assign_roles(
        channels,
        {},
        needs_cabin=True,
        empty=(role,),
    )
    assert role not in roles
    (left_empty,) = [note.what for note in notes if "null" in note.what]
    assert left_empty.endswith(f"none, because log.channels.{role} is null")


@pytest.mark.parametrize(
    ("named", "code", "says"),
    [
        ({"position": "GPS[3]"}, "CHANNEL-MISSING", ["near: GPS[0]", "POS"]),
        # Without it a window in the belly would be turned with the camera: no silent substitute.
        ({"aircraft_attitude": "ATT[7]"}, "CHANNEL-MISSING", ["near: ATT", "log.channels"]),
        ({"attitude": "BARO[0]"}, "CHANNEL-MISSING", ["board_temperature_k"]),
        ({"pressure": "BARO[0]", "cabin_pressure": "BARO[0]"}, "CHANNEL-TWICE", ["BARO[0]"]),
    ],
    ids=["absent", "attitude of the aircraft", "without the columns", "inside and outside"],
)
def test_a_needed_channel_that_cannot_play_its_role_is_refused(named, code, says):
    with refused(code, MissionError) as refusal:
        assigned([BOARD], named, True)
    for text in says:
        assert text in str(refusal.value)


@pytest.mark.parametrize(
    ("channels", "named", "says"),
    [
        ((*FLIGHT, OUT), {"humidity": "HYGR[5]"}, ["HYGR[5]", "HYGR[0]"]),
        ((*FLIGHT, BOARD), {"temperature": "BARO[0]"}, ["BARO[0]", "board"]),
        ((ATT, BARO), {}, ["position", "BARO[0]"]),
    ],
    ids=["absent", "of a board", "no position"],
)
def test_a_role_that_is_not_played_is_a_loss(channels, named, says):
    _, notes = assign_roles(channels, named, needs_cabin=False)
    (loss,) = [note for note in notes if note.kind is Kind.LOSS]
    assert loss.code == "CHANNEL-MISSING"
    for text in says:
        assert text in loss.what


# Half of the fall of the outside pressure: a temperature of 550 K would explain it.
LEAKING = barometer("BARO[3]", standard_pressure_pa(0.5 * FLIGHT_HEIGHT_M))
WAVES = 1.0 + 0.05 * np.sin(FLIGHT_HEIGHT_M / 200.0)
WAVY = barometer("BARO[5]", FREE_AIR_PA * WAVES)


@pytest.mark.parametrize(
    ("channel", "height", "follows"),
    [
        (BARO, GPS, True),
        (CABIN, GPS, False),
        (SEALED, GPS, False),
        (LEAKING, GPS, False),
        (WAVY, GPS, False),
        (BARO, receiver("GPS[0]", 450.0 + FLIGHT_HEIGHT_M * 0.01), None),
        (BARO.rows(FLIGHT_S % 100.0 == 0.0), GPS, None),
        (BARO, POS, None),
    ],
    ids=[
        "outside",
        "a cabin",
        "a sealed one",
        "a leaking cabin",
        "wavy",
        "level flight",
        "nine pressures",
        "no heights",
    ],
)
def test_whether_a_pressure_follows_the_height_as_free_air_does(channel, height, follows):
    assert follows_height(channel, height) is follows


def test_heights_above_sea_level_come_before_those_above_the_ellipsoid():
    both = sensor("GPS", 1, h_msl_m=500.0, h_ellipsoid_m=547.0)
    unknown = sensor(
        "GPS",
        1,
        h_msl_m=np.nan,
        h_ellipsoid_m=547.0,
    )
    assert both.height_column == "h_msl_m"
    assert unknown.height_column == "h_ellipsoid_m"
    assert OUT.height_column is None
