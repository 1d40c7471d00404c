"""Clocks of a telemetry log, of which samples are kept: what they place, and how many there are."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from pipeline.ingest import Log, open_log
from pipeline.ingest.tlog_clock import Sampler

SECOND = 10**9
START_US = 1_700_000_000_000_000


def log_of(path: Path, boot_ms: np.ndarray, received_us: np.ndarray) -> Log:
    """An attitude at each time since boot, right behind it an airspeed without a time."""
    from pymavlink.dialects.v20 import all as library

    sender, frames = library.MAVLink(None, 1, 1), []
    for k, (ms, us) in enumerate(zip(boot_ms.tolist(), received_us.tolist(), strict=True)):
        messages = [
            library.MAVLink_attitude_message(ms, 0.1, -0.2, 3.0, 0.0, 0.0, 0.0),
            library.MAVLink_vfr_hud_message(40.0 + k, 41.0, 90, 50, 600.0, 0.1),
        ]
        if k == 0:
            messages.insert(0, library.MAVLink_system_time_message(START_US, ms))
        for message in messages:
            frames.append(struct.pack(">Q", us) + message.pack(sender))
            sender.seq = (sender.seq + 1) % 256
    path.write_bytes(b"".join(frames))
    return open_log(path)


@pytest.mark.parametrize("seed", range(5))
def test_a_link_that_stalls_shifts_nothing_by_more_than_a_sample(tmp_path: Path, seed: int) -> None:
    """For 1.7 s nothing arrives, then lumps: by the host's clock it would be 1.6 s wrong."""
    draw = np.random.default_rng(seed)
    boot_ms = 60_000 + 20 * np.arange(1500)
    sent_us = START_US + (boot_ms - 60_000) * 1000
    received_us = sent_us + draw.integers(30_000, 38_000, boot_ms.shape)
    for begin in (400, 1000):
        held = slice(begin, begin + 100)
        lumps = 90_000 * (np.arange(100) // 30)  # thirty at a time, a pause between
        received_us[held] = received_us[begin + 85] + 300 * np.arange(100) + lumps
    received_us = np.maximum.accumulate(received_us)
    log = log_of(tmp_path / "stall.tlog", boot_ms, received_us)
    shown = log.channel("VFR_HUD")
    sent_ns = sent_us[(shown["airspeed_m_s"] - 40.0).round().astype(int)] * 1000
    assert np.abs(received_us - sent_us).max() > 1_600_000
    assert np.abs(shown.time_ns - sent_ns).max() < 60_000_000
    assert len(shown) > 1490


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("rows", [12, 25, 400])
def test_a_short_boot_is_one(tmp_path: Path, rows: int, place: int) -> None:
    begin_ms, length = [9_000_000, 5_000, 4_000], [400, 400, 400]
    length[place] = rows
    steady = [ms + 50 * np.arange(n) for ms, n in zip(begin_ms, length, strict=True)]
    boot_ms = np.concatenate(steady)
    log = log_of(tmp_path / "boots.tlog", boot_ms, START_US + 50_000 * np.arange(boot_ms.shape[0]))
    assert log.boots == 3
    assert np.bincount(log.message("ATTITUDE")["boot"]).tolist() == length


@pytest.mark.parametrize("rows", [1, 3])
def test_a_glitch_of_the_clock_is_no_boot(tmp_path: Path, rows: int) -> None:
    boot_ms = 60_000 + 50 * np.arange(800)
    boot_ms[300 : 300 + rows] += 86_400_000
    log = log_of(tmp_path / "glitch.tlog", boot_ms, START_US + 50_000 * np.arange(800))
    assert log.boots == 1


def test_few_samples_of_a_steady_clock_are_kept() -> None:
    kind = [("at", "i8"), ("host_us", "i8"), ("source", "u2"),
            ("records", [("time_boot_ms", "u4")])]  # fmt: skip
    sampler = Sampler()
    draw = np.random.default_rng(1)
    for block in range(10):  # an hour at 50 Hz
        rows = np.zeros(18_000, kind)
        rows["at"] = np.arange(block * 18_000, (block + 1) * 18_000)
        rows["records"]["time_boot_ms"] = rows["at"] * 20
        rows["host_us"] = START_US + rows["at"] * 20_000 + 5_000 + draw.integers(0, 1000, 18_000)
        rows["source"] = 257
        sampler.take([rows[::2], rows[1::2]])
    kept = sampler.readings({1})
    assert kept is not None
    assert bool(np.all(np.diff(kept.at) > 0))
    assert 3600 <= kept.at.shape[0] < 10_000
    assert sampler.readings({1}) is None
