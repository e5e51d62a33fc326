"""What is packed can be unpacked, to the steps it is kept in."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.evaluation.replay import Recording
from activestructure_gym.evaluation.replay.packing import TRUTH, pack
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, MEAN, QUATERNION


def unpacked(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    whole = zlib.decompress(base64.b64decode(text))
    length = int.from_bytes(whole[:4], "little")
    header = json.loads(whole[4 : 4 + length])
    arrays = {}
    for name, place in header["arrays"].items():
        begin = 4 + length + place["at"]
        assert begin % 4 == 0  # a browser's typed arrays begin at a multiple of their size
        count = int(np.prod(place["shape"]))
        arrays[name] = np.frombuffer(whole, place["type"], count, begin).reshape(place["shape"])
    return header, arrays


def test_a_recording_is_kept_to_its_steps(recordings: list[Recording]) -> None:
    for recording in recordings:
        header, arrays = unpacked(pack(recording, "a name"))
        live = recording.gaussians
        means = np.array(header["low"]) + arrays["means"] / 65535 * np.array(header["side"])
        assert np.abs(means - live[MEAN].T).max() < 2e-4
        logs = header["log"][0] + header["log"][1] * arrays["scales"].astype(float)
        assert np.abs(logs - np.clip(live[LOG_SCALE].T, -9.0, 3.75)).max() <= 0.5 * header["log"][1] + 1e-5
        turned = arrays["rotations"] / 127.0
        unit = (live[QUATERNION] / np.linalg.norm(live[QUATERNION], axis=0)).T
        assert np.abs(turned - unit).max() < 0.5 / 127 + 1e-6
        assert np.abs(arrays["colours"] / 255.0 - np.clip(live[COLOR].T, 0, 1)).max() <= 0.5 / 255 + 1e-6
        np.testing.assert_array_equal(arrays["added"], recording.added)
        np.testing.assert_array_equal(arrays["frames"], [moment.frame for moment in recording.moments])


def test_every_moment_finds_its_own_again(recordings: list[Recording]) -> None:
    recording = recordings[0]
    _, arrays = unpacked(pack(recording, "a name"))
    for n, moment in enumerate(recording.moments):
        first, last = arrays["candidate_starts"][n : n + 2]
        np.testing.assert_allclose(arrays["candidates"][first:last], moment.candidates, atol=1e-5)
        first, last = arrays["plane_starts"][n : n + 2]
        np.testing.assert_allclose(arrays["planes"][first:last].reshape(-1, 4, 3), moment.planes, atol=1e-5)
        starts = arrays["image_starts"][2 * n : 2 * n + 3]
        assert arrays["images"][starts[0] : starts[1]].tobytes() == moment.true
        assert arrays["images"][starts[1] : starts[2]].tobytes() == moment.rendered
    scores = arrays["scores"][: len(recording.moments[0].candidates)]
    np.testing.assert_allclose(scores, recording.moments[0].scores, rtol=1e-6)


@pytest.mark.parametrize("last", [65_534, 65_535, 70_000])
def test_frames_of_a_long_episode_are_distinct(recordings: list[Recording], last: int) -> None:
    recording = recordings[0]
    moments = [*recording.moments[:-1], replace(recording.moments[-1], frame=last)]
    added, removed = recording.added.copy(), recording.removed.copy()
    added[-1], removed[0] = last, last
    header, arrays = unpacked(pack(replace(recording, moments=moments, added=added, removed=removed), "a name"))
    assert arrays["frames"][-1] == arrays["added"][-1] == arrays["removed"][0] == last < header["never_removed"]
    assert (arrays["removed"][1:] == header["never_removed"]).sum() == (removed[1:] > last).sum()


def test_rows_of_many_planes_are_distinct(recordings: list[Recording]) -> None:
    moments = [*recordings[0].moments]
    moments[1] = replace(moments[1], tree=np.array([[3, 70_000]]))
    _, arrays = unpacked(pack(replace(recordings[0], moments=moments), "a name"))
    assert [3, 70_000] in arrays["tree"].tolist()


def test_a_page_shows_an_even_choice_of_what_is_too_much(
    recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    from activestructure_gym.viewer import packing

    recording = recordings[0]
    monkeypatch.setattr(packing, "_MAX_GAUSSIANS", len(recording.added) // 3)
    decisions = len(recording.run.steps)
    shown = [moment for moment in recording.moments if moment.decision % 2 == 0 or moment.decision == decisions]
    header, arrays = unpacked(pack(replace(recording, moments=shown, divergence=""), "a name"))
    np.testing.assert_array_equal(arrays["added"], recording.added[:: header["every"]])
    assert 2 * len(arrays["added"]) <= len(recording.added) and header["decisions"] == decisions
    assert [step["number"] for step in header["steps"]] == list(range(1, decisions + 1, 2))
    metres = [step["metres"] for step in recording.run.steps]
    assert [step["metres"] for step in header["steps"]] == [
        round(metres[min(n + 1, decisions - 1)], 2) for n in range(0, decisions, 2)
    ]
    assert header["warning"] == (
        f"{len(header['steps'])} of {decisions} decisions are shown; one of {header['every']} of the "
        f"{len(recording.added):,} Gaussians is shown"
    )


def test_each_decision_has_its_reason_and_the_runner_up(recordings: list[Recording]) -> None:
    greedy, chance = (unpacked(pack(recording, "a name"))[0]["steps"] for recording in recordings)
    for step, decision in zip(greedy, recordings[0].run.steps):
        why, rows = step["why"], recordings[0].run.decisions[step["number"] - 1]
        assert rows[0].row == decision["action"] and why["runner_up"] == rows[1].row
        assert why["reason"].startswith("Chosen for ")
        assert {"score", "hole_area", "× travel", "path", "frames"} < {line[0] for line in why["table"]}
        areas = recordings[0].new_areas[step["number"] - 1]
        assert why["table"][-1] == [TRUTH, *(f"{areas[row.row]:.2f} m²" for row in rows[:2])]
    assert all(step["why"]["reason"].endswith("without comparing scores.") for step in chance)
    assert all(step["why"]["runner_up"] == -1 for step in chance)


def test_a_replay_without_ground_truth_shows_no_true_surface(recordings: list[Recording]) -> None:
    steps = unpacked(pack(replace(recordings[0], new_areas=[{} for _ in recordings[0].run.steps]), "a name"))[0][
        "steps"
    ]
    assert TRUTH not in {line[0] for step in steps for line in step["why"]["table"]}


def test_a_run_without_stored_rows_shows_no_reason(recordings: list[Recording]) -> None:
    run = replace(recordings[0].run)
    run.__dict__["decisions"] = None
    header, _ = unpacked(pack(replace(recordings[0], run=run), "a name"))
    assert all(step["why"] is None for step in header["steps"])
