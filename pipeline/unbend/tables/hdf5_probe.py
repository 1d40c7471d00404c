"""Reads the structure of a netCDF-4 file with the HDF5 library, within a limit of processor time.

HDF5 loops for ever on some damage, for example where a download left zeros among the references
to dimensions, and nothing in the same process can stop it. So a process of its own reads the
structure first: `structure_is_readable` starts it, `main` is what it runs.
"""

import math
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import h5py

FIXED_CPU_S = 2  # for the structure of a file of any size
MEGABYTE = 1_000_000  # of the file, for each of which the process has a second more
LONGEST_S = 600.0  # until the file is refused where a drive does not answer


def structure_is_readable(path: Path) -> bool:
    """Whether HDF5 comes to an end with the structure of a file; raises OSError as `stat` does."""
    cpu_s = FIXED_CPU_S + path.stat().st_size // MEGABYTE
    command = [sys.executable, "-P", __file__, str(path), str(cpu_s)]
    try:
        ended = subprocess.run(command, capture_output=True, timeout=LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return False
    was_killed = ended.returncode < 0
    return not was_killed


def _limit_processor_time(seconds: int) -> None:
    """End this process after so many more seconds of its processor; Windows has no such limit."""
    with suppress(ImportError):
        import resource

        used_s = math.ceil(time.process_time())
        limit_s = used_s + seconds
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))


def _read_structure(item: "h5py.Dataset | h5py.Group") -> None:
    """Read attributes and dimensions of a dataset, or of all that a group holds.

    Errors of the library are ignored: opening the file raises them again.
    """
    import h5py

    for name in item.attrs:
        with suppress(Exception):
            item.attrs[name]
    if isinstance(item, h5py.Dataset):
        for dimension in item.dims:
            with suppress(Exception):
                len(dimension)
    if isinstance(item, h5py.Group):
        for name in item:
            with suppress(Exception):
                _read_structure(item[name])


def main() -> None:
    """Read the structure of the file that is named, in at most so many seconds."""
    path, cpu_s = sys.argv[1:]
    import h5py

    _limit_processor_time(int(cpu_s))
    with h5py.File(path) as file:
        _read_structure(file)


if __name__ == "__main__":
    main()
