"""How many mutations: UNBEND_MUTATIONS (500) from UNBEND_SEED; and what is done with them."""

import csv
import os
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.draws import SEED
from tests.faults.extreme_tables import PLACE_COLUMNS, UTC
from tests.faults.mutate import Recipe, recipes
from unbend.flight.channels import Channel
from unbend.messages import Ledger, Message
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_trajectories import read_trajectory_csv

CORPUS = Path(__file__).with_name("corpus")
"""Failures found once: FORMAT.csv has a name that says what it was, file, kind and seed."""


@pytest.fixture(scope="session")
def mutation_count():
    return int(os.environ.get("UNBEND_MUTATIONS", "500"))


@pytest.fixture(scope="session")
def mutation_seed():
    return SEED * 1_000_000  # mutations have consecutive seeds: those of two days are others


@pytest.fixture
def run_mutations(
    mutation_count,
    mutation_seed,
    record_property: Callable[[str, object], None],
):
    """Reads them all, none of which may fail."""

    def run(trial):
        for recipe in recipes(len(trial.logs), mutation_count, mutation_seed):
            trial.run(recipe)
        record_property("mutations", f"seed {mutation_seed}, {trial.summary()}")
        assert not trial.failures, trial.summary()

    return run


@pytest.fixture
def run_cuts(mutation_count, mutation_seed):
    """Cuts bytes from either end of the first log: 1 to 1,000 in `make faults`, else 150 of these.

    How often it ended how; it may not fail.
    """
    cuts = range(1, 1001)
    if mutation_count <= 2000:
        cuts = random.Random(mutation_seed).sample(cuts, 150)

    def run(trial):
        before = trial.ends.copy()
        data = trial.logs[0]
        for count in cuts:
            trial.examine(0, data[count:], f"first {count} bytes cut")
            trial.examine(0, data[:-count], f"last {count} bytes cut")
        assert not trial.failures, trial.summary()
        return trial.ends - before

    return run


@pytest.fixture
def write(tmp_path):
    """Writes a text of these lines into the folder of the test; its path."""

    def write_lines(name, lines):
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n", "utf-8")
        return path

    return write_lines


@pytest.fixture
def trajectory_of(write):
    """Reads rows with places and more columns: the channel, and the losses by their codes."""

    def read(rows, stated: Stated = UTC, **more) -> tuple[Channel, dict[str, Message]]:
        columns = {"time": "t"} | PLACE_COLUMNS | more
        path = write("flight.csv", [",".join(columns.values()), *rows])
        ledger = Ledger()
        channel = read_trajectory_csv(path, replace(stated, columns=columns), ledger)
        losses = {entry.code: entry for entry in ledger if entry.kind == "loss"}
        return channel, losses

    return read


@pytest.fixture
def run_corpus():
    """Reads what once failed in a format, which must end in one of these ways."""

    def run(trial, name, allowed):
        before = list(trial.failures)
        with (CORPUS / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
            for row in csv.DictReader(stream):
                recipe = Recipe(
                    int(row["file"]),
                    int(row["kind"]),
                    int(row["seed"]),
                )
                assert trial.run(recipe) in allowed, row["name"]
        assert trial.failures == before

    return run
