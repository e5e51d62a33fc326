"""Frames that another program has drawn of a mesh it has written: the fixture in the layout of Replica sequences."""

import numpy as np

from activestructure_gym.sensors import make_renderer


def test_recorded_frames_are_redrawn(shared):
    from activestructure_gym.scenes.library import load_scene
    from activestructure_gym.scenes.loaders.sequence import load_sequence

    fixture = shared / "scenes" / "replica_fixture"
    renderer = make_renderer("raycast", load_scene(f"replica:{fixture / 'room_fix'}"))
    sequence = load_sequence(fixture / "seq" / "room_fix")
    for index in range(0, len(sequence), 4):
        frame = sequence.frame(index)
        rgb, depth = renderer.render(frame.camera, frame.world_from_camera)
        # Depth is stored in steps of 1 / 6553.5 m: half a step, and a little for float32.
        assert np.abs(depth - frame.depth).max() < 1e-4
        # Colour is stored as JPEG, with one sample per pixel.
        assert np.abs(rgb.astype(int) - frame.rgb).mean() < 3.0
