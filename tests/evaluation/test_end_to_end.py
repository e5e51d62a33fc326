"""The main job on the smallest scene: compared, resumed, measured again."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.evaluation.archive import completion, store
from activestructure_gym.evaluation.archive.comparison import open_comparison
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.metrics.planning import CURVE_MEASURES
from activestructure_gym.evaluation.protocols import ActiveGamerProtocol, StandardProtocol
from activestructure_gym.evaluation.running import comparison, episode, recorded_scene
from activestructure_gym.evaluation.running.warmup import warming_up
from activestructure_gym.mapping import GaussianMap

CRASHING = """
from activestructure_gym.policies import Policy

class Crashing(Policy):
    def act(self, observation):
        print("noise on standard output")
        raise RuntimeError("lost the way")
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A working directory with a cache of its own and a third party's policy."""
    directory = tmp_path_factory.mktemp("compare")
    (directory / "third_party.py").write_text(CRASHING)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ASG_CACHE_DIR", str(directory / "cache"))
        patch.chdir(directory)
        patch.syspath_prepend(str(directory))
        patch.setattr(comparison, "warming_up", warming_up)  # it alone compiles ahead: see `bare_jobs`
        yield directory


COMMAND = [
    "compare", "--scenes", "box", "--policies", "random,pixel_only,third_party:Crashing", "--preset", "fast",
    "--frames", "25", "--views", "3", "--samples", "20000", "--out", "out",
]  # fmt: skip


@pytest.fixture(scope="module")
def finished(place):
    """Exit code and directory of the comparison, run by engine ``local``."""
    return main(COMMAND), place / "out"


@pytest.fixture(scope="module")
def runs(finished):
    return open_comparison(finished[1])


def test_two_finish_and_the_third_is_named(finished, runs):
    code, out = finished
    assert code == 1
    assert [run.policy for run in runs] == ["random", "pixel_only"]
    summary = (out / "summary.md").read_text()
    assert "box · third_party:Crashing · seed 0: RuntimeError: lost the way (exit code 1)" in summary
    # The two that finished write nothing but that kernels are compiled, where some still are.
    logs = [path.read_text() for path in (out / "logs").iterdir()]
    (log,) = [text for text in logs if not all("kernel" in line for line in text.splitlines())]
    assert "noise on standard output" in log and "Traceback" in log
    assert {path.name for path in (out / "jobs").iterdir()} == {run.directory.name for run in runs}


def test_the_archive_holds_everything(finished, runs):
    _, out = finished
    files = {"report.html", "summary.md", "results.csv", "convergence.svg", "views.png", "plans.png", "compare.json"}
    assert files <= {path.name for path in out.iterdir()}
    for run in runs:
        config, metrics = run.config, run.metrics["metrics"]
        assert config["job"]["policy"] == run.policy and config["configuration"]["frame_budget"] == 25
        assert config["scene"]["content_hash"] == run.job.scene_hash == run.metrics["scene"]
        assert run.metrics["protocol"]["name"] == "standard" and run.metrics["protocol"]["opacity_threshold"] == 0.5
        assert config["versions"]["numpy"] == np.__version__
        assert metrics["frames"] == 25 and metrics["collisions"] == 0
        assert 0 < metrics["completion_ratio"] <= 100 and metrics["precision"] > 80 and metrics["psnr"] > 5
        assert len(metrics["views"]) == 3
        assert run.timing["total"] > 0 and {"sensor", "mapping", "planning", "policy"} <= run.timing["seconds"].keys()


def test_decisions_path_and_curve_agree(runs):
    for run in runs:
        metrics, steps, poses = run.metrics["metrics"], run.steps, run.trajectory["world_from_camera"]
        assert [step["decision"] for step in steps] == list(range(metrics["decisions"]))
        assert steps[-1]["frames"] == metrics["frames"] and len(run.timing["decisions"]) == len(steps)
        walked = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
        assert metrics["metres"] == pytest.approx(walked)
        assert len(run.trajectory["keyframes"]) == metrics["keyframes"]
        curve = run.metrics["curve"]
        assert curve[0]["frames"] == 1 and curve[-1]["frames"] == metrics["frames"]
        measured = {name for name in CURVE_MEASURES if metrics[name] is not None}
        assert {"completion_ratio", "observed", "psnr", "depth_l1_cm"} <= measured
        assert all(curve[-1][name] == metrics[name] for name in measured)  # to the last digit
        assert curve[-1]["completion_ratio"] > curve[0]["completion_ratio"]
    (pixel_only,) = (run for run in runs if run.policy == "pixel_only")
    step = pixel_only.steps[0]
    assert step["features"]["pixel"] == pytest.approx(step["trace"]["pixel"])
    assert {"x", "y", "z", "path_length"} <= step["view"].keys()


def test_the_graph_is_kept_and_drawn(runs):
    for run in runs:
        graph, last = run.graph, run.steps[-1]["graph"]
        assert len(graph["ids"]) == run.steps[-1]["planes"] == last["structural"] + last["objects"]
        assert last["deficit"] == pytest.approx(graph["deficit"].mean())
        assert last["deficiency_area"] == pytest.approx(graph["deficiency_areas"].sum())
        assert {"psg_plan.png", "psg_3d.png"} <= {path.name for path in run.directory.iterdir()}


def test_the_map_can_be_read_without_us(runs):
    for run in runs:
        gaussians = GaussianMap.load_npz(run.directory / "map.npz")
        assert gaussians.count == run.metrics["metrics"]["gaussians"]
        with open(run.directory / "map.ply", "rb") as file:
            assert file.readline() == b"ply\n"


def test_another_process_and_engine_give_the_same_bits(runs, tmp_path):
    run = runs[1]
    again = episode.run_job(run.job, tmp_path / "again")
    for name in ("metrics.json", "steps.jsonl", "config.json"):
        assert (again.directory / name).read_bytes() == (run.directory / name).read_bytes(), name
    first, second = (GaussianMap.load_npz(r.directory / "map.npz") for r in (run, again))
    np.testing.assert_array_equal(first.parameters, second.parameters)


def test_resuming_repeats_only_what_did_not_finish(finished, runs, capsys):
    _, out = finished
    stamps = {run.directory: (run.directory / completion.DONE).stat().st_mtime_ns for run in runs}
    text = " ".join(COMMAND).replace("third_party:Crashing", "random").split()
    assert main(text) == 2  # not without --resume
    assert "--resume" in capsys.readouterr().err
    assert main([*text, "--resume"]) == 0
    assert "2 runs finished before and kept" in capsys.readouterr().out
    for directory, stamp in stamps.items():
        assert (directory / completion.DONE).stat().st_mtime_ns == stamp


def test_measuring_again_gives_the_same_bits_and_a_wrong_number_is_found(runs, capsys, tmp_path):
    assert main(["evaluate", *(str(run.directory) for run in runs)]) == 0
    assert "identical" in capsys.readouterr().out
    import shutil

    forged = shutil.copytree(runs[0].directory, tmp_path / "forged")
    metrics = json.loads((forged / "metrics.json").read_text())
    metrics["metrics"]["psnr"] += 1e-9
    (forged / "metrics.json").write_text(json.dumps(metrics))
    assert main(["evaluate", str(forged)]) == 2
    assert "its content does not match its checksum in .done" in capsys.readouterr().err
    mark = forged / completion.DONE
    mark.write_text(mark.read_text().splitlines()[0])  # a run of a version that kept no checksums
    assert main(["evaluate", str(forged)]) == 1
    assert "1 of 1 differ" in capsys.readouterr().out


@dataclass(frozen=True)
class SmallActiveGamer(ActiveGamerProtocol):
    """The same with fewer pixels and samples."""

    surface_samples: int = 5000
    image_divisor: int = 4


def test_a_further_protocol_is_measured_kept_and_reproduced(runs, capsys, monkeypatch, tmp_path):
    import shutil

    from activestructure_gym.evaluation.protocols import PROTOCOLS

    monkeypatch.setitem(PROTOCOLS._entries, "activegamer", SmallActiveGamer)
    copy = shutil.copytree(runs[0].directory, tmp_path / "run")
    assert main(["evaluate", str(copy), "--protocols", "activegamer"]) == 0
    assert "measured for the first time" in capsys.readouterr().out
    run = store.read_run(copy)
    assert list(run.protocols) == ["standard", "activegamer"]
    assert run.protocols["standard"]["metrics"] == run.metrics["metrics"]
    kept = run.protocols["activegamer"]
    assert kept["parameters"]["image_divisor"] == 4 and len(kept["metrics"]["views"]) == 36
    assert 0 < kept["metrics"]["completion_ratio"] < 100 and 0 < kept["metrics"]["ms_ssim"] < 1
    assert main(["evaluate", str(copy)]) == 0  # both again
    assert "first time" not in capsys.readouterr().out
    path = copy / store.EVALUATIONS / "activegamer.json"
    content = json.loads(path.read_text())
    content["metrics"]["accuracy_cm"] += 1e-9
    path.write_text(json.dumps(content))
    assert main(["evaluate", str(copy)]) == 1
    assert "1 of 2 differ" in capsys.readouterr().out


def test_a_job_that_asks_for_a_further_protocol_writes_its_numbers(runs, monkeypatch, tmp_path):
    from dataclasses import replace

    from activestructure_gym.evaluation.protocols import PROTOCOLS

    monkeypatch.setitem(PROTOCOLS._entries, "activegamer", SmallActiveGamer)
    conditions = replace(runs[0].job.conditions, frame_budget=3)
    job = replace(runs[0].job, conditions=replace(conditions, also=("activegamer",)))
    assert job.hash != replace(job, conditions=conditions).hash
    run = episode.run_job(job, tmp_path / "run")
    assert run.protocols["activegamer"]["metrics"]["true_samples"] > 1000


@dataclass(frozen=True)
class SmallStandard(StandardProtocol):
    """The constants of this module's comparison."""

    surface_samples: int = 20_000
    views: int = 3


def test_an_exported_map_scores_as_the_run_did(runs, tmp_path, capsys, monkeypatch):
    from activestructure_gym.evaluation.protocols import PROTOCOLS

    monkeypatch.setitem(PROTOCOLS._entries, "standard", SmallStandard)
    run = runs[1]
    stored = run.metrics["metrics"]
    for form, name in (("ply", "map.ply"), ("splatam", "params.npz")):
        file = tmp_path / name
        assert main(["export", str(run.directory), "--format", form, "--out", str(file)]) == 0
        poses = ["--poses", str(run.directory / "trajectory.npz")] if form == "ply" else []
        numbers = tmp_path / f"{form}.json"
        assert main(["evaluate", "--map", str(file), "--scene", "box", "--out", str(numbers), *poses]) == 0
        capsys.readouterr()
        measured = json.loads(numbers.read_text())["protocols"]["standard"]["metrics"]
        # Colours are rounded on the way into a PLY; SplaTAM's file moves the map to another frame and back.
        for name in ("completion_ratio", "precision", "psnr", "tsdf_precision", "tsdf_completion_ratio"):
            assert measured[name] == pytest.approx(stored[name], abs=0.2), (form, name)
    without = tmp_path / "without.json"
    assert main(["evaluate", "--map", str(tmp_path / "map.ply"), "--scene", "box", "--out", str(without)]) == 0
    measured = json.loads(without.read_text())["protocols"]["standard"]["metrics"]
    assert measured["tsdf_precision"] is None and "poses" in measured["notes"]["tsdf"]


def test_a_scene_that_changed_is_not_taken_for_the_old_one(runs):
    from dataclasses import replace

    from activestructure_gym.errors import InputError

    with pytest.raises(InputError, match="has changed"):
        recorded_scene.load_job_scene(replace(runs[0].job, scene="box?seed=9"))


def test_a_job_that_fails_before_its_episode_is_kept_leaves_nothing(runs, tmp_path, monkeypatch):
    from dataclasses import replace

    def full_disk(*arguments):
        raise OSError("No space left on device")

    monkeypatch.setattr(episode, "_write_files", full_disk)
    job = replace(runs[0].job, conditions=replace(runs[0].job.conditions, frame_budget=3))
    with pytest.raises(OSError, match="No space left"):
        episode.run_job(job, tmp_path / "jobs" / job.name)
    assert not any((tmp_path / "jobs").iterdir())


def test_a_policy_that_returns_no_row_is_told(runs, tmp_path, monkeypatch):
    from dataclasses import replace

    from activestructure_gym.errors import InputError
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.policies.random import Random

    class Silent(Random):
        def act(self, observation):
            self.rng.random()

    monkeypatch.setitem(POLICIES._entries, "silent", Silent)
    job = replace(runs[0].job, policy="silent", conditions=replace(runs[0].job.conditions, frame_budget=3))
    with pytest.raises(
        InputError, match=r"policy 'silent': act\(\) must return a row, a whole number from 0 to \d+, got None"
    ):
        episode.run_job(job, tmp_path / "jobs" / job.name)


def test_choices_of_rows_without_a_candidate_are_counted_and_told(runs, tmp_path, monkeypatch):
    from dataclasses import replace

    from activestructure_gym.evaluation.archive.store import read_run
    from activestructure_gym.evaluation.replay.why import explain
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.policies.random import Random

    class Last(Random):
        def act(self, observation):
            return len(observation["action_mask"]) - 1

    monkeypatch.setitem(POLICIES._entries, "last", Last)
    job = replace(runs[0].job, policy="last", conditions=replace(runs[0].job.conditions, frame_budget=4))
    episode.run_job(job, tmp_path / job.name)
    run = read_run(tmp_path / job.name)
    assert run.metrics["metrics"]["invalid_actions"] == 3 == len(run.steps) and "view" not in run.steps[0]
    assert "which holds no candidate" in explain(run, 1).reason
    assert runs[0].metrics["metrics"]["invalid_actions"] == 0


@pytest.mark.parametrize(
    ("trace", "said"),
    [([1.0], "table of names"), ({"mine": object()}, "object cannot be written"), ({"phase": 3}, "phase: expected")],
)
def test_a_trace_that_a_run_cannot_hold_is_told_at_once(runs, tmp_path, monkeypatch, trace, said):
    from dataclasses import replace

    from activestructure_gym.checks import check_policy
    from activestructure_gym.errors import InputError
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.policies.random import Random

    class Tracing(Random):
        def trace(self):
            return trace

    monkeypatch.setitem(POLICIES._entries, "tracing", Tracing)
    job = replace(runs[0].job, policy="tracing", conditions=replace(runs[0].job.conditions, frame_budget=3))
    with pytest.raises(InputError, match=rf"policy 'tracing': trace\(\) must return .*{said}"):
        episode.run_job(job, tmp_path / job.name)
    with pytest.raises(InputError, match=said):
        check_policy(Tracing, "box", frames=3)


def test_every_executed_step_is_cast_against_the_true_mesh(place):
    from activestructure_gym.scenes import load_scene

    scene = load_scene("box")
    low, high = scene.bounds
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = (low + high) / 2
    assert episode.path_collisions(scene, poses) == 0  # standing still
    poses[1, 0, 3] = high[0] + 1.0  # out through the wall, and back in
    assert episode.path_collisions(scene, poses) == 2


def test_nothing_was_written_outside(place, finished):
    assert {path.name for path in Path(place).iterdir()} <= {"cache", "out", "third_party.py", "__pycache__"}


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["hotel_room.glb?up=z", "bookstore.glb?up=z", "replica_fixture/room_fix"])
def test_real_scenes(shared, scene, tmp_path):
    out = tmp_path / "out"
    assert main(
        ["compare", "--scenes", str(shared / "scenes" / scene), "--preset", "fast", "--frames", "60", "--views", "4",
         "--engine", "inline", "--out", str(out)]
    ) == 0  # fmt: skip
    for run in open_comparison(out):
        metrics = run.metrics["metrics"]
        assert metrics["collisions"] == 0 and metrics["frames"] == 60
        assert metrics["precision"] > 80 and metrics["completion_ratio"] > 1
