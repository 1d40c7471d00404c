"""Which channel plays which role, and what is not believed."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.atmosphere.rejection import Reason
from unbend.errors import MissionError
from unbend.flight.channels import ROLE_COLUMNS, Channel, Source
from unbend.flight.evidence.quality import plausible_samples
from unbend.flight.evidence.stretches import HEIGHT as HEIGHT_QUANTITY
from unbend.flight.evidence.stretches import Stretch
from unbend.flight.heights import HeightSystem
from unbend.flight.outside_air import outside_air_samples
from unbend.flight.roles import assign_roles, follows_height
from unbend.messages import Kind, Ledger

SECONDS = np.arange(0.0, 900.0, 1.0)
TIME = (SECONDS * 1e9).astype(np.int64)
# 60 s on the ground, up to 2450 m at 5 m/s, level, and down again.
HEIGHT = 450.0 + np.clip(np.minimum(SECONDS - 60.0, 860.0 - SECONDS) * 5.0, 0.0, 2000.0)


def channel(name: str, rank: int, *roles: str, **columns: object) -> Channel:
    arrays = {
        k: np.broadcast_to(np.asarray(v, float), TIME.shape).copy() for k, v in columns.items()
    }
    return Channel(name, TIME, arrays, Source(name), roles=roles, rank=rank)


def free_air(h: np.ndarray) -> np.ndarray:
    return 101_325.0 * (1.0 - 0.0065 * h / 288.15) ** 5.2559


PLACE = {"lat_rad": 0.8, "lon_rad": 0.1}
POS = channel("POS", 10, "position", **PLACE)
GPS = channel("GPS[0]", 20, "height", "position", h_msl_m=HEIGHT, **PLACE)
GPS2 = channel("GPS[1]", 20, "height", "position", h_msl_m=HEIGHT, **PLACE)
ATT = channel("ATT", 10, "attitude", q_w=1, q_x=0, q_y=0, q_z=0)
BARO = channel("BARO[0]", 10, "pressure", "cabin_pressure", pressure_pa=free_air(HEIGHT))
CABIN = channel(
    "BARO[1]", 10, "pressure", "cabin_pressure", pressure_pa=free_air(np.minimum(HEIGHT, 1200.0))
)
SEALED = channel("BARO[2]", 10, "pressure", "cabin_pressure", pressure_pa=100_000.0)
AIR = ("temperature", "humidity", "cabin_temperature", "cabin_humidity")
OUT = channel("HYGR[0]", 10, *AIR, temperature_k=280.0, relative_humidity=0.5)
IN = channel("HYGR[1]", 10, *AIR, temperature_k=294.0, relative_humidity=0.3)
ARSP = channel("ARSP[0]", 30, "temperature", "airspeed", temperature_k=281.0, airspeed_m_s=60)


def assign(*channels: Channel, cabin: bool = False, **wishes: str):
    ledger = Ledger()
    roles = ledger.take(assign_roles(channels, wishes, needs_cabin=cabin))
    return {role: c.name for role, c in roles.items()}, ledger


def test_filter_for_position_receiver_for_height() -> None:
    roles, ledger = assign(POS, GPS, GPS2, ATT, BARO)
    chosen = {e.where: e.what for e in ledger if e.code == "ROLE"}
    assert chosen["height"] == "height: GPS[0]"
    assert (roles["position"], roles["height"], roles["attitude"]) == ("POS", "GPS[0]", "ATT")


@pytest.mark.parametrize("role", [role for role in ROLE_COLUMNS if role != "events"])
def test_a_role_that_is_stated_as_null_is_played_by_no_channel(role: str) -> None:
    channels = (POS, GPS, ATT, BARO, CABIN, OUT, ARSP)
    roles, notes = assign_roles(channels, {}, needs_cabin=True, empty=(role,))
    assert role not in roles
    (left_empty,) = [note.what for note in notes if "null" in note.what]
    assert left_empty.endswith(f"none, because log.channels.{role} is null")


def test_barometers_are_told_apart_by_what_they_measure() -> None:
    assert follows_height(BARO, GPS) is True
    assert follows_height(CABIN, GPS) is False
    assert follows_height(SEALED, GPS) is False
    level = channel("GPS[0]", 20, "height", h_msl_m=450.0 + HEIGHT * 0.01, **PLACE)
    assert follows_height(BARO, level) is None
    roles, ledger = assign(POS, GPS, ATT, CABIN, BARO, cabin=True)
    assert (roles["pressure"], roles["cabin_pressure"]) == ("BARO[0]", "BARO[1]")
    assert "BARO-NOT-OUTSIDE" in {e.code for e in ledger}


def test_two_cabins_are_not_guessed_between() -> None:
    roles, ledger = assign(POS, GPS, ATT, BARO, CABIN, SEALED, cabin=True)
    assert "cabin_pressure" not in roles
    assert any(e.code == "ROLE-AMBIGUOUS" and "BARO[2]" in e.what for e in ledger)


def test_two_thermometers_of_one_rank_are_not_guessed_between() -> None:
    roles, ledger = assign(POS, GPS, ATT, OUT, IN, ARSP)
    assert roles["temperature"] == "ARSP[0]"
    assert "humidity" not in roles
    assert sum(e.code == "ROLE-AMBIGUOUS" for e in ledger) == 2
    alone, _ = assign(POS, GPS, ATT, OUT, ARSP)
    assert (alone["temperature"], alone["humidity"]) == ("HYGR[0]", "HYGR[0]")


def test_outside_or_cabin_is_not_guessed() -> None:
    roles, ledger = assign(POS, GPS, ATT, BARO, CABIN, OUT, IN, cabin=True)
    assert not {"temperature", "cabin_temperature", "humidity", "cabin_humidity"} & roles.keys()
    assert sum(e.code == "ROLE-AMBIGUOUS" for e in ledger) == 2
    assert not ledger.has_losses  # the temperature of a cabin can be assumed
    named, ledger = assign(
        POS,
        GPS,
        ATT,
        BARO,
        CABIN,
        OUT,
        IN,
        cabin=True,
        cabin_temperature="HYGR[1]",
        cabin_humidity="HYGR[1]",
    )
    assert (named["temperature"], named["humidity"]) == ("HYGR[0]", "HYGR[0]")
    assert not ledger.has_losses


def test_inside_is_never_outside() -> None:
    roles, _ = assign(
        POS, GPS, ATT, IN, cabin=True, cabin_temperature="HYGR[1]", cabin_humidity="HYGR[1]"
    )
    assert "temperature" not in roles
    assert "humidity" not in roles


def test_board_temperature_is_never_the_air() -> None:
    board = channel(
        "BARO[0]", 10, "pressure", pressure_pa=free_air(HEIGHT), board_temperature_k=310
    )
    roles, _ = assign(POS, GPS, ATT, board)
    assert "temperature" not in roles
    with pytest.raises(MissionError, match=r"board_temperature_k"):
        assign(POS, GPS, board, ATT, attitude="BARO[0]")
    roles, ledger = assign(POS, GPS, ATT, board, temperature="BARO[0]")
    assert "temperature" not in roles
    assert ledger.has_losses


def test_a_named_channel_that_is_not_there() -> None:
    with pytest.raises(MissionError, match=r"near: .*GPS\[0\]") as refusal:
        assign(POS, GPS, ATT, position="GPS[3]")
    assert "POS" in refusal.value.what
    _, ledger = assign(POS, GPS, ATT, OUT, humidity="HYGR[5]")
    assert [e.code for e in ledger if e.kind is Kind.LOSS] == ["CHANNEL-MISSING"]


def test_no_position_at_all_says_what_there_is() -> None:
    _, ledger = assign(ATT, BARO)
    (entry,) = (e for e in ledger if e.kind is Kind.LOSS)
    assert "position" in entry.what
    assert "BARO[0]" in entry.what


def test_one_channel_is_not_inside_and_outside() -> None:
    with pytest.raises(MissionError, match="CHANNEL-TWICE"):
        assign(POS, GPS, ATT, BARO, pressure="BARO[0]", cabin_pressure="BARO[0]", cabin=True)


@pytest.mark.parametrize(
    ("role", "column", "value", "unit"),
    [
        ("pressure", "pressure_pa", 1013.25, "hPa"),
        ("temperature", "temperature_k", 15.0, "degC"),
        ("humidity", "relative_humidity", 65.0, "percent"),
    ],
)
def test_a_wrong_unit_is_refused(role: str, column: str, value: float, unit: str) -> None:
    with pytest.raises(MissionError, match=f"looks like {unit}") as refusal:
        plausible_samples(channel("X", 50, **{column: value}), role)[0]
    assert f"unit: {unit}" in refusal.value.remedy


def test_impossible_readings_are_taken_out_and_counted() -> None:
    pressure = free_air(HEIGHT)
    pressure[:3], pressure[10] = np.nan, 1e9
    ledger = Ledger()
    sound = ledger.take(plausible_samples(channel("BARO[0]", 10, pressure_pa=pressure), "pressure"))
    assert len(sound) == len(TIME) - 4
    assert sorted(e.count for e in ledger) == [1, 3]
    assert ledger.has_losses


def test_the_ground_and_the_first_two_minutes_are_not_the_air() -> None:
    roles = {"height": GPS, "temperature": OUT, "pressure": BARO}
    ledger = Ledger()
    found = ledger.take(outside_air_samples(roles, HeightSystem(), 5.0))
    assert found.temperature is not None
    assert found.pressure is not None
    used = SECONDS[found.temperature.accepted]
    assert used.min() == pytest.approx(60.0 + 120.0, abs=3.0)  # off the ground at 60 s
    assert used.max() == pytest.approx(860.0, abs=3.0)
    assert found.pressure.accepted.all()
    (soak,) = (e for e in ledger if e.code == "AIR-GROUND-SOAK")
    assert found.temperature.count(Reason.GROUND_SOAK) == soak.count
    assert soak.count == np.count_nonzero(~found.temperature.accepted)


def test_a_log_that_begins_in_the_air_has_no_take_off() -> None:
    flying = channel("GPS[0]", 20, "height", h_msl_m=2000.0 + 3.0 * SECONDS, **PLACE)
    found = outside_air_samples({"height": flying, "temperature": OUT}, HeightSystem(), 5.0)[0]
    assert found.temperature is not None
    assert found.temperature.accepted.all()


def test_a_height_that_is_fused_with_the_barometer_says_nothing_of_temperatures() -> None:
    """Pressures of the lowest 30 m give the level; with a receiver all are used, without a word."""
    fused = channel("POS", 10, "position", h_msl_m=HEIGHT, **PLACE)
    samples, notes = outside_air_samples({"height": fused, "pressure": BARO}, HeightSystem(), 5.0)
    assert samples.pressure is not None
    assert samples.pressure.accepted.any()
    assert samples.pressure.extent_m < 30.0
    rejected = samples.pressure.rejected
    assert set(rejected.tolist()) == {Reason.USED, Reason.FUSED_HEIGHT}
    assert [(e.code, e.where) for e in notes] == [("AIR-HEIGHT-FUSED", "POS")]
    samples, notes = outside_air_samples({"height": GPS, "pressure": BARO}, HeightSystem(), 5.0)
    assert samples.pressure is not None
    assert samples.pressure.accepted.all()
    assert notes == ()


def test_readings_without_height_or_at_a_suspect_one_say_so() -> None:
    short = GPS.rows(SECONDS < 700.0)
    suspect = Stretch(int(TIME[300]), int(TIME[309]), HEIGHT_QUANTITY, "it steps")
    replaced = Stretch(int(TIME[400]), int(TIME[409]), HEIGHT_QUANTITY, "it steps", 9.0, "GPS[1]")
    samples, notes = outside_air_samples(
        {"height": short, "pressure": BARO}, HeightSystem(), 5.0, [suspect, replaced]
    )
    assert samples.pressure is not None
    rejected = samples.pressure.rejected
    assert np.flatnonzero(rejected == Reason.SUSPECT_HEIGHT).tolist() == list(range(300, 310))
    assert (rejected == Reason.NO_HEIGHT).tolist() == (SECONDS >= 700.0).tolist()
    assert [(e.code, e.count) for e in notes] == [("AIR-SUSPECT-HEIGHT", 10)]


def test_the_ground_between_two_flights_is_not_the_air() -> None:
    twice = np.concatenate([HEIGHT, HEIGHT])
    time_ns = np.arange(twice.size, dtype=np.int64) * 10**9
    place = {k: np.full(twice.size, v) for k, v in PLACE.items()}
    gnss = Channel("GPS[0]", time_ns, {"h_msl_m": twice, **place}, Source("GPS"))
    warm = Channel("HYGR[0]", time_ns, {"temperature_k": np.full(twice.size, 280.0)}, Source("H"))
    found = outside_air_samples({"height": gnss, "temperature": warm}, HeightSystem(), 5.0)[0]
    assert found.temperature is not None
    accepted = found.temperature.accepted
    assert not accepted[865:1015].any()
    assert not accepted[1015:1070].any()
    assert accepted[1085:1750].all()


def test_heights_that_cannot_be_are_taken_out() -> None:
    wild = HEIGHT.copy()
    wild[100], wild[200], wild[300] = 1e6, -50_000.0, wild[300] + 900.0
    ledger = Ledger()
    gnss = channel("GPS[0]", 20, "height", h_msl_m=wild, **PLACE)
    sound = ledger.take(plausible_samples(gnss, "height"))
    assert np.flatnonzero(np.isnan(sound["h_msl_m"])).tolist() == [100, 200, 300]
    assert len(sound) == len(gnss)
    assert [(e.code, e.count, e.kind) for e in ledger] == [("SENSOR-RANGE", 3, Kind.LOSS)]
    assert plausible_samples(GPS, "height")[0]["h_msl_m"].tolist() == HEIGHT.tolist()


def test_the_attitude_of_the_aircraft_is_only_ever_named() -> None:
    mount = channel("ATT[1]", 20, "attitude", q_w=1, q_x=0, q_y=0, q_z=0)
    roles, _ = assign(POS, GPS, ATT, mount)
    assert "aircraft_attitude" not in roles
    roles, _ = assign(POS, GPS, ATT, mount, attitude="ATT[1]", aircraft_attitude="ATT")
    assert (roles["attitude"], roles["aircraft_attitude"]) == ("ATT[1]", "ATT")
    # Without it a window in the belly would be turned with the camera: no silent substitute.
    with pytest.raises(MissionError, match="CHANNEL-MISSING"):
        assign(POS, GPS, ATT, aircraft_attitude="ATT[7]")


def test_humidity_on_the_ground_is_not_the_airs_either_but_airspeed_is_kept() -> None:
    roles = {"height": GPS, "humidity": OUT, "airspeed": ARSP}
    samples, notes = outside_air_samples(roles, HeightSystem(), 5.0)
    assert samples.humidity is not None
    assert samples.airspeed is not None
    assert SECONDS[samples.humidity.accepted].min() == pytest.approx(180.0, abs=3.0)
    assert samples.airspeed.accepted.all()
    assert samples.takeoff_ns is not None
    # Off the ground at 60 s; after the landing at 860 s the log ends on the ground.
    assert (samples.takeoff_ns / 1e9).tolist() == pytest.approx([60.0, 899.0], abs=4.0)
    assert [(e.kind, e.code) for e in notes] == [("note", "AIR-GROUND-SOAK")]


def test_heights_above_sea_level_come_before_those_above_the_ellipsoid() -> None:
    both = channel("GPS", 1, h_msl_m=HEIGHT, h_ellipsoid_m=HEIGHT + 47.0)
    assert both.height_column == "h_msl_m"
    unknown = channel("GPS", 1, h_msl_m=np.nan, h_ellipsoid_m=HEIGHT)
    assert unknown.height_column == "h_ellipsoid_m"
    assert OUT.height_column is None


def test_a_slowly_leaking_cabin_is_not_outside_air() -> None:
    """Half of the fall of the outside pressure: a temperature of 550 K would explain it."""
    leaking = channel("BARO[3]", 10, "pressure", pressure_pa=free_air(0.5 * HEIGHT))
    assert follows_height(leaking, GPS) is False
    wavy = free_air(HEIGHT) * (1.0 + 0.05 * np.sin(HEIGHT / 200.0))
    assert follows_height(channel("BARO[5]", 10, "pressure", pressure_pa=wavy), GPS) is False
