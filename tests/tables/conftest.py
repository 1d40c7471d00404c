"""Every test of tables works in an empty folder of its own."""

import pytest


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """Paths without a folder are of the test's own."""
    monkeypatch.chdir(tmp_path)
