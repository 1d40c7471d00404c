"""Roles go over to spares where their channel is silent, and the accuracy is that of the spare."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.roles import assign_roles
from unbend.flight.spares import with_spares

SECOND = 1_000_000_000
RECEIVER = ("height", "position")
ALL = np.arange(0.0, 100.0, 0.2)


def channel(name: str, seconds: np.ndarray, rank: int, *roles: str, **columns: object) -> Channel:
    time_ns = np.round(seconds * SECOND).astype(np.int64)
    arrays = {
        key: np.broadcast_to(np.asarray(value, float), seconds.shape)
        for key, value in columns.items()
    }
    message, _, instance = name.partition("[")
    source = Source(message, instance.rstrip("]") or None)
    return Channel(name, time_ns, arrays, source, roles=roles, rank=rank)


def receiver(name: str, seconds: np.ndarray, rank: int, sigma_m: float) -> Channel:
    place = {"lat_rad": 0.8, "lon_rad": 0.1 + 1e-6 * seconds, "h_msl_m": 900.0}
    return channel(
        name, seconds, rank, *RECEIVER, **place, sigma_h_m=sigma_m, sigma_v_m=2.0 * sigma_m
    )


SPARE = receiver("GPS[1]", ALL + 0.05, 30, 1.5)
LOST = receiver("GPS[0]", ALL[ALL < 20.0], 20, 0.5)
LATE = receiver("GPS[0]", ALL[ALL > 30.0], 20, 0.5)


@pytest.mark.parametrize(("first", "by_spare_s"), [(LOST, 60.0), (LATE, 10.0)])
def test_a_receiver_that_is_lost_gives_way_to_the_second(first: Channel, by_spare_s: float) -> None:
    roles, notes = with_spares({"height": first}, (first, SPARE), ())
    height = roles["height"]
    assert height.time_ns[0] <= SECOND
    assert height.time_ns[-1] >= 99 * SECOND
    row = np.searchsorted(height.time_ns, int(by_spare_s * SECOND))
    assert (height["sigma_h_m"][row], height["sigma_v_m"][row]) == (1.5, 3.0)
    assert height["sigma_h_m"].min() == 0.5
    (plays,) = notes
    assert (plays.code, plays.kind) == ("ROLE-SPARE", "fallback")
    assert "GPS[1] for" in plays.what


def test_what_the_mission_file_names_and_what_is_whole_stay() -> None:
    whole = receiver("GPS[0]", ALL, 20, 0.5)
    assert with_spares({"height": whole}, (whole, SPARE), ()) == ({"height": whole}, ())
    assert with_spares({"height": LOST}, (LOST, SPARE), ("height",)) == ({"height": LOST}, ())


def test_a_filter_is_no_spare_of_a_receiver_nor_a_simpler_attitude_of_the_filter() -> None:
    fused = channel("POS", ALL, 10, "position", lat_rad=0.8, lon_rad=0.1, h_msl_m=900.0)
    roles = {"position": LOST}
    assert with_spares(roles, (LOST, fused), ()) == (roles, ())
    level = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
    lost = channel("ATT", ALL[ALL < 20.0], 10, "attitude", **level)
    coarse = channel("AHR2", ALL, 40, "attitude", **level)
    lane = channel("XKQ[0]", ALL, 50, "attitude", **level)
    assert with_spares({"attitude": lost}, (lost, coarse), ())[1] == ()
    (plays,) = with_spares({"attitude": lost}, (lost, coarse, lane), ())[1]
    assert "XKQ[0]" in plays.what


def test_an_attitude_that_is_silent_for_a_while_gives_way_meanwhile() -> None:
    level = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
    tilted = {"q_w": 0.6, "q_x": 0.8, "q_y": 0.0, "q_z": 0.0}
    lane = channel("XKQ[0]", ALL + 0.05, 50, "attitude", **tilted)
    silent = channel("ATT", ALL[(ALL < 30.0) | (ALL > 60.0)], 10, "attitude", **level)
    roles, (plays,) = with_spares({"attitude": silent}, (silent, lane), ())
    attitude = roles["attitude"]
    by_spare_s = attitude.time_ns[attitude["q_x"] > 0.0] / SECOND
    assert by_spare_s.min() == pytest.approx(29.9, abs=0.3)
    assert by_spare_s.max() == pytest.approx(60.0, abs=0.3)
    assert by_spare_s.size == pytest.approx(150, abs=2)
    assert plays.code == "ROLE-SPARE"
    one_second = channel("ATT", ALL[(ALL < 30.0) | (ALL > 31.0)], 10, "attitude", **level)
    assert with_spares({"attitude": one_second}, (one_second, lane), ())[1] == ()


def test_a_filter_is_as_accurate_as_the_receiver_that_is_there() -> None:
    fused = channel("POS", ALL, 10, "position", lat_rad=0.8, lon_rad=0.1, h_msl_m=900.0)
    accuracy = LogAccuracy(LOST, spare_receivers=(SPARE,))
    instants = np.array([10, 80], np.int64) * SECOND
    assert accuracy.positions(fused, instants).horizontal_m == pytest.approx([0.5, 1.5])
    assert LogAccuracy(LOST).positions(fused, instants).horizontal_m[1] > 100.0


def test_a_barometer_that_is_lost_gives_way_to_one_that_goes_on() -> None:
    height = receiver("GPS[0]", ALL, 20, 0.5)
    lost = channel("BARO[0]", ALL[ALL < 40.0], 10, "pressure", pressure_pa=90_000.0)
    spare = channel("BARO[1]", ALL, 20, "pressure", pressure_pa=90_010.0)
    roles, notes = assign_roles((height, lost, spare), {}, needs_cabin=False)
    assert roles["pressure"] is spare
    assert [note.where for note in notes if note.code == "ROLE-SPARE"] == ["pressure"]
    roles, _ = assign_roles((height, lost), {}, needs_cabin=False)
    assert roles["pressure"] is lost
