"""In a mirror everything lies on the other side, and nothing is worth more or less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from activestructure_gym.evaluation.training import oracle
from activestructure_gym.evaluation.training.mirror import mirrored
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.policies.learned import inputs
from activestructure_gym.policies.learned.config import USED_KEYS
from activestructure_gym.policies.learned.network import as_tensors
from activestructure_gym.scenes import Scene, load_scene
from tests.evaluation.training.test_training_env import SMALL, make_env
from tests.policies.learned.toys import random_observation

REFLECTED = np.diag([1.0, -1.0, 1.0, 1.0])  # of the world
IMAGE = np.diag([-1.0, 1.0, 1.0, 1.0])  # of the camera, so that a rotation remains


def states(rng: np.random.Generator, count: int = 6) -> dict[str, torch.Tensor]:
    seen = [random_observation(rng, 12, 8, 6) for _ in range(count)]
    return as_tensors({key: np.stack([one[key] for one in seen]) for key in USED_KEYS})


def test_every_y_of_the_heading_frame_changes_its_sign_and_nothing_else(rng: np.random.Generator) -> None:
    before, which = states(rng), torch.tensor([True, False] * 3)
    after = mirrored(before, which)
    sides = {
        inputs.candidate_inputs: [1, 4],  # offset, look
        inputs.plane_inputs: [1, 4],  # normal, offset of the centroid
        inputs.global_inputs: [],
    }
    for made, sideways in sides.items():
        one, other = made(before), made(after)
        signs = torch.ones(one.shape[-1])
        signs[sideways] = -1.0
        assert torch.allclose(other[which], one[which] * signs, atol=1e-5)
        assert torch.equal(other[~which], one[~which])
        assert all(one[which][..., column].abs().max() > 1e-2 for column in sideways)
    for key in set(USED_KEYS) - {"pose", "candidates", "plane_features"}:
        assert torch.equal(after[key], before[key])
    twice = mirrored(after, which)
    assert all(torch.allclose(twice[key], before[key]) for key in USED_KEYS)


def test_the_pose_is_that_of_the_reflected_camera(rng: np.random.Generator) -> None:
    from scipy.spatial.transform import Rotation

    before = states(rng)
    after = mirrored(before, torch.ones(6, dtype=torch.bool))["pose"].numpy()
    for pose, reflected in zip(before["pose"].numpy(), after):
        rotation = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
        expected = REFLECTED[:3, :3] @ rotation @ IMAGE[:3, :3]
        found = Rotation.from_quat(reflected[3:], scalar_first=True).as_matrix()
        np.testing.assert_allclose(found, expected, atol=1e-5)
        np.testing.assert_allclose(reflected[:3], pose[:3] * [1, -1, 1])


def test_the_labels_of_a_mirrored_layout_are_those_of_the_layout() -> None:
    scene = load_scene("box?size=5,4,2.6")
    mesh = scene.mesh
    other = Scene(
        "mirrored", replace(mesh, vertices=mesh.vertices * np.float32([1, -1, 1]), faces=mesh.faces[:, ::-1].copy()), ""
    )
    first, second = make_env(SMALL, scene), make_env(SMALL, other)
    start = ground_truth_of(scene).free_space.start_poses[0]
    observation, _ = first.reset(seed=1, options={"start_pose": start})
    second.reset(seed=1, options={"start_pose": REFLECTED @ start @ IMAGE})
    # The other env draws candidates and samples of its own: it is given the reflected ones of the first.
    table = first.reconstruction.candidates
    second.reconstruction.candidates = replace(table, world_from_camera=REFLECTED @ table.world_from_camera @ IMAGE)
    second.coverage._points = first.coverage.points * [1.0, -1.0, 1.0]
    second.coverage.seen = first.coverage.seen.copy()
    one, two = oracle.newly_seen(first), oracle.newly_seen(second)
    assert one.max() > 0.02
    np.testing.assert_allclose(two, one, atol=5e-4)  # a sample or two at the borders of the image
    scores = oracle.discounted(one, observation)
    state = as_tensors({key: observation[key][None] for key in USED_KEYS})
    seen = {key: value[0].numpy() for key, value in mirrored(state, torch.tensor([True])).items()}
    np.testing.assert_allclose(oracle.discounted(two, seen), scores, atol=5e-4)
    places = second.reconstruction.candidates.world_from_camera[:, :3, 3]
    np.testing.assert_allclose(seen["candidates"][: len(places), :3], places, atol=1e-5)
    assert oracle.expert_choice(oracle.discounted(two, seen), seen) == oracle.expert_choice(scores, observation)
    for env in (first, second):
        env.close()
