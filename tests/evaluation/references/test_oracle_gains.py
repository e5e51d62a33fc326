import copy

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.evaluation.references.oracle_gains import TrueSurface, whole_pool
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.motion import PlannedPath
from activestructure_gym.scenes import load_scene

SMALL = {"sensor": {"width": 48, "height": 27}, "views.max_candidates": 12}


@pytest.fixture
def episode():
    truth = ground_truth_of(load_scene("box"))
    env = ReconstructionEnv(truth, preset="fast", frame_budget=60, features=(), config=SMALL, coverage_target=None)
    env.reset(seed=3)
    yield env, truth
    env.close()


def test_a_way_is_what_the_step_pays_and_takes(episode):
    env, truth = episode
    surface = TrueSurface(truth)
    reached = 0
    for row in (0, 5, 2, 7):
        now = env.reconstruction
        surface.follow(now)
        before, seen, taken = now.frames, surface.seen.sum(), len(now.keyframe_indices)
        (way,) = now.agent.paths(now.volume, now.candidates.world_from_camera[row : row + 1])
        foreseen = surface.new_areas(now, [way])[0]
        _, _, _, truncated, info = env.step(row)
        surface.follow(now)
        if not info["reached"]:
            continue  # blocked by what was seen on the way
        reached += 1
        assert now.frames - before == way.frames
        poses = np.stack([now.trajectory[index] for index in now.keyframe_indices[taken:]])
        np.testing.assert_allclose(poses, way.keyframes)
        assert surface.area * (surface.seen.sum() - seen) == pytest.approx(foreseen)
        if truncated:
            break
    assert reached >= 2 and surface.seen.any()


def test_to_ask_changes_nothing(episode):
    env, truth = episode
    now = env.reconstruction
    state, open_views = copy.deepcopy(now._planning_rng.bit_generator.state), len(now.pool)
    surface = TrueSurface(truth)
    surface.follow(now)
    pool = whole_pool(now)
    rates = surface.rates(now, now.agent.paths(now.volume, pool))
    assert len(pool) > len(now.candidates)  # all of it, not one table of it
    np.testing.assert_array_equal(rates, surface.rates(now, now.agent.paths(now.volume, pool)))
    assert now._planning_rng.bit_generator.state == state and len(now.pool) == open_views
    assert now.pool.config.max_candidates == 12 and len(whole_pool(now, 5)) == 5
    assert rates.max() > 0 and (rates >= 0).all()


def test_what_all_have_seen_is_worth_nothing(episode):
    env, truth = episode
    surface = TrueSurface(truth)
    here = [PlannedPath(1, env.reconstruction.pose[None])]
    first = surface.rates(env.reconstruction, here)[0]
    assert 0 < first < truth.observable_surface.area
    surface.follow(env.reconstruction)
    assert surface.rates(env.reconstruction, here).tolist() == [0.0]
    assert surface.rates(env.reconstruction, [None]).tolist() == [0.0]
