"""What a rig's file says, laid over the rig that it is like.

like = "sitl-px4"             # all of another rig but what is written here: a name, or a file beside this one
drop = ["world.wind"]         # keys of the other rig that are left out
[both.vehicle]                # what [sender.vehicle] and [receiver.vehicle] say alike
[options]                     # of a rig in a folder of rigs: what it comes as (drivers.rig.choice)
[when."light px4, light field"]  # ... and what it says instead where these words are said

A table that says ``factory`` or ``calibration`` is another part and taken as it is written, and so
is a list; of any other table only the keys that are written differ.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.rig.choice import LEVELS, USUAL_RIG, Choice, shown
from drivers.rig.facts import without_derived
from drivers.rig.tables import RigError, read_toml, suggestion
from drivers.text_file import is_file

_WHOLE = frozenset(("factory", "calibration"))


def find_rig(name_or_path: str | Path, search: Sequence[Path] = ()) -> Path:
    """Return the TOML file of a rig: a path, or a name looked up in the folders of ``search``.

    A name may say options of a rig (``drivers.rig.choice``); its file need not be there then.
    Raises RigError.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if file_of(path):
            return path
        raise RigError([f"{path}: {_why_not(path)}"])
    for folder in search:
        if file_of(folder / f"{path}.toml"):
            return folder / f"{path}.toml"
    names = sorted(file.stem for folder in search for file in folder.glob("*.toml"))
    known = [*names, *LEVELS] if USUAL_RIG in names else names
    raise RigError(
        [
            f"no rig named '{path}'{suggestion(str(path), known)}; there are: {', '.join(names) or 'none'}"
        ],
        "name one of these, or the path of a rig's .toml file",
    )


def file_of(path: Path) -> tuple[Path, Choice] | None:
    """Return the file of a rig that is named by a path, and what the name says; None when there is
    none. ``rigs/sitl-px4.toml`` need not be there where ``rigs/car.toml`` is.
    """
    if is_file(path):
        return path, Choice(path.stem)
    choice = Choice.of(path.stem)
    file = path.with_name(f"{choice.rig}.toml")
    return (file, choice) if path.suffix == ".toml" and is_file(file) else None


def _why_not(path: Path) -> str:
    """Return why a path is no rig file."""
    try:
        return "a folder, and no rig file" if path.is_dir() else "no such rig file"
    except (OSError, ValueError) as error:  # this user may not look there; no name of a file
        return getattr(error, "strerror", None) or "no such rig file"


def read_rig(path: Path, search: Sequence[Path] = ()) -> dict[str, Any]:
    """The tables of a rig file, those of the rig that it is like among them; not checked. Raises
    RigError.
    """
    return _read(path, search, (), None)


def _read(
    path: Path,
    search: Sequence[Path],
    after: tuple[Path, ...],
    asked: Choice | None,
) -> dict[str, Any]:
    """``asked``: the choice of the rig that is like this one, whose options are this one's too."""
    file, choice = file_of(path) or (path, Choice(path.stem))
    try:
        table = read_toml(file)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RigError([f"{path.name}: {error}"]) from error
    if "options" in table:
        search = [*search, file.parent]
        if asked is not None:
            choice = asked.but_for(choice.level, choice.autopilot, choice.light)
        try:
            choice = choice.within(table["options"])
        except ValueError as error:
            ways = "\n       ".join(shown(table["options"]))
            raise RigError([f"{path.name}: {error}"], f"it comes as {ways}") from error
        layers = [{"name": path.stem, "level": choice.level}, *_chosen(table, choice)]
    elif file != path:
        raise RigError([f"{path}: {_why_not(path)}"])
    else:
        choice = asked
        layers = [table]
    made: dict[str, Any] = {}
    likes = [layer.pop("like") for layer in layers if "like" in layer]
    if likes:
        made = _read(_other(likes[-1], path, search, after), search, (*after, path), choice)
    for layer in layers:
        made = _laid(made, layer, path)
    return made


def _chosen(table: dict[str, Any], choice: Choice) -> list[dict[str, Any]]:
    """Return what a rig with options says, one over the other, where these are chosen."""
    del table["options"]
    when = table.pop("when", {})
    return [table, *(own for conditions, own in when.items() if choice.meets(conditions))]


def _laid(
    base: Mapping[str, Any],
    layer: dict[str, Any],
    path: Path,
) -> dict[str, Any]:
    """Return ``base`` without what the layer drops, and with what it says instead. Raises
    RigError.
    """
    for key in layer.pop("drop", []):
        base = _without(base, key, f"{path.name}: drop")
    both = layer.pop("both", {})
    for role in ("sender", "receiver") if both else ():
        layer[role] = _but_for(both, layer.get(role, {}))
    if "target" in layer:
        # another target: what the other rig says of heights and distances is of its own
        base = without_derived(base)
    return _but_for(base, layer)


def _other(
    like: Any,
    path: Path,
    search: Sequence[Path],
    after: tuple[Path, ...],
) -> Path:
    """Return the file of the rig that one is like. Raises RigError."""
    where = f"{path.name}: like"
    if not isinstance(like, str):
        raise RigError(
            [f"{where} is {like!r}; expected the name of a rig, or a rig file beside this one"]
        )
    try:
        other = find_rig(path.parent / like if like.endswith(".toml") else like, search)
    except RigError as error:
        raise RigError([f"{where}: {line}" for line in error.problems], error.remedy) from error
    if other.resolve() in (each.resolve() for each in (*after, path)):
        raise RigError(
            [f"{where} = {like!r} leads back to {other.name}"], "let one of them stand on its own"
        )
    return other


def _without(
    table: Mapping[str, Any],
    key: str,
    where: str,
) -> dict[str, Any]:
    """Return a table without a dotted key. Raises RigError when it has none."""
    first, _, rest = key.partition(".")
    made = dict(table)
    if rest and isinstance(made.get(first), dict):
        made[first] = _without(made[first], rest, where)
    elif not rest and first in made:
        del made[first]
    else:
        raise RigError([f"{where}: the other rig has no '{first}'{suggestion(first, list(made))}"])
    return made


def _but_for(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with what ``own`` says instead."""
    made = dict(base)
    for key, value in own.items():
        before = made.get(key)
        if isinstance(value, dict) and isinstance(before, dict) and not _WHOLE & value.keys():
            made[key] = _but_for(before, value)
        else:
            made[key] = value
    return made
