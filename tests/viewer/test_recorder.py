"""Who came and who went, and where planes lie."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.viewer.recorder import Moment, Recorder, _GaussianHistory, plane_rectangles


def test_the_rectangle_of_a_plane_lies_as_its_surface_does() -> None:
    seen = np.zeros((40, 40), np.uint8)
    np.fill_diagonal(seen, 1)  # a strip of 40 cells at 45 degrees
    graph = {
        "centroids": np.array([[1.0, 2.0, 3.0]] * 2),
        "patch_shapes": np.array([[40, 40], [0, 0]]),
        "patch_starts": np.array([0, 200, 200]),
        "patch_bits": np.packbits(seen),
        "patch_corners": np.array([[5.0, 0.0, 1.0]] * 2),
        "patch_axes": np.array([[[1.0, 0, 0], [0, 0, 1.0]]] * 2),
        "cell": np.array(0.1),
    }
    strip, nothing = plane_rectangles(graph)
    sides = np.linalg.norm(np.diff(strip, axis=0), axis=1)
    np.testing.assert_allclose(sorted(sides[:2]), [0.1 * 2**0.5, 4 * 2**0.5], atol=1e-5)
    np.testing.assert_allclose(strip.mean(axis=0), [7.0, 0.0, 3.0], atol=1e-5)
    np.testing.assert_array_equal(nothing, [[1.0, 2.0, 3.0]] * 4)


def test_who_is_removed_is_kept_as_it_was_last() -> None:
    gaussians, history = GaussianMap(), _GaussianHistory()
    block = np.arange(14 * 5, dtype=np.float32).reshape(14, 5)
    gaussians.append(block[:, :3])
    history.note(gaussians, 1)
    gaussians.append(block[:, 3:])
    gaussians.parameters[0, :5] += 100.0
    history.note(gaussians, 6)
    gaussians.keep(np.array([True, False, True, True, True]))
    history.note(gaussians, 11)
    parameters, added, removed = history.gaussians()
    assert added.tolist() == [1, 1, 1, 6, 6] and sorted(removed.tolist())[0] == 11
    (gone,) = np.nonzero(removed == 11)[0]
    np.testing.assert_array_equal(parameters[1:, gone], block[1:, 1])
    assert parameters[0, gone] == block[0, 1] + 100.0


def test_a_map_that_is_made_anew_as_a_whole_is_kept_once_and_grows_by_place() -> None:
    gaussians, history = GaussianMap(), _GaussianHistory()
    for frame in range(1, 60):
        gaussians.keep(np.zeros(gaussians.count, bool))
        block = np.ones((14, frame), np.float32)
        block[:3] = [np.arange(frame), np.full(frame, 0.01), np.full(frame, -2.0)]
        gaussians.append(block)
        history.note(gaussians, frame)
    parameters, added, removed = history.gaussians()
    assert parameters.shape == (14, 59) and not history.gone
    assert added.tolist() == list(range(1, 60)) and (removed > 59).all()
    np.testing.assert_array_equal(parameters[0], np.arange(59))


def test_the_moments_of_a_long_episode_are_thinned_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Moment(
        1, 1, 0, np.zeros((10, 6)), np.zeros(10), np.zeros((0, 4, 3)), np.zeros(0, bool), np.zeros((0, 2), int),
        np.zeros((0, 3)), bytes(500), bytes(260),
    )  # fmt: skip
    monkeypatch.setattr("activestructure_gym.viewer.recorder.moment_of", lambda episode, row: replace(made, row=row))
    mapper = SimpleNamespace(map=GaussianMap(), observe=None)
    episode = SimpleNamespace(mapper=mapper, frame_budget=70_000, frames=1, trajectory=[])
    kept = {}
    for most in (None, 20_000):
        recorder = Recorder(episode, most_bytes=most)  # type: ignore[arg-type]
        for row in range(999):
            recorder.note(row)
        recorder.note(end=True)
        kept[most] = [(moment.decision, moment.row) for moment in recorder.moments]
    assert kept[None] == [(n, n) for n in range(999)] + [(999, -1)]
    numbers = [number for number, _ in kept[20_000]]
    assert 10 <= len(numbers) <= 20 and numbers[0] == 0 and kept[20_000][-1] == (999, -1)
    assert sum(number % 64 != 0 for number in numbers) <= 7 and numbers == sorted(set(numbers))
