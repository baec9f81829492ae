"""D1 searches a field for the car that was reported, follows it, and hands it over to D2."""

import math

from missions.own import Drone

REPORTED_N_M = (4.0, 0.0)  # where somebody saw it, north and east; it drives
NEAR_M = 4.0  # of there; whatever is farther off is something else
# north and east, where to look from
STOPS_M = ((0.0, 0.0), (1.5, 0.0), (1.5, -1.5), (1.5, 1.5), (3.0, 0.0))
FRAMES = 25  # to look at there


async def sender(drone: Drone) -> None:
    await drone.take_off(1.5)
    place_n_m = await search(drone)
    drone.say(f"found at {place_n_m[0]:.1f} m north, {place_n_m[1]:.1f} m east")
    await drone.hand_over(place_n_m, error_m=1.0)


async def receiver(drone: Drone) -> None:
    await drone.take_over(then_follow_s=10.0)
    drone.say("the car is mine, and was in view for ten seconds")


async def search(drone: Drone) -> tuple[float, float, float]:
    for north_m, east_m in STOPS_M:
        await drone.fly_to(north_m, east_m, 1.5, heading_deg=0.0)
        for _ in range(FRAMES):
            seen = drone.objects(await drone.look())
            near = [
                place_n_m for place_n_m in seen if math.dist(place_n_m[:2], REPORTED_N_M) < NEAR_M
            ]
            if near:
                return min(near, key=lambda place_n_m: math.dist(place_n_m[:2], REPORTED_N_M))
    drone.fail("there is no car where it was reported")
