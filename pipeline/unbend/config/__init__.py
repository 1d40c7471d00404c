"""The mission file."""

from unbend.config.reading import load_mission
from unbend.config.sections import Mission, NamedChannel

__all__ = ["Mission", "NamedChannel", "load_mission"]
