"""The decorators of values: dataclasses with slots that nobody may change.

To the type checker, which looks at every line, both are frozen dataclasses. ``value`` is for those
that are made hundreds of times a second: in flight its fields are simply set when it is made, while
a frozen one asks ``object.__setattr__`` for each field, which takes four times as long.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar, dataclass_transform, overload

Value = TypeVar("Value")


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def value(cls: type[Value]) -> type[Value]:
    """Make a class a dataclass that nobody may change, equal and hashed by its fields."""
    return dataclass(slots=True, unsafe_hash=True)(cls)


@overload
def frozen(cls: type[Value]) -> type[Value]: ...
@overload
def frozen(*, eq: bool) -> Callable[[type[Value]], type[Value]]: ...
@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def frozen(cls: type[Value] | None = None, *, eq: bool = True) -> Any:
    """Make a class a frozen dataclass with slots. ``eq``: equal by its fields, and not by itself
    alone.
    """
    made = dataclass(frozen=True, slots=True, eq=eq)
    return made if cls is None else made(cls)
