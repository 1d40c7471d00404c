"""The mission file."""

from pipeline.config.reading import load_mission
from pipeline.config.sections import Mission, NamedChannel

__all__ = ["Mission", "NamedChannel", "load_mission"]
