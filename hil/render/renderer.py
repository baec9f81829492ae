"""The synthetic colour-and-depth camera of one drone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from flight.harness.errors import DepthError
from flight.harness.measured import MEASURED
from flight.harness.renderer import Imaging
from hil.render import edges as edge_pass
from hil.render import kernels, primitives, sensor
from hil.render.bodies.crates import crate_body
from hil.render.bodies.kinds import model_of_thing
from hil.render.ground import SCRATCH_ROWS, draw_ground, ground_plane
from hil.render.looks import LOOKS
from hil.render.mosaic import MosaicSensor
from hil.render.overlay import Overlay
from hil.render.scene import MARKER, Body, drone, flying, marked_drone, standing
from hil.render.sensor import SensorNoise
from hil.render.shutter import NO_SWEEP, CameraMotion, Shutter, carried, smear_px, sweep
from hil.render.spoilt import spoil
from hil.render.surfaces import lost_shares
from hil.render.textures import ground_pyramid
from hil.world.config import SceneName
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.arrays import Array, Depths, Image, Singles, Whole
from path.camera.model import CameraModel, sensor_of
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout, single_marker
from path.messages import Role
from path.values import frozen

EXACT_DEPTH = DepthError()
SUN_W = LOOKS["plain"].sun_w
SAMPLES = (edge_pass.hammersley(16), edge_pass.hammersley(64))
STAGES = 8

_Level = TypeVar("_Level", np.uint8, np.uint16)
Exposing = Callable[[Image, int], Image]
"""Makes an image (h, w, 3) of light (3, h, w) and the key of its noise."""


@frozen
class Lens:
    """A camera's rays: per pixel centre, their derivatives by column and row, and bounds per column
    and row.
    """

    rays: tuple[Singles, ...]  # x, y, dx/du, dx/dv, dy/du, dy/dv, each (h, w)
    view: tuple[Array, Array, float]  # column_x (2, w), row_y (2, h), largest pixel on z = 1
    pixel: float  # mean size of a pixel on z = 1


_Looks = tuple[Image, Whole, Image, Whole]
_NO_CELLS = (np.zeros((1, 1, 1), np.uint8), np.ones(1, np.int64))
_NO_SHADES = (np.zeros(1, np.uint8), np.ones((1, 3), np.int64))


class Renderer:
    """Draws what one drone's camera sees: colour with sensor noise, and depth registered to it.

    The same arguments give the same bytes, in every process and in any number of threads. An
    instance keeps scratch buffers: call it from one thread at a time. Different instances share
    nothing that changes.
    """

    def __init__(
        self,
        camera: CameraModel,
        T_b_c: Pose,
        T_b_v: Pose,
        layout: MarkerLayout,
        noise: SensorNoise | None = None,
        seed: int = 0,
        scene: SceneName = "plain",
        imaging: Imaging | None = None,
        shutter: Shutter | None = None,
        depth_error: DepthError = EXACT_DEPTH,
    ) -> None:
        """``T_b_c``: mount of this camera on its drone; ``T_b_v``, ``layout``: the markers on the
        sender.

        The seed is of the noise, and of what lies about in the scene. ``imaging``: one that
        ``MosaicSensor`` does, instead of the colour's blur and noise in ``noise``. ``shutter``: by
        default all is taken in one instant. ``depth_error``: of what ``render`` and ``draw`` give
        as depth.

        Raises:
            ValueError: the camera has pixels without a ray.
        """
        look = LOOKS[scene]
        noise = look.noise(SensorNoise() if noise is None else noise)
        self._kept = None
        if camera.thinning is not None:
            finer = camera.thinning.of / camera.thinning.kept
            noise = replace(noise, blur_sigma_px=noise.blur_sigma_px * finer)
            imaging = imaging and replace(
                imaging,
                blur_sigma_px=imaging.blur_sigma_px * finer,
                sharpen_sigma_px=imaging.sharpen_sigma_px * finer,
            )
            rows, columns = (
                camera.thinning.sensor_pixels(n, k)
                for n, k in ((camera.height, 1), (camera.width, 0))
            )
            self._kept = np.ix_(rows, columns)
            camera = sensor_of(camera)
        height = camera.height
        width = camera.width
        self._T_b_c = T_b_c
        self._camera = camera
        self._shutter = None if shutter is None else look.shutter(shutter)
        self._smear = 0.0, 0.0
        self._depth_error = depth_error
        self.seed = seed
        self.noise = noise
        self._lens = lens_of(camera)
        self._sun_w, self._tints, self._ground = (
            look.sun_w,
            look.tints.rows,
            ground_pyramid(look.ground),
        )
        self._overlay = (
            None if scene == "plain" else Overlay(look, camera, self._lens.rays[:2], seed)
        )
        self._plain = drone()
        self._marked = {
            hidden: marked_drone(T_b_v, layout, hidden=hidden) for hidden in (False, True)
        }
        self._taps = sensor.blur_taps(noise.blur_sigma_px)
        rng = np.random.default_rng(sensor.mixed(seed))
        self._color_pool = sensor.noise_pool(rng, height, width, 0.0)
        self._depth_pool = sensor.noise_pool(rng, height, width, noise.depth_correlation_px)
        self._sensor = (
            None
            if imaging is None
            else MosaicSensor(look.imaging(imaging), height, width, self._color_pool)
        )
        self._image = np.empty((3, height, width), np.uint8)
        self._exposed = np.empty((3, height, width), np.uint8)
        self._inverse_z = np.empty((height, width), np.float32)
        self._owner = np.empty((height, width), np.int16)
        self._edges = np.empty((height, width), np.uint8)
        self._rows = np.empty((SCRATCH_ROWS, width + 2 * self._taps.size), np.float32)
        self._words = np.empty(width, np.int32)

    def render(
        self, snapshot: Snapshot, role: Role, frame_seed: int, exposed: Exposing | None = None
    ) -> tuple[Image, Depths]:
        """The view of ``role``'s camera; that drone itself is not drawn.

        Args:
            frame_seed: any integer; it selects the noise: give every frame its own.
            exposed: what makes an image of light, by default ``expose``.

        Returns:
            Colour, shape (h, w, 3), BGR, and depth, shape (h, w), z in millimetres, 0 where there
            is none.
        """
        key = self.key(role, frame_seed)
        bodies = self.bodies(snapshot, role)
        depth = np.empty(self._inverse_z.shape, np.uint16)
        seen = self._motion(snapshot, role)
        unseen = self._unseen(snapshot, role)
        for _ in self._stages(seen, bodies, key, depth, snapshot.depth_holes, unseen):
            pass
        light = self._image
        spoil(light, snapshot.light, snapshot.smudge, self.seed)
        image = self.expose(light, key) if exposed is None else self.thinned(exposed(light, key))
        return image, self.thinned(depth)

    def render_color(self, snapshot: Snapshot, role: Role, frame_seed: int) -> Image:
        """The colour of ``render`` alone."""
        key = self.key(role, frame_seed)
        bodies = self.bodies(snapshot, role)
        unseen = self._unseen(snapshot, role)
        for _ in self._stages(self._motion(snapshot, role), bodies, key, None, False, unseen):
            pass
        spoil(self._image, snapshot.light, snapshot.smudge, self.seed)
        return self.expose(self._image, key)

    def T_w_c(self, snapshot: Snapshot, role: Role) -> Pose:
        """Return the pose of the camera of ``role``."""
        return snapshot.drones[role].T_w_b @ self._T_b_c

    def _motion(self, snapshot: Snapshot, role: Role) -> CameraMotion:
        own = snapshot.drones[role]
        rates_w = own.T_w_b.R @ np.array(own.rates_b_radps)
        return carried(own.T_w_b, self._T_b_c, np.array(own.velocity_w_mps), rates_w)

    def stages(self, snapshot: Snapshot, role: Role, frame_seed: int) -> Iterator[str]:
        """Do the work of one image, naming every stage before it starts."""
        key = self.key(role, frame_seed)
        depth = np.empty(self._inverse_z.shape, np.uint16)
        seen = self._motion(snapshot, role)
        yield from self._stages(seen, self.bodies(snapshot, role), key, depth, snapshot.depth_holes)
        yield "exposure"
        self.expose(self._image, key)

    def key(self, role: Role, frame_seed: int) -> int:
        """Return the key that selects the noise of one image."""
        return sensor.mixed(self.seed, list(Role).index(role), frame_seed)

    def draw(
        self,
        T_w_b: Pose,
        bodies: Sequence[Body],
        key: int,
        *,
        depth_holes: bool = False,
        unseen: Sequence[Body] = (),
    ) -> tuple[Image, Depths]:
        """Bodies as the camera of the drone at ``T_w_b`` sees them; at most one of them carries
        ideal markers.

        ``unseen``: bodies of which there is only a shadow, in a scene that has shadows.

        Returns:
            Light before optics and sensor, shape (3, h, w), in the order B, G, R, valid until the
            next call; and depth with its noise. Both have the sensor's size, where the camera
            leaves out pixels of it: ``thinned``.
        """
        depth = np.empty(self._inverse_z.shape, np.uint16)
        for _ in self._stages(
            CameraMotion(T_w_b @ self._T_b_c), bodies, key, depth, depth_holes, unseen
        ):
            pass
        return self._image, depth

    def expose(self, light: Image, key: int) -> Image:
        """The camera's image, shape (h, w, 3), BGR, of what ``draw`` gave."""
        if self._sensor is not None:
            return self.thinned(self._sensor.image(light, key, self._smear))
        noise = self.noise
        sensor.expose(
            light,
            self._taps,
            noise.read_sigma,
            noise.shot_gain,
            self._color_pool,
            pool_offset(key, 2),
            pool_offset(key, 3),
            self._rows,
            self._exposed,
        )
        return self.thinned(cv2.merge(tuple(self._exposed)))  # pyright: ignore[reportArgumentType]

    def thinned(self, picture: NDArray[_Level]) -> NDArray[_Level]:
        """The pixels of the sensor's picture (h, w, ...) that are in the camera's."""
        return picture if self._kept is None else np.ascontiguousarray(picture[self._kept])

    def _stages(
        self,
        seen: CameraMotion,
        bodies: Sequence[Body],
        key: int,
        depth: Depths | None,
        depth_holes: bool,
        unseen: Sequence[Body] = (),
    ) -> Iterator[str]:
        """Draw, naming every stage before it starts; leaves the light in ``_image``. No depth where
        it is None.
        """
        rays = self._lens.rays
        view = self._lens.view
        pixel = self._lens.pixel
        x, y, inverse_z, owner, edges, image = (
            *rays[:2],
            self._inverse_z,
            self._owner,
            self._edges,
            self._image,
        )
        T_w_c = seen.T_w_c
        sun_c = T_w_c.R.T @ self._sun_w
        owner.fill(-1)
        edges.fill(kernels.INTERIOR)
        yield "ground"
        plane = ground_plane(T_w_c)
        light = primitives.AMBIENT + primitives.DIFFUSE * self._sun_w[2]
        draw_ground(
            plane,
            light,
            pixel,
            x,
            y,
            self._ground,
            self._tints,
            self._rows,
            self._words,
            image,
            inverse_z,
        )
        if self._overlay is not None:
            self._overlay.on_ground(T_w_c, [*bodies, *unseen], image)
        yield "primitives"
        sweeps = None
        if self._shutter is not None:
            sweeps = [sweep(body, seen, self._camera, self._shutter) for body in bodies]
            self._smear = smear_px(bodies, seen, self._camera, self._shutter)
        faces, tags, count, looks = set_up(bodies, T_w_c.inverse(), sun_c, view, sweeps)
        order = np.empty(count, np.int64)
        rotors = kernels.order_rotors(faces, tags, count, order)
        yield "visibility"
        kernels.draw_faces(faces, tags, count, x, y, inverse_z, owner, edges)
        yield "faces"
        kernels.shade_faces(faces, tags, count, looks, x, y, pixel, owner, edges, image)
        yield "rotors"
        kernels.draw_rotors(faces, order, rotors, tags, x, y, inverse_z, edges, image)
        yield "edges"
        edge_pass.draw_edges(
            faces, tags, count, order, rotors, looks, plane[2], rays, SAMPLES, edges, image
        )
        if self._overlay is not None:
            self._overlay.over_all(T_w_c, image)
        if depth is not None:
            yield "depth"
            noise = self.noise
            pool = self._depth_pool
            error = self._depth_error
            sense_depth(inverse_z, owner, tags, edges, depth_holes, noise, pool, key, depth, error)
            lost = lost_shares(faces, tags, count, sun_c, noise)
            if lost is not None:
                sensor.swallow(owner, lost, key >> 2, depth)

    def _unseen(self, snapshot: Snapshot, role: Role) -> list[Body]:
        """The drone of ``role`` itself: its camera sees its shadow."""
        if self._overlay is None:
            return []
        own = snapshot.drones[role]
        marked = self._marked[snapshot.marker_hidden]
        model = marked if role is Role.SENDER else self._plain
        return [flying(model, own.T_w_b, own.rotor_phase_rad, own.armed)]

    def bodies(self, snapshot: Snapshot, role: Role) -> list[Body]:
        """Everything that the camera of ``role`` may see: all but its own drone."""
        marked = self._marked[snapshot.marker_hidden]
        drones = [
            replace(
                flying(
                    marked if other is Role.SENDER else self._plain,
                    own.T_w_b,
                    own.rotor_phase_rad,
                    own.armed,
                ),
                velocity_w=np.array(own.velocity_w_mps),
                rates_w=own.T_w_b.R @ np.array(own.rates_b_radps),
            )
            for other, own in snapshot.drones.items()
            if other is not role
        ]
        return (
            drones
            + [
                replace(
                    standing(
                        model_of_thing(snapshot.kind, thing, snapshot.stretch),
                        thing.position_w_m,
                        thing.yaw_rad,
                    ),
                    velocity_w=np.array(thing.velocity_w_mps),
                )
                for thing in snapshot.objects
            ]
            + [crate_body(each) for each in (*snapshot.crates, *snapshot.obstacles)]
        )


def sense_depth(
    inverse_z: Singles,
    owner: NDArray[np.int16],
    tags: Whole,
    edges: Image,
    hide_targets: bool,
    noise: SensorNoise,
    pool: NDArray[np.int8],
    key: int,
    depth: Depths,
    error: DepthError = EXACT_DEPTH,
) -> None:
    """Fill ``depth`` with what a depth camera measures of 1/z: noise, limits, holes at steps, and
    its own error.
    """
    sigma = noise.depth_sigma_at_1m_m
    near = noise.min_depth_m
    far = noise.max_depth_m
    row = pool_offset(key, 0)
    column = pool_offset(key, 1)
    off = error.factor, 1000.0 * error.bias_m
    sensor.measure_depth(
        inverse_z, owner, tags, hide_targets, sigma, near, far, off, pool, row, column, depth
    )
    sensor.punch_holes(inverse_z, edges, noise.depth_hole_rate, key >> 1, depth)


def pool_offset(key: int, number: int) -> int:
    """Return the place in its pool at which the noise of an image begins."""
    return (key >> (8 * number)) % sensor.POOL_MARGIN


def set_up(
    bodies: Sequence[Body],
    T_c_w: Pose,
    sun_c: Array,
    view: tuple[Array, Array, float],
    sweeps: Sequence[Array] | None = None,
) -> tuple[Array, Whole, int, _Looks]:
    """Primitives of the bodies, nearest body first, and the cells and shades that they show.

    sweeps: of each body, as ``hil.render.shutter.sweep`` gives it; nothing moves by default.
    """
    swept = [NO_SWEEP] * len(bodies) if sweeps is None else sweeps
    placed = [
        (body, T_c_w @ body.T_w_body, moved) for body, moved in zip(bodies, swept, strict=True)
    ]
    placed.sort(key=lambda pair: float(pair[1].t @ pair[1].t))
    total = sum(len(body.model.kinds) for body in bodies)
    faces = np.empty((total, primitives.COLUMNS))
    tags = np.empty((total, primitives.TAGS), np.int64)
    count = 0
    tables = 0
    for body, pose, moved in placed:
        model = body.model
        R = np.ascontiguousarray(pose.R)
        t = np.ascontiguousarray(pose.t)
        looks = model.colors, model.seconds, model.kinds
        count = primitives.add_body(
            model.corners,
            looks,
            tables,
            R,
            t,
            sun_c,
            body.motion,
            moved,
            body.target,
            view,
            faces,
            tags,
            count,
        )
        tables += len(model.shades)
    marked = (body.model for body in bodies if np.any(body.model.kinds == MARKER))
    cells, sides = next(((model.cells, model.cells_per_side) for model in marked), _NO_CELLS)
    shades = _joined([table for body, _, _ in placed for table in body.model.shades])
    return faces, tags, int(count), (cells, sides, *shades)


def _joined(shades: Sequence[Image]) -> tuple[Image, Whole]:
    """Tables of shades one after the other, flat, and for each where it begins, its rows and its
    columns.
    """
    if not shades:
        return _NO_SHADES
    first = np.cumsum([0, *(table.size for table in shades[:-1])])
    tables = np.array(
        [(start, *table.shape) for start, table in zip(first, shades, strict=True)], np.int64
    )
    return np.concatenate([table.ravel() for table in shades]), tables


def warm_up(progress: Callable[[str, int, int], None] | None = None) -> None:
    """Compile every kernel or load it from numba's cache: some seconds the first time on a machine,
    then a fraction.

    Call it once before processes or threads that render start together. ``progress(stage, number,
    of)`` is called before each of the stages.
    """
    camera = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)
    down = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    level = Pose(np.eye(3), np.zeros(3))
    renderer = Renderer(camera, level, level, single_marker(), imaging=MEASURED)
    drones = {role: DroneTruth(down, (0.0, 0.0, 0.0), 0.0, True) for role in Role}
    snapshot = Snapshot(0.0, drones, (ObjectTruth(0, (0.0, 0.0, 0.0), 0.0, 0.0),))
    for number, stage in enumerate(renderer.stages(snapshot, Role.RECEIVER, 0), 1):
        if progress is not None:
            progress(stage, number, STAGES)
    Renderer(camera, level, level, single_marker()).render_color(
        snapshot, Role.RECEIVER, 0
    )  # an ideal sensor's exposure


@lru_cache(maxsize=3)
def lens_of(camera: CameraModel) -> Lens:
    """Shared: nobody changes it. It takes about a second at 1080p, and cameras often come in
    several renderers.
    """
    height = camera.height
    width = camera.width
    columns, rows = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = camera.rays(np.stack((columns.ravel(), rows.ravel()), axis=1)).reshape(height, width, 2)
    if not np.isfinite(rays).all():
        raise ValueError(f"distortion: {camera.distortion!r} leaves pixels without a ray")
    x = rays[..., 0]
    y = rays[..., 1]
    x_column = np.gradient(x, axis=1)
    x_row = np.gradient(x, axis=0)
    y_column = np.gradient(y, axis=1)
    y_row = np.gradient(y, axis=0)
    jacobians = np.stack((x_column, x_row, y_column, y_row), axis=-1).reshape(-1, 2, 2)
    largest = _largest_singular_value(jacobians)
    column_x = np.stack(
        (np.minimum.accumulate(x.min(axis=0)[::-1])[::-1], np.maximum.accumulate(x.max(axis=0)))
    )
    row_y = np.stack(
        (np.minimum.accumulate(y.min(axis=1)[::-1])[::-1], np.maximum.accumulate(y.max(axis=1)))
    )
    planes = tuple(
        np.ascontiguousarray(p, np.float32) for p in (x, y, x_column, x_row, y_column, y_row)
    )
    return Lens(planes, (column_x, row_y, largest), float(np.sqrt(np.mean(x_column * y_row))))


def _largest_singular_value(matrices: Array) -> float:
    """Over all matrices (n, 2, 2)."""
    half = 0.5 * np.sum(matrices**2, axis=(1, 2))
    return float(
        np.sqrt((half + np.sqrt(np.maximum(half**2 - np.linalg.det(matrices) ** 2, 0.0))).max())
    )
