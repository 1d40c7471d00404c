"""A measure of CPU time, so that no limit depends on the machine or on its load."""

from __future__ import annotations

import time

import pytest


@pytest.fixture
def work_unit_s() -> float:
    """CPU time [s] of a million steps of a Python loop here and now: 0.03 to 0.1 s."""
    begin = time.process_time()
    total = 0
    for k in range(1_000_000):
        total += k & 3
    return time.process_time() - begin
