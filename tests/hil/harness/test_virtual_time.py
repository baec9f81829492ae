import asyncio

import pytest

from hil.harness.virtual_time import run_virtual


def test_a_long_sleep_costs_nothing_and_moves_the_clock() -> None:
    async def main() -> float:
        await asyncio.sleep(3600.0)
        return asyncio.get_running_loop().time()

    assert run_virtual(main()) == pytest.approx(3600.0)


def test_wake_ups_happen_in_the_order_of_their_due_time() -> None:
    order: list[str] = []

    async def sleeper(name: str, periods: list[float]) -> None:
        for period in periods:
            await asyncio.sleep(period)
            order.append(f"{name}@{asyncio.get_running_loop().time():.2f}")

    async def main() -> None:
        await asyncio.gather(sleeper("a", [0.5, 0.5]), sleeper("b", [0.3, 0.3, 0.3]))

    run_virtual(main())
    assert order == ["b@0.30", "a@0.50", "b@0.60", "b@0.90", "a@1.00"]


def test_a_time_out_fires_at_its_virtual_instant() -> None:
    async def main() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(2.5):
                await asyncio.sleep(10.0)
        return asyncio.get_running_loop().time()

    assert run_virtual(main()) == pytest.approx(2.5)


def test_waiting_for_what_cannot_happen_is_an_error_not_a_hang() -> None:
    async def main() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(RuntimeError, match="every task waits"):
        run_virtual(main())
