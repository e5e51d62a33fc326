"""Co-SLAM as a mapper: a room is learnt, its surface is the map, and what cannot be known of it is refused."""

import dataclasses

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.mapping import MAPPERS
from activestructure_gym.mapping.systems.co_slam.mapper import CoSLAMMapper, rays_of
from tests.mapping.conftest import ROOM

SMALL = {"levels": 4, "log2_entries": 12, "finest_m": 0.1, "rays": 128, "first_rounds": 5, "surface_m": 0.1}


def _mapper(seed=0, **changes):
    config = dataclasses.replace(MAPPERS.get("co_slam"), **{**SMALL, **changes})
    return CoSLAMMapper(config, np.random.default_rng(seed), np.array([np.zeros(3) - 0.1, ROOM + 0.1]))


def test_rays_end_at_the_points_of_a_frame(room_frames):
    frame = room_frames[3]
    rays = rays_of(frame, 7)
    ends = frame.world_from_camera[:3, 3] + rays.depths[:, None] * rays.directions
    assert ends == pytest.approx(frame.world_points(), abs=1e-5)
    assert set(rays.keyframe) == {7} and rays.colors.max() <= 1


def test_samples_rise_and_crowd_around_the_surface(room_frames):
    mapper = _mapper()
    depths = mapper._sampled(np.array([2.0, 0.0], np.float32))
    assert depths.shape == (2, 43) and (np.diff(depths, axis=1) >= 0).all()
    near = np.abs(depths - 2.0) < 0.1
    assert near[0].sum() >= 10 and near[1].sum() <= 4
    assert depths.max() <= mapper._farthest


@pytest.mark.slow
def test_a_room_is_learnt(room_frames, held_out_frames):
    mapper = _mapper()
    for frame in room_frames[::2]:
        mapper.observe(frame)
    walls = np.minimum(np.abs(mapper.map.means), np.abs(mapper.map.means - ROOM)).min(axis=1)
    assert mapper.map.count > 500
    shown = mapper.render(held_out_frames[0].camera, held_out_frames[0].world_from_camera)
    error = np.abs(shown.depth - held_out_frames[0].depth)[shown.alpha > 0]
    color = np.abs(shown.color - held_out_frames[0].rgb / 255.0)[shown.alpha > 0]
    assert np.median(walls) < 0.03
    assert np.median(error) < 0.1 and color.mean() < 0.12 and shown.alpha.mean() > 0.9


def test_the_map_is_made_anew_only_after_a_change(room_frames):
    mapper = _mapper(iterations=2)
    assert mapper.map.count == 0
    mapper.observe(room_frames[0])
    first = mapper.map.ids[: mapper.map.count].copy()
    assert np.array_equal(mapper.map.ids[: mapper.map.count], first) and mapper.map.next_id == len(first)
    mapper.refine(1)
    assert mapper.map.ids[: mapper.map.count].min() == len(first)


def test_only_what_was_looked_at_is_surface(room_frames):
    """One frame: no disk outside of its picture but by a cell."""
    mapper = _mapper(iterations=4)
    frame = room_frames[0]
    mapper.observe(frame)
    points = (mapper.map.means - frame.world_from_camera[:3, 3]) @ frame.world_from_camera[:3, :3]
    pixels = frame.camera.project(points)
    assert (points[:, 2] > 0).all()
    assert (pixels > -1).all() and (pixels < [frame.camera.width + 1, frame.camera.height + 1]).all()


def test_refining_looks_at_the_given_keyframes_alone(room_frames, monkeypatch):
    mapper = _mapper(iterations=1)
    for frame in room_frames[:4]:
        mapper.observe(frame)
    asked = []
    loss = mapper._loss
    monkeypatch.setattr(mapper, "_loss", lambda rays: asked.append(set(rays.keyframe)) or loss(rays))
    mapper.refine(3, keyframe_indices=[1, 3])
    assert len(asked) == 3 and set().union(*asked) == {1, 3}
    with pytest.raises(ValueError, match="keyframe indices must lie in 0..3"):
        mapper.refine(1, keyframe_indices=[4])


def test_what_follows_gaussians_is_refused(room_frames):
    mapper = _mapper(iterations=1)
    mapper.observe(room_frames[0])
    with pytest.raises(InputError, match="co_slam creates new Gaussians in every event"):
        _ = mapper.persistent_map
