"""The mission file."""

from unbend.config.logs import NamedChannel
from unbend.config.mission_file import Mission
from unbend.config.reading import load_mission

__all__ = ["Mission", "NamedChannel", "load_mission"]
