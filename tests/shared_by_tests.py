"""Where tests keep what they share, though each has a cache and a home of its own.

Compiled kernels take half a minute to make, matplotlib's list of fonts 20 s: both lie in a folder
that says so. To be imported before anything imports numba or matplotlib.
"""

import os
import site

from unbend.arithmetic import use_same_arithmetic

CACHE = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
FOLDER = f"{CACHE}/unbend-tests"
DEFAULTS = {
    "NUMBA_CACHE_DIR": f"{FOLDER}/compiled",
    "MPLCONFIGDIR": f"{FOLDER}/matplotlib",
    # Packages that a user installed are found from other homes too.
    "PYTHONUSERBASE": site.getuserbase(),
}
for name, value in DEFAULTS.items():
    os.environ.setdefault(name, value)

use_same_arithmetic()  # as the command line does: its results agree with these to the last bit
