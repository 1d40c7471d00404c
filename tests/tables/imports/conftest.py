"""The flights whose files are read."""

import numpy as np
import pytest

from tests.tables.imports.flights import Flight


@pytest.fixture
def flight(tmp_path):
    """Five minutes at 10 Hz."""
    return Flight(tmp_path, np.arange(3000) * 0.1)


@pytest.fixture
def exposures(tmp_path):
    """Thirty exposures of that flight."""
    return Flight(tmp_path, np.arange(30) * 4.13 + 7.0)
