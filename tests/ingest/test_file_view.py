"""The window on a file: every byte where it is, whatever is asked for in which order."""

from __future__ import annotations

import random

import pytest

from unbend.errors import LogError
from unbend.ingest import buffers as window
from unbend.ingest.buffers import open_view, view_of_bytes


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(window, "SPAN", 64)
    monkeypatch.setattr(window, "BEHIND", 8)


def test_any_stretch_in_any_order():
    draw = random.Random(4)
    data = draw.randbytes(1000)
    seen = view_of_bytes(data)
    for _ in range(2000):
        begin = draw.randrange(1000)
        end = begin + draw.randrange(200)
        assert seen[begin:end] == data[begin:end]


def test_a_mark_is_found_across_the_edges():
    draw = random.Random(5)
    for _ in range(300):
        data = bytearray(400)
        at = draw.randrange(397)
        data[at : at + 3] = b"abc"
        begin = draw.randrange(400)
        assert view_of_bytes(bytes(data)).find(b"abc", begin) == bytes(data).find(b"abc", begin)
        assert view_of_bytes(bytes(data)).find(b"abc", 0, at + 2) == -1


def test_a_file_that_was_cut_while_it_is_read(tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(bytes(1000))
    with open_view(path) as seen:
        assert seen[0:10] == bytes(10)
        path.write_bytes(bytes(500))
        with pytest.raises(LogError) as caught:
            seen.array(400, 600)
    assert caught.value.code == "LOG-CHANGED"
    assert "1000 bytes" in caught.value.what


def test_a_file_that_grows_is_read_to_where_it_ended(tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(bytes(1000))
    with open_view(path) as seen:
        with path.open("ab") as stream:
            stream.write(b"more")
        assert seen[990:2000] == bytes(10)
        assert seen.find(b"more", 0) == -1
