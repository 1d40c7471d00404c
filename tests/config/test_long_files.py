"""Mission files that are far too long: a refusal, soon, and short."""

import time

import pytest

from tests.helpers import refused
from unbend.config import load_mission
from unbend.config.mistakes import MOST_REFUSED, MOST_SENTENCES
from unbend.config.reading import refusal_of
from unbend.config.yaml_text import MOST_BYTES
from unbend.errors import ConfigError

MOST_CPU_S = 20.0
"""On a loaded machine; a search of the whole file for each mistake took minutes."""

LONG_TEXTS = {
    "unknown keys": "".join(f"k{number}: 1\n" for number in range(20_000)),
    "open questions": "cameras:\n"
    + "".join(f"  c{number}: {{f_px: TODO}}\n" for number in range(8_000)),
    "soundings": "atmosphere:\n  soundings:\n" + "  - {path: [1, 2], format: {a: 1}}\n" * 8_000,
    "cameras": "cameras:\n"
    + "".join(f"  c{number}: {{f_px: 1, k: 2}}\n" for number in range(8_000)),
}


@pytest.mark.parametrize("text", LONG_TEXTS.values(), ids=LONG_TEXTS.keys())
def test_of_very_many_mistakes_the_first_are_listed(tmp_path, text):
    path = tmp_path / "mission.yaml"
    path.write_text(text, "utf-8")

    begin_s = time.process_time()
    with pytest.raises(ConfigError) as caught:
        load_mission(path)
    cpu_s = time.process_time() - begin_s

    message = str(caught.value)
    assert f"more than {MOST_SENTENCES} " in message
    lines = [line for line in message.splitlines() if line.startswith("    line ")]
    assert len(lines) == MOST_SENTENCES
    assert cpu_s < MOST_CPU_S


def test_very_many_open_questions_in_the_place_of_a_text_are_one_mistake(tmp_path):
    path = tmp_path / "mission.yaml"
    path.write_text(f"mission: {{name: [{','.join(['TODO'] * 40_000)}]}}", "utf-8")

    begin_s = time.process_time()
    with pytest.raises(ConfigError) as caught:
        load_mission(path)
    cpu_s = time.process_time() - begin_s

    assert str(caught.value).count("mission.name") == 1
    assert cpu_s < MOST_CPU_S


def test_as_many_mistakes_as_are_listed_are_all_listed(tmp_path):
    missing = 5  # sections that every mission has
    path = tmp_path / "mission.yaml"
    unknown = "".join(f"k{number}: 1\n" for number in range(MOST_SENTENCES - missing))
    path.write_text(unknown, "utf-8")
    with refused("CONFIG-UNKNOWN-KEY") as caught:
        load_mission(path)
    message = str(caught.value)
    assert f": {MOST_SENTENCES} mistakes" in message
    assert f"k{MOST_SENTENCES - missing - 1}: unknown key" in message


def test_where_not_everything_refused_was_looked_at_the_number_says_more():
    """The first thousand are two mistakes, each said again and again."""
    no_height = {"type": "missing", "loc": ("ground", "height")}
    no_log = {"type": "missing", "loc": ("inputs", "log")}
    items = [no_height, no_log] * (MOST_REFUSED // 2)
    values = {"ground": {}, "inputs": {}}

    all_looked_at = refusal_of(items, values, None, "mission.yaml")
    assert ": 2 mistakes" in str(all_looked_at)
    one_more = refusal_of([*items, no_log], values, None, "mission.yaml")
    assert ": more than 2 mistakes" in str(one_more)


def test_a_file_that_is_larger_than_any_mission_file_is_refused(tmp_path):
    path = tmp_path / "mission.yaml"
    path.write_text("# a comment\n" * (MOST_BYTES // 12 + 1), "utf-8")
    with refused("CONFIG-UNREADABLE", says="a mission file has at most"):
        load_mission(path)
