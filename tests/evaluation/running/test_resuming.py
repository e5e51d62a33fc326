"""Going on: with the same, with more, and not with something else."""

import dataclasses

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, jobs, json_files, store
from activestructure_gym.evaluation.archive.comparison import open_comparison, run_directory
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running import comparison, engines
from activestructure_gym.evaluation.running.comparison import Comparison, jobs_to_resume, run_comparison
from activestructure_gym.evaluation.running.engines.base import Engine, Limits, Outcome
from activestructure_gym.evaluation.running.output_directory import check_output
from activestructure_gym.evaluation.running.resuming import recorded_jobs
from tests.evaluation.written_runs import write_comparison, write_run

JOB = Job(
    "box",
    "random",
    0,
    scene_hash="a" * 64,
    conditions=Conditions(preset="fast", frame_budget=9, overrides=(("sensor.width", 64),)),
)


def variant(**changes) -> Job:
    """The job with other fields, its own or those of its conditions."""
    cell = {name: changes.pop(name) for name in jobs.CELL if name in changes}
    return dataclasses.replace(JOB, **cell, conditions=dataclasses.replace(JOB.conditions, **changes))


class Silent:
    def __init__(self):
        self.begun = None

    def begin(self, jobs, finished):
        self.begun = ([job.title for job in jobs], finished)

    def progress(self, job, progress):
        pass

    def on_retry(self, job, error):
        pass

    def ended(self, outcome):
        pass


@pytest.fixture
def ran(monkeypatch):
    """An engine that writes nothing but the mark of a finished run; jobs of policy "bad" fail."""
    done = []

    def run(jobs, directory, listener, limits, *, keep_open=()):
        for job in jobs:
            done.append(job.title)
            if job.policy == "bad":
                listener.ended(Outcome(job, "it is bad"))
                continue
            place = run_directory(directory, job)
            place.mkdir(parents=True)
            (place / completion.DONE).write_text(job.hash)
            listener.ended(Outcome(job, attempts=1 + job.seed))

    engine = Engine(run, slots=lambda jobs, limits: 2, check=lambda limits: None)
    monkeypatch.setitem(engines.ENGINES._entries, "fake", engine)
    monkeypatch.setattr(store, "read_run", lambda place, scene: place.name)
    monkeypatch.setattr(store, "damage_of", lambda place, job: None)
    monkeypatch.setattr(store, "read_done", lambda place, job, scene: place.name if place.exists() else None)
    return done


def go(jobs, directory, **options):
    listener = Silent()
    directory.mkdir(exist_ok=True)
    return run_comparison(jobs, directory, listener, engine="fake", **options), listener


def test_finished_jobs_are_never_repeated_and_failed_ones_are(ran, tmp_path):
    both = [JOB, variant(policy="bad")]
    first, _ = go(both, tmp_path, command="asg compare one")
    assert (len(first.runs), len(first.failed), first.skipped, first.missing) == (1, 1, 0, 0)
    second, listener = go(both, tmp_path, resume=True, command="asg compare two")
    assert (second.runs, len(second.failed), second.skipped) == (first.runs, 1, 1)
    assert listener.begun == (["box · bad · seed 0"], 1)
    assert ran == ["box · random · seed 0", "box · bad · seed 0", "box · bad · seed 0"]
    record = json_files.read_json(tmp_path / store.COMPARISON)
    assert record["failed"] == {both[1].name: "it is bad"}
    assert (record["command"], record["resumed"]) == ("asg compare one", [])


def test_a_grid_may_grow_and_nothing_leaves_its_record(ran, tmp_path):
    go([JOB, variant(policy="bad")], tmp_path, command="asg compare one")
    result, listener = go([JOB, variant(seed=1)], tmp_path, resume=True, command="asg compare two")
    assert listener.begun == (["box · random · seed 1"], 1)
    # The table shows all that is finished; what was not asked for this time is told apart from what failed.
    assert (len(result.runs), result.failed, result.skipped, result.missing) == (2, [], 1, 1)
    assert [job.title for job in recorded_jobs(tmp_path)] == [
        "box · random · seed 0", "box · bad · seed 0", "box · random · seed 1"
    ]  # fmt: skip
    record = json_files.read_json(tmp_path / store.COMPARISON)
    assert (record["command"], record["resumed"]) == ("asg compare one", ["asg compare two"])  # both repeat the runs
    assert record["attempts"] == {variant(seed=1).name: 2}
    assert record["failed"] == {variant(policy="bad").name: "it is bad"}  # not asked for again: its error stays


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"preset": "default"}, "preset was fast, asked for is default"),
        ({"frame_budget": None}, "frame_budget was 9, asked for is not given"),
        ({"overrides": ()}, "overrides.sensor.width was 64, asked for is not given"),
        ({"overrides": (("sensor.width", 64), ("a.b", 3))}, "overrides.a.b was not given, asked for is 3"),
        ({"start_pose": (1.0, 2.0, 3.0, 4.0)}, "start_pose was not given, asked for is [1.0, 2.0, 3.0, 4.0]"),
        ({"protocol": StandardProtocol(views=3)}, "protocol.views was 64, asked for is 3"),
        ({"also": ("activegamer",)}, "also was none, asked for is activegamer"),
        ({"scene_hash": "b" * 64}, "scene 'box' has changed since"),
        ({"swept": ("sensor.width",)}, "sweep was not given, asked for is sensor.width"),
    ],
)  # fmt: skip
def test_other_conditions_are_refused_by_name_and_the_record_stays(changes, words, ran, tmp_path):
    go([JOB], tmp_path)
    before = (tmp_path / store.COMPARISON).read_bytes()
    other = variant(**changes)
    assert other.hash != JOB.hash
    with pytest.raises(InputError) as error:
        go([other], tmp_path, resume=True)
    assert words in str(error.value) and "\n" not in str(error.value)
    assert (tmp_path / store.COMPARISON).read_bytes() == before
    assert len(ran) == 1


@pytest.mark.parametrize("now", ["/new/house.obj?up=z", "mesh:/old/house.obj?up=z"])
def test_a_scene_that_is_added_to_under_another_path_is_one_scene(ran, tmp_path, now):
    old = variant(scene="/old/house.obj?up=z")
    go([old], tmp_path)
    added = variant(scene=now, policy="naruto")
    result, _ = go([added], tmp_path, resume=True)
    assert result.missing == 0 and recorded_jobs(tmp_path) == [variant(scene=now), added]
    assert Comparison.of(recorded_jobs(tmp_path)).scenes == (now,)
    go(
        [variant(scene="/new/house.obj?up=z", scene_hash="b" * 64)], tmp_path / "other"
    )  # of other content: another scene
    go([variant(scene="/old/house.obj?up=z")], tmp_path / "other", resume=True)
    assert len(Comparison.of(recorded_jobs(tmp_path / "other")).scenes) == 2


def test_a_record_with_two_paths_of_one_scene_is_gone_on_with_and_labelled_as_one(monkeypatch, tmp_path):
    grid = [variant(scene="/a/house.obj"), variant(scene="/b/house.obj", policy="naruto")]
    write_comparison(tmp_path / "all", grid)
    assert [run.scene for run in open_comparison(tmp_path / "all")] == ["house", "house"]

    def prepare(self, notify):
        return [variant(scene=scene, policy=policy) for scene in self.scenes for policy in self.policies]

    monkeypatch.setattr(comparison.Comparison, "prepare", prepare)
    assert [job.scene for job in jobs_to_resume(tmp_path / "all")] == ["/b/house.obj", "/b/house.obj"]


def test_every_option_that_decides_a_result_is_compared():
    # A new field of a job is a condition, unless it may differ within one comparison.
    assert {field.name for field in dataclasses.fields(Job)} == {*jobs.CELL, "conditions"}
    native = dataclasses.replace(JOB.conditions, setup="native", metrics=("mine:metric",))
    assert native.as_dict().keys() == {field.name for field in dataclasses.fields(Conditions)}


def test_results_of_another_version_are_not_mixed(ran, tmp_path, monkeypatch):
    go([JOB], tmp_path)
    monkeypatch.setattr(jobs, "__version__", "99.0")
    with pytest.raises(InputError, match="begun with version"):
        go([variant()], tmp_path, resume=True)


def test_a_second_start_is_no_resume(ran, tmp_path):
    go([JOB], tmp_path)
    with pytest.raises(InputError, match="add --resume"):
        go([JOB], tmp_path)


def test_the_grid_of_a_record_is_checked_like_a_new_one(ran, tmp_path, monkeypatch):
    grid = [variant(policy=policy, seed=seed) for policy, seed in (("random", 0), ("bad", 3), ("random", 3))]
    go(grid, tmp_path)
    prepared = []

    def prepare(self, notify):
        prepared.append(self)
        return [
            variant(scene=scene, policy=policy, seed=seed, scene_hash=now)
            for scene in self.scenes
            for policy in self.policies
            for seed in self.seeds
        ]

    monkeypatch.setattr(comparison.Comparison, "prepare", prepare)
    now = JOB.scene_hash
    assert jobs_to_resume(tmp_path) == grid  # and not the fourth one of the product
    assert prepared == [
        Comparison(
            ["box"], ["random", "bad"], [0, 3], conditions=JOB.conditions, recorded={"box": JOB.scene_hash},
        )
    ]  # fmt: skip
    now = "b" * 64
    with pytest.raises(InputError, match="scene 'box' has changed"):
        jobs_to_resume(tmp_path)


def test_unused_limits_are_the_usual_ones(ran, tmp_path):
    assert Limits() == Limits(workers=0, timeout_min=0.0, retries=1)
    go([], tmp_path)
    assert ran == []


def test_a_record_runs_no_code(ran, tmp_path, monkeypatch):
    job = variant(scene=f"pathlib:Path?path={tmp_path}/hacked", policy="bad")
    go([job], tmp_path)
    with pytest.raises(InputError, match="compare.json' names the scene 'pathlib:Path.* add --trust-code"):
        jobs_to_resume(tmp_path)
    monkeypatch.setenv("ASG_TRUST_CODE", "1")
    with pytest.raises(InputError, match="unknown policy 'bad'"):  # and no more about code
        jobs_to_resume(tmp_path)


def test_a_damaged_run_is_repeated_and_the_others_are_kept(monkeypatch, tmp_path):
    grid = [variant(seed=seed) for seed in range(3)]
    write_comparison(tmp_path / "all", grid)
    places = [run_directory(tmp_path / "all", job) for job in grid]
    (places[0] / "pictures.npz").write_bytes(b"")
    (places[1] / completion.DONE).write_text("nonsense")
    stamp = (places[2] / completion.DONE).stat().st_mtime_ns
    done = []

    def run(jobs, directory, listener, limits, *, keep_open=()):
        for job in jobs:
            done.append(job)
            with completion.atomic_directory(run_directory(directory, job)) as part:
                part.rmdir()
                write_run(part, job)
            listener.ended(Outcome(job))

    engine = Engine(run, slots=lambda jobs, limits: 1, check=lambda limits: None)
    monkeypatch.setitem(engines.ENGINES._entries, "fake", engine)
    heard = []
    result, listener = go(grid[:2], tmp_path / "all", resume=True, notify=heard.append)
    assert done == grid[:2] and listener.begun == ([job.title for job in grid[:2]], 0)
    assert len(heard) == 1 and "seed 0 counts as not finished: '" in heard[0] and "pictures.npz' is damaged" in heard[0]
    assert [run.job for run in result.runs] == grid and [store.damage_of(*pair) for pair in zip(places, grid)] == [
        None
    ] * 3
    assert (places[2] / completion.DONE).stat().st_mtime_ns == stamp
    # One that is damaged and not asked for is told apart from those that failed.
    (places[2] / "map.npz").unlink()
    result, _ = go(grid[:2], tmp_path / "all", resume=True, notify=heard.append)
    assert (len(result.runs), result.missing, result.failed) == (2, 1, []) and len(heard) == 2


def test_a_comparison_whose_record_was_lost_is_gone_on_with(monkeypatch, tmp_path):
    engine = Engine(lambda *_, **__: pytest.fail("run"), slots=lambda *_: 1, check=lambda limits: None)
    monkeypatch.setitem(engines.ENGINES._entries, "fake", engine)
    grid = [variant(seed=seed) for seed in range(2)]
    write_comparison(tmp_path / "all", grid)
    (tmp_path / "all" / store.COMPARISON).write_bytes(b"\x00\xff")
    with pytest.raises(InputError, match="compare.json' is damaged: it is not UTF-8 text; move it away and give"):
        go(grid, tmp_path / "all", resume=True)
    (tmp_path / "all" / store.COMPARISON).unlink()
    with pytest.raises(InputError, match="holds other files"):
        check_output(tmp_path / "all", resume=False)
    check_output(tmp_path / "all", resume=True)
    result, _ = go(grid, tmp_path / "all", resume=True)
    assert len(result.runs) == 2 and recorded_jobs(tmp_path / "all") == grid


MINE = """
import numpy as np
from activestructure_gym.policies import Policy

class Mine(Policy):
    \"\"\"A view on offer.\"\"\"

    def act(self, observation):
        return int(np.flatnonzero(observation["action_mask"])[WHICH])
"""


@pytest.mark.slow
def test_what_was_played_by_own_code_that_has_changed_is_played_again(tmp_path, monkeypatch):
    kit, runs = tmp_path / "kit_of_mine", tmp_path / "runs"
    kit.mkdir()
    runs.mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))  # a folder without __init__.py, as one has it while trying things out
    monkeypatch.chdir(tmp_path)
    job = variant(scene_hash="", policy="kit_of_mine.plan:Mine", protocol=StandardProtocol(views=2))
    mark, told = run_directory(runs, job) / completion.DONE, []

    def go_on(asked=(job,), **options):  # by workers, which find the code by themselves
        told.clear()
        result = run_comparison(asked, runs, Silent(), engine="local", notify=told.append, **options)
        assert not result.failed
        return result.skipped, len(result.runs)

    def actions():
        return [step["action"] for step in open_comparison(runs)[0].steps]

    (kit / "plan.py").write_text(MINE.replace("WHICH", "0"))
    assert go_on() == (0, 1)
    first = actions()
    assert go_on(resume=True) == (1, 1) and not told

    (kit / "plan.py").write_text(MINE.replace("WHICH", "-1"))
    assert go_on([], resume=True) == (0, 1)
    assert (
        told == ["1 run with policy kit_of_mine.plan:Mine stays, though its code has changed since"]
        and actions() == first
    )
    with monkeypatch.context() as patch:

        def stopped(*_, **__):
            raise KeyboardInterrupt

        patch.setitem(engines.ENGINES._entries, "local", Engine(stopped, lambda *_: 1, lambda _: None))
        with pytest.raises(KeyboardInterrupt):
            go_on(resume=True)
    assert not mark.exists()  # what an older text played does not count meanwhile
    (kit / "plan.py").write_text(MINE.replace("WHICH", "0"))
    assert go_on(resume=True) == (1, 1) and not told and actions() == first  # and counts again where it is back

    (kit / "plan.py").write_text(MINE.replace("WHICH", "-1"))
    assert go_on(resume=True) == (0, 1)
    assert (
        told == ["1 run with policy kit_of_mine.plan:Mine is played again: its code has changed since"]
        and actions() != first
    )
    assert go_on(resume=True) == (1, 1) and not told

    (kit / "plan.py").unlink()  # nobody can say what it was: the run stays
    assert go_on([], resume=True) == (0, 1) and not told
