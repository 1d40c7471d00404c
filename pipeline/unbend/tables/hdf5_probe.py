"""Reads the structure of a netCDF-4 file with the HDF5 library, within a limit of processor time.

HDF5 loops forever on some damage, for example if a download left zeros among the references to
dimensions, and nothing in the same process can stop it. So a separate process reads the structure
first: `structure_is_readable` starts it, and it runs `main`.
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

FIXED_CPU_S = 2  # processor time for a file of any size
BYTES_A_CPU_S = 1_000_000  # of the file: each adds a second of processor time
LONGEST_S = 600.0  # of wall time: a drive may not answer


def structure_is_readable(path: Path) -> bool:
    """Whether HDF5 reads the structure of a file without an endless loop or a crash.

    An error that HDF5 reports counts as readable: opening the file raises it again. Raises OSError
    if there is no such file.
    """
    cpu_s = FIXED_CPU_S + path.stat().st_size // BYTES_A_CPU_S
    command = [sys.executable, "-P", __file__, str(path), str(cpu_s)]
    try:
        process = subprocess.run(command, capture_output=True, timeout=LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return False
    was_killed = process.returncode < 0  # by a signal: of the limit, or of a crash
    return not was_killed


def _limit_processor_time(seconds: int) -> None:
    """Let the system kill this process after ``seconds`` more of processor time.

    Windows has no such limit: there the function does nothing.
    """
    with suppress(ImportError):
        import resource

        used_s = math.ceil(time.process_time())
        limit_s = used_s + seconds
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))


def _read_structure(item: "h5py.Dataset | h5py.Group") -> None:
    """Read the attributes and dimensions of a dataset, or of everything within a group.

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
    """Run as a program: arguments are the file and the seconds of processor time allowed."""
    path, cpu_s = sys.argv[1:]
    import h5py

    _limit_processor_time(int(cpu_s))
    with h5py.File(path) as file:
        _read_structure(file)


if __name__ == "__main__":
    main()
