"""``path-handoff doctor``: is everything there that a flight needs, on this machine and in a rig?
Nothing moves.
"""

from __future__ import annotations

import importlib
import os
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import TextIO

from drivers.interfaces import PartError
from drivers.realsense.sdk_import import import_realsense
from drivers.rig.check import local_ports
from drivers.rig.computer_check import clock_finding, write_finding
from drivers.rig.part_check import Finding
from drivers.rig.parts import Rig
from drivers.rig.tables import RigError
from flight.command_end import CommandEnd
from missions.field.doctor.parts import part_tests, run_test
from missions.field.doctor.room import check_room
from missions.field.doctor.table import open_findings
from missions.field.doctor.vehicle import check_vehicle
from missions.fly.leg.alike import alike_of
from missions.ground import rig_library
from missions.ground.computer import computer_findings
from missions.ground.first_flights import FirstFlights
from missions.ground.kernel_cache import VARIABLE, can_write, usual_folders
from missions.ground.options.field import DoctorOptions
from missions.ground.rig_library import mission_of
from path.alike import differing
from path.messages import Role

EXIT_UNFIT = CommandEnd.NOT_FIT.exit_code
OPENCV = (
    "opencv-contrib-python-headless",
    "opencv-python-headless",
    "opencv-contrib-python",
    "opencv-python",
)
REALSENSE = "drivers.realsense.camera:RealSense"


def run(options: DoctorOptions, out: TextIO | None = None) -> int:
    """Show every finding as it is found; return 0, or EXIT_UNFIT when a fault is among them."""
    stream = out or sys.stdout
    with open_findings(stream) as shown:
        for finding in asked(options, shown.doing):
            shown.add(finding)
    faults = sum(finding.state == "fault" for finding in shown.found)
    stream.write(verdict(shown.found, tested=options.role != "none" or options.rehearse) + "\n")
    if options.rehearse:
        stream.write("rehearsed with stand-ins: nothing of this was hardware\n")
    if options.role != "none" and not faults and not any(each.untested for each in shown.found):
        record = FirstFlights(rig_library.load(options.rig))
        record.doctor(Role(options.role))
        stream.write(record.left())
    return EXIT_UNFIT if faults else 0


def verdict(found: Sequence[Finding], *, tested: bool) -> str:
    """The last line. Of what was not tried nothing is promised.

    Args:
        tested: whether a role's parts were to be tested.
    """
    faults = [finding.name for finding in found if finding.state == "fault"]
    notes = sum(finding.state == "note" for finding in found)
    untested = ", ".join(finding.name for finding in found if finding.untested)
    but = f"; not tested: {untested}" if untested else ""
    if faults:
        named = ", ".join(dict.fromkeys(faults))
        return (
            f"{len(faults)} fault{'s' if len(faults) > 1 else ''} ({named}): not ready to fly{but}"
        )
    if untested:
        return f"no fault, but not known to be ready to fly{but}"
    besides = f", {notes} note{'s' if notes > 1 else ''}" if notes else ""
    return (
        f"ready to fly{besides}"
        if tested
        else f"ready{besides}; --role sender or --role receiver tests its parts too"
    )


def asked(options: DoctorOptions, doing: Callable[[str], None]) -> Iterator[Finding]:
    """This machine and the rig, then what else was named. Raises PartError for what was asked
    wrongly.

    Args:
        doing: told what is measured now, before anything that takes seconds.
    """
    if options.slow is not None and options.role == "none":
        raise PartError("--slow: whose computer?", "add --role sender or --role receiver")
    if options.rehearse and (options.role, options.vehicle) != ("none", "none"):
        raise PartError(
            "--rehearse tests stand-ins of both roles", "leave out --role and --vehicle"
        )
    if options.set_parameters and options.vehicle == "none":
        raise PartError("whose parameters?", "add --vehicle sender or --vehicle receiver")
    readable = True
    for finding in findings(options.rig):
        readable = readable and (finding.name, finding.state) != ("rig", "fault")
        yield finding
    if not readable:
        return  # its parts are not known
    if options.rehearse:
        from missions.field.doctor.rehearse import rehearsal  # noqa: PLC0415 (it knows of flights)

        yield from rehearsal(options.rig, doing)
    if options.other is not None:
        yield from check_pair(rig_library.load(options.rig), options.other)
    if options.role != "none":
        doing("this computer: its disk and clock")
        yield write_finding(Path("runs"))
        yield clock_finding()
        rig = rig_library.load(options.rig)
        role = Role(options.role)
        doing("this computer: its time for a frame of several sizes, up to half a minute")
        yield from of_computer(rig, role, options.slow or 1.0)
        for test in part_tests(rig, role):
            doing(f"{test.name}: {test.doing}")
            yield from run_test(test)
    if options.vehicle != "none":
        doing(f"{options.vehicle} vehicle: its parameters")
        rig = rig_library.load(options.rig)
        yield from check_vehicle(
            rig, Role(options.vehicle), options.set_parameters, Path("runs") / "parameters"
        )


def of_computer(rig: Rig, role: Role, share: float) -> Iterator[Finding]:
    """The computer's time for this role's frames; what kept it from being measured is a fault
    too.
    """
    try:
        yield from computer_findings(rig, role, share)
    except PartError as error:
        yield Finding("fault", f"{role.value} computer", str(error), error.remedy)


def findings(rig: str) -> Iterator[Finding]:
    """All that is checked, in order."""
    yield check_python()
    yield check_paths()
    yield check_opencv()
    for name, module in (
        ("MAVSDK", "mavsdk"),
        ("pymavlink", "pymavlink.dialects.v20.minimal"),
        ("numba", "numba"),
    ):
        yield _check_import(name, module)
    yield check_realsense(needed=uses(rig, REALSENSE))
    yield check_kernel_cache()
    yield check_room(rig)
    yield from check_rig_file(rig)


def check_python() -> Finding:
    cores = len(os.sched_getaffinity(0))
    running = (
        f"{sys.version_info.major}.{sys.version_info.minor}.{sys.version_info.micro}, {cores} cores"
    )
    if cores < 2:
        return Finding(
            "note", "Python", running, "rigs in real time need 2 cores; the sim levels do not"
        )
    return Finding("ok", "Python", running)


def check_paths() -> Finding:
    """PyPI has a package ``path`` too, and names such as ``drivers`` are anybody's."""
    here = Path(__file__).resolve().parents[3]
    for name in ("path", "drivers", "flight", "missions", "hil"):
        found = importlib.import_module(name).__file__
        if found is None or Path(found).resolve().parent.parent != here:
            return Finding(
                "fault",
                "packages",
                f"'import {name}' gives {found}",
                f"uninstall the other package '{name}'",
            )
    return Finding("ok", "packages", str(here))


def check_opencv() -> Finding:
    """Exactly one OpenCV, with ArUco and without windows: two of them overwrite each other's
    files.
    """
    installed = [name for name in OPENCV if _version(name)]
    fix = f"pip uninstall -y {' '.join(OPENCV)}, then install {OPENCV[0]}"
    try:
        cv2 = importlib.import_module("cv2")
    except ImportError as error:
        return Finding("fault", "OpenCV", str(error), fix)
    detail = f"{cv2.__version__} from {', '.join(installed)}"
    if not hasattr(cv2, "aruco"):
        return Finding(
            "fault", "OpenCV", f"{detail}, without ArUco: another OpenCV has overwritten it", fix
        )
    gui = [
        line.split(":")[1].strip()
        for line in cv2.getBuildInformation().splitlines()
        if "GUI:" in line
    ]
    if gui and gui[0] != "NONE":
        return Finding(
            "fault", "OpenCV", f"{detail}, built with {gui[0]} windows: not the headless one", fix
        )
    if len([name for name in installed if not _is_stub(name)]) > 1:
        return Finding(
            "note", "OpenCV", f"{detail}: several share one folder, which one works is luck", fix
        )
    return Finding("ok", "OpenCV", detail)


def uses(rig: str, factory: str) -> bool:
    """Return whether a camera of the rig is of this kind; not when the rig cannot be read, which
    is said elsewhere.
    """
    try:
        loaded = rig_library.load(rig)
    except RigError:
        return False
    cameras = [own.perception.options.get("camera", {}) for own in (loaded.sender, loaded.receiver)]
    return any(camera.get("factory") == factory for camera in cameras)


def check_realsense(*, needed: bool) -> Finding:
    try:
        module = import_realsense()
    except PartError as error:
        return Finding("fault" if needed else "note", "RealSense", str(error), error.remedy)
    return Finding("ok", "RealSense", f"pyrealsense2 {getattr(module, '__version__', '')}")


def check_kernel_cache() -> Finding:
    """Find where numba keeps what it compiled: without such a place no command starts."""
    wanted = os.environ.get(VARIABLE)
    folders = (Path(wanted),) if wanted else usual_folders()
    for folder in folders:
        if can_write(folder):
            return Finding("ok", "kernel cache", str(folder))
    return Finding(
        "fault", "kernel cache", "no folder can be written to", f"set {VARIABLE} to a folder"
    )


def check_rig_file(name: str) -> Iterator[Finding]:
    """The rig as a flight would load it, then its ports."""
    try:
        rig = rig_library.load(name)
    except RigError as error:
        for problem in error.problems:
            yield Finding("fault", "rig", problem)
        return
    sizes = {f"{own.camera.width}x{own.camera.height}" for own in (rig.sender, rig.receiver)}
    yield Finding(
        "ok", "rig", f"{rig.file}: level {rig.level}, cameras {' and '.join(sorted(sizes))}"
    )
    free: list[str] = []
    for port, option in sorted(local_ports(rig).items()):
        if _is_free(port):
            free.append(f"{port} for {option}")
        else:
            fix = "is another flight going on, or a ground station? End it, or name another port in the rig"
            yield Finding("fault", "port", f"{port} for {option} is in use", fix)
    if free:
        yield Finding("ok", "ports", ", ".join(free))


def check_pair(rig: Rig, other: str) -> Iterator[Finding]:
    """The other drone's rig: nothing in it may differ of what both must have alike."""
    try:
        theirs = rig_library.load(other)
        found = differing(*(alike_of(each, mission_of(each).separation) for each in (rig, theirs)))
    except RigError as error:
        for problem in error.problems:
            yield Finding("fault", "other rig", problem)
        return
    for what in found:
        fix = "copy one rig file to both companions"
        yield Finding("fault", "other rig", f"{theirs.file} differs in {what}", fix)
    if not found:
        yield Finding(
            "ok", "other rig", f"{theirs.file}: alike in what both drones must have alike"
        )


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", port))
        except OSError:
            return False
    return True


def _check_import(name: str, module: str) -> Finding:
    try:
        importlib.import_module(module)
    except (ImportError, OSError) as error:
        return Finding("fault", name, str(error), "install PATH again, in a fresh environment")
    return Finding("ok", name, _version(module.partition(".")[0]) or "")


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _is_stub(package: str) -> bool:
    """A distribution that brings no files of its own, only a name."""
    return not any(str(file).startswith("cv2") for file in distribution(package).files or ())
