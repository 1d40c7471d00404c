"""Commands that must end in one way."""

from tests.batch.conftest import obeyed as obeyed
from tests.batch.conftest import refusal_of as refusal_of
