"""The delay of fixes behind their epoch: stated, estimated, and what it moves."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.flight.channels import Channel, Source
from unbend.ingest.flight_log import Contents
from unbend.ingest.receiver_delay import estimated_delay, stated_delay, with_receiver_delay
from unbend.messages import Ledger

SECOND = 1_000_000_000
NOW_NS = 1_700_000_000 * SECOND


def place(t: np.ndarray) -> dict[str, np.ndarray]:
    """Circles of 200 m at 25 m/s, written down in closed form."""
    angle = t * 25.0 / 200.0
    north = 200.0 * np.sin(angle)
    east = 200.0 * (1.0 - np.cos(angle)) + 3.0 * t
    return {
        "lat_rad": np.radians(47.0) + north / 6_367_400.0,
        "lon_rad": np.radians(8.0) + east / (6_389_600.0 * np.cos(np.radians(47.0))),
    }


def track(name: str, t: np.ndarray, at: np.ndarray, system: int | None = None) -> Channel:
    """Places of the times ``at``, stamped ``t`` [s]."""
    message, _, instance = name.partition("[")
    source = Source(message, instance.rstrip("]") or None, system)
    columns = place(at)
    roles = ("height", "position") if message.startswith("GPS") else ("position",)
    return Channel(
        name, NOW_NS + np.rint(t * SECOND).astype(np.int64), columns, source, roles=roles
    )


FUSED_AT = np.arange(0.0, 300.0, 0.1)
FIXED_AT = np.arange(5.03, 290.0, 0.2)


def flown(delay_s: float, **changes: object) -> Contents:
    channels = (
        track("POS", FUSED_AT, FUSED_AT),
        track("GPS[0]", FIXED_AT + delay_s, FIXED_AT),
        Channel(
            "CAM[0]",
            NOW_NS + np.array([50, 60]) * SECOND,
            {"event_index": np.arange(2.0)},
            Source("CAM", "0"),
        ),
    )

    def table(name: str, instance: str | None) -> dict[str, np.ndarray]:
        return {"time_ns": NOW_NS + np.array([50, 60]) * SECOND}

    given: dict = {"parameters": {"GPS1_DELAY_MS": 0.0}, "utc_sigma_s": 0.0} | changes
    return Contents({}, channels, 0, 0, 1, "", table, **given)


@pytest.mark.parametrize("delay_s", [0.06, 0.118, 0.22, 0.4])
def test_the_delay_is_found_from_the_filter_that_follows_the_fixes(delay_s):
    _, fixes, _ = flown(delay_s).channels
    found = estimated_delay(fixes, track("POS", FUSED_AT, FUSED_AT))
    assert found is not None
    assert found.delay_s == pytest.approx(delay_s, abs=1e-3)
    assert 0.015 <= found.sigma_s < 0.02


def test_everything_but_the_fixes_is_later_by_the_delay():
    """UTC was from the stamps of the fixes, which are later than their epoch."""
    before = flown(0.2)
    ledger = Ledger()
    after = with_receiver_delay(before, ledger)
    moved = {
        c.name: c.time_ns[0] - b.time_ns[0]
        for c, b in zip(after.channels, before.channels, strict=True)
    }
    assert moved["GPS[0]"] == 0
    assert moved["POS"] == moved["CAM[0]"] == pytest.approx(0.2 * SECOND, abs=1e-3 * SECOND)
    assert after.table is not None
    rows = after.table("CAM", None)["time_ns"] - NOW_NS
    assert rows[0] == 50 * SECOND + moved["CAM[0]"]
    (entry,) = [e for e in ledger if e.code == "TIME-FIT"]
    assert "accurate to 15 ms" in entry.what
    assert "200 ms after their epoch" in entry.what
    assert after.utc_sigma_s == pytest.approx(0.015, abs=1e-3)


def test_a_second_receiver_has_its_own_delay_and_another_vehicle_its_own_clock():
    contents = flown(0.2)
    second = track("GPS[1]", FIXED_AT[:-9] + 0.1, FIXED_AT[:-9])
    other = track("GLOBAL_POSITION_INT", FUSED_AT, FUSED_AT, system=7)
    channels = (*contents.channels, second, other)
    after = with_receiver_delay(
        Contents({}, channels, 0, 0, 1, "", parameters=contents.parameters), Ledger()
    ).channels
    shift = [a.time_ns[0] - b.time_ns[0] for a, b in zip(after, channels, strict=True)]
    assert shift[3] == pytest.approx(0.1 * SECOND, abs=2e-3 * SECOND)
    assert shift[4] == 0


@pytest.mark.parametrize(
    ("parameters", "texts", "instance", "delay_s", "sigma_s"),
    [
        ({"GPS1_DELAY_MS": 150.0}, [], "0", 0.15, 0.04),
        ({"GPS_DELAY_MS": 90.0, "GPS_DELAY_MS2": 60.0}, [], "1", 0.06, 0.04),
        ({"GPS1_DELAY_MS": 0.0}, [], "0", 0.22, 0.04),
        ({"GPS1_DELAY_MS": 0.0}, ["u-blox 1 HW: 00080000 SW: EXT CORE 3.01"], "0", 0.12, 0.04),
        ({"GPS1_DELAY_MS": 0.0}, ["u-blox 1 HW: 00070000 SW: 1.00"], "0", 0.12, 0.04),
        ({"GPS1_DELAY_MS": 0.0}, ["u-blox 1 HW: 00040007 SW: 7.03"], "0", 0.22, 0.04),
        ({"EKF2_GPS_DELAY": 110.0}, [], None, 0.11, 0.04),
        ({}, [], "0", 0.0, 0.15),
        ({"GPS1_DELAY_MS": float("nan")}, [], "0", 0.0, 0.15),
        ({"GPS1_DELAY_MS": 1e9}, [], "0", 0.0, 0.15),
    ],
)
def test_the_settings_of_the_autopilot(parameters, texts, instance, delay_s, sigma_s):
    receiver = track(f"GPS[{instance}]" if instance else "sensor_gps", FIXED_AT, FIXED_AT)
    found = stated_delay(receiver, parameters, texts)
    assert (found.delay_s, found.sigma_s) == (delay_s, sigma_s)


def test_no_estimate_at_rest_nor_from_a_filter_that_follows_something_else():
    fixes = track("GPS[0]", FIXED_AT + 0.2, FIXED_AT)
    rest = track("POS", FUSED_AT, FUSED_AT * 0.0)
    assert estimated_delay(track("GPS[0]", FIXED_AT, FIXED_AT * 0.0), rest) is None
    ahead = track("POS", FUSED_AT, FUSED_AT - 2.0)  # the fixes would be stamped before their epoch
    assert estimated_delay(fixes, ahead) is None
    assert estimated_delay(track("GPS[0]", FIXED_AT[:20], FIXED_AT[:20]), rest) is None


def test_fixes_that_are_stamped_at_their_epoch_move_nothing():
    contents = flown(0.0)
    after = with_receiver_delay(contents, Ledger())
    for old, new in zip(contents.channels, after.channels, strict=True):
        np.testing.assert_array_equal(old.time_ns, new.time_ns)


def test_without_a_filter_the_setting_counts():
    contents = flown(0.2)
    settings = {"GPS1_DELAY_MS": 130.0}
    bare = Contents({}, contents.channels[1:], 0, 0, 1, "", parameters=settings, utc_sigma_s=0.0)
    after = with_receiver_delay(bare, Ledger())
    assert after.utc_sigma_s == 0.04
    assert after.channels[1].time_ns[0] - bare.channels[1].time_ns[0] == 130_000_000


def test_a_log_without_a_receiver_is_left_alone():
    contents = Contents({}, flown(0.2).channels[2:], 0, 0, 1, "")
    assert with_receiver_delay(contents, Ledger()) is contents


@pytest.mark.parametrize(
    ("clock_s", "sigma_s", "words"),
    [(5.0, 5.0, "accurate to 5.0 s"), (float("nan"), float("nan"), "UTC is unknown")],
)
def test_utc_of_another_clock_is_not_as_good_as_the_delay(clock_s, sigma_s, words):
    ledger = Ledger()
    after = with_receiver_delay(flown(0.2, utc_sigma_s=clock_s), ledger)
    assert after.utc_sigma_s == pytest.approx(sigma_s, rel=1e-4, nan_ok=True)
    (entry,) = [e for e in ledger if e.code == "TIME-FIT"]
    assert words in entry.what
