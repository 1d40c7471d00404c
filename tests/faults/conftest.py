"""The mutator, and how many mutations: UNBEND_MUTATIONS (500) from UNBEND_SEED."""

from __future__ import annotations

import csv
import os
import random
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

from tests.draws import SEED

HERE = Path(__file__).resolve().parent


def _mutate() -> ModuleType:
    name = "unbend_tests_mutate"
    if name not in sys.modules:
        spec = spec_from_file_location(name, HERE / "mutate.py")
        if spec is None or spec.loader is None:
            raise ImportError("tests/faults/mutate.py")
        module = module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look their module up
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session")
def mutate() -> ModuleType:
    """The module tests/faults/mutate.py."""
    return _mutate()


@pytest.fixture(scope="session")
def mutation_count() -> int:
    return int(os.environ.get("UNBEND_MUTATIONS", "500"))


@pytest.fixture(scope="session")
def mutation_seed() -> int:
    return SEED * 1_000_000  # mutations have consecutive seeds: those of two days are others


@pytest.fixture(scope="session")
def cuts(mutation_count: int, mutation_seed: int) -> list[int]:
    """How many bytes are cut from either end: 1 to 1,000 in `make faults`, else 150 of these."""
    every = range(1, 1001)
    return [*every] if mutation_count > 2000 else random.Random(mutation_seed).sample(every, 150)


@pytest.fixture(scope="session")
def corpus() -> dict[str, list[tuple[str, tuple[int, int, int]]]]:
    """Failures found once, by format: a name that says what it was, and its recipe.

    tests/faults/corpus/FORMAT.csv has the columns name, file, kind, seed.
    """
    found = {}
    for path in sorted((HERE / "corpus").glob("*.csv")):
        with path.open(encoding="utf-8", newline="") as stream:
            found[path.stem] = [
                (row["name"], (int(row["file"]), int(row["kind"]), int(row["seed"])))
                for row in csv.DictReader(stream)
            ]
    return found
