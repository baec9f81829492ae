"""The helpers that the tests of the doctor's parts share."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from drivers.rig.part_check import Finding
from missions.field.doctor.parts import PartTest, run_test

LIMIT_S = 60.0


def found(findings: AsyncIterator[Finding]) -> dict[str, Finding]:
    """By what was looked at; ``""`` is what ended the test."""
    every = run_test(PartTest("part", "now", lambda: findings), LIMIT_S)
    return {finding.name.removeprefix("part").strip(): finding for finding in every}


def states(findings: dict[str, Finding]) -> dict[str, str]:
    return {name: finding.state for name, finding in findings.items()}


async def both(one: AsyncIterator[Finding], other: AsyncIterator[Finding]) -> list[list[Finding]]:
    async def all_of(findings: AsyncIterator[Finding]) -> list[Finding]:
        return [finding async for finding in findings]

    async with asyncio.timeout(LIMIT_S):
        return list(await asyncio.gather(all_of(one), all_of(other)))
