"""Keys of a mission file that are there with null, which the values alone do not tell from absent.

What a manifest keeps of a mission states each key: these functions are of missions from a file.
"""

from unbend.config.mission_file import Mission


def cameras_of_unstated_window(mission: Mission) -> tuple[str, ...]:
    """The cameras of which the mission file says neither a window nor that there is none."""
    names = []
    for name, camera in mission.cameras.items():
        stated = camera.model_fields_set
        if "window" not in stated and camera.opening is None:
            names.append(name)
    return tuple(names)


def stated_nulls(mission: Mission) -> tuple[str, ...]:
    """The keys with null that mean something else than keys that are absent."""
    keys = []
    if mission.log is not None:
        for role in sorted(mission.log.channels.empty):
            keys.append(f"log.channels.{role}")
    for name, camera in mission.cameras.items():
        stated = camera.model_fields_set
        if camera.window is None and "window" in stated:
            keys.append(f"cameras.{name}.window")
    return tuple(keys)
