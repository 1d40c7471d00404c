"""Every cell of every telemetry log at hand, bit for bit as pymavlink decodes it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.logs import REAL, with_suffix
from unbend.ingest import open_log

LOGS = with_suffix(".tlog")


def library_messages(path: Path) -> dict[str, list]:
    """All messages by type, read one by one; ids that the dialect does not know are left out."""
    from pymavlink import mavutil

    reader = mavutil.mavlink_connection(str(path), dialect="all")
    rows = defaultdict(list)
    while (row := reader.recv_msg()) is not None:
        if row.get_type() != "BAD_DATA" and not row.get_type().startswith("UNKNOWN"):
            rows[row.get_type()].append(row)
    reader.close()
    return rows


def test_logs_are_at_hand() -> None:
    assert any(path.parent.name == "sample_logs" for path in LOGS)
    assert len(LOGS) >= (8 if REAL.is_dir() else 4)


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name)
def test_every_cell_is_the_librarys(
    path: Path,
    head: Callable[[Path, int], Path],
    monkeypatch: pytest.MonkeyPatch,
    record_property: Callable[[str, object], None],
) -> None:
    monkeypatch.setenv("MAVLINK20", "1")  # so that the library knows the fields of MAVLink 2
    path = head(path, 2_200_000)
    log = open_log(path)
    expected = library_messages(path)
    known = {name: n for name, n in log.message_types().items() if not name.startswith("UNKNOWN")}
    assert known == {name: len(rows) for name, rows in expected.items()}
    cells = columns = 0
    for name, rows in expected.items():
        table = log.message(name)
        header = [row.get_header() for row in rows]
        assert table["system"].tolist() == [head.srcSystem for head in header]
        assert table["component"].tolist() == [head.srcComponent for head in header]
        assert table["time_ns"].dtype == np.int64
        assert [*table][4:] == rows[0].get_fieldnames()
        for field in rows[0].get_fieldnames():
            ours = table[field]
            theirs = np.array([getattr(row, field) for row in rows])
            if theirs.dtype.kind == "U":
                assert ours.tolist() == theirs.tolist(), f"{name}.{field}"
            else:  # the library widens; nothing is rounded on the way
                theirs = theirs.astype(ours.dtype)
                same = ours.shape == theirs.shape and ours.tobytes() == theirs.tobytes()
                assert same or np.array_equal(ours, theirs, equal_nan=True), f"{name}.{field}"
            cells += ours.size
            columns += 1
    assert cells > (100_000 if path.stat().st_size > 1_000_000 else 10_000)
    record_property("cells compared", cells)
    print(f"{path.name}: {cells} cells of {columns} columns, all bit-equal")
