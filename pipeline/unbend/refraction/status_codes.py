"""What became of an observation, as small integers inside and as words in files."""

OK, NO_STATION, NO_GROUND, BAD_MEASUREMENT, OUTSIDE_CAMERA = range(5)
MISSES_GROUND, BEYOND_GRAZING, OUTSIDE_PROFILE, FAR_BRANCH, SEVERAL_CROSSINGS = range(5, 10)

STATUS_NAMES = (
    "ok",
    "no_station",
    "no_ground",
    "bad_measurement",
    "outside_camera",
    "misses_ground",
    "beyond_grazing",
    "outside_profile",
    "far_branch",
    "several_crossings",
)
"""Names by code. Corrected values have ``ok``, ``beyond_grazing`` (a far crossing is possible, the
near one was taken), ``far_branch`` (the slant range said so) and ``several_crossings`` (a terrain
is met again farther on, behind a ridge or a cliff; the first crossing was taken)."""
