"""What is packed can be unpacked, to the steps it is kept in."""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np

from activestructure_gym.evaluation.replay import Recording
from activestructure_gym.evaluation.replay.packing import pack
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, QUATERNION


def unpacked(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    whole = zlib.decompress(base64.b64decode(text))
    length = int.from_bytes(whole[:4], "little")
    told = json.loads(whole[4 : 4 + length])
    arrays = {}
    for name, place in told["arrays"].items():
        begin = 4 + length + place["at"]
        assert begin % 4 == 0  # a browser's typed arrays begin at a multiple of their size
        count = int(np.prod(place["shape"]))
        arrays[name] = np.frombuffer(whole, place["type"], count, begin).reshape(place["shape"])
    return told, arrays


def test_a_recording_is_kept_to_its_steps(recordings: list[Recording]) -> None:
    for recording in recordings:
        told, arrays = unpacked(pack(recording))
        live = recording.gaussians
        means = np.array(told["low"]) + arrays["means"] / 65535 * np.array(told["side"])
        assert np.abs(means - live[MEAN].T).max() < 2e-4
        logs = told["log"][0] + told["log"][1] * arrays["scales"].astype(float)
        assert np.abs(logs - np.clip(live[LOG_SCALE].T, -9.0, 3.75)).max() <= 0.5 * told["log"][1] + 1e-5
        turned = arrays["rotations"] / 127.0
        unit = (live[QUATERNION] / np.linalg.norm(live[QUATERNION], axis=0)).T
        assert np.abs(turned - unit).max() < 0.5 / 127 + 1e-6
        assert np.abs(arrays["colours"] / 255.0 - np.clip(live[COLOR].T, 0, 1)).max() <= 0.5 / 255 + 1e-6
        np.testing.assert_array_equal(arrays["born"], recording.born)
        np.testing.assert_array_equal(arrays["frames"], [moment.frame for moment in recording.moments])


def test_every_moment_finds_its_own_again(recordings: list[Recording]) -> None:
    recording = recordings[0]
    _, arrays = unpacked(pack(recording))
    for n, moment in enumerate(recording.moments):
        first, last = arrays["candidate_starts"][n : n + 2]
        np.testing.assert_allclose(arrays["candidates"][first:last], moment.candidates, atol=1e-5)
        first, last = arrays["plane_starts"][n : n + 2]
        np.testing.assert_allclose(arrays["planes"][first:last].reshape(-1, 4, 3), moment.planes, atol=1e-5)
        starts = arrays["image_starts"][2 * n : 2 * n + 3]
        assert arrays["images"][starts[0] : starts[1]].tobytes() == moment.true
        assert arrays["images"][starts[1] : starts[2]].tobytes() == moment.rendered
    shades = arrays["worth"][: len(recording.moments[0].candidates)]
    assert shades.max() == 254 and shades.argmax() == recording.moments[0].worth.argmax()
