"""Roles go over to spares where their channel is silent, and the accuracy is that of the spare."""

import numpy as np
import pytest

from tests.flight.made_channels import instants, ranked
from tests.helpers import NS_PER_S, with_code
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.roles import assign_roles
from unbend.flight.spares import with_spares

SECONDS = np.arange(0.0, 100.0, 0.2)
PLACE = {
    "lat_rad": 0.8,
    "lon_rad": 0.1,
    "h_msl_m": 900.0,
}


def receiver(name, seconds, rank, sigma_m):
    return ranked(
        name,
        seconds,
        rank,
        "height",
        "position",
        **PLACE,
        sigma_h_m=sigma_m,
        sigma_v_m=2.0 * sigma_m,
    )


def attitude(name, seconds, rank, q_x=0.0):
    return ranked(
        name,
        seconds,
        rank,
        "attitude",
        q_w=np.sqrt(1.0 - q_x**2),
        q_x=q_x,
        q_y=0.0,
        q_z=0.0,
    )


def barometer(name, seconds, rank):
    return ranked(name, seconds, rank, "pressure", pressure_pa=9e4)


WHOLE = receiver("GPS[0]", SECONDS, 20, 0.5)
LOST = WHOLE.rows(SECONDS < 20.0)
LATE = WHOLE.rows(SECONDS > 30.0)
SPARE = receiver("GPS[1]", SECONDS + 0.05, 30, 1.5)
FUSED = ranked("POS", SECONDS, 10, "position", **PLACE)
ATT = attitude("ATT", SECONDS, 10)
LOST_ATT = ATT.rows(SECONDS < 20.0)
COARSE_ATT = attitude("AHR2", SECONDS, 40)
LANE = attitude("XKQ[0]", SECONDS + 0.05, 50, q_x=0.8)


@pytest.mark.parametrize(("first", "by_spare_s"), [(LOST, 60.0), (LATE, 10.0)])
def test_a_receiver_that_is_lost_gives_way_to_the_second(first, by_spare_s):
    roles, (note,) = with_spares(
        {"height": first},
        (first, SPARE),
        (),
    )

    height = roles["height"]
    assert height.time_ns[0] <= NS_PER_S
    assert height.time_ns[-1] >= 99 * NS_PER_S
    row = np.searchsorted(height.time_ns, instants(by_spare_s))
    assert height["sigma_h_m"][row] == 1.5
    assert height["sigma_v_m"][row] == 3.0
    assert height["sigma_h_m"].min() == 0.5
    assert (note.code, note.kind) == ("ROLE-SPARE", "fallback")
    assert "GPS[1] for" in note.what


@pytest.mark.parametrize(
    ("role", "first", "spare", "named"),
    [
        ("height", WHOLE, SPARE, ()),
        ("height", LOST, SPARE, ("height",)),
        ("position", LOST, FUSED, ()),
        ("attitude", LOST_ATT, COARSE_ATT, ()),
        ("attitude", ATT.rows(abs(SECONDS - 30.5) > 0.5), LANE, ()),
    ],
    ids=[
        "it is whole",
        "the mission file names it",
        "a filter is no spare of a receiver",
        "a simpler attitude is none of the filter",
        "silent for a second",
    ],
)
def test_a_role_that_stays(role, first, spare, named):
    roles = {role: first}
    assert with_spares(roles, (first, spare), named) == (roles, ())


def test_of_two_attitudes_that_of_the_filter_is_the_spare():
    channels = (LOST_ATT, COARSE_ATT, LANE)
    _, (note,) = with_spares({"attitude": LOST_ATT}, channels, ())
    assert "XKQ[0]" in note.what


def test_an_attitude_that_is_silent_for_a_while_gives_way_meanwhile():
    silent = ATT.rows(abs(SECONDS - 45.0) > 15.0)

    roles, (note,) = with_spares({"attitude": silent}, (silent, LANE), ())

    played = roles["attitude"]
    is_of_spare = played["q_x"] > 0.0
    by_spare_s = played.time_ns[is_of_spare] / NS_PER_S
    assert by_spare_s.min() == pytest.approx(29.85)
    assert by_spare_s.max() == pytest.approx(60.05)
    assert by_spare_s.size == 152
    assert note.code == "ROLE-SPARE"


def test_a_filter_is_as_accurate_as_the_receiver_that_is_there():
    time_ns = instants(10, 80)
    alone = LogAccuracy(LOST)
    with_spare = LogAccuracy(LOST, spare_receivers=(SPARE,))

    sigmas = with_spare.positions(FUSED, time_ns)
    sigmas_alone = alone.positions(FUSED, time_ns)

    assert sigmas.horizontal_m == pytest.approx([0.5, 1.5])
    assert sigmas_alone.horizontal_m[1] > 100.0


@pytest.mark.parametrize(
    ("silent_s", "plays"),
    [
        (9.9, "BARO[0]"),
        (10.1, "BARO[1]"),
    ],
)
def test_a_barometer_that_is_lost_gives_way_to_one_that_goes_on(silent_s, plays):
    last_s = SECONDS[-1] - silent_s
    lost_s = np.append(SECONDS[SECONDS < 40.0], last_s)
    lost = barometer("BARO[0]", lost_s, 10)
    spare = barometer("BARO[1]", SECONDS, 20)

    roles, notes = assign_roles((WHOLE, lost, spare), {}, needs_cabin=False)
    without_spare, _ = assign_roles((WHOLE, lost), {}, needs_cabin=False)

    assert roles["pressure"].name == plays
    spares = with_code(notes, "ROLE-SPARE")
    assert [note.where for note in spares] == ["pressure"] * (plays == "BARO[1]")
    for note in spares:
        assert "BARO[1], because BARO[0] has no values" in note.what
    assert without_spare["pressure"] is lost
