"""Samples that no vehicle and no air can reach are taken out and counted; what can be, stays."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.flight.channels import Channel, Source
from pipeline.flight.quality import within_reason
from pipeline.ledger import Ledger

RATE_HZ = 10.0


def channel(n: int = 60, **columns: np.ndarray) -> Channel:
    time_ns = (np.arange(n) * (1e9 / RATE_HZ)).astype(np.int64)
    return Channel("X", time_ns, columns, Source("X"))


def flown(n: int = 60) -> dict[str, np.ndarray]:
    """60 m/s to the north-east across the date line."""
    along = np.arange(n) * (60.0 / RATE_HZ) / 6.371e6
    lon = np.pi - 1e-5 + along
    return {"lat_rad": 0.8 + along, "lon_rad": np.where(lon > np.pi, lon - 2 * np.pi, lon)}


def turned(n: int = 60) -> dict[str, np.ndarray]:
    """A roll at 400 deg/s, as a multirotor does."""
    half = np.radians(400.0 / RATE_HZ) * np.arange(n) / 2.0
    return {"q_w": np.cos(half), "q_x": np.sin(half), "q_y": 0.0 * half, "q_z": 0.0 * half}


def cold(n: int = 60) -> dict[str, np.ndarray]:
    return {"temperature_k": 280.0 - 0.01 * np.arange(n)}


def climbing(n: int = 60) -> dict[str, np.ndarray]:
    noise = np.random.default_rng(2).normal(0.0, 8.0, n)
    return {"pressure_pa": 90_000.0 - 12.0 * np.arange(n) + noise}


SOUND = {
    "position": flown,
    "attitude": turned,
    "temperature": cold,
    "pressure": climbing,
}
JUMPS = {
    "position": ("lon_rad", 150.0 / 6.371e6),
    "attitude": ("q_z", 8.0),
    "temperature": ("temperature_k", -5.5),
    "pressure": ("pressure_pa", 300.0),
}


@pytest.mark.parametrize("role", SOUND)
def test_what_can_be_stays(role: str) -> None:
    ledger = Ledger()
    assert len(within_reason(channel(**SOUND[role]()), role, ledger)) == 60
    assert not list(ledger)


@pytest.mark.parametrize("role", SOUND)
def test_one_wrong_sample_is_taken_out_and_counted(role: str) -> None:
    columns = SOUND[role]()
    name, jump = JUMPS[role]
    columns[name][30] += jump
    if role == "attitude":
        q = np.array([columns[f"q_{axis}"][30] for axis in "wxyz"])
        for axis, value in zip("wxyz", q / np.linalg.norm(q), strict=True):
            columns[f"q_{axis}"][30] = value
    ledger = Ledger()
    sound = within_reason(channel(**columns), role, ledger)
    assert len(sound) == 59
    assert 3_000_000_000 not in sound.time_ns.tolist()
    (entry,) = ledger
    assert (entry.kind, entry.code, entry.count) == ("loss", "SENSOR-JUMP", 1)
    assert "3.000 s" in entry.what


def test_a_step_that_stays_is_no_jump() -> None:
    """A sensor that is set anew, or a gap: both sides of it may be true."""
    columns = cold()
    columns["temperature_k"][30:] += 20.0
    ledger = Ledger()
    assert len(within_reason(channel(**columns), "temperature", ledger)) == 60
    assert not list(ledger)
