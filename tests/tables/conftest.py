"""Every test of tables works in an empty folder of its own."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths without a folder are of the test's own."""
    monkeypatch.chdir(tmp_path)
