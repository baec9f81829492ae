"""A role's program around its course: what is opened and closed, whose the log is, and how it ends."""

from __future__ import annotations

import asyncio
import gc
import json
import sys
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import pytest

from drivers.log.state_file import MemoryStore, StateFile
from drivers.rig.tables import RigError
from flight.config import MissionConfig
from flight.harness.flights import ProgramContext, Progress, RoleResult
from flight.outcome import Outcome
from missions.fly.leg import command, opening, process
from missions.ground.options.field import ReceiverOptions, SenderOptions
from path.messages import Role
from tests.doubles import LoopClock
from tests.missions.fly.leg.session_bench import FakeLink, FakeVehicle, Recorder, giving

GOOD = RoleResult(Role.SENDER, Outcome.COMMITTED, "", True, True)


# --- opening


class Part:
    """A part that is opened and closed."""

    def __init__(self, name: str, done: list[str]) -> None:
        self.name = name
        self.done = done
        self.counters = FakeLink().counters
        self.state = FakeVehicle().state

    async def __aenter__(self) -> Part:
        self.done.append(f"opens {self.name}")
        return self

    async def __aexit__(self, *_: object) -> None:
        self.done.append(f"closes {self.name}")


class Opening:
    """What a program opens, on parts that stand in."""

    def __init__(self, rig: Any, monkeypatch: pytest.MonkeyPatch, harness: Any = None) -> None:
        self.done: list[str] = []
        self.frozen: list[bool] = []
        self.harness = harness
        self.log = Recorder()
        spec = SimpleNamespace
        own = rig.role(Role.SENDER)
        self.own = spec(
            link=spec(name="link"),
            perception=spec(name="camera"),
            vehicle=spec(name="vehicle"),
            guard=spec(name="guard"),
            operator=spec(name="crew"),
            mount=own.mount,
            camera=own.camera,
        )
        self.rig: Any = SimpleNamespace(
            role=giving(self.own), layout=rig.layout, origin=rig.origin, method=rig.method, height=None
        )  # fmt: skip
        self.asked: list[tuple[object, ...]] = []
        monkeypatch.setattr(opening, "create", self._create)
        monkeypatch.setattr(opening, "part_context", self._context)
        monkeypatch.setattr(opening, "warm_up_for", self._warm_up)
        monkeypatch.setattr(opening, "give_back", lambda: self.done.append("gives back"))
        monkeypatch.setattr(opening, "guard_line_of", self._line)
        monkeypatch.setattr(gc, "freeze", lambda: self.frozen.append(True))

    def _create(self, part: Any, context: object) -> Part:
        assert context is self.context
        return Part(part.name, self.done)

    def _context(self, *args: object) -> Any:
        self.asked.append(args)
        self.context = SimpleNamespace(clock=LoopClock(1.0))
        return self.context

    def _warm_up(self, *args: object) -> None:
        assert args == (self.own, self.harness)
        self.done.append("compiles")

    def _line(self, *args: object) -> Part:
        self.asked.append(args)
        return Part("guard", self.done)

    async def open(self) -> Any:
        given = ProgramContext(
            cast(Any, self.log), giving(None), asyncio.Event(), self.harness, MemoryStore()
        )
        async with AsyncExitStack() as stack:
            config = MissionConfig()
            return await opening.open_session(stack, self.rig, Role.SENDER, config, given)


@pytest.mark.parametrize("harness", [None, SimpleNamespace(seed=4)])
def test_every_part_is_opened_in_its_order_and_closed_again(
    rig: Any, harness: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("missions.fly.leg.session.alike_of", giving(None))
    opened = Opening(rig, monkeypatch, harness)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(4)
    session = asyncio.run(opened.open())
    assert cv2.getNumThreads() == 1
    cv2.setNumThreads(threads)
    parts = ["link", "camera", "vehicle", "guard", "crew"]
    own_process = harness is None
    assert opened.done == [
        "compiles",
        *(f"opens {name}" for name in parts),
        *["gives back"] * own_process,
        *(f"closes {name}" for name in reversed(parts)),
    ]
    assert opened.frozen == [True] * own_process
    rig_, role, given = opened.asked[0]
    assert (rig_, role, given) == (opened.rig, Role.SENDER, harness)
    assert opened.asked[1][0] is opened.own.guard and opened.asked[1][1:] == (
        Role.SENDER,
        opened.context.clock,
        harness,
    )
    assert session.operator.name == "crew" and session.link.name == "link"
    assert session.guarding.guard is not None
    assert (session.stages is not None) is own_process


def test_a_part_that_ends_the_program_while_it_is_opened_is_refused_by_its_name(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Leaves(Part):
        async def __aenter__(self) -> Part:
            sys.exit(0)

    async def open_it() -> None:
        async with AsyncExitStack() as stack:
            spec: Any = SimpleNamespace(where="[sender.link]", factory="own:Link")
            await opening._opened(stack, spec, cast(Any, None))

    monkeypatch.setattr(opening, "create", giving(Leaves("link", [])))
    with pytest.raises(RigError, match=r"\[sender.link\].factory: own:Link cannot be opened"):
        asyncio.run(open_it())


def test_chance_is_repeated_with_a_world_and_is_another_after_a_restart(rig: Any) -> None:
    def drawn(name: str, now_ns: int, seed: int | None) -> float:
        clock: Any = SimpleNamespace(now_ns=lambda: now_ns)
        harness: Any = None if seed is None else SimpleNamespace(seed=seed)
        return opening.entropy_of(name, clock, harness).random()

    first = drawn("sender", 5, 1)
    assert first == drawn("sender", 5, 1)
    others = [drawn("receiver", 5, 1), drawn("sender", 6, 1), drawn("sender", 5, 2)]
    assert first not in others
    assert drawn("sender", 5, None) != drawn("sender", 5, None)


def test_a_guard_is_met_where_its_table_says_or_in_the_world() -> None:
    guard: Any = SimpleNamespace(options={"bind": "127.0.0.1:14561"})
    asked: list[Role] = []

    def line(role: Role) -> str:
        asked.append(role)
        return "in the world"

    world: Any = SimpleNamespace(guard_line=line)
    assert opening.guard_line_of(guard, Role.RECEIVER, LoopClock(1.0), world) == "in the world"
    assert asked == [Role.RECEIVER]
    made: Any = opening.guard_line_of(guard, Role.RECEIVER, LoopClock(1.0), None)
    assert (type(made).__name__, made.name) == ("UdpGuardLine", "127.0.0.1:14561")


@pytest.mark.parametrize("role", list(Role))
def test_each_role_flies_its_own_course(
    rig: Any, role: Role, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, ...]] = []

    class Flown:
        def __init__(self, name: str) -> None:
            self.course = f"{name}'s course"
            self.recover = f"{name}'s way down"

    def flown(name: str) -> Any:
        def make(*args: object) -> Flown:
            asked.append(args)
            return Flown(name)

        return make

    async def open_session(stack: object, *args: object) -> str:
        asked.append(args)
        return "a session"

    async def fly_course(*args: object) -> RoleResult:
        asked.append(args)
        return GOOD

    monkeypatch.setattr(opening, "open_session", open_session)
    monkeypatch.setattr(opening, "fly_course", fly_course)
    monkeypatch.setattr(opening, "Sender", flown("sender"))
    monkeypatch.setattr(opening, "Receiver", flown("receiver"))
    given: Any = SimpleNamespace(store="a store")
    assert asyncio.run(opening.fly(rig, role, given)) is GOOD
    own = role.value
    assert asked[0][:2] == (rig, role) and asked[0][3] is given
    assert asked[1:] == [
        ("a session", "a store"),
        ("a session", f"{own}'s course", f"{own}'s way down"),
    ]


# --- the process


def test_the_program_in_the_world_s_own_process_is_the_same_one(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(*args: object) -> RoleResult:
        assert args == (rig, Role.RECEIVER, "given")
        return GOOD

    monkeypatch.setattr(process, "load_program", lambda: main)
    given: Any = "given"
    assert asyncio.run(process.fly_role(rig, Role.RECEIVER, given)) is GOOD
    monkeypatch.undo()
    assert process.load_program() is opening.fly


def progress(number: int) -> Progress:
    return Progress(Role.SENDER, number, "follow", 0, 1, None, None, None, 0.0, True, "")


@pytest.mark.parametrize("parent", [False, True])
def test_a_role_has_a_log_a_state_file_and_somebody_to_tell(
    tmp_path: Path,
    parent: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    stops: list[object] = []
    monkeypatch.setattr(process, "stop_on_signals", stops.append)
    monkeypatch.setattr(process, "stop_at_end_of_input", stops.append)
    shown: list[Progress] = []

    async def main(rig: object, role: Role, given: ProgramContext) -> RoleResult:
        assert (rig, role, given.harness) == ("a rig", Role.SENDER, None)
        assert stops == [given.stop.set] * (1 + parent) and not given.stop.is_set()
        assert isinstance(given.store, StateFile) and given.store.load() is None
        given.log.write("/note", 5, {"note": "hello"})
        given.emit(progress(3))
        return GOOD

    rig: Any = "a rig"
    state = tmp_path / "sender.state.json"
    result = process.run_role(
        rig, Role.SENDER, tmp_path, state, shown.append, parent=parent, main=main
    )
    assert result == GOOD
    assert [file.name for file in tmp_path.glob("*.mcap")] == ["sender.mcap"]
    lines = [json.loads(line)["event"] for line in capsys.readouterr().out.splitlines()]
    assert lines == (["progress", "result"] if parent else [])
    assert shown == ([] if parent else [progress(3)])


# --- the command


class Told:
    """What ``path-handoff sender`` and ``receiver`` begin, and with what."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.asked: list[tuple[Any, ...]] = []
        self.result = GOOD

        @contextmanager
        def refused(out: object, **options: object) -> Any:
            self.asked.append(("folder", out, options))
            yield folder

        @contextmanager
        def console(stream: object) -> Any:
            assert stream is sys.stdout
            yield SimpleNamespace(show="shown")

        @contextmanager
        def live(*args: object) -> Any:
            self.asked.append(("live", *args))
            yield

        def load(name: object, *, world: bool) -> object:
            self.asked.append(("rig", name, world))
            return "a rig"

        def guarded(*args: object) -> object:
            self.asked.append(("guard", *args))
            return "a rig with its guard"

        def run(*args: object, **options: object) -> RoleResult:
            self.asked.append(("run", *args, options))
            return self.result

        def kept(*flown: object) -> None:
            self.asked.append(("kept", *flown))

        def record(rig: object) -> object:
            self.asked.append(("record", rig))
            return SimpleNamespace(left=lambda: "two are left\n", flight=kept)

        monkeypatch.setattr(command.rig_library, "load", load)
        monkeypatch.setattr(command, "one", giving("what its page may do"))
        monkeypatch.setattr(command, "unless_refused", refused)
        monkeypatch.setattr(command, "open_console", console)
        monkeypatch.setattr(command, "live", live)
        monkeypatch.setattr(command, "with_guard", guarded)
        monkeypatch.setattr(command, "run_role", run)
        monkeypatch.setattr(command, "FirstFlights", record)
        monkeypatch.setattr(command, "parts", giving(["sender.mcap", "sender.1.mcap"]))

    def of(self, name: str) -> list[list[Any]]:
        return [rest for first, *rest in self.asked if first == name]


@pytest.mark.parametrize(
    ("options", "role"), [(SenderOptions, Role.SENDER), (ReceiverOptions, Role.RECEIVER)]
)
def test_a_role_is_flown_with_its_guard_and_told_how_it_ended(
    options: Any,
    role: Role,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    told = Told(tmp_path / "runs" / "now", monkeypatch)
    told.result = RoleResult(role, Outcome.TARGET_LOST, "gone", True, True)
    code = command.run(options("sitl", guard="expect"))
    assert code == Outcome.TARGET_LOST.exit_code != 0
    assert told.of("rig") == [["sitl", False]]
    assert told.of("folder") == [[None, {"beside": True}]]
    assert told.of("guard") == [["a rig", role, "expect", told.folder]]
    assert told.of("live") == [[None, told.folder, "what its page may do"]]
    state = tmp_path / "runs" / f"{role.value}.state.json"
    (run,) = told.of("run")
    assert run[:5] == ["a rig with its guard", role, told.folder, state, "shown"]
    assert run[5] == {"parent": False, "main": process.fly_role}
    said = capsys.readouterr().out
    assert said == f"two are left\n{role.value}: target_lost: gone\nlog: sender.1.mcap\n"
    assert told.of("record") == [["a rig"]]
    assert told.of("kept") == [[role, Outcome.TARGET_LOST]]


def test_an_end_without_a_detail_is_told_by_what_it_means(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Told(tmp_path, monkeypatch)
    assert command.run(SenderOptions("sitl")) == 0
    assert Outcome.COMMITTED.meaning in capsys.readouterr().out


def test_for_another_program_it_says_lines_of_json_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told = Told(tmp_path, monkeypatch)
    out, state = tmp_path / "out", tmp_path / "own.json"
    assert command.run(SenderOptions("sitl", out=out, console="events")) == 0
    assert command.run(SenderOptions("sitl", out=out, state=state, console="events")) == 0
    first, second = told.of("run")
    assert (first[3], second[3]) == (out / "sender.state.json", state)
    assert first[5] == {"parent": True, "main": process.fly_role}
    assert told.of("live") == [] and capsys.readouterr().out == ""
    assert told.of("kept") == 2 * [[Role.SENDER, Outcome.COMMITTED]]
