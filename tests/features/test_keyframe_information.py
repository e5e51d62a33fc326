"""The sum over the keyframes against one made anew, through insertions, removals and steps."""

import numpy as np
import pytest

from activestructure_gym.features.keyframe_information import COLUMNS, KeyframeInformation
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.splatting.fisher import view_information

CAMERA = PinholeCamera.from_size(24, 18)


def some_gaussians(count, rng):
    block = np.zeros((14, count), np.float32)
    block[:3] = rng.uniform(-1.5, 1.5, (3, count)) + [[0.0], [0.0], [1.0]]
    block[3:7] = rng.normal(size=(4, count))
    block[7:10] = rng.uniform(-3.5, -2.0, (3, count))
    block[10] = rng.uniform(-2.0, 2.0, count)
    block[11:] = rng.random((3, count))
    return block


def keyframe(angle):
    outwards = np.array([np.cos(angle), np.sin(angle), 0.0])
    pose = look_along(2.5 * outwards + [0.0, 0.0, 1.0], -outwards)
    return Frame(np.zeros((18, 24, 3), np.uint8), np.ones((18, 24), np.float32), pose, CAMERA)


def made_anew(gaussians, keyframes):
    total = np.zeros((gaussians.count, COLUMNS))
    for frame in keyframes:
        (seen,) = view_information(gaussians.parameters, gaussians.count, CAMERA, frame.world_from_camera)
        total[seen.indices] += seen.numbers[:, :COLUMNS]
    return total


def close(found, exact):
    return np.abs(found - exact).max() <= 1e-9 * np.abs(exact).max()


@pytest.fixture
def grown():
    rng = np.random.default_rng(0)
    gaussians = GaussianMap(16)
    gaussians.append(some_gaussians(150, rng))
    return gaussians, [keyframe(angle) for angle in np.linspace(0.0, 6.0, 9)], rng


def test_the_first_sum_is_that_of_all_keyframes(grown):
    gaussians, keyframes, _ = grown
    exact = made_anew(gaussians, keyframes)
    assert (exact[:, 23] > 0).sum() > 100
    assert close(KeyframeInformation(gaussians).update(keyframes, renders=2), exact)


def test_it_follows_insertions_and_removals_without_rendering(grown):
    gaussians, keyframes, rng = grown
    information = KeyframeInformation(gaussians)
    before = information.update(keyframes).copy()
    named = dict(zip(gaussians.ids[: gaussians.count].tolist(), before))
    for round_ in range(6):
        gaussians.append(some_gaussians(20, rng))
        gaussians.keep(rng.random(gaussians.count) < 0.8)
        if round_ % 2:
            gaussians.append(some_gaussians(7, rng))
        if round_ != 2:  # changes add up until somebody asks
            found = information.update(keyframes, renders=0)
            own = [named.get(name, np.zeros(COLUMNS)) for name in gaussians.ids[: gaussians.count].tolist()]
            assert np.array_equal(found, own)
    gaussians.keep(np.zeros(gaussians.count, dtype=bool))
    assert information.update(keyframes, renders=0).shape == (0, COLUMNS)


def test_after_all_have_had_their_turn_it_is_as_made_anew(grown):
    gaussians, keyframes, rng = grown
    information = KeyframeInformation(gaussians)
    information.update(keyframes[:5])
    gaussians.append(some_gaussians(40, rng))
    gaussians.keep(rng.random(gaussians.count) < 0.7)
    gaussians.parameters[:3, : gaussians.count] += 0.02
    stale = information.update(keyframes, renders=4).copy()  # the 4 new ones
    exact = made_anew(gaussians, keyframes)
    assert not close(stale, exact)
    information.update(keyframes, renders=3)
    assert not close(information.update(keyframes, renders=1), exact)
    assert close(information.update(keyframes, renders=1), exact)  # 9 keyframes: 4 + 3 + 1 + 1
    gaussians.parameters[:3, : gaussians.count] -= 0.02
    assert close(information.update(keyframes, renders=None), made_anew(gaussians, keyframes))


def test_a_decision_renders_a_fixed_number(grown, monkeypatch):
    gaussians, keyframes, _ = grown
    information, rendered = KeyframeInformation(gaussians), []
    measure = KeyframeInformation._measure

    def listen(self, index, *rest):
        rendered.append(index)
        measure(self, index, *rest)

    monkeypatch.setattr(KeyframeInformation, "_measure", listen)
    information.update(keyframes[:6], renders=2)
    information.update(keyframes[:7], renders=3)
    information.update(keyframes[:7], renders=3)
    assert rendered == [0, 1, 2, 3, 4, 5, 0, 1, 6, 2, 3, 4]


def test_memory_stays_within_the_budget(grown):
    gaussians, keyframes, rng = grown
    information = KeyframeInformation(gaussians, budget_mb=0.03)
    first = information.update(keyframes[:6]).copy()
    assert close(first, made_anew(gaussians, keyframes[:6]))  # fixed contributions still count
    assert 0 < information.megabytes <= 0.03 and 0 < information.fixed < 6
    fixed = information.fixed
    gaussians.keep(rng.random(gaussians.count) < 0.8)
    exact = made_anew(gaussians, keyframes[:6])
    found = information.update(keyframes[:6], renders=None)
    assert information.fixed == fixed and found.shape == exact.shape and not close(found, exact)


def test_another_camera_can_be_asked_for(grown):
    gaussians, keyframes, _ = grown
    half = PinholeCamera.from_size(12, 9)
    found = KeyframeInformation(gaussians, camera=half).update(keyframes[:1])
    (seen,) = view_information(gaussians.parameters, gaussians.count, half, keyframes[0].world_from_camera)
    assert np.array_equal(found[seen.indices], seen.numbers[:, :COLUMNS].astype(float))


def test_mistakes_are_named(grown):
    gaussians, keyframes, _ = grown
    with pytest.raises(ValueError, match="budget_mb"):
        KeyframeInformation(gaussians, budget_mb=0.0)
    information = KeyframeInformation(gaussians)
    information.update(keyframes[:2])
    with pytest.raises(ValueError, match="2 keyframes"):
        information.update(keyframes[:1])
    with pytest.raises(ValueError, match="renders"):
        information.update(keyframes, renders=-1)
