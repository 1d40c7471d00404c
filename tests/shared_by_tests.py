"""Where tests keep what they share, though each has a cache and a home of its own.

Compiled kernels take half a minute to make, matplotlib's list of fonts 20 s: both lie in a folder
that says so. To be imported before anything imports numba or matplotlib.
"""

from __future__ import annotations

import os
import site

CACHE = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
FOLDER = os.path.join(CACHE, "unbend-tests")

# As the command line does, and before anything imports numpy: results then agree to the last bit.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_CACHE_DIR", os.path.join(FOLDER, "compiled"))
os.environ.setdefault("MPLCONFIGDIR", os.path.join(FOLDER, "matplotlib"))
# Packages that a user installed are found from other homes too.
os.environ.setdefault("PYTHONUSERBASE", site.getuserbase())
