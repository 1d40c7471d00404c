"""Object storage that accepts a connection and then says nothing, or half of an answer."""

import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager, suppress
from functools import partial

import pytest

from tests.helpers import refused
from unbend.batch import object_store, remote
from unbend.batch.object_store import Place
from unbend.batch.remote import RemoteInput, fetch, read_manifest
from unbend.errors import UnbendError

from .conftest import S3, environment_of


@contextmanager
def accepting(answer=b""):
    """A store that accepts each connection and says no more than a part of an answer, or nothing.

    After it the connections are closed.
    """
    connections = []
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(50)

        def serve():
            with suppress(OSError):  # closed
                while True:
                    connection, _ = listening.accept()
                    connections.append(connection)
                    if answer:
                        connection.recv(1 << 16)  # the question comes first
                        connection.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        listening.shutdown(socket.SHUT_RDWR)
    for connection in connections:
        connection.close()


HALF = (
    b'HTTP/1.1 206 Partial Content\r\nETag: "1"\r\nContent-Length: 1000\r\n'
    b"Last-Modified: Mon, 23 Nov 2026 01:00:00 GMT\r\nContent-Range: bytes 0-999/1000\r\n\r\n"
) + b"x" * 400


@pytest.fixture
def impatient(monkeypatch):
    """Waits for a fifth of a second, and tries nothing again."""
    monkeypatch.setattr(object_store, "SILENCE_S", 0.2)
    monkeypatch.setattr(object_store, "REQUEST_S", 0.4)
    monkeypatch.setattr(object_store, "RETRY_S", 0.0)


@pytest.mark.parametrize("scheme", ["s3", "az"])
def test_a_store_that_accepts_and_says_nothing(use, impatient, scheme, tmp_path, monkeypatch):
    file = tmp_path / "stations.parquet"
    file.write_bytes(b"x" * 1000)
    with accepting() as url:
        asked = count_requests(monkeypatch)
        use(environment_of(scheme, url))
        place = Place.of(f"{scheme}://season/a")
        host = url.removeprefix("http://")
        for verb, call in (
            ("read", place.read),
            ("read", place.head),
            ("read", lambda: list(place.blocks())),
            ("list", place.objects),
            ("write", lambda: place.put(b"", None)),
            ("write", lambda: place.put(file, "overwrite")),
            ("write", lambda: remote.rehearse(place)),
            ("delete", lambda: place.remove(["b"])),
        ):
            began_s = time.monotonic()
            error = silence(call)
            assert time.monotonic() - began_s < 30.0, "it waits for 60 s where it may"
            sentence = rf"{host} has not answered within \d+ s: request to {verb} it"
            assert re.fullmatch(sentence, error.what)
            assert error.where.startswith(str(place))
        assert asked.count("head") == 2
        assert asked.count("get") == 1, "who hears nothing is not asked again in another way"


def count_requests(monkeypatch):
    """The functions of obstore that are called from now on."""
    asked = []
    original = object_store.request

    def request(verb, place, function, *arguments, **options):
        asked.append(function)
        return original(verb, place, function, *arguments, **options)

    monkeypatch.setattr(object_store, "request", request)
    return asked


def silence(call: Callable[[], object]) -> UnbendError:
    """The refusal of a store that does not answer; it may name the host."""
    with refused("CLOUD-SILENT") as refusal:
        call()
    assert S3["AWS_SECRET_ACCESS_KEY"] not in str(refusal.value)
    return refusal.value


def test_a_store_that_says_half_and_stops(use, impatient):
    with accepting(HALF) as url:
        use(environment_of("s3", url))
        place = Place.of("s3://season/a")
        remote_input = RemoteInput(place, version="1", size_bytes=1000, mtime_ns=0)
        calls = (
            place.read,
            place.objects,
            partial(fetch, remote_input),
            partial(read_manifest, place),
        )
        for call in calls:
            assert "has not answered within" in silence(call).what
        assert not remote_input.copy.exists()


def test_ctrl_c_is_heard_while_a_store_is_silent(use):
    """A request waits in Rust, where Python hears no signal."""
    # A shell that starts the tests in the background leaves SIGINT ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with accepting() as url:
        use(environment_of("s3", url))
        pressed = threading.Timer(0.3, os.kill, [os.getpid(), signal.SIGINT])
        pressed.start()
        began_s = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            Place.of("s3://season/a").read()
        assert time.monotonic() - began_s < 30.0


def test_clearing_away_has_a_limit(use, monkeypatch):
    monkeypatch.setattr(remote, "_CLEARING_S", 0.1)
    with accepting() as url:
        use(environment_of("s3", url))
        place = Place.of("s3://season/a")
        began_s = time.monotonic()
        remote.try_to_remove(lambda: place.remove(["b"]))
        assert time.monotonic() - began_s < 30.0
