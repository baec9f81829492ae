"""The pose of a drone's camera, and the direction of down, at the instant a frame was taken."""

from __future__ import annotations

from drivers.interfaces import Vehicle
from drivers.rig.parts import Mount
from flight.guidance import Vec3, add, scale
from path.geometry.rotation import R_from_quat
from path.geometry.transforms import Matrix, Pose


class CameraPose:
    """The camera of a vehicle, by the vehicle's own estimate."""

    def __init__(self, vehicle: Vehicle, mount: Mount) -> None:
        self._vehicle = vehicle
        self._mount = mount

    def R_n_b(self, stamp_ns: int) -> Matrix:
        """Attitude at a role-clock stamp."""
        return R_from_quat(self._vehicle.attitude_at(stamp_ns))

    def T_n_c(self, stamp_ns: int, R_n_b: Matrix) -> Pose:
        """Camera pose in local NED; the newest position is carried to the stamp with its
        velocity.
        """
        state = self._vehicle.state
        dt_s = (stamp_ns - state.stamp_ns) * 1e-9
        north, east, down = add(state.position_n_m, scale(state.velocity_n_mps, dt_s))
        offset = R_n_b @ self._mount.T_b_c.t
        offset[0] += north
        offset[1] += east
        offset[2] += down
        return Pose(R_n_b @ self._mount.T_b_c.R, offset)

    def gravity_v(self, R_n_b: Matrix) -> Vec3:
        """Unit gravity in the frame of the marker this vehicle carries."""
        return gravity_in(R_n_b @ self._mount.T_b_v.R)


def gravity_in(R_n_x: Matrix) -> Vec3:
    """Unit gravity, (0, 0, 1) in ``n``, in a frame of this attitude."""
    x, y, z = R_n_x[2].tolist()
    return x, y, z
