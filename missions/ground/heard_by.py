"""Where D1's program hears which object is meant, by its rig: for a terminal and for the live
page.
"""

from __future__ import annotations

from drivers.interfaces import PartError
from drivers.link.udp import address_of
from drivers.operator.udp import UdpOperatorConfig
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table

HEARD_BY = "drivers.operator.udp:UdpOperator"


def is_heard(rig: Rig) -> bool:
    """Return whether D1's program hears anybody by UDP."""
    spec = rig.sender.operator
    return spec is not None and spec.factory == HEARD_BY


def operator_of(rig: Rig) -> tuple[str, int]:
    """Return where D1's program listens. Raises PartError when its rig hears nobody."""
    spec = rig.sender.operator
    if spec is None or spec.factory != HEARD_BY:
        raise PartError(
            f"{rig.where('[sender.operator]')}: nobody is heard by UDP",
            f'write it with factory = "{HEARD_BY}"',
        )
    return address_of(
        decode_table(spec.options, UdpOperatorConfig, spec.where, spec.base).bind, "bind"
    )
