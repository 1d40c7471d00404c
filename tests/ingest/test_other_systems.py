"""Reading logs where functions of POSIX do not exist, as on Windows."""

import os
import subprocess
import sys

import pytest

from tests.logs import LOGS

# Removed before anything of the package is imported; what Windows lacks of the modules in use.
WITHOUT_POSIX = """
import mmap, os, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
for module, names in (
    (os, "register_at_fork fork posix_fallocate sched_getaffinity O_TMPFILE memfd_create getuid"),
    (mmap, "MADV_DONTNEED MAP_PRIVATE MAP_SHARED MAP_ANONYMOUS MAP_ANON PROT_READ PROT_WRITE"),
):
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
"""
READ = """
import hashlib
from unbend.ingest import buffers, open_log
buffers.PRIVATE, buffers.REGION, buffers.SMALL = {private}, 1 << 16, 1
log = open_log(sys.argv[1])
digest = hashlib.sha256()
for channel in log.channels:
    digest.update(channel.time_ns)
    for name in sorted(channel.columns):
        digest.update(channel[name].tobytes())
buffers.release_pages()
print(len(buffers._ARENA.regions) > 0, digest.hexdigest())
"""


def read(code, log, folder):
    """What a new process prints that reads a log, with its temporary files in a folder."""
    environment = dict(os.environ) | {"TMPDIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", code, str(log)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize("suffix", [".bin", ".tlog", ".mcap"])
def test_a_log_is_the_same_without_functions_of_posix(tmp_path, suffix):
    log = LOGS[f"flight{suffix}"]
    _, usual = read("import sys" + READ.format(private=1 << 30), log, tmp_path)
    in_files, digest = read(WITHOUT_POSIX + READ.format(private=0), log, tmp_path)
    assert digest == usual
    assert in_files == "True"
    assert not list(tmp_path.iterdir())
