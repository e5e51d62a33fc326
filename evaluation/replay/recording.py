"""Play a stored run again, action by action, and keep what can be watched of it.

The actions stand in ``steps.jsonl`` and everything else in ``config.json``, so the same code on the same machine plays
the same episode: the map of every moment need not be stored with every run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import is_reference, refuse_code
from activestructure_gym.evaluation.archive.plane_record import GraphArrays, graph_arrays, seen_cells
from activestructure_gym.evaluation.archive.store import CONFIG, Run

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.mapping import GaussianMap

_JPEG_QUALITY = 82
_FIELDS = 14  # rows of the map's parameters


@dataclass(frozen=True)
class Moment:
    """What there is to see before one decision; the last one has no candidates."""

    frame: int  # frames paid
    row: int  # the candidate that is chosen, -1 at the end
    candidates: np.ndarray  # [K, 6] metres and unit vector: position and look
    worth: np.ndarray  # [K] the first feature that the policy asks for; NaN where it asks for none
    planes: np.ndarray  # [P, 4, 3] metres, corners of the seen part of each plane
    structural: np.ndarray  # [P] bool
    tree: np.ndarray  # [E, 2] rows of planes that the spanning forest joins
    centroids: np.ndarray  # [P, 3] metres
    true: bytes  # JPEG of the last keyframe
    rendered: bytes  # JPEG of the map from its pose


@dataclass(frozen=True)
class Recording:
    """An episode as it can be watched."""

    run: Run
    moments: list[Moment]
    poses: np.ndarray  # [T, 4, 4] world_from_camera, one per frame
    gaussians: np.ndarray  # [14, N] float32 parameters of all that ever were, as they were last
    born: np.ndarray  # [N] int32 frame with which each came
    died: np.ndarray  # [N] int32 frame with which it went; beyond the last one for those that stayed
    bounds: np.ndarray  # [2, 3] metres, the workspace
    camera: tuple[float, float, float, float, int, int]  # fx, fy, cx, cy, width, height
    differs: str = ""  # where this code plays another episode than the stored one, in words


@dataclass
class _Lives:
    """Who came and went, by the ids of the Gaussians."""

    frame_of: list[tuple[int, int]] = field(default_factory=list)  # (ids below this were there, frame)
    gone: list[tuple[np.ndarray, np.ndarray, int]] = field(default_factory=list)  # parameters, ids, frame
    ids: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    parameters: np.ndarray = field(default_factory=lambda: np.zeros((_FIELDS, 0), np.float32))

    def note(self, gaussians: GaussianMap, frame: int) -> None:
        """Remember the map as it is; called after every keyframe."""
        ids = gaussians.ids[: gaussians.count].copy()
        left = ~np.isin(self.ids, ids)
        if left.any():
            self.gone.append((self.parameters[:, left], self.ids[left], frame))
        self.ids, self.parameters = ids, gaussians.parameters[:, : gaussians.count].copy()
        self.frame_of.append((gaussians.next_id, frame))

    def all(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # [14, N], [N] born, [N] died
        """Everybody, those who came first in front."""
        last = np.iinfo(np.int32).max
        parameters = np.concatenate([self.parameters, *(block for block, _, _ in self.gone)], axis=1)
        ids = np.concatenate([self.ids, *(ids for _, ids, _ in self.gone)])
        died = np.concatenate(
            [np.full(len(self.ids), last), *(np.full(len(ids), frame) for _, ids, frame in self.gone)]
        )
        below, frames = np.array(self.frame_of).reshape(-1, 2).T
        born = frames[np.searchsorted(below, ids, side="right")]
        order = np.argsort(born, kind="stable")
        return parameters[:, order], born[order].astype(np.int32), died[order].astype(np.int32)


def play_again(
    run: Run, tell: Callable[[int, int], None] = lambda frames, budget: None, *, trusted: bool = False
) -> Recording:
    """The episode of ``run``, played again; ``tell`` hears how many frames of how many are done.

    Raises `InputError` where the scene is not there any more or has changed, for a mapper without Gaussians, and where
    the run's files name code and are not ``trusted``; see `registry.refuse_code`.
    """
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.running.episode import load_job_scene
    from activestructure_gym.ground_truth import ground_truth_of

    job, stored = run.job, run.config["configuration"]
    if not trusted:  # a policy is made on native terms alone, to learn what it brings
        refuse_code([job if job.terms == "native" else replace(job, policy="random")], run.directory / CONFIG)
    gains = () if is_reference(job.policy) else _at_hand(stored["gains"])
    env = ReconstructionEnv(
        scene=ground_truth_of(load_job_scene(job)),
        preset=job.preset,
        frame_budget=stored["frame_budget"],
        gains=gains,
        config={**_changes(run), "views.max_candidates": stored["views"]["max_candidates"]},
        coverage_target=None,
        start_pose=job.start_pose,
    )
    try:
        return _recorded(run, env, tell)
    finally:
        env.close()


def _changes(run: Run) -> dict[str, Any]:
    """What the configuration differs in from the preset's: what was asked for, and what the policy brought."""
    from activestructure_gym.policies import make_policy

    if run.job.terms == "shared":
        return dict(run.job.overrides)
    return run.job.changes(make_policy(run.job.policy))


def _at_hand(gains: list[str]) -> tuple[str, ...]:
    """The features that can be evaluated here and run no code of others: only colours depend on them."""
    from activestructure_gym.features import FEATURES

    return tuple(name for name in gains if ":" not in name and any(name.startswith(known) for known in FEATURES))[:1]


def _recorded(run: Run, env: ReconstructionEnv, tell: Callable[[int, int], None]) -> Recording:
    observation, _ = env.reset(seed=run.job.seed)
    episode, lives, moments = env.reconstruction, _Lives(), list[Moment]()
    if not hasattr(episode.mapper, "map"):
        raise InputError(f"the map of {run.directory} is not made of Gaussians: there is nothing to watch it grow by")
    lives.note(episode.mapper.map, episode.frames)
    observe = episode.mapper.observe

    def noted(*given: Any, **options: Any) -> Any:
        """A keyframe, and who came with it."""
        report = observe(*given, **options)
        lives.note(episode.mapper.map, episode.frames)
        return report

    episode.mapper.observe = noted  # type: ignore[method-assign]
    differs = ""
    for step in run.steps:
        row = int(step["action"])
        moments.append(_moment(env, observation, row))
        observation, *_, info = env.step(row)
        if not differs and (info["frames"] != step["frames"] or info["gaussians"] != step["gaussians"]):
            differs = (
                f"from decision {step['decision']} on this machine plays another episode: {info['frames']} frames and "
                f"{info['gaussians']} Gaussians, and in the run {step['frames']} and {step['gaussians']}"
            )
        tell(info["frames"], episode.frame_budget)
        if info["frames"] >= episode.frame_budget or episode.finished:
            break
    lives.note(episode.mapper.map, episode.frames)
    moments.append(_moment(env, observation, -1))
    parameters, born, died = lives.all()
    camera = episode.config.sensor.camera
    return Recording(
        run=run,
        moments=moments,
        poses=np.array(episode.trajectory),
        gaussians=parameters,
        born=born,
        died=died,
        bounds=np.asarray(episode.scene.bounds, float),
        camera=(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height),
        differs=differs,
    )


def _moment(env: ReconstructionEnv, observation: dict[str, np.ndarray], row: int) -> Moment:
    episode, graph = env.reconstruction, graph_arrays(env.reconstruction.planes)
    poses = episode.candidates.world_from_camera[: episode.candidates.views]
    worth = observation["candidate_gains"][: len(poses), 0] if env.config.gains else np.full(len(poses), np.nan)
    frame = env._frame
    assert frame is not None
    rendered = episode.mapper.render(frame.camera, frame.world_from_camera).color
    return Moment(
        frame=episode.frames,
        row=row,
        candidates=np.concatenate([poses[:, :3, 3], poses[:, :3, 2]], axis=1),
        worth=np.asarray(worth, float),
        planes=plane_rectangles(graph),
        structural=graph["structural"],
        tree=graph["edges"][graph["edge_in_tree"]],
        centroids=graph["centroids"],
        true=_jpeg(frame.rgb),
        rendered=_jpeg((np.clip(rendered, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)),
    )


def plane_rectangles(graph: GraphArrays) -> np.ndarray:  # [P, 4, 3] metres
    """Corners in turn of the smallest rectangle around what was seen of every plane; its centroid for nothing."""
    found = np.repeat(np.asarray(graph["centroids"], float).reshape(-1, 1, 3), 4, axis=1)
    for k in range(len(found)):
        cells = np.argwhere(seen_cells(graph, k))
        if len(cells):
            # All four corners of each cell, so that a row of cells has a width.
            corners = np.concatenate([cells + offset for offset in ((0, 0), (0, 1), (1, 0), (1, 1))])
            box = cv2.boxPoints(cv2.minAreaRect(corners.astype(np.float32)))
            found[k] = graph["patch_corners"][k] + graph["cell"] * (box @ graph["patch_axes"][k])
    return found


def _jpeg(rgb: np.ndarray) -> bytes:  # [H, W, 3] uint8
    _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()
