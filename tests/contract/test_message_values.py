"""Each message and refusal carries the values that it is given, each under its own name.

The functions of every `messages.py` are called with values of which no two are equal: one that
stands under the name of another, or in another unit, is noticed.
"""

import importlib
import inspect
import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.contract.sources import PACKAGE
from unbend.errors import UnbendError
from unbend.messages import Kind, Message


def makers():
    """The functions of every `messages.py` that make messages and refusals."""
    for path in sorted(PACKAGE.rglob("messages.py")):
        file = path.relative_to(PACKAGE.parent)
        module_name = ".".join(file.with_suffix("").parts)
        module = importlib.import_module(module_name)
        for name, function in inspect.getmembers(module, inspect.isfunction):
            is_defined_there = function.__module__ == module_name
            if is_defined_there and not name.startswith("_"):
                yield function


MAKERS = {f"{maker.__module__}.{maker.__name__}": maker for maker in makers()}


def distinct_arguments(maker: Callable[..., Any]):
    """A value for each argument by its annotation, no two alike; None where one is an object."""
    numbers = itertools.count(3)
    arguments = {}
    signature = inspect.signature(maker, eval_str=True)
    for name, parameter in signature.parameters.items():
        kind = parameter.annotation
        if kind is bool:
            arguments[name] = False
        elif kind is Kind:
            arguments[name] = Kind.WARNING
        elif kind is int:
            arguments[name] = next(numbers)
        elif kind is float:
            arguments[name] = next(numbers) + 0.25
        elif kind == tuple[float, float]:
            first = next(numbers) + 0.25
            arguments[name] = (first, next(numbers) + 0.25)
        elif kind is Path:
            arguments[name] = Path(f"the {name}")
        elif kind in (str, object, Path | str, str | None):
            arguments[name] = f"the {name}"
        else:
            return None
    return arguments


def values_of(made: Message | UnbendError):
    """What a message carries; its count only where it has one."""
    values = {"where": made.where, **made.values}
    if made.count:
        values.setdefault("count", made.count)
    return values


def test_most_messages_are_tried_here():
    arguments = list(map(distinct_arguments, MAKERS.values()))
    assert arguments.count(None) < 0.2 * len(arguments)


@pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)
def test_a_message_carries_each_value_under_its_own_name(maker):
    arguments = distinct_arguments(maker)
    if arguments is None or maker.__name__ == "ties_contradict":  # it looks up a code
        return
    made = maker(**arguments)
    if not isinstance(made, (Message, UnbendError)):
        return
    if isinstance(made, Message):
        assert isinstance(made.kind, Kind)
        assert Kind.WARNING not in arguments.values() or made.kind is Kind.WARNING
    carried = values_of(made)
    for name, argument in arguments.items():
        value = carried.get(name)
        is_number = isinstance(argument, int | float)
        if isinstance(argument, str | Path) and name in carried:
            assert str(argument) in str(value), name
        elif is_number and isinstance(value, int | float):
            assert math.isclose(value, argument), name
        elif isinstance(argument, tuple) and name not in carried:
            # Its two numbers have names of their own, or are together in a text.
            numbers = [number for number in carried.values() if number in argument]
            assert numbers in ([], [*argument]), name
