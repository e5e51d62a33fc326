"""A cluster of two machines on this one, which loses a worker and then a machine."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.comparison import run_directory
from activestructure_gym.evaluation.archive.completion import is_done
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running import episode
from activestructure_gym.evaluation.running.engines import ENGINES, ray_cluster
from activestructure_gym.evaluation.running.engines.base import LOGS, Limits
from activestructure_gym.evaluation.running.engines.ray_cluster import run_ray

pytestmark = pytest.mark.slow

# Finishes at once, unless its policy says how its first attempt is lost; waits there, and says who runs it.
STAND_IN = """
import json, os, pathlib, sys, time
policy = json.loads(sys.stdin.readline())["policy"]
directory = pathlib.Path(sys.argv[1])
marks = directory.parent.parent / "marks"
marks.mkdir(exist_ok=True)
mine = marks / f"{policy}.{len(list(marks.glob(policy + '.*')))}"
mine.write_text(json.dumps({"process": os.getpid(), "ray": os.getppid(), "threads": os.environ["OMP_NUM_THREADS"]}))
print(json.dumps({"stage": "exploring", "frames": 5, "frame_budget": 10}), flush=True)  # once the mark can be read
if policy == "wrong":
    sys.exit("it cannot be done")
if policy.startswith("lost") and mine.suffix == ".0":
    sys.stdin.read()
    sys.exit(3)
if policy == "hangs" and mine.suffix == ".0":
    time.sleep(300)
directory.mkdir(parents=True)
(directory / ".done").write_text(directory.name.rpartition("--")[2])
"""


class Recorder:
    """Kills what it is told to as soon as that runs."""

    def __init__(self, place=None, kill=None):
        self.progressed, self.lost, self.outcomes = [], [], []
        self.place, self.kill = place, kill

    def begin(self, jobs, finished):
        pass

    def progress(self, job, progress):
        self.progressed.append((job.policy, progress.frames))
        mark = self.place / "marks" / "lost.0" if self.place else None
        if self.kill and job.policy == "lost" and mark.is_file():
            kill, self.kill = self.kill, None
            kill(json.loads(mark.read_text()))

    def on_retry(self, job, error):
        self.lost.append((job.policy, error))

    def ended(self, outcome):
        self.outcomes.append(outcome)


@pytest.fixture(scope="module")
def cluster():
    """A head that runs no jobs, and one machine with two cores."""
    ray = pytest.importorskip("ray", reason="engine ray is an extra: pip install 'activestructure-gym[ray]'")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        patch.setenv("PYTHONPATH", os.pathsep.join([os.getcwd(), *sys.path]))
        patch.delenv("RAY_ADDRESS", raising=False)
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
        cluster.add_node(num_cpus=2)
        ray.init(address=cluster.address, log_to_driver=False, logging_level="error")
        yield cluster
        ray.shutdown()
        cluster.shutdown()


def jobs(*policies: str) -> list[Job]:
    return [Job("box", policy, seed) for seed, policy in enumerate(policies)]


def run(todo, place, listener, limits=None):
    return run_ray(todo, place, listener, limits or Limits(), command=("-c", STAND_IN))


def marks(place: Path, policy: str) -> list[dict]:
    return [json.loads(path.read_text()) for path in sorted((place / "marks").glob(f"{policy}.*"))]


def ends(process: int) -> bool:
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


def test_a_cluster_out_of_reach_is_one_sentence(monkeypatch):
    # The first test: afterwards there is a cluster.
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_ADDRESS", "nonsense")
    with pytest.raises(InputError, match="RAY_ADDRESS=nonsense cannot be reached"):
        ENGINES.get("ray").slots(1, Limits())


HEAD = """
import os, sys
from ray.cluster_utils import Cluster
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
print(cluster.address, flush=True)
sys.stdin.readline()
cluster.shutdown()
"""
CONNECT = """
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.running.engines import ray_cluster
try:
    ours, ray = ray_cluster._connect()
    print("answer", ray.get(ray.remote(lambda: 42).remote()))
except InputError as error:
    print("refused", error)
"""


@pytest.fixture
def alone(tmp_path):
    """The environment of a user with an empty home, on a machine where Ray keeps to itself."""
    pytest.importorskip("ray")
    names = [name for name in os.environ if name.startswith("RAY_")]
    environment = {name: value for name, value in os.environ.items() if name not in names}
    path = os.pathsep.join([os.getcwd(), *filter(None, sys.path)])
    return environment | {"HOME": str(tmp_path), "PYTHONPATH": path, "RAY_USAGE_STATS_ENABLED": "0"}


def connected(environment: dict[str, str]) -> str:
    """How a process in this environment fares."""
    done = subprocess.run([sys.executable, "-c", CONNECT], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_cluster_of_its_own_leaves_no_token_behind(alone, tmp_path):
    assert connected(alone) == "answer 42"
    assert not (tmp_path / ".ray").exists()


def test_a_token_that_is_asked_for_and_not_there_is_one_sentence(alone):
    refused = connected(alone | {"RAY_AUTH_MODE": "token", "RAY_ADDRESS": "127.0.0.1:1"})
    assert refused.startswith("refused the Ray cluster at RAY_ADDRESS=127.0.0.1:1 cannot be reached")
    assert "\n" not in refused and "token was found; if it asks" in refused and "`ray get-auth-token`" in refused


@pytest.mark.parametrize("asks", [True, False])
def test_a_cluster_gets_the_token_that_is_there(alone, tmp_path, asks):
    right, wrong = ({"RAY_AUTH_TOKEN": letter * 64} for letter in "ab")
    mode = {"RAY_AUTH_MODE": "token", **right} if asks else {"RAY_AUTH_MODE": "disabled"}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, "-c", HEAD], env=alone | mode, text=True, **pipes) as head:
        try:
            user = alone | {"RAY_ADDRESS": head.stdout.readline().strip()}
            assert connected(user | right) == "answer 42"
            (tmp_path / ".ray").mkdir()
            (tmp_path / ".ray" / "auth_token").write_text(right["RAY_AUTH_TOKEN"])
            assert connected(user) == "answer 42"
            if asks:
                refused = connected(user | wrong | {"RAY_gcs_rpc_server_connect_timeout_s": "2"})
                assert refused.startswith("refused") and "RAY_AUTH_TOKEN" in refused and "\n" not in refused
        finally:
            head.communicate("end\n", timeout=60)


def test_results_logs_and_errors_are_those_of_engine_local(cluster, tmp_path):
    listener, todo = Recorder(), jobs("a", "wrong", "b", "hangs")
    outcomes = run(todo, tmp_path, listener, Limits(timeout_min=10 / 60))
    ended = {outcome.job.policy: (outcome.error, outcome.attempts) for outcome in outcomes}
    assert ended == {
        "a": (None, 1),
        "wrong": ("it cannot be done (exit code 1)", 1),
        "b": (None, 1),
        "hangs": (None, 2),
    }
    assert [policy for policy, _ in listener.lost] == ["hangs"]
    assert set(listener.progressed) == {(policy, 5) for policy in ("a", "wrong", "b", "hangs")}
    assert all(is_done(run_directory(tmp_path, job), job) for job in todo if job.policy != "wrong")
    assert [path.read_text() for path in (tmp_path / LOGS).iterdir()] == ["it cannot be done\n"]
    assert marks(tmp_path, "a")[0]["threads"] == "1"  # four jobs on two cores


def test_a_job_outlives_the_ray_worker_that_ran_it(cluster, tmp_path):
    listener = Recorder(tmp_path, lambda mark: os.kill(mark["ray"], signal.SIGKILL))
    outcomes = run(jobs("lost", "a"), tmp_path, listener)
    assert [outcome.finished for outcome in outcomes] == [True, True] and listener.kill is None
    first, second = marks(tmp_path, "lost")
    assert first["ray"] != second["ray"] and len(marks(tmp_path, "a")) == 1
    assert ends(first["process"])  # its standard input ended


def test_a_real_job_gives_the_bits_of_engine_inline(cluster, tmp_path, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path / "cache"))
    protocol = StandardProtocol(views=1, view_width=64, view_height=36, surface_samples=2000)
    job = Job("box", "pixel_only", 0, conditions=Conditions(preset="fast", frame_budget=12, protocol=protocol))
    (outcome,) = ENGINES.get("ray").run([job], tmp_path / "out", Recorder(), Limits())
    assert outcome.finished, outcome.error
    again = episode.run_job(job, tmp_path / "again")
    for name in ("metrics.json", "steps.jsonl", "config.json"):
        assert (again.directory / name).read_bytes() == (run_directory(tmp_path / "out", job) / name).read_bytes()


def test_an_answer_that_comes_late_is_not_lost(cluster):
    import ray

    class Slow(ray_cluster._Board):
        def take(self):
            time.sleep(0.5)
            return super().take()

    board = ray.remote(num_cpus=0)(Slow).remote()
    board.add.remote("job", "line")
    news, looks, heard = ray_cluster._BoardReader(ray, board), 0, []
    while not heard and looks < 3000:  # five minutes for a busy machine
        heard, looks = news.lines(0.1), looks + 1
    assert heard == [("job", "line")] and looks > 1


def test_jobs_outlive_the_machine_that_ran_them(cluster, tmp_path):
    # The last test: afterwards the cluster is another one.
    (machine,) = cluster.worker_nodes

    def kill(mark):
        deadline = time.monotonic() + 60  # what has not begun would wait on the next machine, and nothing kill it there
        while not (tmp_path / "marks" / "lost-too.0").is_file() and time.monotonic() < deadline:
            time.sleep(0.05)
        cluster.remove_node(machine, allow_graceful=False)
        cluster.add_node(num_cpus=1)

    listener = Recorder(tmp_path, kill)
    outcomes = run(jobs("lost", "lost-too", "a"), tmp_path, listener)
    assert [outcome.finished for outcome in outcomes] == [True, True, True] and listener.kill is None
    for policy in ("lost", "lost-too"):
        first, second = marks(tmp_path, policy)
        assert ends(first["process"])
