"""The pilot's transmitter behind a real autopilot's simulator: what each kind is sent, and what its
loss is there.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field

import pytest

from drivers.interfaces import PartError
from drivers.mavlink.modes import ARDUPILOT, PX4
from drivers.mavlink.preflight.pilot_rules import kept_out, names_of
from drivers.mavlink.preflight.wanted import refused
from drivers.rig.tables import decode_table
from hil.autopilot.radio import HIGH_US, MIDDLE_US, RadioConfig, Transmitter, channels_of
from hil.autopilot.simulator import Kind
from hil.harness.inject import need_radios
from hil.vehicle.simulators.radio import (
    FAIL,
    FIRST_PORT,
    PORTS_APART,
    SEND_S,
    SET_UP,
    SimulatedRadio,
)
from hil.world.config import WorldConfig
from hil.world.faults import parse_faults
from missions.ground import rig_library
from path.messages import Role

SYSID = 9  # of no rig: its port is free beside a run


@dataclass
class Wire:
    """Keeps what the simulator's connection was given."""

    parameters: dict[str, float] = field(default_factory=dict[str, float])
    asked: list[tuple[str, float]] = field(default_factory=list[tuple[str, float]])
    channels: list[tuple[int, ...]] = field(default_factory=list[tuple[int, ...]])

    def set_parameter(self, name: str, value: float) -> None:
        self.asked.append((name, value))

    def send_channels(self, channels: tuple[int, ...]) -> None:
        self.channels.append(channels)


@pytest.fixture
def port() -> Generator[socket.socket]:
    """Where ArduPilot's simulator of that number would listen."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", FIRST_PORT + PORTS_APART * (SYSID - 1)))
    made.settimeout(60.0)
    try:
        yield made
    finally:
        made.close()


def test_px4_is_sent_its_switches_and_nothing_once_the_radio_is_lost() -> None:
    wire = Wire()
    radio = SimulatedRadio("px4", SYSID, wire)
    radio.pump(0.0)
    radio.send()
    assert wire.channels[0][:4] == (MIDDLE_US,) * 4
    radio.transmitter.kill = True
    radio.send()
    assert wire.channels[-1][6] == HIGH_US
    radio.transmitter.away_until_s = 3.0
    radio.pump(2.0)
    radio.send()
    assert radio.lost and len(wire.channels) == 2
    radio.pump(3.0)
    radio.send()
    assert not radio.lost and len(wire.channels) == 3
    assert wire.asked == []
    radio.close()


def test_ardupilot_gets_pulses_on_its_port_and_is_told_of_a_loss_until_it_knows(
    port: socket.socket,
) -> None:
    wire = Wire()
    radio = SimulatedRadio("ardupilot", SYSID, wire)
    radio.pump(0.0)
    radio.send()
    assert struct.unpack("<8H", port.recv(64)) == channels_of(Transmitter(), RadioConfig())
    assert wire.asked == []
    radio.transmitter.away_until_s = math.inf
    for _ in range(2):
        radio.pump(1.0)
        time.sleep(1.5 * SEND_S)
    assert wire.asked == [(FAIL, 1.0)] * 2
    wire.parameters[FAIL] = 1.0
    radio.pump(1.0)
    assert len(wire.asked) == 2
    radio.transmitter.away_until_s = 0.0
    radio.pump(1.0)
    assert wire.asked[-1] == (FAIL, 0.0)
    radio.close()


def test_it_goes_on_sending_while_the_world_stands_still() -> None:
    wire = Wire()
    radio = SimulatedRadio("px4", SYSID, wire)
    radio.start()
    end_s = time.monotonic() + 60.0
    while len(wire.channels) < 3 and time.monotonic() < end_s:
        time.sleep(SEND_S)
    radio.close()
    sent = len(wire.channels)
    assert sent >= 3
    time.sleep(3.0 * SEND_S)
    assert len(wire.channels) == sent, "closed"


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_with_the_field_rigs_parameters_a_pilot_is_in_command(kind: Kind) -> None:
    rig = rig_library.load(f"sitl-{kind}-field")
    for role in Role:
        own: Mapping[str, float] = rig.role(role).vehicle.options["parameters"]
        assert rig.role(role).vehicle.options["rc"] == "required"
        assert not refused(own, radio=True, companion_id=245)
        autopilot = PX4 if kind == "px4" else ARDUPILOT
        delivered = {"RC_OPTIONS": 32.0, **{f"RC{n}_OPTION": 0.0 for n in range(5, 17)}}
        found = {
            name: {**delivered, **SET_UP[kind], **own}.get(name) for name in names_of(autopilot)
        }
        assert not kept_out(autopilot, found)


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_the_field_rigs_altitudes_are_ten_metres_off_each_way(kind: Kind) -> None:
    config = decode_table(rig_library.load(f"sitl-{kind}-field").world, WorldConfig, "world")
    assert [config.altitude.error_m(number, 0.0) for number in (0, 1)] == [10.0, -10.0]


def test_a_fault_of_a_radio_that_is_not_there_is_refused() -> None:
    faults = parse_faults(("rc_mode_sender@follow",), "sitl")
    need_radios(rig_library.load("sitl-px4-field"), faults)
    need_radios(rig_library.load("sitl"), faults)
    with pytest.raises(PartError, match='rc = "none"'):
        need_radios(rig_library.load("sitl-px4"), faults)
