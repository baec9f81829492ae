from __future__ import annotations

from drivers.interfaces import LinkCounters
from drivers.link.flood import FLOOD_HZ, LinkAlarm

SECOND_NS = 10**9


def looked(alarm: LinkAlarm, at_s: float, **dropped: int) -> str:
    return alarm.look(LinkCounters(dropped=dropped), round(at_s * SECOND_NS))


def test_a_flood_is_told_once_and_so_is_its_end() -> None:
    alarm = LinkAlarm()
    # of what was before the first look nobody knows when it came
    assert looked(alarm, 0.0, flooded=10**6) == ""
    assert "ALARM: 1,500 packets a second" in looked(
        alarm, 2.0, flooded=10**6 + 2000, stranger=1000
    )
    assert looked(alarm, 3.0, flooded=10**6 + 50_000, stranger=1000) == ""
    after = 10**6 + 50_000 + FLOOD_HZ
    assert (
        looked(alarm, 4.0, flooded=after, stranger=1000)
        == looked(alarm, 5.0, flooded=after, stranger=1000)
        == ""
    )
    assert looked(alarm, 6.0, flooded=after, stranger=1000) == "the flood on the link is over"
    assert looked(alarm, 7.0, flooded=after, stranger=1000) == ""
    assert "ALARM" in looked(alarm, 8.0, flooded=after + FLOOD_HZ + 1, stranger=1000)


def test_a_flood_that_comes_and_goes_is_one() -> None:
    alarm = LinkAlarm()
    told = [looked(alarm, float(at_s), flooded=10_000 * (at_s // 2)) for at_s in range(20)]
    assert [bool(each) for each in told].count(True) == 1


def test_a_link_without_one_is_quiet_for_ever() -> None:
    alarm = LinkAlarm()
    assert {looked(alarm, float(at_s), replayed=FLOOD_HZ * at_s) for at_s in range(20)} == {""}


def test_what_was_the_peers_own_is_no_flood() -> None:
    alarm = LinkAlarm()
    assert (
        looked(alarm, 0.0)
        == looked(alarm, 1.0, superseded=9999, inbox_full=9999, network_busy=9999)
        == ""
    )
    assert "ALARM" in looked(
        alarm, 2.0, superseded=9999, inbox_full=9999, bad_signature=FLOOD_HZ + 1
    )


def test_two_looks_at_one_instant_are_one() -> None:
    alarm = LinkAlarm()
    assert looked(alarm, 1.0) == looked(alarm, 1.0, flooded=9999) == ""
