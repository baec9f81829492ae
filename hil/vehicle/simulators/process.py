"""PX4 (SIH) and ArduCopter (SITL) simulators as child processes, each with its own numbers, home
and working folder.

Nothing of an autopilot comes with PATH: the binary is named by the user. A child gets a process
group of its own and dies with this process, however that ends.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from drivers.interfaces import PartError
from drivers.mavlink.preflight.parameters import RENAMED
from hil.autopilot.simulator import Kind
from path.values import frozen

BINARY_VARIABLE: dict[Kind, str] = {"px4": "PATH_PX4", "ardupilot": "PATH_ARDUPILOT"}
PROGRAM: dict[Kind, str] = {"px4": "px4", "ardupilot": "arducopter"}
FIRST_PORT = 14540  # PX4's own scheme for its companion link; ArduPilot is told to keep to it
FIRST_GUARD_PORT = 14030  # PX4's second link for a companion: the guard has it to itself
FIRST_TRUTH_PORT = 19410  # where PX4's SIH sends what is true
MAX_SYSID = 10  # PX4 gives all instances from the eleventh on one port
STOP_S = 3.0
LAST_WORDS = 400
# PX4 changed the unit from 1e-7 degrees to degrees; how the default is written tells which this is.
PX4_HOME = """case "$(param show -q SIH_LOC_{name}0)" in
*.*) param set SIH_LOC_{name}0 {degrees:.7f} ;;
*) param set SIH_LOC_{name}0 {whole} ;;
esac
"""

# Becomes the simulator after telling the kernel to kill it when this process ends, even by kill -9
# (PR_SET_PDEATHSIG).
DIE_WITH_PARENT = "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 9, 0, 0, 0); os.execv(sys.argv[1], sys.argv[1:])"

# What ArduCopter's simulated quadrotor needs before it agrees to arm: a frame, and sensors that
# count as calibrated.
ARDUPILOT_AIRFRAME: dict[str, float] = {
    "FRAME_CLASS": 1, "FRAME_TYPE": 0,
    "ATC_RAT_YAW_P": 0.09, "ATC_RAT_YAW_I": 0.009,
    "MOT_THST_EXPO": 0.65, "MOT_THST_HOVER": 0.39, "MOT_BAT_VOLT_MIN": 9.6, "MOT_BAT_VOLT_MAX": 12.8,
    "BATT_MONITOR": 4,
    **{f"COMPASS_OFS{n}_{axis}": offset for n in ("", "2", "3") for axis, offset in (("X", 5), ("Y", 13), ("Z", -18))},
    **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"},
    "LOG_BACKEND_TYPE": 0,
}  # fmt: skip


class SimulatorBroken(Exception):
    """An autopilot's simulator could not be started, died or fell silent: no mission is to
    blame.
    """


@frozen
class Home:
    """The place where a simulated vehicle starts; altitude above mean sea level, heading from
    north.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    heading_deg: float = 0.0


def binary_of(kind: Kind) -> Path:
    """The simulator that was named. Raises PartError with what to do."""
    variable = BINARY_VARIABLE[kind]
    program = PROGRAM[kind]
    written = os.environ.get(variable, "")
    remedy = (
        f"build {program} for SITL (docs/autopilots.md), then give --{kind} PATH or set {variable}"
    )
    if not written:
        raise PartError(f"this rig needs {program}, and none was named", remedy)
    try:
        path = Path(written).expanduser().resolve()
    except RuntimeError:  # ~ of nobody that is known here
        path = Path(written)
    if not path.is_file() or not os.access(path, os.X_OK):
        raise PartError(f"{variable} = {written}: there is no such program", remedy)
    if kind == "px4":
        _px4_etc(path)
    return path


def _px4_etc(binary: Path) -> Path:
    """PX4's start-up scripts, as its build leaves them: ``bin/px4`` beside ``etc``."""
    for folder in (binary.parent.parent, binary.parent):
        if (folder / "etc" / "init.d-posix" / "rcS").is_file():
            return folder / "etc"
    raise PartError(
        f"{binary} has no etc/init.d-posix/rcS beside it",
        "name bin/px4 inside PX4's build folder, not a copy of it",
    )


class AutopilotProcess:
    """One running simulator. ``start`` returns at once; ``check`` raises SimulatorBroken when it
    has died.
    """

    def __init__(
        self,
        kind: Kind,
        sysid: int,
        home: Home,
        parameters: Mapping[str, float],
        folder: Path,
        speedup: float = 1.0,
    ) -> None:
        """``folder`` is its working folder: emptied, and left for whoever wants to read its
        output.
        """
        if not 1 <= sysid <= MAX_SYSID:
            raise PartError(
                f"sysid {sysid}: a simulated {kind} needs one within 1..{MAX_SYSID}",
                "change it in the rig",
            )
        self.kind: Kind = kind
        self.sysid = sysid
        self.folder = folder
        self._home = home
        self._parameters = parameters
        self._speedup = speedup
        self._child: subprocess.Popen[bytes] | None = None

    @property
    def output(self) -> Path:
        return self.folder / "output.txt"

    def start(self) -> None:
        """Raise PartError, or SimulatorBroken when the program cannot be run."""
        binary = binary_of(self.kind)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        prepare = self._prepare_px4 if self.kind == "px4" else self._prepare_ardupilot
        command, variables = prepare(binary)
        with self.output.open("wb") as output:
            try:
                self._child = subprocess.Popen(
                    [sys.executable, "-I", "-c", DIE_WITH_PARENT, *command],
                    cwd=self.folder,
                    env={**os.environ, **variables},
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
            except OSError as error:
                raise SimulatorBroken(f"{binary} cannot be run: {error.strerror}") from error

    def check(self) -> None:
        """Raise SimulatorBroken with its last words when it has ended."""
        code = None if self._child is None else self._child.poll()
        if code is not None:
            how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
            raise SimulatorBroken(
                f"{self.kind} of vehicle {self.sysid} ended ({how}): {self.last_words()}"
            )

    def last_words(self) -> str:
        """The end of what it printed."""
        if not self.output.exists():
            return "it printed nothing"
        lines = (line.strip() for line in self.output.read_text("utf-8", "replace").splitlines())
        return " | ".join(line for line in lines if line)[-LAST_WORDS:] or "it printed nothing"

    def stop(self) -> None:
        """End it and whatever it started. Idempotent; bounded by STOP_S, then it is killed."""
        child = self._child
        self._child = None
        if child is None:
            return
        for number, wait_s in ((signal.SIGTERM, STOP_S), (signal.SIGKILL, STOP_S)):
            try:
                os.killpg(child.pid, number)
            except ProcessLookupError:
                break
            try:
                child.wait(wait_s)
            except subprocess.TimeoutExpired:
                continue
        child.wait()

    def _prepare_px4(self, binary: Path) -> tuple[list[str], dict[str, str]]:
        """PX4's rcS sources ``px4-rc.simulator`` from PATH after the airframe's defaults; ours goes
        on with its.
        """
        home = self._home
        instance = self.sysid - 1
        parameters = {"SIH_LOC_H0": home.altitude_m, "SDLOG_MODE": -1, **self._parameters}
        script = PX4_HOME.format(
            name="LAT",
            degrees=home.latitude_deg,
            whole=round(home.latitude_deg * 1e7),
        )
        script += PX4_HOME.format(
            name="LON",
            degrees=home.longitude_deg,
            whole=round(home.longitude_deg * 1e7),
        )
        script += "".join(f"param set {name} {value:.9g}\n" for name, value in parameters.items())
        script += ". ${R}etc/init.d-posix/px4-rc.simulator\n"  # R: where rcS found itself
        (self.folder / "px4-rc.simulator").write_text(script, "ascii")
        variables = {
            "PX4_SIM_MODEL": "sihsim_quadx",
            "PX4_SIMULATOR": "sihsim",
            "PATH": f"{self.folder}:{os.environ.get('PATH', os.defpath)}",
        }
        return [str(binary), "-i", str(instance), "-d", str(_px4_etc(binary))], variables

    def _prepare_ardupilot(self, binary: Path) -> tuple[list[str], dict[str, str]]:
        home = self._home
        instance = self.sysid - 1
        defaults = self.folder / "defaults.parm"
        # Under every name it had: a version passes over those it does not know.
        parameters = dict(ARDUPILOT_AIRFRAME)
        for name, value in self._parameters.items():
            parameters |= dict.fromkeys((name, *RENAMED.get(name, ())), value)
        defaults.write_text(
            "".join(f"{name} {value:.9g}\n" for name, value in parameters.items()), "ascii"
        )
        place = f"{home.latitude_deg:.9f},{home.longitude_deg:.9f},{home.altitude_m:.3f},{home.heading_deg:.3f}"
        options = {
            "--model": "quad",
            "--home": place,
            "-I": str(instance),
            "--sysid": str(self.sysid),
            "--serial0": f"udpclient:127.0.0.1:{FIRST_PORT + instance}",
            "--serial1": f"udpclient:127.0.0.1:{FIRST_TRUTH_PORT + instance}",
            "--serial2": f"udpclient:127.0.0.1:{FIRST_GUARD_PORT + instance}",
            "--defaults": str(defaults),
            "--speedup": f"{self._speedup:g}",
        }
        return [str(binary), *(word for option in options.items() for word in option)], {}
