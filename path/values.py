"""The decorator of values that are made hundreds of times a second.

To the type checker, which looks at every line, such a class is a frozen dataclass with slots. In
flight it is one whose fields are simply set when it is made: a frozen one asks
``object.__setattr__`` for each field, which takes four times as long.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeVar, dataclass_transform

Value = TypeVar("Value")


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def value(cls: type[Value]) -> type[Value]:
    """Make a class a dataclass that nobody may change, equal and hashed by its fields."""
    return dataclass(slots=True, unsafe_hash=True)(cls)
