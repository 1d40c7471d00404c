"""unbend: removes atmospheric refraction from aerial image observations.

The main names are imported from their modules when they are first used, so that ``import unbend``
loads neither numpy nor numba:

>>> import unbend
>>> profile = unbend.standard_atmosphere("us1976", index="gyer")
>>> round(float(profile.temperature(0.0)), 2)
288.15
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from unbend.atmosphere import standard_atmosphere
    from unbend.batch.runs import run_mission
    from unbend.config import load_mission
    from unbend.errors import UnbendError
    from unbend.ingest import open_log
    from unbend.library import correct
    from unbend.refraction import correct_observations, refraction_angle

__version__ = "0.2.0"

__all__ = [
    "UnbendError",
    "__version__",
    "correct",
    "correct_observations",
    "load_mission",
    "open_log",
    "refraction_angle",
    "run_mission",
    "standard_atmosphere",
]

_MODULE_OF_NAME = {
    "UnbendError": "unbend.errors",
    "correct": "unbend.library",
    "correct_observations": "unbend.refraction",
    "load_mission": "unbend.config",
    "open_log": "unbend.ingest",
    "refraction_angle": "unbend.refraction",
    "run_mission": "unbend.batch.runs",
    "standard_atmosphere": "unbend.atmosphere",
}


if not TYPE_CHECKING:  # for mypy a name that does not exist stays an error

    def __getattr__(name: str) -> Any:
        """Import the module of a name of `__all__` when the name is first used."""
        if name not in _MODULE_OF_NAME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULE_OF_NAME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
