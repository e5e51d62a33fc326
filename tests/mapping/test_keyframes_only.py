"""A mapper that is switched off keeps keyframes, and everything that is read from its map is 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.config import configure
from activestructure_gym.errors import InputWarning
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.keyframes_only import KeyframesOnly
from activestructure_gym.reconstruction.parts import make_mapper


@pytest.mark.parametrize("name", ["default", "splatam", "monogs"])
def test_the_map_of_any_mapper_stays_empty(name: str, room_frames: list[Frame]) -> None:
    mapper_changes = {"name": name, "enabled": False, "keyframe_reduction": 5}
    config = configure("fast", {"sensor": {"width": 80, "height": 45}, "mapper": mapper_changes})
    mapper = make_mapper(config, np.array([[0.0, 0, 0], [4, 3, 2.5]]), np.random.default_rng(0))
    assert isinstance(mapper, KeyframesOnly)
    for frame in room_frames[:3]:
        report = mapper.observe(frame)
        assert (report.added, report.count, report.views) == (0, 0, ())
    assert mapper.refine(10).views == () and mapper.events == 4 and mapper.map.count == 0
    kept, frame = mapper.keyframes[2], room_frames[2]
    assert len(mapper.keyframes) == 3 and kept.camera.width == frame.camera.width // 5
    assert np.array_equal(kept.world_from_camera, frame.world_from_camera)
    rendering = mapper.render(frame.camera, frame.world_from_camera)
    assert not rendering.alpha.any() and not rendering.color.any()
    depth, alpha = mapper.render_depth_alpha(frame.camera, frame.world_from_camera[None])
    assert depth.shape == (1, frame.camera.height, frame.camera.width) and not depth.any() and not alpha.any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rgb": np.full((45, 80, 3), 0.5)}, "rgb in uint8 and depth in metres as floats, got float64 and float32"),
        ({"depth": np.full((45, 80), 2000, np.uint16)}, "got uint8 and uint16"),
        ({"world_from_camera": np.full((4, 4), np.nan)}, r"an array \[4, 4\] of finite numbers"),
        ({"world_from_camera": np.eye(3)}, r"an array \[4, 4\] of finite numbers"),
    ],
)
def test_a_frame_of_other_types_is_refused(changes, message, room_frames: list[Frame]) -> None:
    config = configure("fast", {"sensor": {"width": 80, "height": 45}})
    mapper = make_mapper(config, np.array([[0.0, 0, 0], [4, 3, 2.5]]), np.random.default_rng(0))
    with pytest.raises(ValueError, match=message):
        mapper.observe(replace(room_frames[0], **changes))
    assert mapper.map.count == 0


def test_depth_in_millimetres_gets_a_warning(room_frames: list[Frame]) -> None:
    config = configure("fast", {"sensor": {"width": 80, "height": 45}, "mapper": {"enabled": False}})
    mapper = make_mapper(config, np.array([[0.0, 0, 0], [4, 3, 2.5]]), np.random.default_rng(0))
    with pytest.warns(InputWarning, match="if they are in millimetres") as said:
        mapper.observe(replace(room_frames[0], depth=1000.0 * room_frames[0].depth))
    assert said[0].filename == __file__
