"""The perception over a camera and a detector: which frames become views, and what a view
answers.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.interfaces import CameraError, Capability, Frame
from drivers.perception.depth_mask import GREY
from drivers.perception.pixels import PixelPerception, PixelPerceptionConfig, PixelView
from drivers.rig.parts import Mount, Origin, PartContext, PartSpec
from drivers.rig.tables import RigError, decode_table
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import UNKNOWN, Box, Detection, Region
from path.target.monocular import TargetSize
from tests.path.marker.scene import Optics, render

CAMERA = CameraModel(160, 120, 200.0, 200.0, 79.5, 59.5)
LEVEL = Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True, slots=True)
class StubConfig:
    name: str = "stub"


class StubCamera:
    """Gives the frames it was handed, in order, then nothing."""

    Config = StubConfig

    def __init__(self, config: StubConfig, context: PartContext) -> None:
        self.model = context.camera
        self.frames: list[Frame] = []
        self.open = False

    async def __aenter__(self) -> StubCamera:
        self.open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self.open = False

    async def read(self, timeout_s: float) -> Frame:
        if not self.frames:
            await asyncio.sleep(timeout_s)
            raise CameraError(f"no frame from the stub for {timeout_s:.3f} s")
        return self.frames.pop(0)


class StubDetector:
    """Counts how often it is asked."""

    Config = StubConfig

    def __init__(self, config: StubConfig, context: PartContext) -> None:
        self.asked: list[Region | None] = []
        self.shown: list[NDArray[np.uint8]] = []
        self.box = Box(1.0, 2.0, 3.0, 4.0)

    def detect(self, image: NDArray[np.uint8], region: Region | None) -> Sequence[Detection]:
        self.asked.append(region)
        self.shown.append(image)
        return (Detection(self.box, 0.5),)


class Clock:
    def now_ns(self) -> int:
        return 0


CONTEXT = PartContext(
    Role.SENDER, Clock(), CAMERA, Mount(LEVEL, LEVEL), single_marker(), Origin(0.0, 0.0, 0.0)
)


def table(**settings: Any) -> dict[str, Any]:
    parts = {
        "camera": {"factory": f"{__name__}:StubCamera"},
        "detector": {"factory": f"{__name__}:StubDetector"},
    }
    return {**parts, **settings}


def perception(**settings: Any) -> tuple[PixelPerception, StubCamera, StubDetector]:
    made = PixelPerception(
        decode_table(table(**settings), PixelPerceptionConfig, "rig.toml: sender.perception"),
        CONTEXT,
    )
    camera, detector = made._camera, made._detector
    assert isinstance(camera, StubCamera)
    assert isinstance(detector, StubDetector)
    return made, camera, detector


def frame(number: int, stamp_ns: int | None = None, depth: bool = True) -> Frame:
    color = np.full((120, 160, 3), number, np.uint8)
    depth_mm = np.full((120, 160), 2000, np.uint16) if depth else None
    return Frame(number * 1000 if stamp_ns is None else stamp_ns, number, color, depth_mm)


def view_of(made: PixelPerception, timeout_s: float = 0.05) -> PixelView:
    return asyncio.run(made.view(timeout_s))


def test_it_opens_and_closes_its_camera() -> None:
    made, camera, _ = perception()

    async def main() -> None:
        async with made:
            assert camera.open
        assert not camera.open

    asyncio.run(main())
    assert made.model is CAMERA


def test_frames_that_wait_already_leave_the_loop_to_the_pilot() -> None:
    """A program that is slower than its camera for a while must go on sending setpoints."""
    made, camera, _ = perception()
    camera.frames = [frame(number) for number in range(1, 21)]
    steps = 0

    async def pilot() -> None:
        nonlocal steps
        while True:
            await asyncio.sleep(0)
            steps += 1

    async def main() -> None:
        flying = asyncio.create_task(pilot())
        for _ in range(20):
            await made.view(0.05)
        flying.cancel()

    asyncio.run(main())
    assert steps >= 20


def test_old_and_repeated_frames_are_never_given() -> None:
    made, camera, _ = perception()
    camera.frames = [
        frame(1),
        frame(1),
        frame(3),
        frame(2),
        frame(4, stamp_ns=3000),
        frame(5),
        frame(5, 6000),
    ]
    views = [view_of(made) for _ in range(3)]
    assert [view.frame_id for view in views] == [1, 3, 5]
    assert [view.stamp_ns for view in views] == [1000, 3000, 5000]
    assert made.dropped == 3
    with pytest.raises(CameraError, match="no frame from the stub"):
        view_of(made)


def test_a_camera_whose_clock_went_back_is_a_fault_after_a_limit() -> None:
    made, camera, _ = perception(max_old_frames=5)
    camera.frames = [frame(1, stamp_ns=10_000_000_000)]
    view_of(made)
    camera.frames = [frame(2 + k, stamp_ns=4_000_000_000 + k) for k in range(20)]
    with pytest.raises(CameraError, match=r"5 frames in a row are no newer .*-6\.000 s"):
        view_of(made)
    assert len(camera.frames) == 15


def test_the_wait_is_bounded_however_many_old_frames_come() -> None:
    made, camera, _ = perception(max_old_frames=10_000)
    camera.frames = [frame(7)]
    view_of(made)
    camera.frames = [frame(7)] * 200_000
    with pytest.raises(CameraError):
        view_of(made, 0.01)


@pytest.mark.parametrize("color_only", [True, False])
def test_frames_of_another_size_than_the_calibration_are_refused_with_both_sizes(
    color_only: bool,
) -> None:
    made, camera, _ = perception()
    small = np.zeros((90, 120), np.uint16)
    good = frame(1)
    camera.frames = [Frame(1, 1, np.zeros((90, 120, 3), np.uint8), None)]
    if not color_only:
        camera.frames = [Frame(1, 1, good.color, small)]
    with pytest.raises(CameraError, match=r"160x120 px .* 120x90 px"):
        view_of(made)


def test_nothing_is_computed_before_it_is_asked() -> None:
    made, camera, detector = perception()
    camera.frames = [frame(9)]
    view = view_of(made)
    assert detector.asked == []
    region = Region(0.0, 0.0, 50.0, 50.0)
    assert view.targets(region)[0].box.w == 3.0
    assert detector.asked == [region]
    assert np.all(view.image() == 9)


def test_the_detector_is_shown_only_what_is_as_far_away_as_the_region_says() -> None:
    made, camera, detector = perception()
    half = frame(9)
    assert half.depth_mm is not None
    half.depth_mm[:] = 1000
    half.depth_mm[:, 80:] = 2000
    camera.frames = [half, frame(10, depth=False)]
    anywhere, near = Region(0.0, 0.0, 50.0, 50.0), Region(0.0, 0.0, 50.0, 50.0, 0.8, 1.2)
    view = view_of(made)
    view.targets(None)
    view.targets(anywhere)
    assert all(shown is half.color for shown in detector.shown)
    view.targets(near)
    cut = detector.shown[2]
    assert (cut[:88, :76] == 9).all()
    assert (cut[:, 84:] != 9).all()
    assert (half.color == 9).all()
    flat = view_of(made)
    flat.targets(near)
    assert (detector.shown[-1] == 10).all()


class Cutting:
    """Finds one thing in the whole image, and its pieces where something is grey."""

    def __init__(self, whole: Detection, pieces: Sequence[Detection]) -> None:
        self.whole, self.pieces = whole, pieces

    def detect(self, image: NDArray[np.uint8], region: Region | None) -> Sequence[Detection]:
        return self.pieces if (image == GREY).all(axis=2).any() else (self.whole,)


def seen_cut(whole: Detection, *pieces: Detection, near_to: int = 80) -> Sequence[Detection]:
    shot = frame(9)
    assert shot.depth_mm is not None
    shot.depth_mm[:] = 1000
    shot.depth_mm[:, near_to:] = 2000
    view = PixelView(shot, CAMERA, single_marker(), Cutting(whole, pieces), MethodConfig())
    return view.targets(Region(0.0, 0.0, 160.0, 120.0, 0.8, 1.2))


def test_what_depth_cuts_off_is_no_target_and_what_it_leaves_alone_keeps_its_edges() -> None:
    both = Detection(Box(40.0, 40.0, 80.0, 40.0), 0.9)
    near = Detection(Box(40.0, 40.0, 40.0, 40.0), 0.9)
    sliver = Detection(Box(84.0, 40.0, 4.0, 40.0), 0.2)
    assert seen_cut(both, near, sliver) == [near]
    nearly_all = Detection(Box(41.0, 40.0, 78.0, 40.0), 0.9)
    assert seen_cut(both, nearly_all) == [both]


def test_a_piece_of_odd_shape_is_a_target_only_when_there_is_no_other_and_its_own_depth_is_right() -> (
    None
):
    both = Detection(Box(40.0, 40.0, 80.0, 40.0), 0.9)
    near, far = (
        Detection(Box(40.0, 40.0, 40.0, 40.0), 0.2),
        Detection(Box(100.0, 40.0, 20.0, 40.0), 0.2),
    )
    assert seen_cut(both, near, far) == [near]
    assert seen_cut(both, far) == []
    assert seen_cut(both) == []


def test_pieces_that_the_cut_made_of_one_thing_are_that_thing_with_its_own_edges() -> None:
    one = Detection(Box(20.0, 20.0, 60.0, 62.0), 0.9)
    upper, lower = (
        Detection(Box(20.0, 20.0, 60.0, 40.0), 0.2),
        Detection(Box(30.0, 50.0, 50.0, 30.0), 0.2),
    )
    assert seen_cut(one, upper, lower, near_to=100) == [one]


def test_the_uncut_image_is_looked_at_only_when_something_is_left_of_the_cut_one() -> None:
    made, camera, detector = perception()
    camera.frames = [frame(9), frame(10)]
    region = Region(0.0, 0.0, 160.0, 120.0, 1.8, 2.2)
    view_of(made).targets(region)
    assert len(detector.shown) == 2
    detector.detect = lambda image, region: detector.shown.append(image) or ()  # type: ignore[method-assign]
    assert view_of(made).targets(region) == []
    assert len(detector.shown) == 3


def test_depth_is_asked_of_the_registered_image() -> None:
    made, camera, _ = perception()
    holes = frame(2)
    assert holes.depth_mm is not None
    holes.depth_mm[:] = 0
    camera.frames = [frame(1), holes, frame(3, depth=False)]
    box = Box(40.0, 30.0, 60.0, 40.0)
    depth = view_of(made).depth(box)
    assert depth is not None
    assert depth.z_m == pytest.approx(2.0)
    assert depth.sigma_m > 0.0
    assert view_of(made).depth(box) is None
    assert view_of(made).depth(box) is None


def test_depth_limits_are_those_of_the_settings() -> None:
    made, camera, _ = perception(method={"max_depth_m": 1.5})
    camera.frames = [frame(1)]
    assert view_of(made).depth(Box(40.0, 30.0, 60.0, 40.0)) is None


@pytest.mark.parametrize("corners", ["photometric", "subpix"])
def test_markers_are_found_in_the_pixels(corners: str) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    printed = cv2.cvtColor(cv2.aruco.generateImageMarker(dictionary, 0, 240), cv2.COLOR_GRAY2BGR)
    large = np.full((480, 640, 3), 255, np.uint8)
    large[100:340, 200:440] = printed
    made, camera, _ = perception(corners=corners)
    camera.frames = [
        Frame(
            1,
            1,
            np.asarray(cv2.resize(large, (160, 120), interpolation=cv2.INTER_AREA), np.uint8),
            None,
        )
    ]
    view = view_of(made)
    (found,) = view.markers(None)
    assert found.marker_id == 0
    expected = [[49.5, 24.5], [109.5, 24.5], [109.5, 84.5], [49.5, 84.5]]
    assert np.abs(found.corners_px - expected).max() < 0.7
    assert found.covariance_px2.shape == (8, 8)
    assert not view.markers(Region(0.0, 0.0, 40.0, 40.0))


def test_a_rig_that_names_no_detector_is_refused() -> None:
    with pytest.raises(RigError, match="missing key 'detector'"):
        decode_table(
            {"camera": table()["camera"]}, PixelPerceptionConfig, "rig.toml: sender.perception"
        )


def test_a_detector_that_wants_the_whole_image_is_asked_once_and_depth_judges_its_boxes() -> None:
    made, camera, detector = perception()
    detector.box = Box(40.0, 30.0, 60.0, 50.0)
    setattr(detector, "whole_image", True)  # noqa: B010 (the stub has no such attribute)
    camera.frames = [frame(1)]
    view = view_of(made)
    at_2_m, elsewhere = (
        Region(0.0, 0.0, 160.0, 120.0, 1.5, 2.5),
        Region(0.0, 0.0, 160.0, 120.0, 3.0, 4.0),
    )
    depth_mm = camera_frame_depth(view)
    depth_mm[:] = 2000
    assert len(view.targets(at_2_m)) == 1
    assert len(view.targets(elsewhere)) == 0
    depth_mm[:] = 0  # not known to be elsewhere
    assert len(view.targets(elsewhere)) == 1
    assert len(detector.asked) == 3
    assert all(np.array_equal(shown, view.image()) for shown in detector.shown)


def camera_frame_depth(view: PixelView) -> NDArray[np.uint16]:
    depth_mm = view._frame.depth_mm
    assert depth_mm is not None
    return depth_mm


# --- a camera without depth


SIZE = TargetSize(apparent_m=0.3, sigma=0.1)
told: list[Any] = []  # regions that the detector was asked about


class NoDepth(StubCamera):
    lacks = frozenset({Capability.RANGE})


def flat_view(boxes: Sequence[Box], size: TargetSize | None) -> PixelView:
    class Finding(StubDetector):
        def detect(self, image: NDArray[np.uint8], region: Region | None) -> Sequence[Detection]:
            told.append(region)
            return [Detection(box, 0.9) for box in boxes]

    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    finding = Finding(StubConfig(), CONTEXT)
    return PixelView(
        Frame(1, 1, image, None), CAMERA, single_marker(), finding, MethodConfig(), size=size
    )


def test_without_depth_the_target_s_size_gives_the_range() -> None:
    box = Box(40.0, 40.0, 30.0, 30.0)
    depth = flat_view([box], SIZE).depth(box)
    assert depth is not None
    assert depth.z_m == pytest.approx(2.0)
    assert flat_view([box], None).depth(box) is None


def test_what_can_only_be_elsewhere_by_its_size_is_left_out() -> None:
    near, far = Box(20.0, 20.0, 60.0, 60.0), Box(100.0, 60.0, 15.0, 15.0)  # 1 m and 4 m
    view = flat_view([near, far], SIZE)
    asked = Region(0.0, 0.0, 160.0, 120.0, near_m=0.7, far_m=1.3)
    assert [each.box for each in view.targets(asked)] == [near]
    assert [each.box for each in view.targets(Region(0.0, 0.0, 160.0, 120.0))] == [near, far]
    assert [each.box for each in flat_view([near, far], None).targets(asked)] == [near, far]


def test_without_depth_the_detector_is_told_how_long_a_target_can_be_there() -> None:
    cut, box = Box(-0.5, 20.0, 60.0, 40.0), Box(70.0, 20.0, 30.0, 30.0)
    view = flat_view([cut, box], replace(SIZE, longest_m=0.4))
    asked = Region(0.0, 0.0, 160.0, 120.0, near_m=1.5, far_m=2.5)
    # what the border cuts is longer than 0.4 m already
    assert [each.box for each in view.targets(asked)] == [box]
    assert [each.box for each in flat_view([cut, box], SIZE).targets(asked)] == [cut, box]
    assert told[-2].extent.longest_px == pytest.approx(0.4 * CAMERA.fx / 2.0)
    assert told[-1].extent == UNKNOWN


def test_a_box_that_is_longer_than_a_target_can_be_there_is_not_its_box() -> None:
    # of sizes that go with 2.2 m and 2 m
    long, box = Box(20.0, 20.0, 60.0, 12.0), Box(90.0, 60.0, 30.0, 30.0)
    asked = Region(0.0, 0.0, 160.0, 120.0, near_m=1.5, far_m=2.5)
    assert [each.box for each in flat_view([long, box], SIZE).targets(asked)] == [long, box]
    assert [
        each.box for each in flat_view([long, box], replace(SIZE, longest_m=0.4)).targets(asked)
    ] == [box]


@pytest.mark.parametrize(("size", "lacks"), [(None, {Capability.RANGE}), (SIZE, set[Capability]())])
def test_a_sight_lacks_what_its_camera_lacks_but_for_ranges_by_size(
    size: TargetSize | None, lacks: set[Capability]
) -> None:
    camera = PartSpec(f"{__name__}:NoDepth", {}, "test: camera")
    detector = PartSpec(f"{__name__}:StubDetector", {}, "test: detector")
    assert (
        PixelPerception(PixelPerceptionConfig(camera, detector, target=size), CONTEXT).lacks
        == lacks
    )


def test_views_of_one_camera_share_what_is_known_of_a_marker() -> None:
    made, _, _ = perception()
    still = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.2]))
    grey = render(CAMERA, still, single_marker(), np.random.default_rng(0), Optics())
    color = np.repeat(grey[:, :, None], 3, axis=2)
    for number in (1, 2, 3):
        view = made.view_of(Frame(number, number, color, None))
        assert len(view.markers(None, still if number > 1 else None)) == 1
    assert made._memory[0].frames == 3
