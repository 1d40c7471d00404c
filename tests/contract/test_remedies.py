"""What a refusal tells the user to write exists: keys of mission files, columns of soundings."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from unbend.atmosphere.soundings.formats import PLACE_COLUMNS, PLAIN_COLUMNS
from unbend.config import Mission

PACKAGE = Path(__file__).resolve().parents[2] / "pipeline" / "unbend"
OF_FILES = {"calibrated_camera_parameters", "tp_pix4d"}
"""Parts of names of files that Pix4D writes."""

OF_EXPORTS = {"origin_lat_deg", "origin_lon_deg", "origin_h_ellipsoid_m"}
"""Columns of ``unbend export --format opk-enu``."""

WORD = re.compile(r"[a-z][a-z0-9]*(?:_[a-z0-9]+)+")


def words_of_remedies() -> dict[str, set[str]]:
    """Every word with an underscore in a remedy of the package, and the files it stands in."""
    found: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            stated = isinstance(node, ast.keyword) and node.arg == "remedy"
            if isinstance(node, ast.Assign):  # ... or stated on a line of its own
                stated = any(isinstance(t, ast.Name) and t.id == "remedy" for t in node.targets)
            if not (stated and isinstance(node, ast.keyword | ast.Assign)):
                continue
            for part in ast.walk(node.value):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    for word in WORD.findall(part.value):
                        found.setdefault(word, set()).add(path.name)
    return found


def keys_of_mission_files(schema: object) -> set[str]:
    """All keys, and the words that are values of keys, such as ``from_feedback``."""
    if isinstance(schema, dict):
        nested = (keys_of_mission_files(value) for value in schema.values())
        values = [*schema.get("enum", []), schema.get("const")]
        words = {value for value in values if isinstance(value, str)}
        return words.union(schema.get("properties", {}), *nested)
    if isinstance(schema, list):
        return set().union(*(keys_of_mission_files(value) for value in schema))
    return set()


def test_remedies_name_keys_that_exist():
    known = (
        keys_of_mission_files(Mission.model_json_schema()) | set(PLAIN_COLUMNS) | set(PLACE_COLUMNS)
    )
    known |= OF_FILES | OF_EXPORTS
    words = words_of_remedies()
    assert len(words) >= 7
    assert "station_h_msl_m" in words
    assert {word: files for word, files in words.items() if word not in known} == {}
