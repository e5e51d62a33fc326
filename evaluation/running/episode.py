"""Running one job: from a scene and a policy to a finished run directory."""

from __future__ import annotations

import dataclasses
import os
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from activestructure_gym.errors import InputError, InputWarning, shown
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.jobs import Job, is_reference, is_trajectory, split_spec
from activestructure_gym.evaluation.archive.own_code import KEY as OWN_CODE
from activestructure_gym.evaluation.archive.own_code import first_sum_of, own_code
from activestructure_gym.evaluation.archive.picture_record import picture_arrays
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.evaluation.metrics.planning import CURVE_MEASURES, planning_scores
from activestructure_gym.evaluation.protocols import CameraPath, get_protocol
from activestructure_gym.planes.record import graph_arrays, graph_summary

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.protocols import Truth
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.reconstruction import Reconstruction
    from activestructure_gym.scenes import Scene

SCENE_FOLDERS = "ASG_SCENES"  # variable: where files are looked for that have moved since a record was made
CHECKPOINTS = 20  # points of the convergence curve, besides the first
IMAGE_CHECKPOINTS = 10  # points of the PSNR curve, besides the first: each renders every held-out view
CHECKPOINT_SAMPLES = 10_000  # surface points its C.R. is taken on: standard error below 0.5 %
# In how many parts the budget is divided by points at which the TSDF surface is fused anew out of the depth at all
# keyframes: each as dear as at the end in proportion to the keyframes so far. The last point is the finished map's.
SURFACE_CHECKPOINTS = 4


Stage = Literal["loading", "exploring", "measuring", "done"]


class Decider(Protocol):
    """Who chooses: a policy, or a reference."""

    def reset(self, seed: int) -> None:
        """Begin an episode."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """The row to go to."""

    def trace(self) -> dict[str, Any]:
        """Numbers behind the last choice."""


@dataclass(frozen=True)
class Progress:
    """Progress of a running job."""

    stage: Stage
    frames: int = 0
    frame_budget: int = 0
    completion_ratio: float | None = None  # % at the last checkpoint


def run_job(job: Job, directory: Path, progress: Callable[[Progress], None] | None = None) -> store.Run:
    """Run ``job`` and write ``directory``, whole or not at all; returns what was written.

    A pure function of the job: no global state, no clock in any result but ``timing.json``. Raises `InputError` where
    the job cannot be run at all.
    """
    from activestructure_gym.ground_truth import ground_truth_of

    tell = progress or (lambda _: None)
    tell(Progress("loading"))
    own = own_code(job, first_sum_of)  # before it is imported, as it may be edited while it plays
    began = time.perf_counter()
    scene = load_job_scene(job)
    known = ground_truth_of(scene)
    truth = job.protocol.truth(known)
    others = [get_protocol(name) for name in job.also]
    policy, env = build(job, known)
    seconds = {"loading": time.perf_counter() - began}
    try:
        episode = _Episode(job, env, policy, truth, tell)
        episode.run()
        reconstruction = env.reconstruction
        tell(Progress("measuring", reconstruction.frames, reconstruction.frame_budget, episode.last_ratio))
        began = time.perf_counter()
        path = CameraPath.from_arrays(_path_arrays(reconstruction))
        metrics = job.protocol.evaluate(reconstruction.mapper.map, truth, path)
        episode.end_curve(metrics)
        planned, reasons = planning_scores(episode.curve, reconstruction.frame_budget)
        metrics |= planned | {"planning_notes": reasons} | episode_metrics(scene, reconstruction, episode)
        with store.whole_directory(directory) as part:
            reconstruction.mapper.map.save_npz(part / "map.npz")
            _write_ply(reconstruction, part)
            _write_record(part, job, scene, env, metrics, episode, own)
            for other in others:
                numbers = other.evaluate(reconstruction.mapper.map, other.truth(known), path)
                store.write_evaluation(part, other.parameters(), scene.content_hash, numbers)
            _write_pictures(part, job, truth, reconstruction, metrics)
            seconds |= episode.seconds() | {"evaluation": episode.evaluation_seconds + time.perf_counter() - began}
            timing = {
                "seconds": seconds,
                "total": episode.total_seconds,
                "decisions": episode.decision_seconds,
                "hardware": machine.hardware(),
            }
            store.write_json(part / "timing.json", timing)
            _draw_pictures(part)
            # Last: a directory without it is not a result.
            store.finish(part, job)
    finally:
        env.close()
    tell(Progress("done", reconstruction.frames, reconstruction.frame_budget, metrics["completion_ratio"]))
    return store.read_run(directory)


def load_job_scene(job: Job) -> Scene:
    """The job's scene; raises `InputError` if its file is not the one the job was made for."""
    return scene_as_recorded(job.scene, job.scene_hash)


def scene_as_recorded(spec: str, content_hash: str) -> Scene:
    """The scene of a record, known by its content; an empty hash is that of any.

    A record may name a mesh without the axis that was up then. Where the file turned to that axis is the scene of the
    record to the last bit, it is used, and said. So is a file of the same name and content in the working directory or
    a folder of ``ASG_SCENES``, where the record's own is not there. Raises `InputError` for every other content.
    """
    from activestructure_gym.scenes import load_scene
    from activestructure_gym.scenes.loaders.upright import UP_AXES

    if not content_hash:
        return load_scene(spec)
    try:
        scene = _quietly(load_scene, spec)
        refusal = InputError(
            f"scene '{spec}' has changed since this run was planned: expected content {content_hash[:12]}, found "
            f"{scene.content_hash[:12]}; start a new comparison"
        )
        if scene.content_hash == content_hash:
            return scene
    except InputError as error:
        refusal = error
    for up in UP_AXES:
        try:
            turned = _quietly(load_scene, spec, up=up)
        except InputError:  # no mesh file
            break
        if turned.content_hash == content_hash:
            told = f"scene '{spec}': this record was made with {up} up, and is gone on with so; name it with up={up}"
            warnings.warn(told, InputWarning, stacklevel=2)
            return turned
    for other in _moved_specs(spec):
        with suppress(InputError):
            found = scene_as_recorded(other, content_hash)
            warnings.warn(f"scene '{spec}' is not there: '{other}' has its content", InputWarning, stacklevel=2)
            return found
    if _is_gone(spec):
        raise InputError(
            f"{refusal}; a file that has moved is found by its name in the working directory and in the folders of "
            f"{SCENE_FOLDERS}, if its content is the same"
        )
    raise refusal


def _moved_specs(spec: str) -> list[str]:
    """Specs of files called as the one of ``spec``, which is not there, in the folders where they are looked for."""
    kind, path, options = split_spec(spec)
    if not _is_gone(spec):
        return []
    folders = [os.getcwd(), *filter(None, os.environ.get(SCENE_FOLDERS, "").split(os.pathsep))]
    places = [Path(os.path.expanduser(folder)) / Path(path).name for folder in folders]
    return [
        (f"{kind}:" if kind else "") + str(place) + (f"?{options}" if options else "")
        for place in places
        if place.exists()
    ]


def _is_gone(spec: str) -> bool:
    """Whether a spec names a file or folder by its whole path, and nothing is there."""
    path = split_spec(spec)[1]
    return os.path.isabs(path) and not os.path.exists(path)


def _quietly(load: Callable[..., Scene], spec: str, **options: Any) -> Scene:
    """``load(spec)`` without its `InputWarning`s: they were given when the scene was chosen."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return load(spec, **options)


def build(job: Job, known: GroundTruth) -> tuple[Decider, ReconstructionEnv]:
    """The job's policy and an env that offers the gains it asks for; or its reference, which alone gets the truth.

    Or who follows the job's trajectory, which decides nothing.

    The env never ends an episode by how much surface was seen: that is ground truth, and no planner may profit.
    """
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.policies import make_policy

    if is_reference(job.policy):
        from activestructure_gym.evaluation.running.references import WHOLE_POOL, make_reference

        env = ReconstructionEnv(
            scene=known,
            preset=job.preset,
            frame_budget=job.frame_budget,
            gains=(),
            config=dict(job.overrides) | {"views.max_candidates": WHOLE_POOL},
            coverage_target=None,
            start_pose=job.start_pose,
        )
        return make_reference(job.policy, env, known, job.protocol), env
    if is_trajectory(job.policy):
        from activestructure_gym.evaluation.running.following import follower_of

        return follower_of(job, known)
    policy = make_policy(job.policy)
    env = ReconstructionEnv(
        scene=known,
        preset=job.preset,
        frame_budget=job.frame_budget,
        gains=tuple(policy.required_gains),
        config=job.changes(policy),
        coverage_target=None,
        start_pose=job.start_pose,
    )
    policy.bind(env)
    return policy, env


def episode_metrics(scene: Scene, reconstruction: Reconstruction, episode: _Episode) -> dict[str, Any]:
    """Frames, metres, decisions and Gaussians of an episode, and its collisions with the true mesh."""
    return {
        "frames": reconstruction.frames,
        "metres": reconstruction.metres,
        "decisions": reconstruction.decisions,
        "keyframes": len(reconstruction.keyframe_indices),
        "gaussians": reconstruction.mapper.map.count,
        "collisions": path_collisions(scene, np.stack(reconstruction.trajectory)),
        "ended": episode.ended,
    } | _followed(episode.env)


def _followed(env: ReconstructionEnv) -> dict[str, float]:
    """What is told of a trajectory that was given, nothing of any other."""
    from activestructure_gym.evaluation.running.following import FollowingEnv, followed_metrics

    return followed_metrics(env) if isinstance(env, FollowingEnv) else {}


def path_collisions(scene: Scene, trajectory: np.ndarray) -> int:
    """Number of executed steps of a trajectory [T, 4, 4] that pass through the true mesh. Must be 0."""
    positions = trajectory[:, :3, 3]
    moved = np.linalg.norm(np.diff(positions, axis=0), axis=1) > 1e-9
    if not moved.any():
        return 0
    return int(scene.raycaster.occluded(positions[:-1][moved], positions[1:][moved]).sum())


class _Episode:
    """The loop of decisions, with its log, its convergence curve and its clock."""

    def __init__(
        self, job: Job, env: ReconstructionEnv, policy: Decider, truth: Truth, tell: Callable[[Progress], None]
    ) -> None:
        self.job, self.env, self.policy, self.truth, self.tell = job, env, policy, truth, tell
        self.steps: list[dict[str, Any]] = []
        self.curve: list[dict[str, float]] = []
        self.ended = ""
        self.evaluation_seconds = 0.0
        self.total_seconds = 0.0  # without the evaluation
        self.decision_seconds: list[float] = []  # total seconds at the end of each decision
        self._policy_seconds = 0.0
        self._next_checkpoint = 0
        self._next_images = 0
        self._next_surface = 0

    def run(self) -> None:
        """Play the episode from the first frame to the end of the budget."""
        env, policy = self.env, self.policy
        self._began = time.perf_counter()
        observation, info = env.reset(seed=self.job.seed)
        policy.reset(self.job.seed)
        self._checkpoint()
        given = is_trajectory(self.job.policy)
        ended = not given and not np.any(observation["action_mask"])
        truncated = False
        while not (ended or truncated):
            began = time.perf_counter()
            action = self._chosen(policy.act(observation))
            self._policy_seconds += time.perf_counter() - began
            step = self._describe(observation, action)
            observation, _, ended, truncated, info = env.step(action)
            step |= {"frames": info["frames"], "metres": info["metres"]}
            step |= {name: value for name, value in info.items() if _is_logged(name, value)}
            step["graph"] = graph_summary(env.reconstruction.planes)
            self.decision_seconds.append(time.perf_counter() - self._began - self.evaluation_seconds)
            if ended or truncated or info["frames"] >= self._next_checkpoint:
                step["checkpoint"] = self._checkpoint(last=ended or truncated)
            self.steps.append(step)
            self.tell(Progress("exploring", info["frames"], env.reconstruction.frame_budget, self.last_ratio))
        by_choice = "ended by the policy" if env.reconstruction.finished else "no candidate left"
        by_choice = "the trajectory has ended" if given else by_choice
        self.ended = "frame budget used up" if truncated else by_choice
        self.total_seconds = time.perf_counter() - self._began - self.evaluation_seconds

    def _chosen(self, row: Any) -> int:
        if not self.env.is_row(row):
            last = int(self.env.action_space.n) - 1
            raise InputError(
                f"policy '{self.job.policy}': act() must return a row, a whole number from 0 to {last}, "
                f"got {shown(row)}"
            )
        return int(row)

    @property
    def last_ratio(self) -> float | None:
        """C.R. at the last checkpoint."""
        return self.curve[-1]["completion_ratio"] if self.curve else None

    def seconds(self) -> dict[str, float]:
        """Wall-clock by stage, the policy's own share beside the conductor's."""
        return {**self.env.reconstruction.seconds, "policy": self._policy_seconds}

    def _describe(self, observation: dict[str, np.ndarray], action: int) -> dict[str, Any]:
        """The decision as the policy made it, before its consequences."""
        from activestructure_gym.envs.observation import CANDIDATE_FEATURES

        mask = observation["action_mask"]
        step: dict[str, Any] = {"decision": len(self.steps), "action": action, "candidates": int(np.sum(mask))}
        if is_trajectory(self.job.policy):
            return step | {"action": -1}
        if 0 <= action < len(mask):
            step["view"] = dict(zip(CANDIDATE_FEATURES, observation["candidates"][action]))
            step["gains"] = dict(zip(self.env.config.gains, observation["candidate_gains"][action]))
        return step | {"trace": self.policy.trace()}

    def _checkpoint(self, *, last: bool = False) -> dict[str, float]:
        """A point of the convergence curve; its time is not the planner's."""
        began = time.perf_counter()
        reconstruction = self.env.reconstruction
        frames, budget = reconstruction.frames, reconstruction.frame_budget
        # The last point is the finished map's: `end_curve` writes it.
        images, surface = (frames >= following and not last for following in (self._next_images, self._next_surface))
        if images:
            self._next_images = _following(frames, budget // IMAGE_CHECKPOINTS)
        if surface:
            self._next_surface = _following(frames, budget // SURFACE_CHECKPOINTS)
        scores = self.job.protocol.checkpoint(
            reconstruction.mapper.map,
            self.truth,
            CameraPath.from_arrays(_path_arrays(reconstruction)),
            images=images,
            samples=CHECKPOINT_SAMPLES,
            surface=surface,
        )
        point = {"decision": reconstruction.decisions, "frames": frames, "metres": reconstruction.metres}
        self.curve.append(point | scores)
        self._next_checkpoint = _following(frames, budget // CHECKPOINTS)
        self.evaluation_seconds += time.perf_counter() - began
        return scores

    def end_curve(self, metrics: dict[str, Any]) -> None:
        """Replace the numbers of the curve's last point by those of the finished map, so that both are equal."""
        found = {name: metrics[name] for name in CURVE_MEASURES if metrics.get(name) is not None}
        for point in (self.curve[-1], self.steps[-1]["checkpoint"] if self.steps else {}):
            point |= found


def _following(frames: int, spacing: int) -> int:
    """The next multiple of the spacing, which is at least 1."""
    spacing = max(1, spacing)
    return (frames // spacing + 1) * spacing


def _is_logged(name: str, value: Any) -> bool:
    return name != "action_mask" and isinstance(value, bool | int | float | np.generic)


def _write_ply(reconstruction: Reconstruction, part: Path) -> None:
    from activestructure_gym.mapping.ply import write_ply

    write_ply(reconstruction.mapper.map, part / "map.ply")


def _write_record(
    part: Path,
    job: Job,
    scene: Scene,
    env: ReconstructionEnv,
    metrics: dict[str, Any],
    episode: _Episode,
    own: dict[str, str],
) -> None:
    """Configuration, numbers, decisions and path."""
    reconstruction = env.reconstruction
    extent = scene.bounds[1] - scene.bounds[0]
    config = {
        "format": store.FORMAT_VERSION,
        "job": job.as_dict(),
        "hash": job.hash,
        "scene": {
            "name": scene.name,
            "spec": job.scene,
            "content_hash": scene.content_hash,
            "source": scene.source,
            "notes": scene.notes,
            "triangles": len(scene.mesh.faces),
            "extent_m": extent,
        },
        "configuration": dataclasses.asdict(env.config),
        "versions": machine.versions(),
        **({OWN_CODE: own} if own else {}),
    }
    results = {
        "format": store.FORMAT_VERSION,
        "protocol": job.protocol.parameters(),
        "scene": scene.content_hash,
        "metrics": metrics,
        "curve": episode.curve,
    }
    store.write_json(part / "config.json", config)
    store.write_json(part / store.METRICS, results)
    with open(part / "steps.jsonl", "w", encoding="utf-8") as file:
        file.writelines(store.json_line(step) for step in episode.steps)
    with open(part / "trajectory.npz", "wb") as file:
        np.savez(file, **_path_arrays(reconstruction))  # type: ignore[arg-type]
    with open(part / "graph.npz", "wb") as file:
        np.savez_compressed(file, **graph_arrays(reconstruction.planes))  # type: ignore[arg-type]


def _path_arrays(reconstruction: Reconstruction) -> dict[str, np.ndarray]:
    """Every executed pose [T, 4, 4], which of them were keyframes [K], decisions, camera, range; `Run.trajectory`."""
    camera = reconstruction.config.sensor.camera
    return {
        "world_from_camera": np.stack(reconstruction.trajectory),
        "keyframes": np.array(reconstruction.keyframe_indices, dtype=np.int64),
        "keyframe_rounds": np.array(reconstruction.keyframe_rounds, dtype=np.int64),
        "legs": np.array(reconstruction.legs, dtype=np.int64).reshape(-1, 3),
        "intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "image_size": np.array([camera.width, camera.height], dtype=np.int64),
        "max_range": np.array(reconstruction.config.sensor.max_range, dtype=np.float64),
    }


def _write_pictures(
    part: Path, job: Job, truth: Truth, reconstruction: Reconstruction, metrics: dict[str, Any]
) -> None:
    """The arrays that pictures are drawn from."""
    arrays = picture_arrays(job.protocol, truth, reconstruction, [view["psnr"] for view in metrics["views"]])
    with open(part / "pictures.npz", "wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _draw_pictures(part: Path) -> None:
    from activestructure_gym.evaluation.report.run_pictures import draw_run

    draw_run(part)
