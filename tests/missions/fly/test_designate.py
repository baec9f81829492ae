"""``path-handoff designate``: what is said at a terminal is heard by D1, and what D1 asks is shown
and answered.
"""

from __future__ import annotations

import asyncio
import io
import os
import socket
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from drivers.operator.interfaces import BearingTold, Chosen, PlaceTold
from drivers.operator.udp import UdpOperator, UdpOperatorConfig
from missions.fly import designate
from missions.ground import rig_library
from missions.ground.options.field import DesignateOptions
from tests.drivers.operator.test_udp import Clock, Context, until_heard
from tests.drivers.operator.test_words import QUESTION
from tests.free_ports import free_port


def rig_with_port(folder: Path, port: int) -> str:
    file = folder / "my-rig.toml"
    text = rig_library.whole("sitl-light")
    assert 'bind = "127.0.0.1:47041"' in text
    file.write_text(text.replace("127.0.0.1:47041", f"127.0.0.1:{port}"), "utf-8")
    return str(file)


def test_a_place_and_a_direction_are_heard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = free_port()
    rig = rig_with_port(tmp_path, port)

    async def say() -> None:
        async with UdpOperator(
            UdpOperatorConfig(f"127.0.0.1:{port}"), Context(Clock())
        ) as operator:
            place = DesignateOptions(rig, place=(4.2, 1.5), error_m=0.4)
            assert await asyncio.to_thread(designate.run, place) == 0
            told = await until_heard(operator, 1)
            assert isinstance(told[0], PlaceTold)
            assert (told[0].place_n_m, told[0].error_m) == ((4.2, 1.5, 0.0), 0.4)
            assert (
                await asyncio.to_thread(designate.run, DesignateOptions(rig, bearing_deg=40.0)) == 0
            )
            assert isinstance((await until_heard(operator, 1))[0], BearingTold)

    asyncio.run(say())
    assert "4.2" in capsys.readouterr().out


def test_a_question_is_shown_and_the_number_that_is_typed_is_the_answer(tmp_path: Path) -> None:
    port = free_port()
    picture, shown = tmp_path / "which.jpg", io.StringIO()

    async def answer() -> None:
        async with UdpOperator(
            UdpOperatorConfig(f"127.0.0.1:{port}"), Context(Clock())
        ) as operator:
            operator.ask(QUESTION, b"jpeg")
            read, write = os.pipe()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line, os.fdopen(read) as keys:
                line.connect(("127.0.0.1", port))
                talking = asyncio.create_task(
                    asyncio.to_thread(designate.answer_questions, line, keys, shown, picture)
                )
                while "which one" not in shown.getvalue():  # noqa: ASYNC110 (another thread writes)
                    await asyncio.sleep(0.01)
                os.write(write, b"what\n7\n")
                assert await until_heard(operator, 1) == [Chosen(3, 7)]
                os.close(write)
                assert await talking == 0

    asyncio.run(asyncio.wait_for(answer(), 60.0))
    assert "+4.0 m north" in shown.getvalue()
    assert picture.read_bytes() == b"jpeg"


def test_a_rig_that_hears_nobody_and_a_program_that_does_not_run_are_named(tmp_path: Path) -> None:
    with pytest.raises(PartError, match="nobody is heard by UDP"):
        designate.run(DesignateOptions("sim", place=(1.0, 1.0)))
    with pytest.raises(PartError, match="nobody answers"):
        designate.run(DesignateOptions(rig_with_port(tmp_path, free_port()), place=(1.0, 1.0)))
    with pytest.raises(PartError, match="two statements"):
        designate.run(DesignateOptions("sitl-light", place=(1.0, 1.0), bearing_deg=3.0))
