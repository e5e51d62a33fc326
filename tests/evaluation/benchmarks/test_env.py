"""What `asg bench env` counts; how long it takes is not tested."""

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.benchmarks.env import STAGES, Episodes, _profile, run_env_benchmark


def test_an_episode_is_counted_whole_and_stages_add_up():
    episodes = Episodes("box", "fast", {"frame_budget": 12, "sensor": {"width": 48, "height": 27}}, seed=0)
    whole = episodes.episode()
    assert whole.frames == 11 and len(whole.wall) == len(whole.processor) >= 1
    assert 1 <= whole.keyframes <= 11 and set(whole.stages) == set(STAGES)
    assert sum(whole.stages.values()) < whole.wall.sum()
    *stages, step = _profile("box", [whole])
    assert sum(row["ms_per_step"] for row in stages) == pytest.approx(step["ms_per_step"])
    assert len(episodes.during(0.0).wall) == 1  # never nothing


def test_what_the_process_could_not_begin_with_is_one_error():
    with pytest.raises(InputError, match="nowhere"):
        run_env_benchmark(("nowhere.glb",))
