"""What a refusal tells the user to write exists: keys of mission files, columns of soundings."""

import ast
import re

from tests.contract.sources import is_string, nodes
from unbend.atmosphere.soundings.formats import PLACE_COLUMNS, PLAIN_COLUMNS
from unbend.config import Mission

OF_FILES = {"calibrated_camera_parameters", "tp_pix4d"}
"""Parts of names of files that Pix4D writes."""

OF_EXPORTS = {"origin_lat_deg", "origin_lon_deg", "origin_h_ellipsoid_m"}
"""Columns of ``unbend export --format opk-enu``."""

WORD = re.compile(r"[a-z][a-z0-9]*(?:_[a-z0-9]+)+")


def is_remedy(node: ast.AST):
    """Whether a node gives a remedy: as an argument, or on a line of its own."""
    if isinstance(node, ast.keyword):
        return node.arg == "remedy"
    if not isinstance(node, ast.Assign):
        return False
    return "remedy" in map(ast.unparse, node.targets)


def words_of_remedies():
    """Every word with an underscore in a remedy of the package, and the files that have it."""
    files = {}
    for name, node in nodes():
        if not is_remedy(node):
            continue
        for part in filter(is_string, ast.walk(node.value)):
            for word in WORD.findall(part.value):
                files.setdefault(word, set()).add(name)
    return files


def is_text(value):
    return isinstance(value, str)


def keys_of_mission_files(schema):
    """All keys, and the words that are values of keys, such as ``from_feedback``."""
    words = set()
    if isinstance(schema, dict):
        words.update(schema.get("properties", {}))
        values = [*schema.get("enum", []), schema.get("const")]
        words.update(filter(is_text, values))
        schema = list(schema.values())
    if isinstance(schema, list):
        for part in schema:
            words |= keys_of_mission_files(part)
    return words


def test_remedies_name_keys_that_exist():
    existing = keys_of_mission_files(Mission.model_json_schema())
    existing.update(PLAIN_COLUMNS, PLACE_COLUMNS, OF_FILES, OF_EXPORTS)
    files = words_of_remedies()
    assert len(files) >= 7
    assert "station_h_msl_m" in files
    unknown = files.keys() - existing
    assert not unknown, [(word, files[word]) for word in unknown]
