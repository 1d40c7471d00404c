"""Logs of this format from bytes."""

from functools import partial
from pathlib import Path

import pytest

from tests.ingest import written_logs
from tests.ingest.written_logs import Opener


@pytest.fixture
def opened(tmp_path: Path) -> Opener:
    """Opens bytes as a log of PX4."""
    return partial(written_logs.opened, tmp_path / "flight.ulg")
