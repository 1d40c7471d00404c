"""Messages, and the ledger that holds them."""

import json

import pytest

from unbend.errors import Code, Counted
from unbend.messages import Kind, Ledger, Message, fallback, finding, loss, note, warning

MAKERS = {
    "note": note,
    "fallback": fallback,
    "warning": warning,
    "finding": finding,
    "loss": loss,
}


def code(name) -> Code:
    return Code(name, means="It happened.", effect="None.", remedy="Nothing.")


@pytest.mark.parametrize("kind", MAKERS)
def test_a_message_of_each_kind(kind):
    text = "{count} of {where}: {x:.1f}"
    message = MAKERS[kind](code("A-B"), text, where="there", count=3, x=2.0)
    expected = Message(
        kind=Kind(kind),
        code="A-B",
        text=text,
        where="there",
        count=3,
        values={"x": 2.0},
    )
    assert message == expected
    ledger = Ledger()
    ledger.add(message)
    assert list(ledger) == [message]
    assert ledger.has_losses == (kind in ("finding", "loss"))
    assert ledger.rows() == [
        {
            "kind": kind,
            "code": "A-B",
            "what": "3 of there: 2.0",
            "where": "there",
            "count": 3,
            "values": {"x": 2.0},
        }
    ]


def test_a_message_stands_once_in_the_order_of_its_coming_and_rows_are_sorted():
    b = warning(code("W-1"), "b")
    z = note(code("N-1"), "z")
    a = note(code("N-1"), "a")
    ledger = Ledger([b])
    assert ledger.take(("result", (z, b, a))) == "result"
    assert list(ledger) == [b, z, a]
    rows = [message.row() for message in (a, z, b)]
    assert ledger.rows() == rows
    assert len(ledger) == 3


@pytest.mark.parametrize(("count", "expected"), [(1, "1 row is lost"), (2, "2 rows are lost")])
def test_one_has_its_own_text(count, expected):
    lost = loss(code("A-B"), "{count} rows are lost", one="1 row is lost", count=count)
    assert lost.what == expected


@pytest.mark.parametrize("name", ["strip 1 frames", "line 1 images/log.bin", "{count}", "1 rows"])
def test_names_of_users_stay_as_they_are(name):
    message = note(code("A-B"), "{name!r} in {where}", where=name, name=name)
    assert message.what == f"{name!r} in {name}"


def test_a_counted_value_is_a_number_in_files():
    message = note(code("A-B"), "in {images}", images=Counted(1, "image"))
    assert message.what == "in 1 image"
    assert json.loads(json.dumps(message.row()))["values"] == {"images": 1}


def test_an_accepted_finding_says_why():
    ledger = Ledger([finding(code("A-B"), "odd"), finding(code("C-D"), "odder")])
    assert ledger.accept({"A-B": "a gorge", "E-F": "nothing"}) == ("E-F",)
    assert [(message.kind, message.what) for message in ledger] == [
        (Kind.WARNING, "odd (accepted: a gorge)"),
        (Kind.FINDING, "odder"),
    ]
