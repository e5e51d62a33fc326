"""What a camera cannot see is left out, and nothing else."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.mapping.boxes import BLOCK, block_boxes
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.mapper import largest_adam_step
from activestructure_gym.splatting import cpu

CAMERA = PinholeCamera(48, 32, 30.0, 34.0, 22.0, 17.0)


def _map(rng, *, blocks=80, spread=0.4, largest=-1.0):
    """Blocks of Gaussians here and there within 8 m, the last one not full."""
    count = blocks * BLOCK - 77
    centers = rng.uniform(-8, 8, (blocks, 3)).repeat(BLOCK, axis=0)[:count]
    block = np.zeros((14, count), np.float32)
    block[:3] = (centers + rng.normal(0, spread, (count, 3))).T
    block[3:7] = rng.normal(size=(4, count))
    block[7:10] = rng.uniform(-5.0, largest, (3, count))
    block[10] = rng.normal(size=count)
    block[11:] = rng.uniform(size=(3, count))
    gaussians = GaussianMap()
    gaussians.append(block)
    return gaussians


def _poses(rng, count):
    return [look_along(rng.uniform(-8, 8, 3), np.append(rng.normal(size=2), rng.uniform(-1, 1))) for _ in range(count)]


@pytest.mark.parametrize("largest", [-3.0, 0.5])
def test_pictures_are_the_same_to_the_last_bit(largest):
    """Also with Gaussians of more than a metre, close beside the camera, where the projection stretches most."""
    rng = np.random.default_rng(0)
    gaussians = _map(rng, largest=largest)
    parts = MapParts(gaussians)
    left_out = []
    for pose in _poses(rng, 12):
        parameters, count = parts.in_view(CAMERA, pose)
        left_out.append(gaussians.count - count)
        part = cpu.render(parameters, count, CAMERA, pose)
        whole = cpu.render(gaussians.parameters, gaussians.count, CAMERA, pose)
        for name in ("color", "depth", "alpha"):
            assert getattr(part, name).tobytes() == getattr(whole, name).tobytes()
    if largest < 0:
        assert np.median(left_out) > 0.4 * gaussians.count


def test_several_cameras_get_what_any_of_them_sees():
    rng = np.random.default_rng(1)
    gaussians = _map(rng, largest=-3.0)
    position = np.array([-2.0, 0.0, 0.0])
    poses = np.stack([look_along(position, np.array([-1.0, y, 0.0])) for y in (0.0, 0.4)])
    parameters, count = MapParts(gaussians).in_view(CAMERA, poses)
    assert count < gaussians.count
    part = cpu.render_depth_alpha(parameters, count, CAMERA, poses)
    whole = cpu.render_depth_alpha(gaussians.parameters, gaussians.count, CAMERA, poses)
    assert np.array_equal(part[0], whole[0]) and np.array_equal(part[1], whole[1]) and part[1].max() > 0.5


def test_a_small_map_and_a_view_of_nearly_everything_take_the_map_itself():
    rng = np.random.default_rng(2)
    for gaussians in (_map(rng, blocks=4), _map(rng)):
        poses = np.stack(_poses(rng, 60))
        parameters, count = MapParts(gaussians).in_view(CAMERA, poses)
        assert parameters is gaussians.parameters and count == gaussians.count


def test_nothing_in_view_is_an_empty_picture():
    gaussians = _map(np.random.default_rng(3), largest=-3.0)
    away = look_along(np.array([40.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    parameters, count = MapParts(gaussians).in_view(CAMERA, away)
    assert count == 0 and not cpu.render(parameters, count, CAMERA, away).alpha.any()


def test_boxes_hold_their_blocks_and_not_much_more():
    gaussians = _map(np.random.default_rng(4))
    gaussians.parameters[1, 300] = np.nan
    boxes = block_boxes(gaussians.parameters, gaussians.count)
    for block in range(len(boxes) - 1):
        own = gaussians.parameters[:, block * BLOCK : (block + 1) * BLOCK].astype(np.float64)
        assert np.array_equal(boxes[block, :3], np.nanmin(own[:3], axis=1))
        assert np.array_equal(boxes[block, 3:6], np.nanmax(own[:3], axis=1))
        assert boxes[block, 6] == pytest.approx(np.exp(own[7:10].max()))


@pytest.mark.parametrize("largest", [-3.0, 0.5])
def test_steps_that_skip_what_is_out_of_view_change_the_same_bits(largest):
    rng = np.random.default_rng(4)
    whole = _map(rng, largest=largest)
    parts = GaussianMap()
    parts.append(whole.parameters[:, : whole.count])
    rates = np.full(14, 1e-3, np.float32)
    poses = _poses(rng, 6)
    bound = largest_adam_step(0.9, 0.999) * len(poses) * 1e-3
    boxes = MapParts(parts, shift=bound, growth=float(np.exp(bound)))
    skipped = []
    for pose in poses:
        target = rng.uniform(size=(CAMERA.height, CAMERA.width, 3)).astype(np.float32)
        depth = rng.uniform(0.5, 3.0, (CAMERA.height, CAMERA.width)).astype(np.float32)
        for gaussians, unseen in ((whole, None), (parts, boxes.unseen(CAMERA, pose))):
            cpu.mapping_step(
                gaussians.parameters, gaussians.first_moment, gaussians.second_moment, gaussians.count, CAMERA, pose,
                target, depth, weights=cpu.LossWeights(), learning_rates=rates, unseen=unseen,
            )  # fmt: skip
        skipped.append(unseen.mean())
    assert whole.parameters[:, : whole.count].tobytes() == parts.parameters[:, : parts.count].tobytes()
    assert whole.second_moment[:, : whole.count].any()
    if largest < 0:
        assert np.median(skipped) > 0.2


def test_no_step_of_adam_is_larger_than_its_bound():
    rng = np.random.default_rng(5)
    bound, worst = largest_adam_step(0.9, 0.999), 0.0
    for growth in (1.0, 1.05, 0.999 / 0.9):
        m = v = 0.0
        for g in growth ** np.arange(200) * np.where(rng.random(200) < 0.02, 0.5, 1.0):
            m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g
            worst = max(worst, abs(m) / np.sqrt(v))
    assert 0.9 * bound < worst <= bound
    assert largest_adam_step(0.99, 0.9) == np.inf
