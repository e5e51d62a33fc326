from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes import PosedSequence


def views(count: int) -> PosedSequence:
    files = tuple(Path(f"{number}.png") for number in range(count))
    return PosedSequence(PinholeCamera.from_size(4, 3), np.tile(np.eye(4), (count, 1, 1)), files, files, 1000.0)


def test_a_scene_loaded_again_has_the_truth_that_somebody_holds(furnished_room):
    recorded = replace(furnished_room, evaluation_views=views(2))
    for scene in (furnished_room, recorded):
        truth = ground_truth_of(scene)
        again = replace(scene, evaluation_views=None if scene is furnished_room else views(2))
        assert ground_truth_of(again) is truth


def test_scenes_of_one_content_keep_their_names_and_their_views(furnished_room):
    held = ground_truth_of(furnished_room)
    assert held.scene is furnished_room
    for change in ({"name": "office0"}, {"source": "elsewhere"}, {"evaluation_views": views(2)}):
        scene = replace(furnished_room, **change)
        assert ground_truth_of(scene).scene is scene
    first = ground_truth_of(replace(furnished_room, evaluation_views=views(2)))
    other = replace(furnished_room, evaluation_views=views(3))
    assert ground_truth_of(other) is not first and ground_truth_of(other).scene is other
