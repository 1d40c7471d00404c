"""DataFlash logs with every kind of damage: whole, salvaged and said so, or refused with a code."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from unbend.ingest import open_log
from unbend.simulate.write_dataflash import FORMATS

REFUSALS = {"LOG-FORMAT", "LOG-NO-MESSAGES", "LOG-EMPTY"}


def definition(name: str) -> bytes:
    form = FORMATS[name]
    columns = (form.name.encode(), form.format.encode(), form.columns.encode())
    return FORMATS["FMT"].pack(form.type_id, 3 + form.struct.size, *columns)


def row(name: str, **values: Any) -> bytes:
    """A record whose other fields are zero."""
    form = FORMATS[name]
    blank = {
        field: b"" if letter in "nNZ" else 0
        for field, letter in zip(form.columns.split(","), form.format, strict=True)
    }
    return form.pack(*(blank | values).values())


def moment(k: int, from_us: int, week_ms: int) -> bytes:
    """What a flight logs in a tenth of a second."""
    t = from_us + k * 100_000
    far = k * 1e-5
    place = {"Lat": 47.0 + far, "Lng": 8.0 + far, "Alt": 900.0 + k}
    tilt = {"Roll": 2.0 * math.sin(k), "Pitch": 1.0, "Yaw": 90.0}
    data = row("ATT", TimeUS=t, **tilt) + row("POS", TimeUS=t + 10, RelHomeAlt=1.0 * k, **place)
    for unit in (0, 1):
        air = {"Press": 91_000.0 - 11.0 * k, "Temp": 35.0}
        data += row("BARO", TimeUS=t + 20, I=unit, **air)
    if k % 2 == 0:
        fix = {"Status": 4, "GMS": week_ms + k * 100, "GWk": 2200, "NSats": 20}
        data += row("GPS", TimeUS=t + 30, I=0, **fix, **place)
        data += row("GPA", TimeUS=t + 30, I=0, HAcc=0.5, VAcc=0.8, AEl=948.0 + k)
        data += row("HYGR", TimeUS=t + 40, Id=0, Humidity=55.0, Temp=9.0)
    if k % 20 == 9:
        data += row("TRIG", TimeUS=t + 50, Img=k // 20, **place)
        data += row("CAM", TimeUS=t + 90, Img=k // 20, **place)
    return data


def one_boot() -> bytes:
    """Twelve seconds with a late definition, 30 KiB."""
    data = b"".join(definition(name) for name in FORMATS if name not in ("HYGR", "MSG"))
    data += b"".join(
        row("PARM", TimeUS=4_900_000, Name=f"PARAM_{k}".encode(), Value=1.0 * k) for k in range(40)
    )
    data += definition("HYGR") + b"".join(moment(k, 5_000_000, 200_000) for k in range(60))
    data += definition("MSG") + row("MSG", TimeUS=11_000_000, Message=b"Mission: 3 WP")
    return data + b"".join(moment(k, 5_000_000, 200_000) for k in range(60, 120))


def two_boots() -> bytes:
    """Two times six seconds, the second after a power-up."""
    definitions = b"".join(definition(name) for name in FORMATS)
    first = b"".join(moment(k, 60_000_000, 200_000) for k in range(60))
    second = b"".join(moment(k, 5_000_000, 900_000) for k in range(60))
    return definitions + first + definitions + second


@pytest.fixture
def trial(mutate: ModuleType, tmp_path: Path) -> Any:
    return mutate.Trial([one_boot(), two_boots()], ".bin", open_log, tmp_path)


def test_the_small_logs_are_whole(trial: Any, mutate: ModuleType) -> None:
    assert [log.boots for log in trial.whole] == [1, 2]
    assert not any(mutate.damage_reported(log) for log in trial.whole)
    assert all(20_000 < len(data) < 40_000 for data in trial.logs)


def test_mutations(
    trial: Any,
    mutate: ModuleType,
    mutation_count: int,
    mutation_seed: int,
    record_property: Callable[[str, object], None],
) -> None:
    for recipe in mutate.recipes(len(trial.logs), mutation_count, mutation_seed):
        trial.run(recipe)
    record_property("mutations", f"seed {mutation_seed}, {trial.summary()}")
    assert not trial.failures, trial.summary()
    # A bit of a name in an FMT record makes another name of it: "renamed".
    assert set(trial.ends) <= {"complete", "reported", "renamed", "unreported"} | REFUSALS
    assert trial.ends["renamed"] <= 0.005 * mutation_count, trial.summary()
    # Without numbers or checksums a cut between two records cannot be seen.
    assert trial.ends["unreported"] <= 0.01 * mutation_count, trial.unreported[:20]
    for recipe in trial.unreported:
        assert mutate.KINDS[recipe.kind] in ("truncate", "delete"), recipe


def test_the_ends_cut_byte_by_byte(trial: Any, cuts: list[int]) -> None:
    data = trial.logs[0]
    for count in cuts:
        trial.examine(0, data[count:], f"without the first {count} bytes")
        trial.examine(0, data[:-count], f"without the last {count} bytes")
    assert not trial.failures, trial.summary()
    assert set(trial.ends) <= {"complete", "reported", "unreported"} | REFUSALS, trial.summary()
    # 1,000 bytes are some 30 records, so as many cuts lie between two
    assert trial.ends["unreported"] < 0.04 * len(cuts) + 4


@pytest.fixture
def text_trial(mutate: ModuleType, tmp_path: Path) -> Any:
    binary = tmp_path / "whole.bin"
    logs = []
    for data in (one_boot(), two_boots()):
        binary.write_bytes(data)
        logs.append(as_text(binary))
    return mutate.Trial(logs, ".log", open_log, tmp_path)


def as_text(binary: Path) -> bytes:
    """What a ground station writes: one message a line, scaled fields in their unit."""
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(binary))
    lines = []
    with contextlib.closing(reader):
        while (record := reader.recv_msg()) is not None:
            values = [getattr(record, field) for field in record.get_fieldnames()]
            lines.append(", ".join([record.get_type(), *map(str, values)]))
    return "\n".join([*lines, ""]).encode()


def test_mutations_of_logs_as_text(
    text_trial: Any,
    mutate: ModuleType,
    mutation_count: int,
    mutation_seed: int,
    record_property: Callable[[str, object], None],
) -> None:
    """A digit more or less is a number still: what is altered in a line cannot be seen."""
    for recipe in mutate.recipes(2, mutation_count, mutation_seed):
        text_trial.run(recipe)
    record_property("mutations", f"seed {mutation_seed}, {text_trial.summary()}")
    assert not text_trial.failures, text_trial.summary()
    assert set(text_trial.ends) <= {"complete", "reported", "renamed", "unreported"} | REFUSALS
    assert text_trial.ends["unreported"] <= 0.02 * mutation_count, text_trial.unreported[:20]


def test_what_was_found_stays_repaired(
    trial: Any, corpus: dict[str, Any], mutate: ModuleType
) -> None:
    for name, recipe in corpus.get("dataflash", []):
        assert trial.run(mutate.Recipe(*recipe)) in {"complete", "reported"} | REFUSALS, name
    assert not trial.failures, trial.summary()


def test_what_was_found_in_texts_stays_repaired(
    text_trial: Any, corpus: dict[str, Any], mutate: ModuleType
) -> None:
    for name, recipe in corpus["dataflash_text"]:
        assert text_trial.run(mutate.Recipe(*recipe)) == "reported", name
    assert not text_trial.failures, text_trial.summary()


def test_no_log_at_all(trial: Any) -> None:
    import random

    assert trial.examine(0, b"", "empty") == "LOG-EMPTY"
    assert trial.examine(0, random.Random(3).randbytes(30_000), "noise") == "LOG-FORMAT"
    assert trial.examine(0, b"\xa3\x95" * 15_000, "nothing but headers") == "LOG-FORMAT"
    assert trial.examine(0, b"\xa3\x95\x80" * 10_000, "nothing but FMT headers") in REFUSALS
