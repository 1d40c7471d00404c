"""Flights drawn at random, and how many: UNBEND_FLIGHTS (200) from UNBEND_SEED."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.draws import SEED


def _beside(name: str) -> ModuleType:
    """A module beside this file, which no package contains."""
    spec = importlib.util.spec_from_file_location(
        f"unbend_tests_{name}", Path(__file__).with_name(f"{name}.py")
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def drawn_flights() -> ModuleType:
    """The module drawn_flights.py."""
    return _beside("drawn_flights")


@pytest.fixture(scope="session")
def simulated_block() -> ModuleType:
    """The module simulated_block.py."""
    return _beside("simulated_block")


@pytest.fixture(scope="session")
def flight_count() -> int:
    return int(os.environ.get("UNBEND_FLIGHTS", "200"))


@pytest.fixture(scope="session")
def flight_seed() -> int:
    return SEED
