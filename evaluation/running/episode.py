"""Run one job: play its episode, measure the map, and write the run directory."""

from __future__ import annotations

import dataclasses
import shutil
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from activestructure_gym.evaluation.archive import completion, json_files, played, run_files, store
from activestructure_gym.evaluation.archive.decisions import DecisionLog
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.picture_record import plan_arrays
from activestructure_gym.evaluation.archive.plugin_code import KEY as OWN_CODE
from activestructure_gym.evaluation.archive.plugin_code import first_checksum_of, plugin_code_of
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.evaluation.protocols import CameraPath, get_protocol
from activestructure_gym.evaluation.protocols.metrics.without_truth import measured_without_truth
from activestructure_gym.evaluation.running.actors import Actor, build, chosen_row
from activestructure_gym.evaluation.running.measuring import measure
from activestructure_gym.evaluation.running.surroundings import (
    Surroundings,
    captures_in_progress,
    stored_surroundings,
    surroundings_of,
)
from activestructure_gym.npz import write_npz
from activestructure_gym.planes.record import graph_arrays, graph_summary
from activestructure_gym.policies.scored import recorded_scores

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.protocols import Truth
    from activestructure_gym.reconstruction import Reconstruction
    from activestructure_gym.scenes import Scene
    from activestructure_gym.worlds import StoredCaptures

CHECKPOINTS = 20  # points of the convergence curve after the first
_LOGGED = ("action_mask", "candidates", "candidate_features")  # entries of an observation that a run stores
IMAGE_CHECKPOINTS = 10  # points of the PSNR curve after the first; each renders every held-out view
CHECKPOINT_SAMPLES = 10_000  # surface samples for the completion ratio at a checkpoint: standard error below 0.5 %


Stage = Literal["loading", "exploring", "measuring", "done"]


@dataclass(frozen=True)
class Progress:
    """Describe the progress of a running job."""

    stage: Stage
    frames: int = 0
    frame_budget: int = 0
    completion_ratio: float | None = None  # % at the last checkpoint


def run_job(
    job: Job,
    directory: Path,
    progress: Callable[[Progress], None] | None = None,
    *,
    world: StoredCaptures | None = None,
    begun: Callable[[ReconstructionEnv], None] = lambda env: None,
) -> store.Run:
    """Run ``job``, write ``directory`` completely or not at all, and return the run.

    The played episode is stored before it is measured. If it is already stored, it is not played again.

    The result depends only on the job. Only ``timing.json`` contains times. Raise `InputError` if the job cannot be
    run.

    Parameters
    ----------
    job, directory
        The job and the directory of its run.
    progress
        Called with the progress.
    world
        Explore this world in place of the one that the job names.
    begun
        Called with the environment before its first reset.
    """
    notify = progress or (lambda _: None)
    notify(Progress("loading"))
    own = plugin_code_of(job, first_checksum_of)  # before the import: the files may be edited during the episode
    began = time.perf_counter()
    place = played.played_episode(directory, job, first_checksum_of)
    where = surroundings_of(job, directory, world) if place is None else stored_surroundings(job, place)
    truth = where.truth(job.conditions.protocol)
    for name in job.conditions.also:
        where.truth(get_protocol(name))
    if place is None:
        _play(job, directory, where, truth, own, time.perf_counter() - began, notify, begun)
        if completion.is_done(directory, job):  # another process was faster
            return store.read_run(directory)
        place = directory
    episode = played.read_episode(place)
    frames, budget = episode["metrics"]["frames"], episode["frame_budget"]
    notify(Progress("measuring", frames, budget, episode["curve"][-1]["completion_ratio"]))
    run = measure(job, place, directory, where, truth)
    notify(Progress("done", frames, budget, run.metrics["metrics"]["completion_ratio"]))
    return run


def _play(
    job: Job,
    directory: Path,
    where: Surroundings,
    truth: Truth | None,
    own: dict[str, str],
    loading: float,  # seconds spent on loading so far
    notify: Callable[[Progress], None],
    begun: Callable[[ReconstructionEnv], None],
) -> None:
    """Play the episode of ``job`` and store it in ``directory``, completely or not at all."""
    with closing(where):
        began = time.perf_counter()
        policy, env = build(job, where.explored)
        loading += time.perf_counter() - began
        # The parts that the policy names are known only now.
        own |= plugin_code_of(job, first_checksum_of, dataclasses.asdict(env.config))
        with closing(env):
            begun(env)
            episode = _Episode(job, env, policy, truth, notify, where.is_over)
            episode.run()
            with played.written_episode(directory, job) as part:
                _write_episode(part, job, where, env, episode, own, loading)
                _write_files(part, env.reconstruction)
                if where.world is not None:
                    played.link_folder(where.world.folder, part / store.CAPTURES)
    if where.world is not None:  # the run holds the captures now
        shutil.rmtree(captures_in_progress(directory), ignore_errors=True)  # those of a replay stay


def episode_metrics(scene: Scene | None, reconstruction: Reconstruction, episode: _Episode) -> dict[str, Any]:
    """Return the counts of an episode (frames, metres, decisions, ...) and its collisions with the true mesh.

    Without a scene, ``collisions`` is None, and the metrics of `protocols.metrics.without_truth` are added.
    """
    return {
        "frames": reconstruction.frames,
        "metres": reconstruction.metres,
        "decisions": reconstruction.decisions,
        "invalid_actions": sum(step["invalid_action"] for step in episode.steps),
        "keyframes": len(reconstruction.keyframe_indices),
        "gaussians": reconstruction.mapper.map.count,
        "collisions": None if scene is None else path_collisions(scene, np.stack(reconstruction.trajectory)),
        "ended": episode.ended,
        **(measured_without_truth(reconstruction) if scene is None else _followed(episode.env)),
    }


def _followed(env: ReconstructionEnv) -> dict[str, float]:
    """Return the metrics of a followed trajectory; empty for other runs."""
    from activestructure_gym.evaluation.references.trajectory_env import TrajectoryEnv, followed_metrics

    return followed_metrics(env) if isinstance(env, TrajectoryEnv) else {}


def path_collisions(scene: Scene, trajectory: np.ndarray) -> int:
    """Return how many executed steps of a trajectory [T, 4, 4] pass through the true mesh; expected: 0."""
    positions = trajectory[:, :3, 3]
    moved = np.linalg.norm(np.diff(positions, axis=0), axis=1) > 1e-9
    if not moved.any():
        return 0
    return int(scene.raycaster.occluded(positions[:-1][moved], positions[1:][moved]).sum())


class _Episode:
    """Play an episode, and record its decisions, convergence curve and times."""

    def __init__(
        self,
        job: Job,
        env: ReconstructionEnv,
        policy: Actor,
        truth: Truth | None,
        notify: Callable[[Progress], None],
        is_over: Callable[[], bool],
    ) -> None:
        self.job, self.env, self.policy, self.truth, self.notify = job, env, policy, truth, notify
        self._is_over = is_over
        self.steps: list[dict[str, Any]] = []
        self.decisions = None if job.policy.kind in ("reference", "trajectory") else DecisionLog()
        self.curve: list[dict[str, float | None]] = []
        self.ended = ""
        self.evaluation_seconds = 0.0
        self.total_seconds = 0.0  # without the evaluation
        self.decision_seconds: list[float] = []  # elapsed seconds at the end of each decision, without the evaluation
        self._policy_seconds = 0.0
        self._next_checkpoint = 0
        self._next_images = 0

    def run(self) -> None:
        """Play the episode from the first frame to its end."""
        env, policy = self.env, self.policy
        self._began = time.perf_counter()
        observation, info = env.reset(seed=self.job.seed)
        policy.reset(self.job.seed)
        self._checkpoint()
        given = self.job.policy.kind == "trajectory"
        ended = not given and not np.any(observation["action_mask"])
        truncated = stopped = False
        while not (ended or truncated):
            began = time.perf_counter()
            seen = {name: np.array(observation[name]) for name in _LOGGED}  # the policy may write into its observation
            with recorded_scores() as comparisons:
                action = chosen_row(self.job.policy, env, policy.act(observation))
            self._policy_seconds += time.perf_counter() - began
            if self.decisions is not None:
                self.decisions.add(seen, action, comparisons)
            step = self._describe(seen, action)
            observation, _, ended, truncated, info = env.step(action)
            stopped = self._is_over()
            ended |= stopped
            step |= {"frames": info["frames"], "metres": info["metres"]}
            step |= {name: value for name, value in info.items() if _is_logged(name, value)}
            step["graph"] = graph_summary(env.reconstruction.planes)
            self.decision_seconds.append(time.perf_counter() - self._began - self.evaluation_seconds)
            if ended or truncated or info["frames"] >= self._next_checkpoint:
                step["checkpoint"] = self._checkpoint(last=ended or truncated)
            self.steps.append(step)
            self.notify(Progress("exploring", info["frames"], env.reconstruction.frame_budget, self.last_ratio))
        by_choice = "ended by the policy" if env.reconstruction.finished else "no candidate left"
        by_choice = "the trajectory has ended" if given else by_choice
        by_choice = "stopped" if stopped else by_choice
        self.ended = "frame budget used up" if truncated else by_choice
        self.total_seconds = time.perf_counter() - self._began - self.evaluation_seconds

    @property
    def last_ratio(self) -> float | None:
        """Return the completion ratio (%) at the last checkpoint, None before the first."""
        return self.curve[-1]["completion_ratio"] if self.curve else None

    def seconds(self) -> dict[str, float]:
        """Return the wall-clock seconds by stage: those of the reconstruction and of the policy."""
        return {**self.env.reconstruction.seconds, "policy": self._policy_seconds}

    def _describe(self, observation: dict[str, np.ndarray], action: int) -> dict[str, Any]:
        """Return the log entry of a decision before it is executed."""
        from activestructure_gym.envs.observation import CANDIDATE_COLUMNS

        mask = observation["action_mask"]
        step: dict[str, Any] = {"decision": len(self.steps), "action": action, "candidates": int(np.sum(mask))}
        if self.job.policy.kind == "trajectory":
            return step | {"action": -1}
        if mask[action]:
            step["view"] = dict(zip(CANDIDATE_COLUMNS, observation["candidates"][action]))
            step["features"] = dict(zip(self.env.config.features, observation["candidate_features"][action]))
        return step | {"trace": run_files.trace_as_read(f"policy '{self.job.policy}'", self.policy.trace())}

    def _checkpoint(self, *, last: bool = False) -> dict[str, float | None]:
        """Add a point to the convergence curve and return its scores; the time counts as evaluation."""
        began = time.perf_counter()
        reconstruction = self.env.reconstruction
        frames, budget = reconstruction.frames, reconstruction.frame_budget
        # `measuring.measure` adds the numbers of the finished map to the last point.
        images = frames >= self._next_images and not last
        if images:
            self._next_images = _following(frames, budget // IMAGE_CHECKPOINTS)
        scores: dict[str, float | None]
        if self.truth is None:
            scores = {"completion_ratio": None, **measured_without_truth(reconstruction)}
        else:
            scores = {**self.job.conditions.protocol.checkpoint(
                reconstruction.mapper.map,
                self.truth,
                CameraPath.from_arrays(_path_arrays(reconstruction)),
                images=images,
                samples=CHECKPOINT_SAMPLES,
            )}  # fmt: skip
        point: dict[str, float | None]
        point = {"decision": reconstruction.decisions, "frames": frames, "metres": reconstruction.metres}
        self.curve.append(point | scores)
        self._next_checkpoint = _following(frames, budget // CHECKPOINTS)
        self.evaluation_seconds += time.perf_counter() - began
        return scores


def _following(frames: int, spacing: int) -> int:
    """Return the smallest multiple of ``spacing`` (at least 1) that is greater than ``frames``."""
    spacing = max(1, spacing)
    return (frames // spacing + 1) * spacing


def _is_logged(name: str, value: Any) -> bool:
    return name != "action_mask" and isinstance(value, bool | int | float | np.generic)


def _write_episode(
    part: Path,
    job: Job,
    where: Surroundings,
    env: ReconstructionEnv,
    episode: _Episode,
    own: dict[str, str],
    loading: float,
) -> None:
    """Write the configuration, the decisions, the curve and the times."""
    config = {
        "format": store.FORMAT_VERSION,
        "job": job.as_dict(),
        "hash": job.hash,
        "scene": where.facts,
        "configuration": dataclasses.asdict(env.config),
        "versions": machine.versions(),
        **({OWN_CODE: own} if own else {}),
    }
    content = {
        "metrics": episode_metrics(None if where.known is None else where.known.scene, env.reconstruction, episode),
        "frame_budget": env.reconstruction.frame_budget,
        "curve": episode.curve,
        "clock": {
            "seconds": {"loading": loading} | episode.seconds(),
            "evaluation": episode.evaluation_seconds,
            "total": episode.total_seconds,
            "decisions": episode.decision_seconds,
            "hardware": machine.hardware(),
        },
    }
    json_files.write_json(part / store.CONFIG, config)
    json_files.write_json(part / played.EPISODE, content)
    with open(part / store.STEPS, "w", encoding="utf-8") as file:
        file.writelines(json_files.json_line(step) for step in episode.steps)
    if episode.decisions is not None:
        write_npz(part / store.DECISIONS, episode.decisions.arrays())


def _write_files(part: Path, reconstruction: Reconstruction) -> None:
    """Write the map, the trajectory, the planes and the plan."""
    from activestructure_gym.mapping.ply import write_ply

    reconstruction.mapper.map.save_npz(part / store.MAP)
    write_ply(reconstruction.mapper.map, part / store.PLY)
    with open(part / store.TRAJECTORY, "wb") as file:
        np.savez(file, **_path_arrays(reconstruction))  # type: ignore[arg-type]
    write_npz(part / store.GRAPH, graph_arrays(reconstruction.planes))
    write_npz(part / played.PLAN, plan_arrays(reconstruction))


def _path_arrays(reconstruction: Reconstruction) -> dict[str, np.ndarray]:
    """Return the arrays of ``trajectory.npz``, see `Run.trajectory`: poses, keyframes, decisions, camera, range."""
    camera = reconstruction.config.sensor.camera
    return {
        "world_from_camera": np.stack(reconstruction.trajectory),
        "keyframes": np.array(reconstruction.keyframe_indices, dtype=np.int64),
        "keyframe_rounds": np.array(reconstruction.refine_factors, dtype=np.int64),
        "legs": np.array(reconstruction.legs, dtype=np.int64).reshape(-1, 3),
        "intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "image_size": np.array([camera.width, camera.height], dtype=np.int64),
        "max_range": np.array(reconstruction.config.sensor.max_range, dtype=np.float64),
    }
