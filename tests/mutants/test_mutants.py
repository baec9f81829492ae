"""Wrong changes by rule, and the score of the tests against them: on small modules, and a sample of
the real ones.
"""

from __future__ import annotations

import ast
import importlib
import io
import json
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.mutants import trials
from tests.mutants.__main__ import main, show, summarize
from tests.mutants.operators import mutated, mutations
from tests.mutants.rooms import (
    FileTests,
    Room,
    Table,
    TableError,
    changed_lines,
    load_table,
    of_change,
    of_room,
    sample,
    suite_for,
)
from tests.mutants.trials import Server, Trials, believed, score
from tests.mutants.warm import NotHereError, put_into

ROOT = Path(__file__).parents[2]

CASES = {
    "def f(a, b):\n    return a < b": {"compare: a < b -> a <= b"},
    "def f(a, b):\n    return a is not b": {"compare: a is not b -> a is b"},
    "def f(a, b):\n    return a and b": {"logic: a and b -> a or b"},
    "def f(a):\n    if a:\n        return a": {"negate: if a: -> if not a:"},
    "def f(a):\n    return a + 7": {"sign: a + 7 -> a - 7", "number: 7 -> 8"},
    "def f():\n    return True": {"number: True -> False"},
    "def f(a, b):\n    return min(a, b)": {"sign: min(a, b) -> max(a, b)"},
    "def f(a):\n    a.go()": {"forget: a.go() -> pass"},
    "def f(a):\n    a.b = a": {"forget: a.b = a -> pass"},
    "def f(a):\n    return replace(a, b=a)": {"keyword: replace(a, b=a) -> replace(a)"},
    "def f(a):\n    return State(a, b=a)": set[str](),
    "def f(a):\n    return zip(a, a, strict=True)": set[str](),
    "def f(a, b):\n    return a, (b,)": {"element: (a, (b,)) -> (a, ())"},
    "def f(a):\n    match a:\n        case 1 if a:\n            return a\n        case _:\n            return f": {
        "negate: case 1 if a: -> case 1 if not a:",
        "case: case 1 if a: -> case _:",
    },
    'def f(a: int = 3) -> int:\n    """Words."""\n    assert a > 1\n    raise ValueError(f"{a + 1}")': {
        "number: 3 -> 4"
    },
    "def f(a):\n    a += 1.5": {"forget: a += 1.5 -> pass", "number: 1.5 -> 3.0"},
    "def f():\n    return 0.0": {"number: 0.0 -> 1.0"},
    "def f(a, b):\n    return g(a, b)": {"swap: g(a, b) -> g(b, a)"},
    "def f(a, b):\n    return g(a, a), hypot(a, b), g(*a, b)": set[str](),
    "def f(a):\n    return math.radians(a)": {"unit: math.radians(a) -> float(a)"},
    "LIMIT = 5\n\n\nclass A:\n    width: int = 7": {"number: 5 -> 6"},
}


@pytest.mark.parametrize("source", CASES)
def test_each_operator(source: str) -> None:
    found = mutations("m.py", source)
    assert {f"{one.operator}: {one.what}" for one in found} == CASES[source]
    for one in found:
        assert ast.dump(ast.parse(mutated(source, one))) != ast.dump(ast.parse(source))


def test_the_same_change_in_two_places_has_two_names() -> None:
    first, second = mutations(
        "m.py", "class A:\n    def f(self, a, b):\n        return (a < b) == (a < b)"
    )[1:]
    assert second.name == f"{first.name} (no. 2)" and first.where == "A.f" and first.line == 3


def test_every_wrong_version_of_the_real_modules_is_python_and_the_equivalent_ones_are_among_them() -> (
    None
):
    """Both in one test, which is one worker's: to change all modules takes seconds."""
    table = load_table()
    real = {room.name: [one for _, one in of_room(table, room, ROOT)] for room in table.rooms}
    for room, found in real.items():
        assert len(found) >= 40 and len({one.name for one in found}) == len(found), room
        for one in found[:: len(found) // 12]:
            compile(mutated((ROOT / one.file).read_text(), one), one.file, "exec")

    every = [one for found in real.values() for one in found]
    assert set(table.equivalent) - {one.name for one in every} == set()
    assert all(len(why) > 20 for why in (*table.equivalent.values(), *table.arbitrary.values()))
    places = {one.file for one in every} | {f"{one.file} {one.where}" for one in every}
    assert set(table.arbitrary) - places == set()


def test_the_numbers_of_a_file_may_be_any_and_nothing_else_of_it() -> None:
    table = Table(
        (), {"a.py f: sign: x + 1 -> x - 1": "named"}, {"b.py": "its numbers stand for any"}
    )
    same = {
        file: [
            one.operator
            for one in mutations(file, "def f(x):\n    return x + 1")
            if table.why_the_same(one)
        ]
        for file in ("a.py", "b.py", "c.py")
    }
    assert same == {"a.py": ["sign"], "b.py": ["number"], "c.py": []}
    own = Table((), {}, {"b.py f": "its numbers stand for any"})
    first, second = mutations("b.py", "def f():\n    return 1\n\n\ndef g():\n    return 1")
    assert own.why_the_same(first) and not own.why_the_same(second)


def test_a_seed_is_a_choice() -> None:
    table = load_table()
    every = of_room(table, table.room("flight/guard"), ROOT)
    chosen = sample(every, 40, 3)
    assert chosen == sample(every, 40, 3) != sample(every, 40, 4)
    assert len({one.name for _, one in chosen}) == 40
    assert sample(every, 10_000, 3) == every


def test_a_file_has_the_tests_of_its_room_or_of_its_mirror_those_of_its_own_name_first() -> None:
    table = load_table()
    in_room = suite_for(table, "flight/guard/watch.py", ROOT)
    assert in_room is not None and in_room.room == "flight/guard"
    assert in_room.tests[0] == "tests/flight/guard/test_watch.py" and len(in_room.tests) > 3
    mirrored = suite_for(table, "hil/beacons/noise.py", ROOT)
    assert mirrored is not None and mirrored.room == "hil/beacons"
    assert all(test.startswith("tests/hil/beacons/") for test in mirrored.tests)
    assert suite_for(table, "nowhere/at/all.py", ROOT) is None
    both = suite_for(table, "drivers/mavlink/vehicle.py", ROOT)
    assert both is not None and both.slow[0] == "tests/drivers/mavlink/test_vehicle.py"
    assert not set(both.slow) & set(both.tests)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module, of which the tests notice one wrong change and not the other. They need no plugins,
    which take most of the time that pytest takes to begin.
    """
    without = "-p no:hypothesispytest -p no:missions.fly.testing.plugin"
    monkeypatch.setitem(trials.WITH_THIS, "PYTEST_ADDOPTS", without)
    (tmp_path / "sums.py").write_text(
        "def unseen(a, b):\n    return a < b\n\n\ndef seen(a, b):\n    return a > b\n\n\ndef one():\n    return 1\n"
    )
    (tmp_path / "test_sums.py").write_text(
        "from sums import seen\n\n\ndef test_seen():\n    assert not seen(1, 1)\n"
    )
    return tmp_path


def test_the_score_counts_what_the_tests_notice_and_names_what_they_do_not(project: Path) -> None:
    nobody = "sums.py one: number: 1 -> 2"
    room = Room("sums", ("sums.py",), ("test_sums.py",))
    table = Table((room,), {nobody: "nobody calls it"})
    stream = io.StringIO()
    tried = score(table, of_room(table, room, project), 1, project, stream)
    told = summarize(tried, {"sums.py": "sums"}, ["alone.py"], 1.0)
    assert [one["name"] for one in told["survivors"]] == [
        "sums.py unseen: compare: a < b -> a <= b"
    ]
    assert [(one.mutation.what, one.by) for one in tried if one.caught] == [
        ("a > b -> a >= b", "test_sums.py::test_seen")
    ]
    assert told["equivalent"] == [{"name": nobody, "why": "nobody calls it"}]
    assert (told["mutants"], told["caught"], told["holds"]) == (2, 1, False)
    assert told["by_room"] == {"sums": {"mutants": 2, "caught": 1}}
    show(told, stream)
    lines = stream.getvalue().splitlines()
    assert "SURVIVED line    2  sums.py unseen: compare: a < b -> a <= b" in lines
    assert [line.split() for line in lines if line.startswith("sums ")] == [
        ["sums", "2", "1", "50.0%"]
    ]
    assert "no tests mirror alone.py" in lines


def git(folder: Path, *words: str) -> None:
    who = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """One function of two has changed since the first commit, and a file that no test is there
    for.
    """
    before = "def old(a, b):\n    return a < b\n\n\ndef new(a, b):\n    return a\n"
    for folder in ("path/sums", "tests/path/sums", "hil"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "path" / "sums" / "sums.py").write_text(before)
    test = "from path.sums.sums import new\n\n\ndef test_new():\n    assert new(2, 1) and not new(1, 1)\n"
    (tmp_path / "tests" / "path" / "sums" / "test_sums.py").write_text(test)
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-q", "-m", "before")
    (tmp_path / "path" / "sums" / "sums.py").write_text(
        before.replace("return a\n", "c = a > b\n    return c\n")
    )
    (tmp_path / "hil" / "alone.py").write_text("def alone(a):\n    return not a\n")
    git(tmp_path, "add", "-A")
    return tmp_path


def test_of_a_change_its_own_lines_are_changed_and_nothing_else(checkout: Path) -> None:
    assert changed_lines("HEAD", checkout) == {"path/sums/sums.py": {6, 7}, "hil/alone.py": {1, 2}}
    every, untested = of_change(Table(()), "HEAD", checkout)
    assert [one.name for _, one in every] == ["path/sums/sums.py new: compare: a > b -> a >= b"]
    assert every[0][0].tests == ("tests/path/sums/test_sums.py",)
    assert untested == ["hil/alone.py"]


def test_a_revision_that_is_none_is_told(checkout: Path) -> None:
    stream = io.StringIO()
    assert main(["--diff", "no-such-revision"], checkout, stream) == 2
    assert "no-such-revision" in stream.getvalue()


def test_nothing_asked_for_names_the_rooms(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([], ROOT, io.StringIO())
    assert "flight/guard" in capsys.readouterr().err
    stream = io.StringIO()
    assert main(["--room", "attic"], ROOT, stream) == 2 and "missions/fly/leg" in stream.getvalue()


def test_what_the_quick_tests_do_not_notice_the_slow_ones_are_asked(project: Path) -> None:
    (project / "test_slow.py").write_text(
        "from sums import unseen\n\n\ndef test_slow():\n    assert not unseen(1, 1)\n"
    )
    room = Room("sums", ("sums.py",), ("test_sums.py",), ("test_slow.py",))
    table = Table((room,))
    tried = score(table, of_room(table, room, project), 1, project, io.StringIO())
    assert [one.by.rpartition("::")[2] for one in tried] == ["test_slow", "test_seen", ""]
    tried = score(table, of_room(table, room, project), 1, project, io.StringIO(), quick=True)
    assert [one.caught for one in tried] == [False, True, False]


def test_a_wrong_version_that_hangs_is_ended_and_noticed(project: Path) -> None:
    suite = FileTests("sums.py", ("test_sums.py",))
    endless = "def seen(a, b):\n    while True:\n        pass\n"
    with Trials(project, 1, suite.tests) as running:
        came = running.trial(suite, endless, 1.0)
    assert came["hung"] and not came["passed"] and came["what"] == "test_sums.py::test_seen"


@pytest.mark.parametrize(
    ("again", "right", "noticed"),
    [(False, True, True), (True, True, False), (False, False, False), (True, False, False)],
)
def test_a_test_has_noticed_when_it_fails_again_alone_and_passes_without_the_change(
    again: bool, right: bool, noticed: bool
) -> None:
    class Asked(Server):
        def __init__(self) -> None:
            pass

        def trial(
            self, sources: Mapping[str, str], tests: Sequence[str], bound_s: float
        ) -> dict[str, Any]:
            assert tests == ["test_a.py::test_it"] and bound_s == 9.0
            return {"passed": again if sources else right, "took_s": 1.0}

    first = {"passed": False, "broken": False, "what": "test_a.py::test_it", "took_s": 2.0}
    first["hung"] = False
    over = {**first, "hung": True, "what": "{}"}
    assert believed(over, Asked(), {"a": "wrong"}, 9.0)["passed"]
    came = believed(first, Asked(), {"a": "wrong"}, 9.0)
    assert came["passed"] is not noticed and came["took_s"] == 4.0
    assert came["what"] == f"{'' if noticed else 'not because of it: '}test_a.py::test_it"


def test_a_test_that_reads_the_code_as_text_is_told_before_anything_is_tried(
    project: Path,
) -> None:
    """Every wrong version is written anew without its comments: it would notice each of them."""
    (project / "sums.py").write_text("def seen(a, b):\n    # why\n    return a > b\n")
    (project / "test_sums.py").write_text(
        "import sums\n\n\ndef test_seen():\n    assert sums.seen.__code__.co_firstlineno == 1\n"
        "    assert next(sums.seen.__code__.co_lines())[2] == 1\n"
        "    assert 3 in [line for *_, line in sums.seen.__code__.co_lines()]\n"
    )
    room = Room("sums", ("sums.py",), ("test_sums.py",))
    with pytest.raises(TableError, match="fail as it is"):
        score(Table((room,)), of_room(Table((room,)), room, project), 1, project, io.StringIO())


def test_the_tests_of_a_files_own_name_come_first_and_then_the_cheapest(project: Path) -> None:
    (project / "test_other.py").write_text(
        "import time\n\n\ndef test_long():\n    time.sleep(0.1)\n"
    )
    (project / "test_short.py").write_text("def test_short():\n    pass\n")
    tests = ("test_other.py", "test_short.py", "test_sums.py")
    suite = FileTests("sums.py", tests)
    with Trials(project, 1, tests) as running:
        running.bounds_s([suite])
        assert running._cheapest_first(suite) == ["test_sums.py", "test_short.py", "test_other.py"]


def test_what_is_noticed_only_at_import_is_tried_from_the_first_import_on(project: Path) -> None:
    """A version that a living module cannot take, and one whose tests were made of it when they
    were collected.
    """
    suite = FileTests("sums.py", ("test_sums.py",))
    (project / "test_sums.py").write_text(
        "import sums\n\nMADE = sums.seen(1, 1)\n\n\ndef test_made():\n    assert not MADE\n"
    )
    right = (project / "sums.py").read_text()
    with Trials(project, 1, suite.tests) as running:
        came = running.trial(suite, right.replace("a > b", "a >= b"), 60.0)
        assert not came["passed"] and "test_made" in came["what"]
        came = running.trial(suite, f"{right}\n\ndef more():\n    return 1\n", 60.0)
        assert came["passed"]
        came = running.trial(suite, f"{right}\n\nraise ValueError\n", 60.0)
        assert not came["passed"] and not came["broken"]


def test_even_quickly_a_wrong_table_is_imported_with_what_is_made_of_it(project: Path) -> None:
    (project / "sums.py").write_text("MOST = (1, 2)\n\n\ndef seen(a, b):\n    return a > b\n")
    (project / "test_sums.py").write_text(
        "import sums\n\n\ndef test_most():\n    assert sums.MOST == (1, 2)\n"
    )
    room = Room("sums", ("sums.py",), ("test_sums.py",))
    table = Table((room,))
    every = of_room(table, room, project)
    tried = score(table, every, 1, project, io.StringIO(), quick=True)
    assert [one.caught for one in tried] == [True, True, False]


def test_a_wrong_kernel_is_compiled_and_tried(project: Path) -> None:
    """What numba cannot keep it does not compile: every wrong kernel would count as noticed, and no
    test be run.
    """
    (project / "sums.py").write_text(
        "from path.compiled import kernel\n\n\n@kernel\ndef more(a):\n    return a + 1\n\n\n"
        "def unseen(a):\n    return a < 1\n"
    )
    (project / "test_sums.py").write_text(
        "from sums import more\n\n\ndef test_more():\n    assert more(1) == 2\n"
    )
    right = (project / "sums.py").read_text()
    suite = FileTests("sums.py", ("test_sums.py",))
    with Trials(project, 1, suite.tests) as running:
        assert running.trial(suite, right.replace("a < 1", "a <= 1"), 60.0)["passed"]
        came = running.trial(suite, right.replace("a + 1", "a - 1"), 60.0)
    assert not came["passed"] and "test_more" in came["what"]


def test_a_module_that_pytest_would_load_by_itself_is_the_wrong_one_all_the_same(
    project: Path,
) -> None:
    """pytest rewrites the asserts of its plugins' packages, and ``missions`` is one: it loads them
    from their files.
    """
    (project / "conftest.py").write_text(
        'import pytest\n\npytest.register_assert_rewrite("sums")\n'
    )
    (project / "sums.py").write_text("class Base:\n    def f(self):\n        return 1\n\n\nclass Sums(Base):\n"
                                     "    def f(self):\n        return super().f()\n")  # fmt: skip
    (project / "test_sums.py").write_text(
        "from sums import Sums\n\n\ndef test_it():\n    assert Sums().f() == 1\n"
    )
    suite = FileTests("sums.py", ("test_sums.py",))
    # no living function can take it
    wrong = (project / "sums.py").read_text().replace("return super().f()", "pass")
    with Trials(project, 1, suite.tests) as running:
        came = running.trial(suite, wrong, 60.0)
    assert not came["passed"] and "test_it" in came["what"]


def test_a_module_gets_the_code_of_another_source_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = """
from dataclasses import dataclass
from functools import cache

TABLE = {"a": lambda: 1, "b": lambda: 2}
LIMIT = 5

def limit():
    return LIMIT

def plain(a, b=3):
    return a + b

@cache
def cached():
    return 1

@dataclass(frozen=True, slots=True)
class Thing:
    size: int

    @property
    def twice(self):
        return self.size + self.size

    @classmethod
    def make(cls):
        return cls(1)

    @staticmethod
    def one():
        return 1
"""
    (tmp_path / "living.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    living = importlib.import_module("living")
    plain, thing = living.plain, living.Thing(4)  # bound before, as other modules have them
    changes = (
        ("return a + b", "return a - b", lambda: plain(5), 8, 2),
        ("LIMIT = 5", "LIMIT = 6", living.limit, 5, 6),
        ("b=3", "b=4", lambda: plain(5), 8, 9),
        ("lambda: 2", "lambda: 3", lambda: living.TABLE["b"]() + 0, 2, 3),
        ("self.size + self.size", "self.size - self.size", lambda: thing.twice, 8, 0),
        ("cls(1)", "cls(2)", lambda: living.Thing.make().size, 1, 2),
        ("def one():\n        return 1", "def one():\n        return 2", living.Thing.one, 1, 2),
    )
    for old, new, made, before, after in changes:
        assert made() == before and old in source
        put_into(living, source.replace(old, new))
        assert made() == after, new
        put_into(living, source)
    put_into(living, source.replace("def cached():\n    return 1", "def cached():\n    return 2"))
    assert living.cached() == 2
    with pytest.raises(NotHereError, match="more"):
        put_into(living, f"{source}\ndef more():\n    return 1\n")


def test_tests_that_fail_as_it_is_are_told(project: Path) -> None:
    (project / "test_sums.py").write_text("def test_wrong():\n    assert False\n")
    room = Room("sums", ("sums.py",), ("test_sums.py",))
    table = Table((room,))
    with pytest.raises(TableError, match=r"sums\.py fail as it is.*test_wrong"):
        score(table, of_room(table, room, project), 1, project, io.StringIO())


def test_outside_a_checkout_it_says_so(tmp_path: Path) -> None:
    stream = io.StringIO()
    assert main(["--room", "path/gate"], tmp_path, stream) == 2
    assert "there is no path/gate here" in stream.getvalue()


def test_a_sample_of_the_real_ones_is_caught(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command, on the quickest of the rooms."""
    tests = tuple(f"tests/flight/guard/test_rules{more}.py" for more in ("", "_taken", "_bounds"))
    rules = Room("rules", ("flight/guard/rules.py",), tests)
    monkeypatch.setattr("tests.mutants.__main__.load_table", lambda: Table((rules,)))
    stream = io.StringIO()
    code = main(
        ["--room", "rules", "--sample", "3", "--seed", "2", "--out", str(tmp_path / "told")],
        ROOT,
        stream,
    )
    told = json.loads((tmp_path / "told").read_text())
    assert (code, told["mutants"], told["caught"]) == (0, 3, 3), stream.getvalue()
