"""Two drones search a field, half of it each. The first to see an object tells the other."""

from missions.own import Drone

HEIGHT_M = {"sender": 2.0, "receiver": 3.0}
EAST_M = {"sender": (-2.5, -1.0), "receiver": (1.0, 2.5)}  # the lanes of each half
NORTH_M = (0.0, 2.0, 4.0)  # where to stop and look on each lane
FRAMES = 10  # to look at there


async def mission(drone: Drone) -> None:
    home_north_m, home_east_m, _ = drone.position_n_m
    await drone.take_off(HEIGHT_M[drone.name])
    await search(drone)
    await drone.fly_to(home_north_m, home_east_m, HEIGHT_M[drone.name])


async def search(drone: Drone) -> None:
    for east_m in EAST_M[drone.name]:
        for north_m in NORTH_M:
            await drone.fly_to(north_m, east_m, HEIGHT_M[drone.name], heading_deg=0.0)
            if other_found(drone) or await found(drone):
                return
    await drone.until(lambda: other_found(drone), 60.0, "no object was found in the field")


async def found(drone: Drone) -> bool:
    for _ in range(FRAMES):
        for place_n_m in drone.objects(await drone.look()):
            drone.observing = True
            drone.log("found", {"place_n_m": place_n_m})
            drone.say(f"object {place_n_m[0]:.1f} m north, {place_n_m[1]:.1f} m east")
            return True
    return False


def other_found(drone: Drone) -> bool:
    return drone.other is not None and drone.other.observing
