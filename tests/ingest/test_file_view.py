"""The window on a file: every byte where it is, whatever is asked for in which order."""

import random

import pytest

from tests.helpers import refused
from unbend.ingest import buffers
from unbend.ingest.buffers import open_view, view_of_bytes


@pytest.fixture(autouse=True)
def narrow(monkeypatch):
    monkeypatch.setattr(buffers, "SPAN", 64)
    monkeypatch.setattr(buffers, "BEHIND", 8)


def test_any_stretch_in_any_order():
    draw = random.Random(4)
    data = draw.randbytes(1000)
    view = view_of_bytes(data)
    for _ in range(500):
        begin = draw.randrange(1000)
        end = begin + draw.randrange(200)
        assert view[begin:end] == data[begin:end]


def test_a_mark_is_found_across_the_edges():
    draw = random.Random(5)
    for place in range(397):
        data = bytearray(400)
        data[place : place + 3] = b"abc"
        view = view_of_bytes(bytes(data))
        begin = draw.randrange(400)
        assert view.find(b"abc", begin) == data.find(b"abc", begin)
        assert view.find(b"abc", 0, place + 2) == -1


def test_a_file_that_was_cut_while_it_is_read(tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(bytes(1000))
    with open_view(path) as view:
        assert view[0:10] == bytes(10)
        path.write_bytes(bytes(500))
        with refused("LOG-CHANGED") as caught:
            view.array(400, 600)
    assert "1000 bytes" in caught.value.what


def test_a_file_that_grows_is_read_to_where_it_ended(tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(bytes(1000))
    with open_view(path) as view:
        with path.open("ab") as stream:
            stream.write(b"more")
        assert view[990:2000] == bytes(10)
        assert view.find(b"more", 0) == -1
