"""Every cell of every telemetry log at hand, bit for bit as pymavlink decodes it."""

from collections import defaultdict

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.logs import REAL, with_suffix
from unbend.ingest import open_log

LOGS = with_suffix(".tlog")


def library_messages(path):
    """All messages by type, read one by one; ids that the dialect does not know are left out."""
    from pymavlink import mavutil

    reader = mavutil.mavlink_connection(str(path), dialect="all")
    rows = defaultdict(list)
    while (row := reader.recv_msg()) is not None:
        name = row.get_type()
        if name != "BAD_DATA" and not name.startswith("UNKNOWN"):
            rows[name].append(row)
    reader.close()
    return rows


def test_logs_are_at_hand():
    assert any(path.parent.name == "sample_logs" for path in LOGS)
    assert len(LOGS) >= (8 if REAL.is_dir() else 4)


@pytest.mark.parametrize(
    "path",
    LOGS,
    ids=lambda path: path.name,
)
def test_every_cell_is_the_librarys(path, head, monkeypatch, record_property):
    monkeypatch.setenv("MAVLINK20", "1")  # so that the library knows the fields of MAVLink 2
    path = head(path, 2_200_000)
    log = open_log(path)
    expected = library_messages(path)
    for name, count in log.message_types().items():
        assert name.startswith("UNKNOWN") or count == len(expected[name])
    cells = 0
    for name, rows in expected.items():
        table = log.message(name)
        headers = [row.get_header() for row in rows]
        fields = rows[0].get_fieldnames()
        assert [*table] == ["time_ns", "boot", "system", "component", *fields]
        assert table["system"].tolist() == [header.srcSystem for header in headers]
        assert table["component"].tolist() == [header.srcComponent for header in headers]
        assert table["time_ns"].dtype == np.int64
        for field in fields:
            ours = table[field]
            theirs = np.array([getattr(row, field) for row in rows])
            if theirs.dtype.kind == "U":
                assert ours.tolist() == theirs.tolist(), f"{name}.{field}"
            else:  # the library widens; nothing is rounded on the way
                widened = theirs.astype(ours.dtype)
                assert_array_equal(
                    ours,
                    widened,
                    f"{name}.{field}",
                    strict=True,
                )
            cells += ours.size
    assert cells > (100_000 if path.stat().st_size > 1_000_000 else 10_000)
    record_property("cells compared", cells)
