"""A terminal of 80 columns and 25 lines."""

from __future__ import annotations

import pytest


@pytest.fixture
def eighty_columns(monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "25")
