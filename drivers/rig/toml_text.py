"""TOML for people to read, from plain tables; the standard library only reads it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml_text(table: Mapping[str, Any], comment: str = "") -> str:
    """A table of strings, booleans, numbers, lists of them, tables, and lists of tables.

    Raises:
        TypeError: for anything else.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()] + ([""] if comment else [])
    _table(table, "", lines)
    return "\n".join(lines).strip() + "\n"


def _table(
    table: Mapping[str, Any],
    name: str,
    lines: list[str],
) -> None:
    inner = {key: value for key, value in table.items() if _is_table(value)}
    lines += [f"{key} = {_value(value)}" for key, value in table.items() if key not in inner]
    for key, value in inner.items():
        full = f"{name}.{key}" if name else key
        for each in [value] if isinstance(value, Mapping) else value:
            lines += ["", f"[{full}]" if isinstance(value, Mapping) else f"[[{full}]]"]
            _table(each, full, lines)


def _is_table(value: Any) -> bool:
    inner = value if isinstance(value, list | tuple) else ()
    return isinstance(value, Mapping) or any(isinstance(each, Mapping) for each in inner)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # TOML's basic strings have JSON's escapes
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(each) for each in value)}]"
    raise TypeError(f"cannot write a {type(value).__name__} as TOML")
