"""Plans of missions, and files of results: their hashes, and a byte that changes."""

import hashlib

from tests.conftest import MissionFolder
from unbend.batch.plan import Plan, make_plan
from unbend.config import load_mission


def plan_of(mission: MissionFolder) -> Plan:
    """What a run of the mission as it is now would do."""
    return make_plan(load_mission(mission.save()), mission.folder)


def hashes_in(folder, pattern="*"):
    """SHA-256 by name of each file in a folder but its lock."""
    hashes = {}
    for path in folder.rglob(pattern):
        if path.is_file() and path.name != ".lock":
            name = path.relative_to(folder).as_posix()
            hashes[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return hashes


def flip_a_byte(path):
    """Change one byte, in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
