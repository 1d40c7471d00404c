"""Flights through known air, for tests of the estimator."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def flights() -> ModuleType:
    """The module `flights` beside this file, which no package contains."""
    name = "unbend_test_flights"
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name("flights.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
