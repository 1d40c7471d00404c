"""Each message and refusal carries the values that it is given, each under its own name.

A text names only values that are given, reads well for one and for many, and a refusal has a
remedy.

The functions of every `messages.py` are called with values of which no two are equal: one that
stands under the name of another, or in another unit, is noticed.
"""

import importlib
import inspect
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.contract.sources import PACKAGE
from unbend.errors import Code, UnbendError
from unbend.messages import Kind, Message

A_CODE = Code("SOME-CODE", means="It happened.", effect="None.", remedy="Nothing.")
WITHOUT_REMEDY = {"no_events", "not_integrated", "path_too_near"}
"""Refusals of what no user can write."""
NOT_TRIED = {"ties_contradict"}  # it looks up a code


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
    """A value for each parameter by its annotation; numbers and texts all differ.

    None in place of the arguments if a parameter has another annotation, such as a class of ours.
    """
    if maker.__name__ in NOT_TRIED:
        return None
    arguments = {}
    signature = inspect.signature(maker, eval_str=True)
    for number, (name, parameter) in enumerate(signature.parameters.items(), start=3):
        text = f"the {name}"
        examples = {
            bool: False,
            int: number,
            float: number + 0.25,
            float | None: number + 0.25,
            tuple[float, float]: (number + 0.25, number + 0.5),
            Kind: Kind.WARNING,
            Code: A_CODE,
            Path: Path(text),
            Sequence[int]: [number],
            Sequence[float]: [number + 0.25],
            Sequence[str]: [text],
            **dict.fromkeys([str, object, Path | str, str | None], text),
        }
        if parameter.annotation not in examples:
            return None
        arguments[name] = examples[parameter.annotation]
    return arguments


def values_of(made: Message | UnbendError):
    """What a message carries; its count only where it has one."""
    values = {"where": made.where, **made.values}
    if made.count:
        values.setdefault("count", made.count)
    return values


def test_most_messages_are_tried_here():
    arguments = list(map(distinct_arguments, MAKERS.values()))
    assert arguments.count(None) < 0.05 * len(arguments)


@pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)
def test_a_message_carries_each_value_under_its_own_name(maker):
    arguments = distinct_arguments(maker)
    if arguments is None:
        return
    made = maker(**arguments)
    if not isinstance(made, (Message, UnbendError)):
        return
    assert made.what  # raises KeyError for a name in braces that is not given
    if isinstance(made, UnbendError):
        assert made.remedy or maker.__name__ in WITHOUT_REMEDY
    else:
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
        elif isinstance(argument, list) and name in carried:
            assert str(argument[0]) in str(value), name
        elif isinstance(argument, tuple) and name not in carried:
            # Its two numbers have names of their own, or are together in a text.
            numbers = [number for number in carried.values() if number in argument]
            assert numbers in ([], [*argument]), name


def words_after(count, text):
    """Words like ``images`` that follow a count, perhaps after an adjective."""
    return set(re.findall(rf"(?<![\d.]){count} (?:[a-z]+ )?([a-z]{{3,}}s)\b", text))


def text_for(maker, count):
    """The text of a message whose ``count`` is this number, and whose lists have so many elements.

    Empty if the maker makes no message.
    """
    arguments = distinct_arguments(maker)
    for name, argument in arguments.items():
        if name == "count":
            arguments[name] = count
        elif isinstance(argument, list):
            arguments[name] = argument * count
    return getattr(maker(**arguments), "what", "")


@pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)
def test_one_thing_is_named_in_the_singular(maker):
    if distinct_arguments(maker) is None:
        return
    same_words = words_after(1, text_for(maker, 1)) & words_after(2, text_for(maker, 2))
    assert same_words <= {"times"}
