"""The processes of a run in real time: started, told things, listened to, and ended whatever
happens.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.camera.shared import RUN_VARIABLE

Child = asyncio.subprocess.Process
END_S = 5.0
STOPPED_S = 20.0
REMIND_S = 5.0
WORLD_READY_S = 180.0  # the first start compiles the renderer
FINDINGS_S = 10.0


class HarnessFailure(Exception):
    """The simulation itself failed: not the mission's fault."""


class WorldTooSlow(HarnessFailure):
    """The world was not ready in time; says how long was waited, and for what."""


def run_name() -> str:
    """Return the name of this process's run, for what its children share."""
    return f"run-{os.getpid()}"


async def spawn(
    command: Sequence[str],
    errors: Path,
    run: str = "",
) -> Child:
    """A child in a session of its own: Ctrl-C in the terminal reaches only this process, which then
    decides.

    ``run`` names what it shares with the world; by default this process's run.
    """
    with errors.open("ab") as stderr:
        return await asyncio.create_subprocess_exec(
            *command,
            env={**os.environ, RUN_VARIABLE: run or run_name(), "PYTHONUNBUFFERED": "1"},
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=stderr,
            start_new_session=True,
        )


async def read_world(world: Child) -> dict[str, Any]:
    """The next line of the world's process; empty for one that is no event. Raises HarnessFailure
    when it ended.
    """
    assert world.stdout is not None
    line = await world.stdout.readline()
    if not line:
        raise HarnessFailure(
            f"the world's process ended (exit code {await world.wait()}): see world.stderr.txt"
        )
    try:
        event = json.loads(line)
    except ValueError:
        return {}
    if event.get("event") == "failed":
        raise HarnessFailure(str(event["what"]))
    return event


async def until_ready(world: Child, warming: Callable[[str], None]) -> dict[str, Any]:
    """Its event, once it is; ``warming`` is called with what it does until then, every few seconds.

    Raises HarnessFailure, and WorldTooSlow when it takes too long.
    """
    doing = "starting"

    async def remind() -> None:
        while True:
            await asyncio.sleep(REMIND_S)
            warming(doing)

    reminder = asyncio.create_task(remind())
    try:
        async with asyncio.timeout(WORLD_READY_S):
            while (event := await read_world(world)).get("event") != "ready":
                if event.get("event") == "warming":
                    doing = str(event["what"])
                    warming(doing)
            return event
    except TimeoutError:
        raise WorldTooSlow(
            f"the start of the world: not ready within {WORLD_READY_S:.0f} s, {doing}"
        ) from None
    finally:
        reminder.cancel()


async def finish_world(world: Child, landing_s: float) -> dict[str, Any]:
    """Let the world run until all vehicles are down, so long at most, and take its findings. Raises
    HarnessFailure.
    """
    await tell(world, {"finish": landing_s})
    try:
        async with asyncio.timeout(landing_s + FINDINGS_S):
            while (event := await read_world(world)).get("event") != "finished":
                pass
            return event
    except TimeoutError:
        raise HarnessFailure("the world did not end") from None


def write(process: Child, line: bytes) -> None:
    """One line, without waiting until it is taken; to nobody when the process is gone."""
    assert process.stdin is not None
    with contextlib.suppress(ConnectionError):
        process.stdin.write(line)


async def tell(process: Child, command: Mapping[str, Any]) -> None:
    """One command as a line of JSON."""
    assert process.stdin is not None
    with contextlib.suppress(ConnectionError):
        process.stdin.write(json.dumps(command).encode() + b"\n")
        await process.stdin.drain()


def send_signal(process: Child, number: signal.Signals) -> None:
    if process.returncode is None:
        process.send_signal(number)


async def end(processes: Sequence[Child]) -> None:
    """Ends processes, children of children included, and leaves nothing behind."""
    for process in processes:
        if process.stdin is not None:
            process.stdin.close()
    for process in processes:
        try:
            async with asyncio.timeout(END_S):
                await process.wait()
        except TimeoutError:
            pass
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        await process.wait()


async def go_on(process: Child, after_s: float | None) -> None:
    """Let a stopped program go on. One that is not to is ended when its vehicle is long down: the
    run must go on.
    """
    await asyncio.sleep(STOPPED_S if after_s is None else after_s)
    send_signal(process, signal.SIGKILL if after_s is None else signal.SIGCONT)


async def kill_after(process: Child, seconds: float) -> None:
    await asyncio.sleep(seconds)
    send_signal(process, signal.SIGKILL)


async def end_gently(process: Child) -> None:
    """Told to end, and ended when it does not."""
    send_signal(process, signal.SIGTERM)
    try:
        async with asyncio.timeout(END_S):
            await process.wait()
    except TimeoutError:
        send_signal(process, signal.SIGKILL)
        await process.wait()


async def drain(process: Child) -> None:
    """Read a program's output to its end: what nobody reads must not fill its pipe."""
    assert process.stdout is not None
    async for _ in process.stdout:
        pass


def duty_of(state_file: Path) -> str:
    """Return the duty in a program's record; "" when there is none."""
    try:
        return str(json.loads(state_file.read_bytes())["record"]["duty"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def last_words(errors: Path) -> str:
    """Return the last words of a program that died."""
    if not errors.exists():
        return "It was never started."
    written = errors.read_text("utf-8", "replace").split("\n")
    return " ".join(line.strip() for line in written if line.strip())[-300:]
