"""unbend: removes atmospheric refraction from aerial image observations.

The main names are imported from their modules when they are first used, so that ``import pipeline``
loads neither numpy nor numba:

>>> import pipeline
>>> profile = pipeline.standard_atmosphere("us1976", index="gyer")
>>> round(float(profile.temperature(0.0)), 2)
288.15
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.atmosphere import standard_atmosphere
    from pipeline.config import load_mission
    from pipeline.in_memory import correct
    from pipeline.ingest import open_log
    from pipeline.refraction import correct_observations, refraction_angle
    from pipeline.stages.story import run_mission

__version__ = "0.2.0"

__all__ = [
    "__version__",
    "correct",
    "correct_observations",
    "load_mission",
    "open_log",
    "refraction_angle",
    "run_mission",
    "standard_atmosphere",
]

_MODULES = {
    "correct": "pipeline.in_memory",
    "correct_observations": "pipeline.refraction",
    "load_mission": "pipeline.config",
    "open_log": "pipeline.ingest",
    "refraction_angle": "pipeline.refraction",
    "run_mission": "pipeline.stages.story",
    "standard_atmosphere": "pipeline.atmosphere",
}


if not TYPE_CHECKING:  # for mypy a name that does not exist stays an error

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
