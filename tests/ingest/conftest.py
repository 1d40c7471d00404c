"""Logs from bytes, and real logs from beside the repository, whole or the beginnings of them."""

import os
from functools import partial

import pytest

from tests.ingest import written_logs
from tests.logs import REAL

SUFFIXES = {"dataflash": ".bin", "mcap": ".mcap", "tlog": ".tlog", "ulog": ".ulg"}


@pytest.fixture
def opened(request, tmp_path):
    """Opens bytes as a log of the format that the folder of the test is named after."""
    suffix = SUFFIXES[request.path.parent.name]
    return partial(written_logs.opened, tmp_path / f"flight{suffix}")


@pytest.fixture
def real_log():
    """The path of a log in ../shared/logs, or a skip."""

    def find(name):
        path = REAL / name
        if not path.is_file():
            pytest.skip(f"{path} is not there: real logs live beside the repository")
        return path

    return find


@pytest.fixture
def head(tmp_path_factory):
    """A log, or a copy of its first bytes; all of it with UNBEND_WHOLE_LOGS, as in `make faults`.

    The libraries take a minute for the logs of 20 MB, whose messages have all begun by then.
    """

    def cut(path, size):
        if "UNBEND_WHOLE_LOGS" in os.environ or path.stat().st_size <= size:
            return path
        copy = tmp_path_factory.mktemp("head") / path.name
        with path.open("rb") as whole:
            copy.write_bytes(whole.read(size))
        return copy

    return cut
