"""Publication: one winner, nothing partial to be seen, nothing left after cleaning."""

from __future__ import annotations

import hashlib
import json
import os
import random
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime, timedelta

import pytest

from tests.draws import SEED
from tests.helpers import refused
from unbend.batch import object_store as place_module
from unbend.batch import remote
from unbend.batch.remote import Publication, find_damage, read_manifest, rehearse, remove_leftovers
from unbend.batch.results import verify_run
from unbend.errors import OutputInUseError, StorageError
from unbend.tables.manifest.whole import Manifest

from .conftest import shift_clock

RACES = int(os.environ.get("UNBEND_RACES", "4"))


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def made(folder, run) -> Manifest:
    """Results of a run in a folder: files with its number in them, and their manifest."""
    outputs = []
    for name in ("observations/part-00000.parquet", "stations.parquet"):
        content = f"{run} {name}".encode() * 40
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        outputs.append({"name": name, "sha256": sha256(content), "bytes": len(content)})
    return Manifest(
        {
            "fingerprint": sha256(str(run).encode()),
            "mission": "m",
            "outputs": outputs,
            "exit_code": 0,
        }
    )


def publish(place, folder, run, together=lambda: None) -> Manifest | None:
    """Publish a run from a folder; None where it is refused because another was published."""
    manifest = made(folder, run)
    before = Publication(place, manifest.run.fingerprint)
    together()
    with suppress(OutputInUseError):
        return before.publish(folder, manifest, lambda size: None)
    return None


def expected_at(manifest):
    """The objects of a published run, and no others."""
    run = manifest.run
    files = {f"attempts/{run.attempt}/{item.name}" for item in run.outputs}
    return {"manifest.json", f"runs/{run.fingerprint}.json", *files}


def test_races_of_two_writers(place, tmp_path):
    draw = random.Random(SEED)
    for race in range(RACES):
        results = place / str(race)
        same = draw.random() < 0.5
        if draw.random() < 0.5:  # results of an earlier run are there
            publish(results, tmp_path / "earlier", 0)
        barrier = threading.Barrier(2)
        over = threading.Event()

        def look(results=results, over=over):
            seen = 0
            while not over.is_set() or not seen:
                if read_manifest(results) is not None:
                    verify_run(results)  # refuses what is not whole
                    seen += 1
            return seen

        def write(number, results=results, same=same, barrier=barrier) -> Manifest | None:
            return publish(results, tmp_path / str(number), 1 if same else number, barrier.wait)

        with ThreadPoolExecutor(3) as pool:
            reader = pool.submit(look)
            ends = list(pool.map(write, (1, 2)))
            over.set()
            assert reader.result() > 0
        (winner,) = {end.run.attempt: end for end in ends if end is not None}.values()
        assert ends.count(None) == (0 if same else 1), "one winner; of the same run both return it"
        assert read_manifest(results) == winner
        assert verify_run(results) == winner
        assert remove_leftovers(results, recent=True) == ([], 0)
        assert set(results.objects()) == expected_at(winner), "something is left of the loser"


class Killed(BaseException):
    """The process of a writer is gone: it does nothing more."""


def test_writers_killed_at_each_request(s3_place, tmp_path, monkeypatch):
    call_store = place_module.call_store
    number = 0
    while True:
        number += 1
        results = s3_place / str(number)
        left = number
        old = publish(results, tmp_path, 0)

        def counted(*arguments, **options):
            nonlocal left
            left -= 1
            if left <= 0:
                raise Killed
            return call_store(*arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(place_module, "call_store", counted)
            with suppress(Killed):
                publish(results, tmp_path, 1)
        seen = verify_run(results)
        assert seen == old or seen.run.fingerprint == made(tmp_path, 1).run.fingerprint
        monkeypatch.setattr(remote, "_WAIT_S", 0.0)
        now = publish(results, tmp_path, 1)
        assert verify_run(results) == now
        remove_leftovers(results, recent=True)
        assert set(results.objects()) == expected_at(now)
        if left > 0:
            break
    assert number > 12, "requests of a publication"


def test_a_slower_writer_of_the_same_run_does_not_try_to_publish_it(
    s3_place, tmp_path, monkeypatch
):
    """It returns the manifest of the faster writer as soon as that is there."""
    request = place_module.request
    manifests_put = []

    def noted(verb, place, function, *arguments, **options):
        if function == "put" and "manifest.json" in place.key:
            manifests_put.append(place.key)
        return request(verb, place, function, *arguments, **options)

    monkeypatch.setattr(place_module, "request", noted)
    monkeypatch.setattr(remote, "_WAIT_S", 2.0)
    manifest = made(tmp_path, 1)
    slower = Publication(s3_place, manifest.run.fingerprint)
    faster = publish(s3_place, tmp_path, 1)

    published = slower.publish(tmp_path, manifest, lambda size: None)

    assert published == faster
    assert len(manifests_put) == 1


@pytest.mark.parametrize("written", ["runs/", "manifest.json"])
def test_an_answer_that_is_lost(s3_place, tmp_path, monkeypatch, written):
    request = place_module.request

    def deaf(verb, place, function, *arguments, **options):
        answer = request(verb, place, function, *arguments, **options)
        if function == "put" and written in place.key:  # as the library tries again
            answer = request(verb, place, function, *arguments, **options)
        return answer

    monkeypatch.setattr(remote, "_WAIT_S", 0.0)
    monkeypatch.setattr(place_module, "request", deaf)
    done = publish(s3_place, tmp_path, 1)
    assert done is not None
    assert verify_run(s3_place) == done
    assert set(s3_place.objects()) == expected_at(done)


def test_orphans_of_the_last_hour_stay(s3_place, tmp_path, monkeypatch, unbend, obeyed):
    done = publish(s3_place / "one", tmp_path, 1)
    orphan = f"one/attempts/{'0' * 32}/observations/part-00000.parquet"
    files_of_others = {"one/attempts/mine.txt", "one/flight.bin", "one/runs/notes.json"}
    for name in (orphan, *files_of_others):
        assert (s3_place / name).put(b"x", None)
    everything = set(s3_place.objects())
    text = obeyed("verify", s3_place, "--remove-leftovers")
    assert text == "1 upload of the last hour kept: --recent also removes them\n"
    assert set(s3_place.objects()) == everything

    with monkeypatch.context() as patch:
        shift_clock(patch, timedelta(hours=2))
        ended = unbend("verify", s3_place, "--remove-leftovers", "--json")
    assert json.loads(ended.out) == {"removed": [f"{s3_place}/one/attempts/{'0' * 32}/"], "kept": 0}
    assert set(s3_place.objects()) == everything - {orphan}
    assert verify_run(s3_place / "one") == done
    text = obeyed("verify", s3_place, "--remove-leftovers")
    assert text == "nothing is left of interrupted runs\n"


def test_objects_of_other_programs_stay(s3_place, tmp_path, unbend):
    ours = made(tmp_path, 1)
    group = f"attempts/{'a' * 32}"
    run = f"one/runs/{ours.run.fingerprint}.json"
    removed = {run, f"one/{group}/stations.parquet", f"one/{group}/observations/part-00001.parquet"}
    files_of_others = {
        f"other/{group}/model.pkl",
        f"other/{group}/stations.parquet",
        f"mixed/{group}/report.html",
        f"mixed/{group}/observations/part-1.parquet",
        f"other/runs/{'b' * 64}.json",
        f"other/runs/{ours.run.fingerprint}.json",
    }
    for name in removed | files_of_others:
        assert (s3_place / name).put(b'{"fingerprint": "own"}', None)
    assert (s3_place / run).put(json.dumps(ours.values, indent=2).encode(), "overwrite")
    assert "2 uploads of the last hour kept" in unbend("verify", s3_place, "--remove-leftovers").out
    ended = unbend("verify", s3_place, "--remove-leftovers", "--recent", "--json")
    assert json.loads(ended.out)["kept"] == 0
    assert set(s3_place.objects()) == files_of_others


def test_a_manifest_that_leads_elsewhere_is_not_followed(s3_place, tmp_path):
    done = publish(s3_place, tmp_path, 1)
    for attempt in ("../../other", "", None):
        content = json.dumps({**done.values, "attempt": attempt}).encode()
        assert (s3_place / "manifest.json").put(content, "overwrite")
        with refused("MANIFEST-UNREADABLE"):
            read_manifest(s3_place)
        with pytest.raises(StorageError):
            remove_leftovers(s3_place, recent=True)
    assert set(s3_place.objects()) == expected_at(done)


def test_a_store_is_rehearsed(place):
    rehearse(place)
    rehearse(place, writes=True)
    assert place.objects() == {}


def test_what_lies_in_an_attempt_and_belongs_to_no_run(s3_place, tmp_path):
    done = publish(s3_place, tmp_path, 1)
    extra = s3_place / f"attempts/{done.run.attempt}/observations/part-00001.parquet"
    assert extra.put(b"x", None)
    damage = find_damage(s3_place, done, hash_all=False)
    assert damage == ["observations/part-00001.parquet: belongs to no run"]


class DatedPlace:
    """A store in memory: objects with the minutes since they were written."""

    def __init__(self, minutes):
        self.minutes = minutes

    def __str__(self):
        return "s3://bucket"

    def __truediv__(self, name) -> DatedPlace:
        return self

    def read(self):
        """No manifest is published here."""
        return None, None

    def objects(self):
        now = datetime.now(UTC)
        return {
            name: {"last_modified": now - timedelta(minutes=minutes)}
            for name, minutes in self.minutes.items()
        }

    def remove(self, names):
        for name in names:
            del self.minutes[name]


def test_leftovers_of_the_last_hour_stay_because_their_run_may_go_on():
    young, old, renewed = (f"attempts/{digit * 32}/" for digit in "abc")
    place = DatedPlace(
        {
            f"{young}stations.parquet": 59.0,
            f"{old}stations.parquet": 61.0,
            # the newest object of an attempt counts
            f"{renewed}stations.parquet": 300.0,
            f"{renewed}report.html": 2.0,
        }
    )
    assert remove_leftovers(place) == ([f"s3://bucket/{old}"], 2)
    assert len(place.minutes) == 3
    _, remaining = remove_leftovers(place, recent=True)
    assert remaining == 0
    assert place.minutes == {}
