"""Python files of somebody's own, beside a rig or a mission, from which a class or a coroutine is
taken.
"""

from __future__ import annotations

import importlib.util
import sys
import zlib
from pathlib import Path
from types import ModuleType

from drivers.interfaces import PartError
from drivers.text_file import is_file


def module_of(file: Path, what: str) -> ModuleType:
    """Return the module of a file, loaded once a program unless it was changed. Raises PartError.

    ``what``: what the file is to a person, such as "mission", for messages.
    """
    if not is_file(file):
        raise PartError(f"there is no {what} {file}", f"name the Python file of a {what}")
    path = file.resolve()
    which = f"{path} {path.stat().st_mtime_ns}"  # two files of one name are two modules
    name = f"path_own_{path.stem}_{zlib.crc32(which.encode()):08x}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PartError(f"{file} is no Python file", f"name the {what}'s file, which ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where its dataclasses look for themselves
    try:
        spec.loader.exec_module(module)
    except SystemExit as error:
        del sys.modules[name]
        raise PartError(
            f"{file} cannot be loaded: it {ended_by(error)}", "mend the file"
        ) from error
    except KeyboardInterrupt:
        del sys.modules[name]
        raise
    except BaseException as error:  # an exception of one's own may be of any kind
        del sys.modules[name]
        raise PartError(
            f"{file} cannot be loaded: {type(error).__name__}: {error}", "mend the file"
        ) from error
    return module


def ended_by(error: SystemExit) -> str:
    """Say that code of a rig or a mission ends the program. With 0 it would look like a flight that
    went well.
    """
    return f"ends the program, by sys.exit({error.code!r}) or the like; let it raise an exception"
