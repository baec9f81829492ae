"""Kernels for kernels only are called by kernels only: called from Python they would end the
process.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from path.marker.photometric.kernels import tones

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("path", "drivers", "flight", "missions", "hil", "tests")
COMPILED = ("kernel", "inner")


def decorated(node: ast.AST, names: tuple[str, ...]) -> bool:
    return isinstance(node, ast.FunctionDef) and any(
        getattr(each, "id", "") in names for each in node.decorator_list
    )


def inner_of(source: str) -> set[str]:
    """Names of a module's kernels that only kernels call."""
    if "@inner" not in source:  # most modules are not worth parsing
        return set()
    return {
        node.name
        for node in ast.parse(source).body
        if isinstance(node, ast.FunctionDef) and decorated(node, ("inner",))
    }


def asked_by_python(tree: ast.Module) -> Iterator[str]:
    """Names that a module uses outside of its kernels."""
    for node in tree.body:
        if decorated(node, COMPILED) or isinstance(node, ast.Import | ast.ImportFrom):
            continue
        for each in ast.walk(node):
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load):
                yield each.id


def calls_of_inner(sources: dict[str, str]) -> list[str]:
    """``module: name`` of each use from Python of a kernel for kernels only; ``sources`` by module
    name.
    """
    inner = {module: inner_of(source) for module, source in sources.items()}
    of_them = "|".join(re.escape(module) for module, names in inner.items() if names)
    may_call = re.compile(rf"@inner|from\s+({of_them})\s+import")
    wrong: list[str] = []
    for module, source in sources.items():
        if not may_call.search(source):
            continue
        tree = ast.parse(source)
        known = {name: name for name in inner[module]}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in inner:
                known |= {
                    each.asname or each.name: each.name
                    for each in node.names
                    if each.name in inner[node.module]
                }
        wrong += [f"{module}: {name}" for name in asked_by_python(tree) if name in known]
    return wrong


@pytest.fixture(scope="module")
def sources() -> dict[str, str]:
    files = [file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")]
    return {
        ".".join(file.relative_to(ROOT).with_suffix("").parts): file.read_text("utf-8")
        for file in files
    }


def test_no_python_calls_a_kernel_for_kernels_only(sources: dict[str, str]) -> None:
    assert calls_of_inner(sources) == []


@pytest.mark.parametrize(
    "call",
    ["def f(): return turned(1)", "answer = turned", "class A:\n    f = staticmethod(turned)"],
)
def test_a_call_from_python_is_found(call: str) -> None:
    kernels = "from path.compiled import inner\n@inner\ndef turned(x):\n    return x\n"
    assert calls_of_inner({"a": kernels + call}) == ["a: turned"]
    assert calls_of_inner({"a": kernels, "b": "from a import turned\n" + call}) == ["b: turned"]


LOADED = """
import sys
import numpy as np
from path.compiled import kernel
from path.marker.photometric.kernels import tones

tones(np.zeros((1, 6)))
assert tones.stats.cache_hits and "numba.np.linalg" not in sys.modules, "what only compiling needs was imported"


def turned(x):
    return np.sort(x)[::-1] + 1.0


print(kernel(turned)(np.array([1.0, 3.0, 2.0])))
"""


def test_what_is_compiled_is_loaded_without_the_compiler_which_is_there_when_it_is_needed(
    tmp_path: Path,
) -> None:
    tones(np.zeros((1, 6)))  # from here on it is on disk
    program = tmp_path / "loads.py"
    program.write_text(LOADED, "utf-8")
    ran = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == "[4. 3. 2.]\n"


def test_a_kernel_may_call_it() -> None:
    kernels = "from path.compiled import inner, kernel\n@inner\ndef turned(x):\n    return x\n"
    assert calls_of_inner({"a": kernels + "@kernel\ndef asked(x):\n    return turned(x)\n"}) == []
