"""The ground of a team: which drone is sent to which target, when, and what those on the ground do.

The drones decide when they need relief, by their own batteries; the ground assigns
(``missions.fly.team.assignment``), sees to it that no two ways through the air cross
(``missions.fly.team.airways``), and has a target pointed at again that was lost. Responsibility
does not depend on it: the protocol runs between the two drones of each leg, and nobody else.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from flight.guidance import Vec3
from flight.harness.fleet import TeamConfig
from flight.harness.relay import Pointed
from flight.outcome import MissionEnd, Outcome
from missions.fly.relay.crew import Crew, end_of
from missions.fly.relay.ground import Leg, SentTo, TakeOffOrder, TurnedBack
from missions.fly.team.airways import Airway, in_the_way, way_back, way_out
from missions.fly.team.assignment import Airspace, Assignment, Need, ReadyDrone, assign
from missions.fly.team.needs import needs_of
from missions.fly.team.roster import TeamDrone, TeamTarget

# of battery, at least, to find a target on the way home: until it has it, and is relieved
_STAYS_S = 180.0
_HELD_BACK_S = 60.0  # without anybody on its way to a lost target, while drones stand ready


@dataclass
class TeamBase(Crew[TeamConfig, TeamDrone]):
    """The ground of a team: legs of many targets at once."""

    targets: list[TeamTarget] = field(init=False)

    def __post_init__(self) -> None:
        self.drones = {
            own.name: TeamDrone(name=own.name, home_m=own.home_m, battery=own.battery)
            for own in self.config.drones
        }
        self.targets = [
            TeamTarget(number, named) for number, named in enumerate(self.config.targets)
        ]

    # --- what the drones' programs ask and say ---

    def called_home(self, name: str) -> bool:
        return self.drones[name].called_home

    def leg_of(self, name: str) -> Leg | None:
        return self.drones[name].leg

    def target_of(self, name: str) -> TeamTarget:
        """The target that a drone is sent to, or has."""
        number = self.drones[name].target
        assert number is not None, "asked for a drone that was not called"
        return self.targets[number]

    def sent_to(self, name: str) -> SentTo:
        target = self.target_of(name)
        return SentTo(target.number, target.place_n_m, self.drones[name].heading_deg)

    def pointed_at(self, name: str) -> Pointed:
        return self._field.point_at(self.target_of(name).number)

    def ask(self, name: str, battery: float, wait_s: float) -> None:
        target = self.target_of(name)
        if name == target.holder:
            target.asking = battery, self._now_s() + wait_s

    def follows(self, name: str, place_n_m: Vec3) -> None:
        target = self.target_of(name)
        if name == target.holder:
            target.place_n_m = place_n_m

    def holds(self, name: str) -> None:
        drone = self.drones[name]
        target = self.target_of(name)
        leg = drone.leg
        if leg is not None:
            leg.held_s = self._now_s()
            self._close_leg(leg, Outcome.COMMITTED.label)
        target.holder = name
        target.finder = None
        target.asking = None
        target.alarmed = False
        drone.has_nothing = False
        self._begin_spell(target.number, name)
        drone.ways.clear()
        where = target.named.name
        self._say(
            name,
            "holds",
            f"{where}: responsible" + ("" if leg is None else f", relieved {leg.sender}"),
        )

    def leg_failed(self, name: str, end: MissionEnd) -> None:
        leg = self.drones[name].leg
        if leg is not None:
            self._close_leg(leg, end.outcome.label, end.detail)
            self.drones[name].ways.clear()  # it stays
            relief = self.drones[leg.receiver]
            # it may be down before its sender knows: then no way is flown
            if relief.where == "flying":
                relief.ways.append(self._back(relief.name, leg.target))
            self._say(name, "leg failed", f"leg {leg.number}, relief {leg.receiver}: {end}")

    def gave_up(self, name: str, why: str) -> None:
        drone = self.drones[name]
        target = self.target_of(name)
        if drone.leg is not None:
            self._close_leg(drone.leg, Outcome.PEER_ABORTED.label, why)
        drone.ways.append(self._back(name, target.number))
        drone.has_nothing = True
        self._lose(target, name, why)

    def may_find(self, name: str, wait_s: float) -> None:
        drone = self.drones[name]
        target = self.target_of(name)
        drone.has_nothing = True
        if wait_s < _STAYS_S:
            if target.finder == name:  # it comes home after all
                drone.turned_back = "no"
                target.finder = None
            return
        if self.over or drone.turned_back != "no" or not self._nobody_has(target, name):
            return
        if target.holder == name:  # it handed it over to one that is dead
            if drone.leg is not None:
                self._close_leg(drone.leg, Outcome.ORPHANED.label)
            self._lose(target, name, "nobody said that it holds it")
        if self._now_s() - target.lost_s >= self.config.point_s:
            drone.turned_back = "wait"
            drone.order = TakeOffOrder.FIND
            target.finder = name
            self._say(name, "find", f"{target.named.name}, turns back on its way home")

    def turned_back(self, name: str) -> TurnedBack:
        drone = self.drones[name]
        target = self.target_of(name)
        if drone.turned_back == "wait":
            out = way_out(drone.home_m, target.place_m, self.config.area_m)
            if not in_the_way((out,), self._flown(but=drone), self.config.clear_route_m):
                drone.turned_back = "go"
                drone.ways.append(out)
        return drone.turned_back

    # --- the loop ---

    def _step(self, time_is_over: bool) -> None:
        if time_is_over and not self.over:
            self._time_is_over()
        self._name_targets()
        self._look_after_the_ground()
        if self.over:
            self._call_home()
        else:
            self._see_to_the_targets()

    def _finished(self) -> bool:
        return self.over and not self._flying()

    def _time_is_over(self) -> None:
        self.over = True
        without = [
            t.named.name for t in self.targets if t.known and t.holder is None and t.finder is None
        ]
        if without:
            self.outcome = Outcome.TARGET_LOST
            self.detail = f"in the end nobody had {', '.join(without)}"

    def _call_home(self) -> None:
        """Those that have a target, one after the other where their ways cross."""
        for target in self.targets:
            drone = None if target.holder is None else self.drones[target.holder]
            if drone is None or drone.called_home or target.leg is not None:
                continue
            back = self._back(drone.name, target.number)
            if not in_the_way((back,), self._flown(), self.config.clear_route_m):
                drone.called_home = True
                drone.ways.append(back)

    def _name_targets(self) -> None:
        for target in self.targets:
            if not target.known and self._now_s() >= target.named.named_at_s and not self.over:
                target.known, (east, north) = True, target.named.place_m
                target.place_n_m = north, east, 0.0
                target.lost_s = self._now_s() - self.config.point_s
                self._say("", "named", f"{target.named.name}, {east:g} m east, {north:g} m north")

    def _program_over(self, drone: TeamDrone) -> bool:
        """Whatever it had to do is over, said or not."""
        if drone.target is not None:
            self._let_go(drone, self.targets[drone.target])
        return True

    def _landed(self, drone: TeamDrone) -> None:
        drone.target = None
        drone.ways.clear()

    def _nobody_has(self, target: TeamTarget, name: str) -> bool:
        """Nobody but this one, which says that it is not, can be responsible for the target, or is
        on its way to it.
        """
        if target.finder is not None or target.holder not in (None, name):
            return False
        others = (
            each
            for each in self.drones.values()
            if each.name != name and each.target == target.number
        )
        return all(each.has_nothing or each.task is None or each.task.done() for each in others)

    def _let_go(self, drone: TeamDrone, target: TeamTarget) -> None:
        if drone.leg is not None:
            leg = drone.leg
            if drone.name == leg.receiver:
                return  # its sender finds out by itself, within the protocol
            self._close_leg(leg, "sender over", end_of(drone.result))
        if target.finder == drone.name:
            target.finder, target.lost_s = None, self._now_s()
        if target.holder == drone.name:
            self._lose(target, drone.name, end_of(drone.result))

    def _lose(self, target: TeamTarget, name: str, why: str) -> None:
        target.holder = None
        target.asking = None
        target.lost_s = self._now_s()
        target.alarmed = False
        self._end_spell(target.number)
        self._field.given_up(target.number)
        if not self.over:
            self._say(name, "lost", f"{target.named.name}: {why}")

    # --- assignment ---

    def _see_to_the_targets(self) -> None:
        ready = [
            ReadyDrone(name, drone.home_m, drone.battery)
            for name, drone in self.drones.items()
            if drone.where == "ready"
        ]
        needs = needs_of(self.targets, self._now_s(), self.config, self._field.point_at)
        chosen = assign(needs, ready, self._ways, self._air())
        for choice in chosen:
            self._send(choice)
        served = {choice.target for choice in chosen}
        for need in needs:
            if need.target not in served:
                self._alarm(self.targets[need.target], bool(ready))

    def _ways(self, need: Need, drone: ReadyDrone) -> tuple[Airway, ...]:
        """Of the drone that is sent, and of the one that it relieves."""
        out = way_out(drone.home_m, need.place_m, self.config.area_m)
        holder = self.targets[need.target].holder
        return (out,) if holder is None else (out, self._back(holder, need.target))

    def _back(self, name: str, target: int) -> Airway:
        return way_back(self.drones[name].home_m, self.targets[target].place_m, self.config.area_m)

    def _flown(self, but: TeamDrone | None = None) -> list[Airway]:
        """The ways that are kept free, but for one drone's own."""
        return [way for drone in self.drones.values() if drone is not but for way in drone.ways]

    def _air(self) -> Airspace:
        config = self.config
        return Airspace(self._flown(), config.clear_route_m, config.entry_m, config.transit_mps)

    def _send(self, choice: Assignment) -> None:
        drone = self.drones[choice.drone]
        target = self.targets[choice.target]
        need = Need(target.number, target.place_m, choice.heading_deg)
        ways = self._ways(need, ReadyDrone(drone.name, drone.home_m, drone.battery))
        if in_the_way(ways, self._flown(), self.config.clear_route_m):
            return  # another one of the same moment is in its way: a little later
        drone.target = target.number
        drone.heading_deg = target.heading_deg = choice.heading_deg
        drone.ways.append(ways[0])
        if target.holder is None:
            target.finder = drone.name
            order = TakeOffOrder.FIND
            self._field.assign(drone.name, target.number)
            self._say(
                drone.name, "find", f"{target.named.name}, heading {choice.heading_deg:.0f} degrees"
            )
        else:
            order = TakeOffOrder.RELIEVE
            self._open_leg(drone, target, ways[1])
        drone.called_home = False
        drone.has_nothing = False
        drone.turned_back = "no"
        self._call(drone, order)

    def _open_leg(self, drone: TeamDrone, target: TeamTarget, back: Airway) -> None:
        assert target.holder is not None and target.asking is not None
        sender = self.drones[target.holder]
        battery = target.asking[0]
        leg = Leg(
            len(self.legs) + 1,
            sender.name,
            drone.name,
            self._now_s(),
            battery,
            target=target.number,
        )
        self.legs.append(leg)
        target.leg = sender.leg = drone.leg = leg
        sender.ways.append(back)
        self._field.open_leg(leg.number, sender.name, drone.name)
        what = f"leg {leg.number}, {target.named.name}: relieves {sender.name}, battery at {100 * battery:.0f} %"
        self._say(drone.name, "call", what)

    def _close_leg(self, leg: Leg, outcome: str, detail: str = "") -> None:
        leg.outcome = outcome
        leg.detail = detail
        for name in (leg.sender, leg.receiver):
            if self.drones[name].leg is leg:
                self.drones[name].leg = None
        target = self.targets[leg.target]
        target.leg = None
        target.asking = None
        self._field.close_leg(leg.number)

    def _alarm(self, target: TeamTarget, ready: bool) -> None:
        """Nobody was sent to a target that needs it: none is ready, or those that are have been
        held back for long.
        """
        without_s = self._now_s() - target.lost_s if target.holder is None else 0.0
        if target.alarmed or (ready and without_s < _HELD_BACK_S):
            return
        target.alarmed = True
        left_s = None if target.asking is None else target.asking[1] - self._now_s()
        until = "" if left_s is None else f"; it is given up in {left_s:.0f} s otherwise"
        why = f"no drone is ready, {self._soonest()}"
        if ready:
            why = f"for {without_s:.0f} s no ready drone had a free way, or may take it"
        self._say(target.holder or "", "alarm", f"{target.named.name}: {why}{until}")
