"""Keys that a mission file states as null, in contrast to keys that are absent.

Only for missions that were read from a file: in the mission of a manifest every key is stated.
"""

from unbend.config.mission_file import Mission


def cameras_of_unstated_window(mission: Mission) -> tuple[str, ...]:
    """The cameras for which the mission file states neither a window, nor null, nor an opening."""
    names = []
    for name, camera in mission.cameras.items():
        stated = camera.model_fields_set
        if "window" not in stated and camera.opening is None:
            names.append(name)
    return tuple(names)


def cameras_of_stated_null(mission: Mission) -> tuple[str, ...]:
    """The cameras for which the mission file states ``window: null``, and no opening."""
    names = []
    for name in _windows_of_null(mission):
        camera = mission.cameras[name]
        if camera.opening is None:
            names.append(name)
    return tuple(names)


def _windows_of_null(mission: Mission) -> list[str]:
    """The cameras for which the mission file states ``window: null``."""
    names = []
    for name, camera in mission.cameras.items():
        if camera.window is None and "window" in camera.model_fields_set:
            names.append(name)
    return names


def stated_nulls(mission: Mission) -> tuple[str, ...]:
    """The keys that are stated as null, if that means something else than an absent key."""
    keys = []
    if mission.log is not None:
        for role in sorted(mission.log.channels.unused_roles):
            keys.append(f"log.channels.{role}")
    for name in _windows_of_null(mission):
        keys.append(f"cameras.{name}.window")
    return tuple(keys)
