"""Generates the MAVLink dialect's module before a wheel or an editable install is made of this
folder.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

GENERATOR = Path("drivers") / "link" / "dialect" / "generate.py"


class DialectHook(BuildHookInterface[Any]):
    """Runs the same generator as ``python -m drivers.link.dialect.generate``, of which nothing is
    installed yet.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        spec = importlib.util.spec_from_file_location(
            "generate_dialect", Path(self.root) / GENERATOR
        )
        assert spec is not None and spec.loader is not None
        generator = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(generator)
        generator.generate(generator.GENERATED)
        build_data["artifacts"].append(str(generator.GENERATED.relative_to(self.root)))
