"""Information of Linux on other processes: whether one is suspended, and which has a lock."""

import os
from pathlib import Path

LOCKS = Path("/proc/locks")


def is_suspended(process: int | None) -> bool:
    """Whether a process is suspended (SIGSTOP); False if the system does not say.

    ``process`` is its number (PID). A suspended process neither works nor ends until it is resumed.
    """
    try:
        status = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    # "number (name) state ...", where the name may contain blanks and parentheses; T: suspended
    return status.rpartition(")")[2].split()[0] == "T"


def holder_of(lock: Path) -> int | None:
    """The number of the process on this machine that holds the lock of a file; None if unknown."""
    try:
        stat = os.stat(lock)
        lines = LOCKS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    locked_inode = f"{os.major(stat.st_dev):02x}:{os.minor(stat.st_dev):02x}:{stat.st_ino}"
    for line in lines:
        # "1: FLOCK ADVISORY WRITE 19362 fe:00:3334716 0 EOF"; "1: -> FLOCK ..." if it only waits
        fields = line.split()
        kind = fields[1]
        process = fields[4]
        inode = fields[5]
        if kind == "FLOCK" and inode == locked_inode:
            return int(process)
    return None


def holder_in_words(lock: Path) -> str:
    """The process that holds the lock of a file, in words for a message."""
    process = holder_of(lock)
    if process is None:
        return "a process that is unknown on this machine, perhaps of another machine,"
    if is_suspended(process):
        return f"process {process}, which is stopped,"
    return f"process {process}"
