"""What became of an observation, as small integers inside and as words in files."""

OK = 0
NO_STATION = 1
NO_GROUND = 2
BAD_MEASUREMENT = 3
OUTSIDE_CAMERA = 4
MISSES_GROUND = 5
BEYOND_GRAZING = 6
OUTSIDE_PROFILE = 7
FAR_BRANCH = 8
SEVERAL_CROSSINGS = 9

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
"""Names by code. Observations that are ``ok``, ``beyond_grazing`` (a far crossing is
possible, the near one was taken) or ``far_branch`` (the slant range said so) carry
corrected values, and so do ``several_crossings`` (a terrain is met again farther on, behind a ridge
or a cliff; the first crossing was taken)."""
