"""Small wrong changes of a module's code, made by rule: what each test suite ought to notice.

The operators, over the syntax tree of functions and of a module's constants (annotations,
assertions, strings and what is raised are left alone, and so are the defaults of a class's fields):

    compare   `<` for `<=` and so on, `==` for `!=`, `is` for `is not`, `in` for `not in`
    logic     `and` for `or`, and the other way round
    negate    the condition of an `if`, `while`, conditional expression or `case`, turned round
    number    an integer one higher, a float twice as large (1.0 for 0.0), True for False
    sign      `+` for `-`, `min` for `max`, and the other way round
    unit      `radians` or `degrees` of a number: the number as it is
    swap      the first two positional arguments of a call exchanged; not where their order is nothing (`hypot`)
    forget    a call, a count or an assignment to an attribute that stands by itself, left out
    keyword   a keyword argument of a function (not of a class), left out; not ``strict`` of zip, which is an assertion
    element   an action in a tuple inside a tuple, left out
    case      a whole case of a match, left out
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import Any, cast

Apply = Callable[[], None]
Variant = tuple[str, Apply]  # operator, and what changes the tree in place

_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_SIGNED: dict[type[ast.operator], type[ast.operator]] = {ast.Add: ast.Sub, ast.Sub: ast.Add}
_OTHER_END = {"min": "max", "max": "min"}
_UNITS = frozenset({"radians", "degrees", "deg2rad", "rad2deg"})
_EITHER_ORDER = frozenset(
    {"min", "max", "hypot", "dist", "isclose", "maximum", "minimum", "isinstance"}
)
_SHOWN = 90  # characters


@dataclass(frozen=True, slots=True)
class Mutation:
    """One wrong change.

    Attributes:
        file: as in the repository; ``where``: the function, with its class, or the constant.
        operator, what: "before -> after", and which one of those in the function when there are
            several.
        node, variant: where in the tree, and which change there.
    """

    file: str
    where: str
    line: int
    operator: str
    what: str
    node: int
    variant: int

    @property
    def name(self) -> str:
        """The same for as long as the function stays as it is."""
        return f"{self.file} {self.where}: {self.operator}: {self.what}"


def mutations(file: str, source: str) -> list[Mutation]:
    """All there are of a module, in the order of its lines."""
    found: list[Mutation] = []
    often: dict[str, int] = {}
    for number, where, node in _places(ast.parse(source)):
        for variant, (operator, _) in enumerate(_variants(node)):
            what = _told(node, variant)
            key = f"{where} {operator} {what}"
            often[key] = often.get(key, 0) + 1
            if often[key] > 1:
                what += f" (no. {often[key]})"
            found.append(
                Mutation(file, where, getattr(node, "lineno", 0), operator, what, number, variant)
            )
    return found


def mutated(source: str, mutation: Mutation) -> str:
    """The module's source, wrong in this one way."""
    tree = ast.parse(source)
    node = next(node for at, _, node in _places(tree) if at == mutation.node)
    list(_variants(node))[mutation.variant][1]()
    return ast.unparse(ast.fix_missing_locations(tree))


def rewritten(source: str) -> str:
    """Return the module's source as a wrong version has it, but right."""
    return ast.unparse(ast.parse(source))


def _told(node: ast.AST, variant: int) -> str:
    """The first line that differs: before -> after."""
    changed = deepcopy(node)
    list(_variants(changed))[variant][1]()
    lines = (
        ast.unparse(node).splitlines(),
        ast.unparse(ast.fix_missing_locations(changed)).splitlines(),
    )
    old, new = next(
        pair for pair in zip_longest(*lines, fillvalue="(nothing)") if pair[0] != pair[1]
    )
    return f"{old.strip()[:_SHOWN]} -> {new.strip()[:_SHOWN]}"


def _places(tree: ast.Module) -> Iterator[tuple[int, str, ast.AST]]:
    """Every node that may be changed: its number, its function or constant, itself."""
    numbers = {id(node): number for number, node in enumerate(ast.walk(tree))}

    def inside(node: ast.AST, where: str, within: bool) -> Iterator[tuple[int, str, ast.AST]]:
        for child in _changeable(node):
            name, now_within = where, within
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                name = f"{where}.{child.name}".lstrip(".")
                now_within = within or not isinstance(child, ast.ClassDef)
            if node is tree and isinstance(child, ast.Assign | ast.AnnAssign):
                name = _constant(child)
                now_within = True
            if now_within:
                yield numbers[id(child)], name, child
            yield from inside(child, name, now_within)

    yield from inside(tree, "", False)


def constants(source: str) -> set[str]:
    """Return the names that a module gives values to when it is imported."""
    body = ast.parse(source).body
    return {_constant(each) for each in body if isinstance(each, ast.Assign | ast.AnnAssign)}


def _constant(statement: ast.Assign | ast.AnnAssign) -> str:
    """Return what a statement of the module gives a value to."""
    targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
    return ast.unparse(targets[0])


def _changeable(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.Assert | ast.Raise | ast.JoinedStr):
        return
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "pattern"):
            continue
        children: list[object] = value if isinstance(value, list) else [value]
        yield from (
            child for child in children if isinstance(child, ast.AST) and not _is_words(child)
        )


def _is_words(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _variants(node: ast.AST) -> Iterator[Variant]:
    match node:
        case ast.Compare():
            yield from _compared(node)
        case ast.BoolOp():
            other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield "logic", lambda: setattr(node, "op", other)
        case ast.If() | ast.While() | ast.IfExp():
            yield "negate", lambda: setattr(node, "test", ast.UnaryOp(ast.Not(), node.test))
        case ast.Constant(value=bool()):
            yield "number", lambda: setattr(node, "value", not node.value)
        case ast.Constant(value=int() as number):
            yield "number", lambda: setattr(node, "value", number + 1)
        case ast.Constant(value=float() as number):
            yield "number", lambda: setattr(node, "value", 2.0 * number if number else 1.0)
        case ast.BinOp() if type(node.op) in _SIGNED:
            yield "sign", lambda: setattr(node, "op", _SIGNED[type(node.op)]())
        case ast.Call():
            yield from _called(node)
            yield from _swapped(node)
            if _name_of(node) in _UNITS:
                yield "unit", lambda: setattr(node, "func", ast.Name("float", ast.Load()))
        case ast.Tuple():
            yield from _elements(node)
        case ast.Match():
            yield from _cases(node)
        case _:
            pass
    yield from _forgotten(node)


def _compared(node: ast.Compare) -> Iterator[Variant]:
    for place, operator in enumerate(node.ops):
        other = _COMPARED[type(operator)]
        yield "compare", lambda place=place, other=other: node.ops.__setitem__(place, other())


def _called(node: ast.Call) -> Iterator[Variant]:
    if isinstance(node.func, ast.Name) and node.func.id in _OTHER_END:
        name = node.func
        yield "sign", lambda: setattr(name, "id", _OTHER_END[name.id])
    if _name_of(node)[:1].islower():
        for keyword in node.keywords:
            if keyword.arg not in (None, "strict"):
                yield "keyword", lambda keyword=keyword: node.keywords.remove(keyword)


def _swapped(node: ast.Call) -> Iterator[Variant]:
    two = node.args[:2]
    if (
        len(two) < 2
        or any(isinstance(one, ast.Starred) for one in two)
        or _name_of(node) in _EITHER_ORDER
    ):
        return
    if ast.dump(two[0]) != ast.dump(two[1]):
        yield "swap", lambda: node.args.__setitem__(slice(2), reversed(two))


def _name_of(node: ast.Call) -> str:
    """Return the last part of what is called."""
    return node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")


def _elements(node: ast.Tuple) -> Iterator[Variant]:
    """Yields, of ``state, (Persist(...), Send(...))``, the actions."""
    for inner in node.elts:
        if isinstance(inner, ast.Tuple):
            for element in inner.elts:
                yield "element", lambda inner=inner, element=element: inner.elts.remove(element)


def _cases(node: ast.Match) -> Iterator[Variant]:
    for case in node.cases:
        if case.guard is not None:
            yield (
                "negate",
                lambda case=case: setattr(
                    case, "guard", ast.UnaryOp(ast.Not(), _known(case.guard))
                ),
            )
    if len(node.cases) > 1:
        for case in node.cases[:-1]:
            yield "case", lambda case=case: node.cases.remove(case)


def _known(guard: ast.expr | None) -> ast.expr:
    assert guard is not None
    return guard


def _forgotten(node: ast.AST) -> Iterator[Variant]:
    for name in ("body", "orelse", "finalbody"):
        statements: Any = getattr(node, name, None)
        if not isinstance(statements, list):
            continue
        for place, statement in enumerate(cast(list[Any], statements)):
            if _stands_alone(statement):
                yield "forget", partial(cast(list[Any], statements).__setitem__, place, ast.Pass())


def _stands_alone(statement: object) -> bool:
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Call | ast.Await)
    if isinstance(statement, ast.AugAssign):
        return True
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    return bool(targets) and all(
        isinstance(target, ast.Attribute | ast.Subscript) for target in targets
    )
