"""What keyframes have seen of each voxel of surface: by hand, and against the sums made anew."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, fibonacci_directions, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.policies.r3_recon.surface_views import DIRECTIONS, VOXEL, SurfaceViews

CAMERA = PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5)  # one pixel, straight ahead


def look(eye: list, direction: list, depth: float, colour: tuple) -> Frame:
    pose = look_along(np.array(eye, float), np.array(direction, float))
    return Frame(np.array([[colour]], np.uint8), np.full((1, 1), depth, np.float32), pose, CAMERA)


def test_two_looks_at_one_voxel_by_hand() -> None:
    middle = np.array([2.025, 0.025, 0.025])  # of a voxel
    first = look([0.025, 0.025, 0.025], [1, 0, 0], 2.0, (0, 0, 0))
    second = look([2.025, 1.025, 0.025], [0, -1, 0], 1.0, (255, 255, 0))
    voxels = SurfaceViews().update([first])
    assert voxels.centres == pytest.approx(middle[None]) and voxels.spread[0] == 0.0 and voxels.nearest[0] == 2.0
    assert voxels.update([first, second]) is voxels
    assert voxels.views.tolist() == [2.0] and voxels.colour[0] == pytest.approx([0.5, 0.5, 0.0])
    assert voxels.spread[0] == pytest.approx(2 * 0.5)  # of 0 and 1 in two colours, over n - 1
    assert voxels.nearest[0] == pytest.approx(1.0)
    expected = 0
    for back in ([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]):
        expected |= 1 << int((fibonacci_directions(DIRECTIONS) @ back).argmax())
    assert int(voxels.directions[0]) == expected and expected.bit_count() == 2
    voxels.update([first, second])
    assert voxels.views.tolist() == [2.0]  # each keyframe once
    with pytest.raises(ValueError, match="expected the 2 keyframes"):
        voxels.update([first])


def test_pixels_of_one_picture_are_one_look_with_the_colour_at_the_centre() -> None:
    camera = PinholeCamera(2, 1, 200.0, 200.0, 0.9, 0.5)  # 1 cm between the pixels at 2 m; the centre is in the first
    pose = look_along(np.array([0.025, 0.025, 0.025]), np.array([1.0, 0.0, 0.0]))
    rgb = np.array([[[51, 0, 0], [255, 0, 0]]], np.uint8)
    voxels = SurfaceViews().update([Frame(rgb, np.full((1, 2), 2.0, np.float32), pose, camera)])
    assert voxels.views.tolist() == [1.0] and voxels.spread[0] == 0
    assert voxels.colour[0] == pytest.approx([0.2, 0.0, 0.0])


def test_a_voxel_whose_centre_is_beside_the_picture_is_known_and_not_seen() -> None:
    camera = PinholeCamera(1, 1, 200.0, 200.0, -1.0, 0.5)  # the pixel is 1.5 cm beside the centre of the voxel
    pose = look_along(np.array([0.025, 0.025, 0.025]), np.array([1.0, 0.0, 0.0]))
    rgb = np.zeros((1, 1, 3), np.uint8)
    voxels = SurfaceViews().update([Frame(rgb, np.full((1, 1), 2.0, np.float32), pose, camera)])
    assert voxels.centres == pytest.approx(np.array([[2.025, 0.025, 0.025]]))
    assert voxels.views.tolist() == [0.0] and voxels.directions.tolist() == [0]


def test_many_looks_one_by_one_are_those_of_all_together(rng: np.random.Generator) -> None:
    camera = PinholeCamera.from_size(24, 18)
    frames = []
    for angle in np.linspace(0.0, 5.0, 6):
        direction = np.array([np.cos(angle), np.sin(angle), 0.1])
        rgb = rng.integers(0, 256, (18, 24, 3)).astype(np.uint8)
        depth = (1.0 + rng.random((18, 24)) * (rng.random((18, 24)) > 0.1)).astype(np.float32)
        frames.append(Frame(rgb, depth, look_along(-0.3 * direction, direction), camera))
    voxels = SurfaceViews()
    for number in range(1, len(frames) + 1):
        voxels.update(frames[:number])
    seen: dict[tuple, list] = {}
    for frame in frames:
        pose = frame.world_from_camera
        points = camera.backproject(frame.depth) @ pose[:3, :3].T + pose[:3, 3]
        for voxel in {tuple(np.floor(point / VOXEL).astype(int)) for point in points.reshape(-1, 3)}:
            column, line = camera.project(((np.array(voxel) + 0.5) * VOXEL - pose[:3, 3]) @ pose[:3, :3])
            colours = seen.setdefault(voxel, [])
            if 0 <= column < 24 and 0 <= line < 18:
                colours.append(frame.rgb[int(line), int(column)] / 255.0)
    assert len(seen) == len(voxels.centres)
    for row, centre in enumerate(voxels.centres):
        colours = np.array(seen[tuple(np.floor(centre / VOXEL).astype(int))])
        assert voxels.views[row] == len(colours)
        if len(colours):
            assert voxels.colour[row] == pytest.approx(colours.mean(axis=0))
        spread = colours.var(axis=0, ddof=1).sum() if len(colours) > 1 else 0.0
        assert voxels.spread[row] == pytest.approx(spread, abs=1e-12)
    assert max(voxels.views) > 1
