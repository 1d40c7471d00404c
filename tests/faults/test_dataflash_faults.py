"""DataFlash logs with every kind of damage: whole, salvaged and said so, or refused with a code."""

import math
import random

import pytest

from tests.faults.hostile import definition_of, packed
from tests.faults.mutate import KINDS, REFUSALS, Trial, damage_reported
from tests.ingest.dataflash.library import as_text
from unbend.ingest import open_log
from unbend.simulate.write_dataflash import FORMATS


def moments(numbers, from_us, week_ms):
    """What a flight logs, each in a tenth of a second."""
    data = b""
    for k in numbers:
        t = from_us + k * 100_000
        far = k * 1e-5
        place = {"Lat": 47.0 + far, "Lng": 8.0 + far, "Alt": 900.0 + k}
        data += packed(
            "ATT",
            TimeUS=t,
            Roll=2.0 * math.sin(k),
            Pitch=1.0,
            Yaw=90.0,
        )
        data += packed("POS", TimeUS=t + 10, RelHomeAlt=1.0 * k, **place)
        for unit in (0, 1):
            pressure_pa = 91_000.0 - 11.0 * k
            data += packed(
                "BARO",
                TimeUS=t + 20,
                I=unit,
                Press=pressure_pa,
                Temp=35.0,
            )
        if k % 2 == 0:
            fix = {
                "Status": 4,
                "GMS": week_ms + k * 100,
                "GWk": 2200,
                "NSats": 20,
            }
            data += packed("GPS", TimeUS=t + 30, **fix, **place)
            data += packed(
                "GPA",
                TimeUS=t + 30,
                HAcc=0.5,
                VAcc=0.8,
                AEl=948.0 + k,
            )
            data += packed("HYGR", TimeUS=t + 40, Humidity=55.0, Temp=9.0)
        if k % 20 == 9:
            data += packed(
                "TRIG",
                TimeUS=t + 50,
                Img=k // 20,
                **place,
            )
            data += packed(
                "CAM",
                TimeUS=t + 90,
                Img=k // 20,
                **place,
            )
    return data


def definitions():
    return {name: definition_of(name) for name in FORMATS}


def one_boot():
    """Twelve seconds with a late definition, 30 KiB."""
    early = definitions()
    hygrometer = early.pop("HYGR")
    text = early.pop("MSG")
    data = b"".join(early.values())
    for k in range(40):
        name = f"PARAM_{k}".encode()
        data += packed("PARM", TimeUS=4_900_000, Name=name, Value=1.0 * k)
    data += hygrometer + moments(range(60), 5_000_000, 200_000)
    data += text + packed("MSG", TimeUS=11_000_000, Message=b"Mission: 3 WP")
    return data + moments(range(60, 120), 5_000_000, 200_000)


def two_boots():
    """Two times six seconds, the second after a power-up."""
    head = b"".join(definitions().values())
    first = moments(range(60), 60_000_000, 200_000)
    second = moments(range(60), 5_000_000, 900_000)
    return head + first + head + second


@pytest.fixture
def trial(tmp_path) -> Trial:
    return Trial([one_boot(), two_boots()], ".bin", open_log, tmp_path)


def test_the_small_logs_are_whole(trial):
    assert [log.boots for log in trial.whole] == [1, 2]
    for log, data in zip(trial.whole, trial.logs, strict=True):
        assert not damage_reported(log)
        assert 20_000 < len(data) < 40_000


def test_mutations(trial, run_mutations, mutation_count):
    run_mutations(trial)

    # A bit of a name in an FMT record makes another name of it: "renamed".
    assert set(trial.ends) <= {"complete", "reported", "renamed", "unreported"} | REFUSALS
    assert trial.ends["renamed"] <= 0.005 * mutation_count, trial.summary()
    # Without numbers or checksums a cut between two records cannot be seen.
    assert trial.ends["unreported"] <= 0.01 * mutation_count, trial.unreported[:20]
    for recipe in trial.unreported:
        assert KINDS[recipe.kind] in ("truncate", "delete"), recipe


def test_the_ends_cut_byte_by_byte(trial, run_cuts):
    ends = run_cuts(trial)

    assert set(ends) <= {"complete", "reported", "unreported"} | REFUSALS, trial.summary()
    # 1,000 bytes are some 30 records, so as many cuts lie between two
    assert ends["unreported"] < 0.02 * ends.total() + 4


@pytest.fixture
def text_trial(tmp_path) -> Trial:
    binary = tmp_path / "whole.bin"
    logs = []
    for data in (one_boot(), two_boots()):
        binary.write_bytes(data)
        logs.append(as_text(binary).encode())
    return Trial(logs, ".log", open_log, tmp_path)


def test_mutations_of_logs_as_text(text_trial, run_mutations, mutation_count):
    """A digit more or less is a number still: what is altered in a line cannot be seen."""
    run_mutations(text_trial)

    assert set(text_trial.ends) <= {"complete", "reported", "renamed", "unreported"} | REFUSALS
    assert text_trial.ends["unreported"] <= 0.02 * mutation_count, text_trial.unreported[:20]


def test_what_was_found_stays_repaired(trial, run_corpus):
    run_corpus(trial, "dataflash", {"complete", "reported"} | REFUSALS)


def test_what_was_found_in_texts_stays_repaired(text_trial, run_corpus):
    run_corpus(text_trial, "dataflash_text", {"reported"})


def test_no_log_at_all(trial):
    noise = random.Random(3).randbytes(30_000)
    assert trial.examine(0, b"", "empty") == "LOG-EMPTY"
    assert trial.examine(0, noise, "noise") == "LOG-FORMAT"
    assert trial.examine(0, b"\xa3\x95" * 15_000, "nothing but headers") == "LOG-FORMAT"
    assert trial.examine(0, b"\xa3\x95\x80" * 10_000, "nothing but FMT headers") in REFUSALS
