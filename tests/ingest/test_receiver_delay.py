"""The delay of fixes behind their epoch: stated, estimated, and what it moves."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal

from unbend.flight.channels import Channel, Source
from unbend.ingest.flight_log import Contents
from unbend.ingest.receiver_delay import estimated_delay, stated_delay, with_receiver_delay
from unbend.messages import Ledger

SECOND = 1_000_000_000
NOW_NS = 1_700_000_000 * SECOND
SHOTS_NS = NOW_NS + np.array([50, 60]) * SECOND
FUSED_S = np.arange(0.0, 300.0, 0.1)
FIXED_S = np.arange(5.03, 290.0, 0.2)


def track(name, stamp_s, epoch_s, system=None):
    """Circles of 200 m at 25 m/s, in closed form: the places of epochs, stamped otherwise."""
    angle = epoch_s * 25.0 / 200.0
    north = 200.0 * np.sin(angle)
    east = 200.0 * (1.0 - np.cos(angle)) + 3.0 * epoch_s
    columns = {
        "lat_rad": np.radians(47.0) + north / 6_367_400.0,
        "lon_rad": np.radians(8.0) + east / (6_389_600.0 * np.cos(np.radians(47.0))),
    }
    message, _, instance = name.partition("[")
    source = Source(
        message,
        instance.rstrip("]") or None,
        system,
    )
    time_ns = NOW_NS + np.rint(stamp_s * SECOND).astype(np.int64)
    return Channel(
        name,
        time_ns,
        columns,
        source,
        roles=("position",),
    )


FILTER = track("POS", FUSED_S, FUSED_S)


def table(name, instance) -> dict[str, np.ndarray]:
    return {"time_ns": SHOTS_NS}


def flown(delay_s, utc_sigma_s=0.0):
    """Positions of a filter, late fixes and two images."""
    shots = Channel(
        "CAM[0]",
        SHOTS_NS,
        {"event_index": np.arange(2.0)},
        Source("CAM", "0"),
    )
    fixes = track("GPS[0]", FIXED_S + delay_s, FIXED_S)
    return Contents(
        messages={},
        channels=(FILTER, fixes, shots),
        bad_bytes=0,
        lost_messages=0,
        boots=1,
        time_base="",
        table=table,
        parameters={"GPS1_DELAY_MS": 0.0},
        utc_sigma_s=utc_sigma_s,
    )


def shifts_ns(before, after):
    """By how much the channels are later than before."""
    pairs = zip(
        before.channels,
        after.channels,
        strict=True,
    )
    return {new.name: new.time_ns[0] - old.time_ns[0] for old, new in pairs}


@pytest.mark.parametrize(
    "delay_s",
    [0.06, 0.118, 0.22, 0.4],
)
def test_the_delay_is_found_from_the_filter_that_follows_the_fixes(delay_s):
    delay = estimated_delay(track("GPS[0]", FIXED_S + delay_s, FIXED_S), FILTER)
    assert delay is not None
    assert delay.delay_s == pytest.approx(delay_s, abs=1e-3)
    assert 0.015 <= delay.sigma_s < 0.02


def test_the_sigma_of_an_estimate_is_that_of_a_median_of_rows_whose_errors_last():
    """Of three fixes one is early and one late by 40 ms; errors last 5 s. The filter adds 15 ms."""
    scattered_s = 0.04 * (np.arange(FIXED_S.size) % 3 - 1)
    fixes = track("GPS[0]", FIXED_S + 0.2 + scattered_s, FIXED_S)
    delay = estimated_delay(fixes, FILTER)
    assert delay is not None
    independent = FIXED_S.size / (5.0 * fixes.rate_hz)
    median_sigma_s = 1.2533 * 1.4826 * 0.04 / np.sqrt(independent)
    assert delay.sigma_s == pytest.approx(np.hypot(median_sigma_s, 0.015), rel=2e-3)
    assert delay.origin == f"estimated from {FIXED_S.size} of them against POS"


def test_everything_but_the_fixes_is_later_by_the_delay():
    """UTC was from the stamps of the fixes, which are later than their epoch."""
    before = flown(0.2)
    ledger = Ledger()
    after = with_receiver_delay(before, ledger)
    later_ns = shifts_ns(before, after)
    assert later_ns["GPS[0]"] == 0
    assert later_ns["POS"] == later_ns["CAM[0]"] == pytest.approx(0.2 * SECOND, abs=1e-3 * SECOND)
    assert after.table is not None
    assert_array_equal(
        after.table("CAM", None)["time_ns"],
        after.channels[2].time_ns,
    )
    (entry,) = ledger
    assert entry.code == "TIME-FIT"
    assert "accurate to 15 ms" in entry.what
    assert "200 ms after their epoch" in entry.what
    assert after.utc_sigma_s == pytest.approx(0.015, abs=1e-3)


def test_a_second_receiver_has_its_own_delay_and_another_vehicle_its_own_clock():
    contents = flown(0.2)
    second = track(
        "GPS[1]",
        FIXED_S[:-9] + 0.1,
        FIXED_S[:-9],
    )
    other_vehicle = track(
        "GLOBAL_POSITION_INT",
        FUSED_S,
        FUSED_S,
        system=7,
    )
    before = replace(
        contents,
        channels=(*contents.channels, second, other_vehicle),
    )
    later_ns = shifts_ns(before, with_receiver_delay(before, Ledger()))
    assert later_ns["GPS[1]"] == pytest.approx(0.1 * SECOND, abs=2e-3 * SECOND)
    assert later_ns["GLOBAL_POSITION_INT"] == 0


SETTINGS = yaml.safe_load("""
- {parameters: {GPS1_DELAY_MS: 150.0}, delay_s: 0.15, sigma_s: 0.04}
- parameters: {GPS_DELAY_MS: 90.0, GPS_DELAY_MS2: 60.0}
  receiver: GPS[1]
  delay_s: 0.06
  sigma_s: 0.04
- {parameters: {GPS1_DELAY_MS: 0.0}, delay_s: 0.22, sigma_s: 0.04}
- parameters: {GPS1_DELAY_MS: 0.0}
  texts: ["u-blox 1 HW: 00080000 SW: EXT CORE 3.01"]
  delay_s: 0.12
  sigma_s: 0.04
- parameters: {GPS1_DELAY_MS: 0.0}
  texts: ["u-blox 1 HW: 00070000 SW: 1.00"]
  delay_s: 0.12
  sigma_s: 0.04
- parameters: {GPS1_DELAY_MS: 0.0}
  texts: ["u-blox 1 HW: 00040007 SW: 7.03"]
  delay_s: 0.22
  sigma_s: 0.04
- {parameters: {EKF2_GPS_DELAY: 110.0}, receiver: sensor_gps, delay_s: 0.11, sigma_s: 0.04}
- {parameters: {}, delay_s: 0.0, sigma_s: 0.15}
- {parameters: {GPS1_DELAY_MS: .nan}, delay_s: 0.0, sigma_s: 0.15}
- {parameters: {GPS1_DELAY_MS: -1.0}, delay_s: 0.0, sigma_s: 0.15}
- {parameters: {GPS1_DELAY_MS: 499.0}, delay_s: 0.499, sigma_s: 0.04}
- {parameters: {GPS1_DELAY_MS: 500.0}, delay_s: 0.0, sigma_s: 0.15}
""")


@pytest.mark.parametrize("case", SETTINGS, ids=str)
def test_the_settings_of_the_autopilot(case):
    receiver = track(case.get("receiver", "GPS[0]"), FIXED_S, FIXED_S)
    delay = stated_delay(receiver, case["parameters"], case.get("texts", []))
    assert delay.delay_s == case["delay_s"]
    assert delay.sigma_s == case["sigma_s"]


RESTING = np.zeros(FIXED_S.size)
AHEAD = track("POS", FUSED_S, FUSED_S - 2.0)  # the fixes would be stamped before their epoch


@pytest.mark.parametrize(
    ("fixes", "positions"),
    [
        (track("GPS[0]", FIXED_S, RESTING), track("POS", FUSED_S, np.zeros(FUSED_S.size))),
        (track("GPS[0]", FIXED_S + 0.2, FIXED_S), AHEAD),
        (track("GPS[0]", FIXED_S[:20], FIXED_S[:20]), FILTER),
    ],
    ids=["at rest", "from a filter that follows something else", "from few fixes"],
)
def test_no_estimate(fixes, positions):
    assert estimated_delay(fixes, positions) is None


def test_fixes_that_are_stamped_at_their_epoch_move_nothing():
    contents = flown(0.0)
    later_ns = shifts_ns(contents, with_receiver_delay(contents, Ledger()))
    assert set(later_ns.values()) == {0}


def test_without_a_filter_the_setting_counts():
    contents = flown(0.2)
    settings = {"GPS1_DELAY_MS": 130.0}
    before = replace(
        contents,
        channels=contents.channels[1:],
        parameters=settings,
    )
    after = with_receiver_delay(before, Ledger())
    assert after.utc_sigma_s == 0.04
    assert shifts_ns(before, after) == {"GPS[0]": 0, "CAM[0]": 130_000_000}


def test_a_log_without_a_receiver_is_left_alone():
    contents = flown(0.2)
    without = replace(contents, channels=contents.channels[2:])
    assert with_receiver_delay(without, Ledger()) is without


@pytest.mark.parametrize(
    ("clock_s", "words"), [(5.0, "accurate to 5.0 s"), (float("nan"), "UTC is unknown")]
)
def test_utc_of_another_clock_is_not_as_good_as_the_delay(clock_s, words):
    ledger = Ledger()
    after = with_receiver_delay(flown(0.2, clock_s), ledger)
    assert after.utc_sigma_s == pytest.approx(clock_s, rel=1e-4, nan_ok=True)
    (entry,) = ledger
    assert words in entry.what
