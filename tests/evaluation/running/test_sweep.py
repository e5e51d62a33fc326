"""A sweep: its jobs, what is refused before anything runs, and its resumption."""

import dataclasses

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import compare
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.comparison import open_comparison
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.api import NullListener
from activestructure_gym.evaluation.running.comparison import Comparison, jobs_to_resume
from activestructure_gym.evaluation.running.resuming import merged
from tests.bare_jobs import bare_jobs

SPACING, NOISE = "mapper.seed_spacing", "sensor.depth_noise"
FAST = Conditions(preset="fast")


def grid(sweep, conditions=FAST, policies=("random", "hole_area")):
    return Comparison(["box"], policies, seeds=(0, 1), conditions=conditions, sweep=sweep)


def test_two_fields_give_their_product_for_every_policy():
    comparison = grid({SPACING: (0.06, 0.12), NOISE: ("none", "kinect")})
    jobs = comparison.jobs(comparison.participants(), {})
    assert len(jobs) == len({job.name for job in jobs}) == 2 * 2 * 4
    assert [job.label for job in jobs[:5]] == [
        "random [mapper.seed_spacing=0.06, sensor.depth_noise=none]",
        "random [mapper.seed_spacing=0.06, sensor.depth_noise=kinect]",
        "random [mapper.seed_spacing=0.12, sensor.depth_noise=none]",
        "random [mapper.seed_spacing=0.12, sensor.depth_noise=kinect]",
        "hole_area [mapper.seed_spacing=0.06, sensor.depth_noise=none]",
    ]
    assert [job.seed for job in jobs] == [0] * 8 + [1] * 8
    assert jobs[1].conditions.overrides == {SPACING: 0.06, NOISE: "kinect"}
    # The record gives the same comparison again.
    again = Comparison.of(jobs)
    assert (again.sweep, again.conditions) == (comparison.sweep, FAST)
    assert again.jobs(again.participants(), {}) == jobs
    # Without a sweep there is one job per cell, with the conditions of the comparison itself.
    plain = grid({})
    assert [job.conditions for job in plain.jobs(plain.participants(), {})] == [FAST] * 4


def test_a_swept_value_overrides_the_native_settings_of_a_policy():
    native = Conditions(setup="native")
    jobs = grid({"mapper.iterations": (3,)}, native, ["activegamer"]).jobs(["activegamer"], {})
    from activestructure_gym.policies import make_policy

    policy = make_policy("activegamer")
    assert native.changes(policy)["mapper.iterations"] != 3
    assert jobs[0].conditions.changes(policy) == native.changes(policy) | {"mapper.iterations": 3}


@pytest.mark.parametrize(
    "sweep, conditions, message",
    [
        ({"mapper.seed_spacin": (1, 2)}, {}, "did you mean 'seed_spacing'"),
        ({SPACING: (0.06, -1.0)}, {}, "-1"),
        ({"sensor.width": (96, "wide")}, {}, "must be a whole number, got 'wide'"),
        ({"volume.voxel_size": (0.1, 1e-5)}, {}, "voxel_size"),
        ({SPACING: (0.06, 0.12, 0.06)}, {}, "has a value twice: 0.06, 0.12, 0.06"),
        ({"motion.body_radius": (1, 1.0)}, {}, "has a value twice: 1, 1"),
        ({SPACING: ()}, {}, "is a list of values, as [1, 2], got ()"),
        ({NOISE: "none"}, {}, "is a list of values, as [1, 2], got 'none'"),
        ({SPACING: 0.06}, {}, "is a list of values, as [1, 2], got 0.06"),
        ({SPACING: (0.06,)}, {"overrides": {SPACING: 0.12}}, "is swept and also set to one value for all runs"),
        ({"frame_budget": (20, 40)}, {"frame_budget": 60}, "frame_budget is swept and also set to one value"),
        ({"frame_budget": (20, 0)}, {}, "the frame budget must be at least 1, got 0"),
        # Values without an effect: the policy, or an override, sets the field.
        ({"features": (["pixel"], ["hole_area"])}, {}, "give 'random' the same configuration"),
        ({"mapper": ({"iterations": 3}, {})}, {"overrides": {"mapper.iterations": 9}}, "the same configuration"),
    ],
)
def test_wrong_sweeps_are_refused_before_a_scene_is_loaded(sweep, conditions, message, monkeypatch):
    if "volume.voxel_size" not in sweep:
        monkeypatch.setattr(Comparison, "_check_scene", lambda *given: pytest.fail("a scene is loaded"))
    with pytest.raises(InputError) as error:
        grid(sweep, dataclasses.replace(FAST, **conditions)).prepare()
    assert message in str(error.value) and "\n" not in str(error.value)


def test_equal_numbers_are_equal_jobs():
    one, other = (grid({"mapper.seed_spacing": (value,)}).jobs(["random"], {})[0] for value in (1, 1.0))
    assert (one.name, one.hash, one.label) == (other.name, other.hash, "random [mapper.seed_spacing=1]")


def test_a_mapper_named_by_a_trajectory_is_not_swept():
    with pytest.raises(InputError, match=r"give 'trajectory:sweep\?mapper=monogs' the same configuration"):
        grid({"mapper.name": ("default", "splatam")}, policies=["trajectory:sweep?mapper=monogs"]).participants()


def test_the_camera_of_a_world_is_not_swept():
    world = "world:simulated?scene=box"
    Comparison(["box", world], ["random"], sweep={"sensor.max_range": (5, 10)})
    with pytest.raises(InputError, match="sensor.width is swept, and 'world:simulated.scene=box' has a camera of its"):
        Comparison(["box", world], ["random"], sweep={SPACING: (0.06,), "sensor.width": (64, 96)})


def test_values_may_be_numbers_of_numpy():
    swept = grid({"mapper.iterations": np.arange(3, 5), SPACING: list(np.array([0.06, 0.12]))})
    assert swept == grid({"mapper.iterations": (3, 4), SPACING: (0.06, 0.12)})
    jobs = swept.jobs(swept.participants(), {})
    assert jobs[0].title == "box · random [mapper.iterations=3, mapper.seed_spacing=0.06] · seed 0" and jobs[0].hash


def test_fields_in_another_order_are_no_other_runs(tmp_path):
    first, second = (
        grid(sweep).jobs(["random"], {})
        for sweep in ({SPACING: (0.06,), NOISE: ("none",)}, {NOISE: ("none",), SPACING: (0.06,)})
    )
    message = f"sweep was '?{SPACING}, {NOISE}'?, asked for is '?{NOISE}, {SPACING}"
    with pytest.raises(InputError, match=message):
        merged(first, second, tmp_path)


class Killed(NullListener):
    """Stop the comparison when its first run has finished."""

    def ended(self, outcome):
        raise KeyboardInterrupt


def test_a_killed_sweep_is_resumed_and_grows(tmp_path):
    shared = Conditions(preset="fast", protocol=StandardProtocol(views=1, surface_samples=2000, points_source="means"))
    options = {"conditions": shared, "engine": "inline"}
    with bare_jobs():
        with pytest.raises(KeyboardInterrupt):
            compare(["box"], ["random"], tmp_path, sweep={"frame_budget": (2, 3)}, listener=Killed(), **options)
        assert len(open_comparison(tmp_path)) == 1
        result = compare(["box"], ["random"], tmp_path, sweep={"frame_budget": (2, 3)}, resume=True, **options)
        assert (len(result.runs), result.skipped, result.failed) == (2, 1, [])
        more = compare(["box"], ["random"], tmp_path, sweep={"frame_budget": (4,)}, resume=True, **options)
        with pytest.raises(InputError, match="sweep was frame_budget, asked for is not given"):
            compare(["box"], ["random"], tmp_path, resume=True, **options)
        assert [job.swept_values for job in jobs_to_resume(tmp_path)] == [{"frame_budget": n} for n in (2, 3, 4)]
    frames = [run.config["configuration"]["frame_budget"] for run in more.runs]
    assert frames == [2, 3, 4] and [run.metrics["metrics"]["frames"] for run in more.runs] == frames
    assert [run.policy for run in more.runs] == [f"random [frame_budget={n}]" for n in frames]
    # Equal seeds start at the same pose, and a stored run is read with its values.
    starts = [run.trajectory["world_from_camera"][0] for run in more.runs]
    assert all(np.array_equal(start, starts[0]) for start in starts)
    assert store.read_run(more.runs[1].directory).job == more.runs[1].job
