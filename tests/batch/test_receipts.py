"""Receipts of parts: values and nothing that runs."""

from unbend.batch.receipts import packed, unpacked
from unbend.messages import Kind, Ledger


class Attribute:
    """Written as Python before 3.11.4 writes members of enumerations."""

    def __init__(self, owner, name):
        self.words = owner, name

    def __reduce__(self):
        return getattr, self.words


def test_members_of_enumerations_are_read_as_older_pythons_wrote_them():
    assert unpacked(packed(Attribute(Kind, "LOSS"))) is Kind.LOSS
    for other in (Attribute(Kind, "mro"), Attribute(Ledger, "loss")):
        assert unpacked(packed(other)) is None
