"""A terminal of 80 columns and 25 lines, and commands that must end in one way."""

import pytest

from tests.batch.conftest import obeyed as obeyed
from tests.batch.conftest import refusal_of as refusal_of


@pytest.fixture
def eighty_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "25")
