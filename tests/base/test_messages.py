"""The ledger and its entries."""

from __future__ import annotations

import pytest

from unbend.messages import Entry, Kind, Ledger, fallback, loss, note, warning

MAKERS = {"note": note, "fallback": fallback, "warning": warning, "loss": loss}


@pytest.mark.parametrize("kind", MAKERS)
def test_an_entry_of_each_kind_by_function_and_by_method(kind):
    entry = MAKERS[kind]("A-B", "what", where="there", count=3)
    assert entry == Entry(Kind(kind), "A-B", "what", "there", 3)
    ledger = Ledger()
    getattr(ledger, kind)("A-B", "what", where="there", count=3)
    assert list(ledger) == [entry]
    assert ledger.has_losses == (kind == "loss")
    assert ledger.rows() == [
        {"kind": kind, "code": "A-B", "what": "what", "where": "there", "count": 3, "values": {}}
    ]


def test_an_entry_stands_once_in_the_order_of_its_coming_and_rows_are_sorted():
    ledger = Ledger([warning("W-1", "b")])
    result = ledger.take(("result", (note("N-1", "z"), warning("W-1", "b"), note("N-1", "a"))))
    assert result == "result"
    assert [entry.what for entry in ledger] == ["b", "z", "a"]
    assert [(row["kind"], row["what"]) for row in ledger.rows()] == [
        ("note", "a"), ("note", "z"), ("warning", "b")
    ]  # fmt: skip
    assert len(ledger) == 3
