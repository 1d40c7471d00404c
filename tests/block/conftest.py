"""Flights drawn at random, and how many: UNBEND_FLIGHTS (200) from UNBEND_FLIGHT_SEED (0)."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def drawn_flights() -> ModuleType:
    """The module drawn_flights.py beside this file."""
    name = "unbend_tests_drawn_flights"
    place = Path(__file__).with_name("drawn_flights.py")
    spec = importlib.util.spec_from_file_location(name, place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def flight_count() -> int:
    return int(os.environ.get("UNBEND_FLIGHTS", "200"))


@pytest.fixture(scope="session")
def flight_seed() -> int:
    return int(os.environ.get("UNBEND_FLIGHT_SEED", "0"))
