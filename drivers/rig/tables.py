"""TOML tables to frozen dataclasses, strictly: every unknown key and wrong value is named, all at
once.
"""

from __future__ import annotations

import dataclasses
import difflib
import sys
import tomllib
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from drivers.interfaces import PartError
from drivers.text_file import read_file
from path.bounds import UNITS, bounds_of, numbers, refusal

T = TypeVar("T")

LARGEST = sys.float_info.max


class RigError(PartError):
    """A rig cannot be used as written. ``problems`` has one line each: file, table, key, and what
    is allowed.
    """

    def __init__(self, problems: Sequence[str], remedy: str = "") -> None:
        super().__init__(
            "\n".join(problems),
            remedy or "correct the rig file; `path-handoff rigs` lists working ones",
        )
        self.problems = tuple(problems)


@dataclass(slots=True)
class Problems:
    """Collects what is wrong, so that one run shows all of it."""

    lines: list[str] = field(default_factory=list[str])

    def add(self, where: str, text: str) -> None:
        self.lines.append(f"{where}: {text}")

    def absorb(self, error: RigError) -> None:
        self.lines.extend(error.problems)

    def raise_any(self) -> None:
        if self.lines:
            raise RigError(list(dict.fromkeys(self.lines)))  # two checks may come upon the same


class _Bad(Exception):
    """A value was refused and the problem noted."""


def decode_table(
    table: Mapping[str, Any], kind: type[T], where: str, base: Path | None = None
) -> T:
    """Decode a TOML table as the dataclass ``kind``.

    Understands nested dataclasses, tuples, dicts with string keys, enums (by value), Literals,
    unions, ``Path``, floats written as integers, and any type with a class method
    ``from_table(table, where, base)``. Numbers must be finite, and within their field's
    ``path.bounds.Bounds``.

    Args:
        table: as tomllib gives it.
        kind: a dataclass; its ``__post_init__`` may raise ValueError to refuse a combination of
            values.
        where: names file and table in messages, such as ``sitl.toml: sender.vehicle``.
        base: relative paths in the table start here.

    Raises:
        RigError: with every problem found.
    """
    problems = Problems()
    try:
        value = _dataclass(table, kind, where, problems, base)
    except _Bad:
        value = None
    problems.raise_any()
    return value  # type: ignore[return-value]


def read_toml(file: Path) -> dict[str, Any]:
    """The tables of a TOML file, also of one that begins with a byte-order mark, as editors on
    Windows write it.

    Raises OSError, UnicodeDecodeError and tomllib.TOMLDecodeError, whatever is in the file.
    """
    text = read_file(file).decode("utf-8-sig")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    # nested without end, a number of thousands of digits
    except (RecursionError, ValueError) as error:
        raise tomllib.TOMLDecodeError(str(error)) from error


# as rigs once called it
RENAMED = {"sight": "perception", "studio": "renderer", "apart": "position_offset"}


def suggestion(key: str, allowed: Sequence[str]) -> str:
    """`` (did you mean 'height_m'?)`` for an old name, a near miss, a missing or different unit;
    else nothing.
    """
    if RENAMED.get(key) in allowed:
        return f" (called '{RENAMED[key]}' now)"
    same_stem = [name for name in allowed if _stem(name) == _stem(key)]
    near = same_stem or difflib.get_close_matches(key, allowed, n=1, cutoff=0.6)
    return f" (did you mean '{near[0]}'?)" if near else ""


def _stem(key: str) -> str:
    stem, _, unit = key.rpartition("_")
    return stem if stem and unit in UNITS else key


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _inside(where: str, key: str) -> str:
    return f"{where}.{key}" if ": " in where else f"{where}: {key}"


def _dataclass(
    table: Any, kind: type[Any], where: str, problems: Problems, base: Path | None
) -> Any:
    if not isinstance(table, Mapping):
        problems.add(where, f"expected a table, found {_shown(table)}")
        raise _Bad
    fields = {f.name: f for f in dataclasses.fields(kind) if f.init}
    before = len(problems.lines)
    for key in table:
        if key not in fields:
            hint = suggestion(key, list(fields))
            allowed = ", ".join(fields) or "none"
            problems.add(where, f"unknown key '{key}'{hint}; allowed: {allowed}")
    values: dict[str, Any] = {}
    for name, spec in fields.items():
        if name in table:
            try:
                values[name] = _value(
                    table[name], _hints(kind)[name], _inside(where, name), problems, base
                )
            except _Bad:
                continue
        elif spec.default is dataclasses.MISSING and spec.default_factory is dataclasses.MISSING:
            problems.add(where, f"missing key '{name}' ({_expected(_hints(kind)[name])})")
    if len(problems.lines) > before:
        raise _Bad
    try:
        return kind(**values)
    except ValueError as error:
        problems.add(where, str(error))
        raise _Bad from error


def _value(value: Any, kind: Any, where: str, problems: Problems, base: Path | None) -> Any:  # noqa: PLR0911
    """Decode one value, or note the problem and raise _Bad."""
    origin = get_origin(kind)
    if origin is Annotated:
        return _bounded(value, kind, where, problems, base)
    if origin in (Union, types.UnionType):
        return _union(value, kind, where, problems, base)
    if origin is Literal:
        if value not in get_args(kind) or isinstance(value, bool) not in {
            isinstance(a, bool) for a in get_args(kind)
        }:
            _refuse(value, kind, where, problems)
        return value
    if origin is tuple:
        return _tuple(value, kind, where, problems, base)
    if origin in (dict, Mapping) or kind in (dict, Mapping):
        return _mapping(value, kind, where, problems, base)
    if hasattr(kind, "from_table"):
        try:
            return kind.from_table(value, where, base)
        except RigError as error:
            problems.absorb(error)
            raise _Bad from error
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _dataclass(value, kind, where, problems, base)
    if isinstance(kind, type) and issubclass(kind, Enum):
        try:
            return kind(value)
        except ValueError:
            _refuse(value, kind, where, problems)
    return _scalar(value, kind, where, problems, base)


def _bounded(value: Any, kind: Any, where: str, problems: Problems, base: Path | None) -> Any:
    """A value whose numbers have bounds."""
    decoded = _value(value, get_args(kind)[0], where, problems, base)
    bounds = bounds_of(kind)
    name = where.rpartition(".")[2].partition("[")[0]
    for number in numbers(decoded):
        if bounds is not None and not bounds.holds(number):
            problems.add(where, refusal(name, number, bounds))
            raise _Bad
    return decoded


def _scalar(value: Any, kind: Any, where: str, problems: Problems, base: Path | None) -> Any:
    if kind is Any:
        return value
    if kind is Path and isinstance(value, str):
        return base / value if base else Path(value)
    if (
        kind is float
        and isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= LARGEST
    ):
        return float(value)
    if kind in (int, str, bool, type(None)) and type(value) is kind:
        return value
    return _refuse(value, kind, where, problems)


def _union(value: Any, kind: Any, where: str, problems: Problems, base: Path | None) -> Any:
    attempts: list[Problems] = []
    for choice in get_args(kind):
        attempt = Problems()
        try:
            return _value(value, choice, where, attempt, base)
        except _Bad:
            attempts.append(attempt)
    tables = [
        a
        for a, choice in zip(attempts, get_args(kind), strict=True)
        if dataclasses.is_dataclass(choice)
    ]
    # `Wind | None`: what is wrong inside says more than the union
    if isinstance(value, Mapping) and len(tables) == 1:
        problems.lines.extend(tables[0].lines)
        raise _Bad
    return _refuse(value, kind, where, problems)


def _tuple(
    value: Any, kind: Any, where: str, problems: Problems, base: Path | None
) -> tuple[Any, ...]:
    kinds = get_args(kind)
    if not isinstance(value, list | tuple):
        _refuse(value, kind, where, problems)
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        _refuse(value, kind, where, problems)
    items = [
        (item, k, f"{where}[{i}]") for i, (item, k) in enumerate(zip(value, kinds, strict=True))
    ]
    return _each(items, problems, base)


def _mapping(
    value: Any, kind: Any, where: str, problems: Problems, base: Path | None
) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        _refuse(value, kind, where, problems)
    item_kind = get_args(kind)[1] if get_args(kind) else Any
    decoded = _each(
        [(item, item_kind, f"{where}.{key}") for key, item in value.items()], problems, base
    )
    return dict(zip(value, decoded, strict=True))


def _each(
    items: Sequence[tuple[Any, Any, str]], problems: Problems, base: Path | None
) -> tuple[Any, ...]:
    """Decode all of (value, kind, where), so that all problems are noted, then fail if any
    failed.
    """
    values: list[Any] = []
    failed = False
    for value, kind, where in items:
        try:
            values.append(_value(value, kind, where, problems, base))
        except _Bad:
            failed = True
    if failed:
        raise _Bad
    return tuple(values)


def _refuse(value: Any, kind: Any, where: str, problems: Problems) -> Any:
    problems.add(where, f"expected {_expected(kind)}, found {_shown(value)}")
    raise _Bad


def _expected(kind: Any) -> str:  # noqa: PLR0911
    """Return what a person may write for a value of this kind."""
    origin = get_origin(kind)
    args = get_args(kind)
    if origin is Annotated:
        return _expected(args[0])
    names: dict[Any, str] = {
        float: "a finite number",
        int: "a whole number",
        str: "a string",
        bool: "true or false",
        Path: "a path",
        Any: "anything",
    }
    if kind in names:
        return names[kind]
    if origin is Literal:
        return "one of " + ", ".join(_shown(a) for a in args)
    if origin in (Union, types.UnionType):
        return " or ".join(_expected(a) for a in args if a is not type(None))
    if origin is tuple:
        if args[1:] == (Ellipsis,):
            return f"a list of {_expected(args[0]).removeprefix('a ')}s"
        return f"a list of {len(args)}: " + ", ".join(_expected(a) for a in args)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return "one of " + ", ".join(_shown(member.value) for member in kind)
    return "a table"


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)
