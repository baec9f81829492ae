"""What an operator has to know of a flight at this moment, made from its logs record by record.

Called by the live page's server with all that is logged (``follow.Said``); the answer is a plain
dictionary that the page draws and nothing else. Knows neither clients nor clocks: the server says
what time it is. What a field is, is said where it is made.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress

import msgspec

from drivers.log.mcap_log import IMAGE_SCHEMA, image_record
from drivers.log.topics import blank
from flight.phases import words_of
from missions.look.live.alarms import ALARM, TOLD, Alarms, holding
from missions.look.live.drone import SHORT, Drone, Record, Snapshot
from missions.look.live.follow import Said
from missions.look.live.places import Stand, through
from missions.look.live.snapshot import evidence_of, matters, separation_of, shown_of, site_of
from missions.look.replay.logged import camera_of
from path.geometry.rotation import quat_from_rpy
from path.messages import Vec3

TRAIL_NS = 500_000_000  # between two places of a drone's way
PHASES = 64  # of the timeline
VIRTUAL_NS = 3_600_000_000_000  # a flight whose stamps are so far from now is none of this moment
GROUNDED = ("preflight", "waiting", "done")
DRONES_OWN = ("/setup", "/phase", "/state")  # whoever logs one of these is a drone


class FlightState:
    """The drones of a flight, and what was said of it all."""

    def __init__(self) -> None:
        self.drones: dict[str, Drone] = {}
        self.alarms = Alarms()
        self.timeline: deque[Snapshot] = deque(maxlen=PHASES)
        self.newest_ns = 0
        self.first_ns = 0
        self.told = 0  # how often D1 has taken up what it was told
        self._of: dict[str, Callable[[Drone, int, Record], None]] = {
            "/setup": self._on_setup,
            "/home": self._on_home,
            "/phase": self._on_phase,
            "/note": self._on_note,
            "/state": self._on_state,
            "/target": self._on_target,
            "/candidate": self._on_seen,
            "/track": self._on_track,
            "/marker": self._on_marker,
            "/agreement": self._on_agreement,
            "/question": self._on_question,
            "/told": self._on_told,
            "/responsibility": self._on_responsibility,
            "/link": self._on_link,
            "/peer": self._on_peer,
            "/outcome": self._on_outcome,
        }

    # --- records ---

    def take(self, said: Said, now_s: float) -> None:
        """Take up one record; ``now_s``: of a clock that only grows. Never raises for what is in
        it: a record that is none, of somebody's own program, is not shown.
        """
        name, _, own = said.topic.lstrip("/").partition("/")
        topic = f"/{own}"
        utc_ns = said.message.log_time
        with suppress(LookupError, TypeError, ValueError, msgspec.MsgspecError):
            if said.schema.name == IMAGE_SCHEMA and topic == "/image":
                drone = self._drone(name, utc_ns, now_s)
                drone.image = (utc_ns, bytes(image_record(said.message.data)["data"]))
            elif said.encoding == "json":
                record = {**blank(topic), **msgspec.json.decode(said.message.data)}
                self.take_record(name, topic, utc_ns, record, now_s)

    def take_record(
        self, name: str, topic: str, utc_ns: int, record: Record, now_s: float = 0.0
    ) -> None:
        """Take up one that is read already, of the log of that name. Never raises either."""
        with suppress(LookupError, TypeError, ValueError, ArithmeticError):
            self._take(name, topic, utc_ns, record, now_s)

    def _take(self, name: str, topic: str, utc_ns: int, record: Record, now_s: float) -> None:
        of_drone, _, of_guard = name.partition("_")
        if of_guard == "guard":
            self.alarms.take(SHORT.get(of_drone, of_drone) + "'s guard", topic, utc_ns, record)
            return
        if name in self.drones or topic in DRONES_OWN:
            drone = self._drone(name, utc_ns, now_s)
            drone.newest[topic] = (utc_ns, record)
            self.alarms.take(drone.short, topic, utc_ns, record)
            take = self._of.get(topic)
            if take is not None:
                take(drone, utc_ns, record)
            return
        self.alarms.take(name, topic, utc_ns, record)

    def _drone(self, name: str, utc_ns: int, now_s: float) -> Drone:
        drone = self.drones.get(name)
        if drone is None:
            drone = self.drones[name] = Drone(name)
        drone.newest_ns = max(drone.newest_ns, utc_ns)
        drone.heard_s = now_s
        self.newest_ns = max(self.newest_ns, utc_ns)
        self.first_ns = self.first_ns or utc_ns
        return drone

    def _on_setup(self, drone: Drone, utc_ns: int, record: Record) -> None:
        drone.setup = record
        drone.camera = camera_of(record["camera"])

    def _on_home(self, drone: Drone, utc_ns: int, record: Record) -> None:
        north, east = record["off_m"][:2]
        drone.home_off_m = (north, east)
        drone.trail.clear()

    def _on_phase(self, drone: Drone, utc_ns: int, record: Record) -> None:
        drone.phase = record["phase"]
        drone.note = record["note"] or ""
        begun = {"utc_ns": utc_ns, "of": drone.name, "phase": drone.phase}
        self.timeline.append({**begun, "words": words_of(drone.phase)})

    def _on_note(self, drone: Drone, utc_ns: int, record: Record) -> None:
        drone.note = record["note"] or ""
        level = ALARM if drone.note.startswith("ALARM") else TOLD
        self.alarms.say(utc_ns, level, drone.short, drone.note)

    def _on_state(self, drone: Drone, utc_ns: int, record: Record) -> None:
        place = record["position_n_m"]
        if not all(each is not None and math.isfinite(each) for each in place):
            return
        drone.state = record
        drone.heard_radio |= bool(record.get("radio"))
        q = record["q_n_b"]
        drone.stands.append(Stand(utc_ns, (place[0], place[1], place[2]), (q[0], q[1], q[2], q[3])))
        if utc_ns - drone.trail_ns >= TRAIL_NS:
            drone.trail_ns = utc_ns
            north, east = drone.in_crews_frame(place)
            drone.trail.append((north, east))

    def _on_target(self, drone: Drone, utc_ns: int, record: Record) -> None:
        self._on_seen(drone, utc_ns, record)
        point = record["point_v_m"]
        stand = drone.stand_at(utc_ns)
        if point is None or stand is None or drone.setup is None:
            return
        at = stand.of_body(through(drone.setup["T_b_v"], point))
        drone.target = _target(drone, utc_ns, at, _spread(record, stand, at))
        drone.others = list(self._beside(drone, utc_ns, record["beside"] or ()))

    def _beside(self, drone: Drone, utc_ns: int, beside: Sequence[float]) -> Sequence[list[float]]:
        """Return where the objects are that D1 saw beside the target in one frame."""
        places: list[list[float]] = []
        for k in range(0, len(beside), 6):
            x, y, w, h, depth_m, _ = beside[k : k + 6]
            sight = drone.sight_at(utc_ns, (x + w / 2, y + h / 2))
            stand = drone.stand_at(utc_ns)
            if sight is None or stand is None or not depth_m:
                continue
            places.append(drone.in_crews_frame(sight.at(depth_m)))
        return places

    def _on_seen(self, drone: Drone, utc_ns: int, record: Record) -> None:
        if record.get("capture_ns") is not None:
            drone.offset_ns = utc_ns - record["capture_ns"]
        if record["box"] is not None:
            drone.overlays.append((utc_ns, "target", record["box"]))

    def _on_track(self, drone: Drone, utc_ns: int, record: Record) -> None:
        """A drone that follows alone knows no place of the target: its line of sight has one."""
        self._on_seen(drone, utc_ns, record)
        box = record["box"]
        down_m = drone.target_down_m()
        if box is None or down_m is None or drone.setup is None:
            return
        sight = drone.sight_at(utc_ns, (box[0] + box[2] / 2, box[1] + box[3] / 2))
        range_m = None if sight is None else sight.range_to(down_m)
        stand = drone.stand_at(utc_ns)
        if sight is None or range_m is None or stand is None:
            return
        tilt_rad = math.radians(drone.setup["mission"]["attitude_sigma_deg"])
        across_m = range_m * tilt_rad
        spread = (across_m / max(sight.direction_n[2], 0.1), across_m, sight.bearing_rad)
        north, east = sight.at(range_m)
        drone.target = _target(drone, utc_ns, (north, east, down_m), spread)

    def _on_marker(self, drone: Drone, utc_ns: int, record: Record) -> None:
        if record["corners_px"] is not None:
            drone.overlays.append((utc_ns, "marker", record["corners_px"][:8]))

    def _on_agreement(self, drone: Drone, utc_ns: int, record: Record) -> None:
        if record["mapped_box"] is not None and record["capture_ns"] is not None:
            at_ns = record["capture_ns"] + drone.offset_ns
            drone.overlays.append((at_ns, "mapped", record["mapped_box"]))

    def _on_question(self, drone: Drone, utc_ns: int, record: Record) -> None:
        shown = record["shown"] or ()
        drone.others = [drone.in_crews_frame(each["place_n_m"]) for each in shown]
        text = f"asks which of {len(shown)} objects is meant"
        self.alarms.say(utc_ns, ALARM, drone.short, text)

    def _on_told(self, drone: Drone, utc_ns: int, record: Record) -> None:
        self.told += 1

    def _on_responsibility(self, drone: Drone, utc_ns: int, record: Record) -> None:
        drone.responsible = bool(record["responsible"])
        until_ns = record["until_ns"]
        drone.responsible_until_ns = None if until_ns is None else until_ns + drone.offset_ns

    def _on_link(self, drone: Drone, utc_ns: int, record: Record) -> None:
        drone.links.append((utc_ns, record))

    def _on_peer(self, drone: Drone, utc_ns: int, record: Record) -> None:
        """Show the other drone by what was heard of it, where its own log is on another computer.

        It says its place in the crew's frame.
        """
        other = self.drones.get(record["role"])
        named_otherwise = drone.name not in SHORT  # of a relay, whose drones' logs are all here
        if named_otherwise or (other is not None and other.setup is not None):
            return
        other = self._drone(record["role"], utc_ns, drone.heard_s)
        if other.phase != record["phase"]:
            self._on_phase(other, utc_ns, {"phase": record["phase"], "note": ""})
        flying = record["phase"] not in GROUNDED
        q = quat_from_rpy(0.0, 0.0, record["yaw_rad"] or 0.0)
        heard = {"mode": f"as {drone.short} hears", "armed": flying, "q_n_b": q}
        self._on_state(other, utc_ns, {**record, **heard})
        other.responsible = bool(record["responsible"])
        if record["ended"]:
            other.outcome = {"outcome": record["ended"], "detail": ""}

    def _on_outcome(self, drone: Drone, utc_ns: int, record: Record) -> None:
        drone.outcome = record

    # --- what is shown ---

    def image_of(self, name: str) -> tuple[int, bytes] | None:
        """Return the newest image of a drone: its stamp, ns of UTC, and JPEG."""
        drone = self.drones.get(name)
        return None if drone is None else drone.image

    def now(self, now_s: float, utc_ns: int) -> Snapshot:
        """Return what changes all the time; ``now_s``: as in ``take``, ``utc_ns``: of this
        computer.
        """
        shown = self._two()
        # in virtual time a log comes in pieces of many seconds
        real_time = abs(utc_ns - self.newest_ns) < VIRTUAL_NS
        now: Snapshot = {
            "utc_ns": self.newest_ns,
            "since_s": round((self.newest_ns - self.first_ns) * 1e-9, 1),
            "drones": [shown_of(drone, now_s if real_time else drone.heard_s) for drone in shown],
            "separation": separation_of(shown),
            "evidence": evidence_of(shown),
            "target": self._target(shown),
            "others": [place for drone in shown for place in drone.others],
            "events": self.alarms.newest(),
        }
        now["holds"] = holding(now)
        now["matters"] = matters(now)
        return now

    def slow(self) -> Snapshot:
        """Return what changes every now and then: ways, phases, and the site."""
        shown = self._two()
        setup = next((drone.setup for drone in shown if drone.setup is not None), None)
        return {
            "rig": None if setup is None else setup["rig"],
            "level": None if setup is None else setup["level"],
            "site": None if setup is None else site_of(setup),
            "trails": {drone.name: [list(place) for place in drone.trail] for drone in shown},
            "timeline": list(self.timeline),
            "first_ns": self.first_ns,
        }

    def _two(self) -> list[Drone]:
        """Return the drones that have been heard of, D1 first."""
        order = {"sender": 0, "receiver": 1}
        return sorted(self.drones.values(), key=lambda each: (order.get(each.name, 2), each.name))

    def _target(self, shown: Sequence[Drone]) -> Snapshot | None:
        """Return the newest place of the target that any drone knew."""
        known = [drone.target for drone in shown if drone.target is not None]
        if not known:
            return None
        newest = max(known, key=lambda each: each["utc_ns"])
        return {**newest, "age_s": round((self.newest_ns - newest["utc_ns"]) * 1e-9, 1)}


def _target(
    drone: Drone, utc_ns: int, at_n_m: Vec3, spread: tuple[float, float, float]
) -> Snapshot:
    """Return the target's place; its ellipse is of three standard deviations."""
    major_m, minor_m, turned_rad = spread
    return {
        "utc_ns": utc_ns,
        "by": drone.name,
        "place_m": drone.in_crews_frame(at_n_m),
        "ellipse_m": [round(3.0 * major_m, 3), round(3.0 * minor_m, 3)],
        "turned_rad": round(turned_rad, 3),
    }


def _spread(record: Record, stand: Stand, at_n_m: Vec3) -> tuple[float, float, float]:
    """Return the standard deviations along the line of sight and across, m, and its bearing."""
    bearing_rad = math.atan2(at_n_m[1] - stand.position_n_m[1], at_n_m[0] - stand.position_n_m[0])
    sigma_m = record["sigma_m"] or 0.0
    depth_m = record["depth_sigma_m"] or sigma_m
    return max(sigma_m, depth_m), sigma_m, bearing_rad
