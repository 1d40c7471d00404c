"""Stores that speak S3 and Azure's protocol, on this machine; each starts when a test needs it."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

import pytest

from unbend.batch import remote
from unbend.batch.object_store import Place, open_store

pytest.importorskip("obstore")

PREFIXES = "AWS_", "AZURE_", "AZURITE_", "GOOGLE_"
S3 = {
    "AWS_ACCESS_KEY_ID": "writer",
    "AWS_SECRET_ACCESS_KEY": "not-to-be-printed",
    "AWS_REGION": "us-east-1",
    "AWS_ALLOW_HTTP": "true",
}
READER = {"AWS_ACCESS_KEY_ID": "reader", "AWS_SECRET_ACCESS_KEY": "not-to-be-printed"}


def free_port():
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        return int(held.getsockname()[1])


@contextmanager
def serving(command, port, folder):
    """A server, from its first answer to the end of the block; skips where it cannot be started."""
    log = folder / "log.txt"
    with log.open("wb") as file:
        try:
            process = subprocess.Popen(command, stdout=file, stderr=file, cwd=folder)
        except OSError as error:
            pytest.skip(f"{command[0]} cannot run: {error}")
    try:
        deadline = time.monotonic() + 60.0
        while True:
            try:
                urlopen(f"http://127.0.0.1:{port}/", timeout=5)
            except HTTPError:
                break
            except (URLError, OSError):
                if process.poll() is not None or time.monotonic() > deadline:
                    pytest.fail(f"{command[0]} does not answer: {log.read_text()[-500:]}")
                time.sleep(0.05)
            else:
                break
        yield
    finally:
        process.kill()
        process.wait()


def in_environment(name):
    """A program of the environment of the tests, or of the PATH; skips where it is not there."""
    beside = shutil.which(name, path=str(Path(sys.executable).parent))
    return beside or shutil.which(name) or pytest.skip(f"{name} is not installed")


@pytest.fixture(scope="session")
def seaweed(tmp_path_factory):
    """SeaweedFS, with a user who may write and one who may read."""
    folder = tmp_path_factory.mktemp("seaweed")
    rights = {"writer": ["Admin", "Read", "Write", "List"], "reader": ["Read", "List"]}
    users = []
    for name, actions in rights.items():
        key = {"accessKey": name, "secretKey": S3["AWS_SECRET_ACCESS_KEY"]}
        users.append({"name": name, "actions": actions, "credentials": [key]})
    (folder / "s3.json").write_text(json.dumps({"identities": users}))
    servers = ("master", "volume", "filer", "s3")
    names = [f"{server}.{kind}" for server in servers for kind in ("port", "port.grpc")]
    ports = {name: free_port() for name in names}
    command = [
        in_environment("weed"),
        "server",
        f"-dir={folder}",
        "-ip=127.0.0.1",
        "-ip.bind=127.0.0.1",
        "-s3",
        "-s3.config=s3.json",
        "-s3.port.iceberg=0",
        "-s3.port.lance=0",
        f"-filer.localSocket={folder}/filer.sock",
        f"-s3.localSocket={folder}/s3.sock",
        "-master.volumeSizeLimitMB=64",
        "-volume.max=20",
    ]
    command += [f"-{name}={port}" for name, port in ports.items()]
    with serving(command, ports["s3.port"], folder):
        yield environment_of("s3", f"http://127.0.0.1:{ports['s3.port']}")
    for port in ports.values():  # of gRPC, which it puts there
        for left in Path("/tmp").glob(f"seaweedfs-*-{port}.sock"):
            left.unlink()


@pytest.fixture(scope="session")
def moto(tmp_path_factory):
    """Moto's server of S3."""
    port = free_port()
    command = [in_environment("moto_server"), "-p", str(port)]
    with serving(command, port, tmp_path_factory.mktemp("moto")):
        yield environment_of("s3", f"http://127.0.0.1:{port}")


@pytest.fixture(scope="session")
def azurite(tmp_path_factory):
    """Azurite, Azure's emulator: from npm, in the folder UNBEND_AZURITE or on the PATH."""
    folder = tmp_path_factory.mktemp("azurite")
    installed = Path(os.environ.get("UNBEND_AZURITE", "none")) / "node_modules/.bin/azurite-blob"
    program = str(installed) if installed.exists() else in_environment("azurite-blob")
    port = free_port()
    options = ["--location", str(folder), "--blobPort", str(port)]
    command = [program, *options, "--silent", "--skipApiVersionCheck"]
    with serving(command, port, folder):
        yield environment_of("az", f"http://127.0.0.1:{port}")


@pytest.fixture
def use(monkeypatch, tmp_path):
    """Makes the environment that of a store; the cache is the test's own."""

    def set_environment(variables):
        for name in [name for name in os.environ if name.startswith(PREFIXES)]:
            monkeypatch.delenv(name)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        open_store.cache_clear()

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    yield set_environment
    open_store.cache_clear()


MADE = set()


def make_bucket(environment, name):
    """Make a bucket or container by the protocol itself: obstore makes none."""
    endpoint = environment.get("AWS_ENDPOINT_URL")
    if endpoint is not None:
        import boto3

        client = boto3.client(
            "s3",
            endpoint_url=endpoint,
            region_name="us-east-1",
            aws_access_key_id="writer",
            aws_secret_access_key=S3["AWS_SECRET_ACCESS_KEY"],
        )
        client.create_bucket(Bucket=name)
        return
    from base64 import b64decode, b64encode
    from email.utils import formatdate
    from hashlib import sha256
    from hmac import new
    from urllib.request import Request

    # Azurite's account and its key are public: they are the same everywhere.
    account = "devstoreaccount1"
    key = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="
    date = formatdate(usegmt=True)
    text = "PUT" + "\n" * 12 + f"x-ms-date:{date}\nx-ms-version:2021-08-06\n"
    text += f"/{account}/{account}/{name}\nrestype:container"
    signature = b64encode(new(b64decode(key), text.encode(), sha256).digest()).decode()
    headers = {
        "x-ms-date": date,
        "x-ms-version": "2021-08-06",
        "Content-Length": "0",
        "Authorization": f"SharedKey {account}:{signature}",
    }
    url = f"{environment['AZURITE_BLOB_STORAGE_URL']}/{account}/{name}?restype=container"
    urlopen(Request(url, method="PUT", headers=headers), timeout=30)


def shift_clock(patch, difference):
    """Let the clock of this machine be ahead of that of the stores."""

    class Shifted(remote.datetime):
        @classmethod
        def now(cls, zone=None):
            return super().now(zone) + difference

    patch.setattr(remote, "datetime", Shifted)


def environment_of(scheme, url):
    """The environment that leads to a store at a URL, which speaks S3 or Azure's protocol."""
    if scheme == "s3":
        return S3 | {"AWS_ENDPOINT_URL": url}
    return {"AZURE_STORAGE_USE_EMULATOR": "true", "AZURITE_BLOB_STORAGE_URL": url}


@pytest.fixture(params=["seaweed", "moto", "azurite"])
def place(request, use) -> Place:
    """An empty place in each store, which the environment leads to."""
    return place_in(request, request.param, use)


@pytest.fixture
def s3_place(request, use) -> Place:
    """An empty place in SeaweedFS, which the environment leads to."""
    return place_in(request, "seaweed", use)


def place_in(request, store, use: Callable[..., None]) -> Place:
    environment = request.getfixturevalue(store)
    use(environment)
    if store not in MADE:
        make_bucket(environment, "season")
        MADE.add(store)
    scheme = "az" if store == "azurite" else "s3"
    return Place.of(f"{scheme}://season/{request.node.name.replace('[', '-').strip(']')}")
