"""URLs, and what a store refuses: by name, before any work, without a secret."""

import os
import sys
import threading
from contextlib import contextmanager
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.helpers import refused
from unbend.batch import remote, runs
from unbend.batch.object_store import Place, is_url, open_store
from unbend.batch.plan import located
from unbend.batch.remote import RemoteInput, fetch, look_up, read_manifest
from unbend.errors import UnbendError

from .conftest import READER, S3, environment_of, free_port, shift_clock

SECRET = "hunter2"


@pytest.mark.parametrize(
    "url",
    [
        f"s3://me:{SECRET}@bucket/key",
        f"az://container/key?sv=1&sig={SECRET}",
        f"s3://bucket/key#{SECRET}",
        f"s3://{SECRET}@bucket",
        f"https://x/y?X-Amz-Signature={SECRET}",
        f"s3://bucket?{SECRET}",
        f"S3://bucket/?{SECRET}",
    ],
)
def test_secrets_in_a_url_are_refused_and_not_repeated(url, mission):
    results = mission.output
    for key in ("log", "observations", "output"):
        section = mission.config[key]
        mission.config[key] = section | {"path": url}
        ended = mission.run()
        mission.config[key] = section
        assert ended.code == 2
        assert "URL-INVALID" in ended.err
        assert SECRET not in ended.text
    assert not results.exists()


@pytest.mark.parametrize(
    "url",
    [
        "s3://bucket/../other",
        "s3://bucket/a/../../b",
        "s3://bucket/./a",
        "s3://bucket//a",
        "s3://bucket/a//b",
        "s3://bucket/a\\..\\b",
        "s3://bucket/a\n",
        "s3:///key",
        "s3://",
        "s3:/b/k",
        "s3://../key",
        "s3://Bucket/key",
        "S3://bucket/key",
        "gcs://bucket/key",
        "file:///etc/passwd",
        "http://bucket/key",
        "s3://bucket:80/key",
        "s3://bucket/a\x00",
    ],
)
def test_what_is_no_url_of_object_storage(url):
    assert is_url(url)
    with refused("URL-INVALID"):
        located(url)


def test_keys_are_taken_as_they_are(s3_place):
    for name in ("x y", "x%20y", "ü", "a+b=c&d", "~", "CON", "a:b", "%2e%2e"):
        place = Place.of(f"{s3_place}/{name}")
        assert str(place) == f"{s3_place}/{name}"
        assert place.put(name.encode(), None)
        assert place.read()[0] == name.encode()
        assert fetch(look_up(place)).read_bytes() == name.encode()
        assert set(s3_place.objects()) == {name}
        s3_place.remove([name])


CONTENTS = {"cameras.txt": b"1", "0/images.txt": b"2", "empty": b""}


def test_the_folder_of_an_input(place):
    folder = Place.of(f"{place}/sparse/")
    assert folder.is_folder
    with pytest.raises(FileNotFoundError):
        look_up(folder)
    for name, content in CONTENTS.items():
        assert (folder / name).put(content, None)
    looked_up = look_up(folder)
    copy = fetch(looked_up)
    assert copy.name == "sparse"
    for name, content in CONTENTS.items():
        assert (copy / name).read_bytes() == content
    assert sum(path.is_file() for path in copy.rglob("*")) == len(CONTENTS)
    assert (folder / "cameras.txt").put(b"3", "overwrite")
    with refused("INPUT-CHANGED"):
        fetch(looked_up, anew=True)
    assert look_up(folder).version != looked_up.version


def test_copies_beyond_the_bound_go_the_oldest_first(s3_place, monkeypatch):
    monkeypatch.setattr(remote, "_MOST_BYTES", 250)
    paths = []
    for number in range(5):
        place = s3_place / str(number)
        assert place.put(b"x" * 100, None)
        path = fetch(look_up(place))
        os.utime(path.parent, (number, number))
        paths.append(path)
        newest = paths[-2:]
        assert [path for path in paths if path.exists()] == newest


def test_an_object_that_goes_while_it_is_copied(s3_place, monkeypatch):
    assert s3_place.put(b"x", None)
    remote_input = look_up(s3_place)
    blocks = Place.blocks

    def blocks_of_nothing(place):
        place.remove([""])
        return blocks(place)

    monkeypatch.setattr(Place, "blocks", blocks_of_nothing)
    assert refusal(fetch, remote_input).code == "INPUT-CHANGED"


def refusal(call, *arguments, **options) -> UnbendError:
    with pytest.raises(UnbendError) as caught:
        call(*arguments, **options)
    text = str(caught.value)
    assert S3["AWS_SECRET_ACCESS_KEY"] not in text
    assert "http" not in text
    return caught.value


def test_a_bucket_that_is_not_there(place):
    elsewhere = Place(place.scheme, "no-such-bucket", "a")
    for call in (elsewhere.read, elsewhere.head, elsewhere.objects):
        assert refusal(call).code == "CLOUD-BUCKET"


def test_credentials_that_may_not_write_are_refused_before_any_work(
    s3_place, use, seaweed, mission, monkeypatch
):
    use(seaweed | READER)
    for writes in (False, True):
        error = refusal(remote.rehearse, s3_place, writes=writes)
        assert error.code == "CLOUD-DENIED"
        assert "write" in error.what
    mission.config["output"]["path"] = str(s3_place / "results")
    monkeypatch.setattr(runs, "prepare", lambda *_: pytest.fail("work was done"))
    mission.refusal("CLOUD-DENIED", exit_code=5)
    assert s3_place.objects() == {}


def test_credentials_that_are_wrong_or_not_there(s3_place, use, seaweed, mission, refusal_of):
    use(seaweed | {"AWS_SECRET_ACCESS_KEY": "another"})
    assert refusal(s3_place.read).code == "CLOUD-CREDENTIALS"
    nowhere = f"http://127.0.0.1:{free_port()}"
    use({"AWS_METADATA_ENDPOINT": nowhere, "AWS_ALLOW_HTTP": "true"})
    error = refusal(s3_place.read)
    assert error.code == "CLOUD-CREDENTIALS"
    assert "there are no credentials for s3://" in error.what
    use({})
    assert "there are no credentials for az://" in refusal(Place.of("az://season/a").read).what
    mission.config["output"]["path"] = "az://season/results"
    refusal_of("CLOUD-CREDENTIALS", 5, "run", mission.save())


def test_a_store_that_is_not_there(s3_place, use, seaweed):
    use(seaweed | {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{free_port()}"})
    assert refusal(s3_place.read).code == "CLOUD-FAILED"


def test_a_clock_that_is_off(s3_place, monkeypatch):
    shift_clock(monkeypatch, timedelta(minutes=-20))
    assert refusal(remote.rehearse, s3_place, writes=True).code == "CLOUD-CLOCK"
    assert s3_place.objects() == {}


def test_the_extra_is_not_installed(monkeypatch, mission):
    monkeypatch.setitem(sys.modules, "obstore", None)
    open_store.cache_clear()
    mission.config["log"]["path"] = "s3://season/flight.bin"
    assert "unbend[cloud]" in mission.refusal("CLOUD-EXTRA", exit_code=2)


@contextmanager
def answering(status, body, headers):
    """A store that has one answer to all that it is asked."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.rfile.read(int(self.headers.get("Content-Length") or 0))
            self.send_response(status)
            for name, value in ({"Content-Length": str(len(body))} | headers).items():
                self.send_header(name, value)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(body)
            self.close_connection = True

        do_PUT = do_HEAD = do_DELETE = do_POST = do_GET  # noqa: N815

        def log_message(self, *_):
            """Nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


SKEWED = (
    b"<Error><Code>RequestTimeTooSkewed</Code><Message>The difference between the request time and "
    b"the current time is too large.</Message></Error>"
)
AZURE_SKEWED = (
    b"<Error><Code>AuthenticationFailed</Code><Message>Server failed to authenticate the request."
    b"</Message><AuthenticationErrorDetail>Request date header too old: 'Mon, 23 Nov 2026 01:00:00 "
    b"GMT'</AuthenticationErrorDetail></Error>"
)
DENIED = b"<Error><Code>AccessDenied</Code><Message>Access Denied</Message></Error>"


@pytest.mark.parametrize(
    ("scheme", "status", "body", "code"),
    [
        ("s3", 403, SKEWED, "CLOUD-CLOCK"),
        ("az", 403, AZURE_SKEWED, "CLOUD-CLOCK"),
        ("s3", 403, DENIED, "CLOUD-DENIED"),
        ("s3", 403, b"", "CLOUD-DENIED"),
        ("s3", 418, b"", "CLOUD-FAILED"),
        ("s3", 301, b"<Error><Code>PermanentRedirect</Code></Error>", "CLOUD-BUCKET"),
    ],
)
def test_answers_of_a_store(use, scheme, status, body, code):
    with answering(status, body, {}) as url:
        use(environment_of(scheme, url))
        place = Place.of(f"{scheme}://season/a")
        for call in (place.read, place.head, place.objects, lambda: place.put(b"", None)):
            assert refusal(call).code == code


def test_a_store_that_overwrites_in_spite_of_a_condition(use):
    with answering(200, b"", {"ETag": '"1"'}) as url:
        use(environment_of("s3", url))
        assert refusal(remote.rehearse, Place.of("s3://season/a")).code == "CLOUD-UNCONDITIONAL"


def test_a_download_that_is_cut_off(use, tmp_path):
    headers = {
        "ETag": '"1"',
        "Last-Modified": "Mon, 23 Nov 2026 01:00:00 GMT",
        "Content-Length": "1000",
        "Content-Range": "bytes 0-999/1000",
    }
    with answering(206, b"x" * 400, headers) as url:
        use(environment_of("s3", url))
        place = Place.of("s3://season/a")
        remote_input = RemoteInput(place, version="1", size_bytes=1000, mtime_ns=0)
        assert refusal(fetch, remote_input).code == "CLOUD-FAILED"
        assert refusal(read_manifest, place).code == "CLOUD-FAILED"
        assert not remote_input.copy.exists()
        assert list((tmp_path / "cache/unbend/copies").iterdir()) == []
