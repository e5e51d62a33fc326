"""Define the Gymnasium environment, a thin wrapper of `activestructure_gym.reconstruction.Reconstruction`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal, TypedDict, get_args

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from activestructure_gym.config import Preset, ReconstructionConfig, configure, replaced
from activestructure_gym.envs.exclusive_access import ExclusiveAccess
from activestructure_gym.envs.inputs import Scenes, as_pose, as_truth, only_world, table_of, warn_of_start
from activestructure_gym.envs.observation import encode, observation_space
from activestructure_gym.envs.panel import draw_panel
from activestructure_gym.envs.reward import RewardConfig, SurfaceCoverage, known_volume, reward_terms
from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.ground_truth import GroundTruth, Layout
from activestructure_gym.motion import is_level
from activestructure_gym.reconstruction import Reconstruction, StepResult
from activestructure_gym.scenes import Scene
from activestructure_gym.sensors import Frame
from activestructure_gym.streams import write_line
from activestructure_gym.worlds import World, is_world, names_world, with_camera

if TYPE_CHECKING:
    from activestructure_gym.viewer import LiveView

RenderMode = Literal["human", "rgb_array"]

# Default rows of the plane arrays. A house of nine rooms has 130 planes after 2,000 frames.
_PLANES, _FEW_PLANES = 256, 64


class EnvOptions(TypedDict, total=False):
    """Define the keywords common to all tasks; the docstring of `ReconstructionEnv` explains them."""

    preset: Preset
    frame_budget: int | None
    features: Sequence[str] | None
    config: ReconstructionConfig | Mapping[str, Any] | None
    reward: RewardConfig | Mapping[str, Any] | None
    coverage_target: float | None
    max_planes: int | None
    observation_keys: Sequence[str] | None
    start_pose: Sequence[float] | np.ndarray | None
    render_mode: RenderMode | None


class ReconstructionEnv(gym.Env[dict[str, Any], np.int64]):
    """Reconstruct an unknown indoor scene online with an RGB-D camera.

    ## Description
    The map consists of 3D Gaussians. In each step the agent chooses one of K candidate views. It moves there along a
    collision-free path through known free space and maps every fifth frame. The reward is newly seen surface.

    ## Action Space
    `Discrete(K)`: a row of the candidate table. `info["action_mask"]`, `observation["action_mask"]` and the method
    `action_masks()` mark the rows that hold a candidate. A masked action raises no error: the agent stays, the step
    costs one frame, and `info["invalid_action"]` is True.

    ## Observation Space
    One flat `Dict` of arrays, defined in `activestructure_gym.envs.observation`. It holds the last keyframe (`rgb`,
    `depth`, `pose`), `budget`, the candidates with their features and mask, the Plane Scene Graph (`plane_features`,
    `plane_mask`, `plane_edges`, `plane_tree`), and the planes that each candidate would see (`candidate_planes`). Graph
    arrays are zero if no plane exists yet. No entry uses ground truth. `observation_space["candidate_features"].names`
    are the names of the columns; `policy.bind(env)` reads them.

    ## Rewards
    The sum of the terms in `info`: `reward/coverage` = 20 x newly observed share of the observable surface,
    `reward/path` = -0.01 x metres travelled, `reward/invalid` = -0.05 for a masked action. With
    `reward={"noise_free": True}`, the observed surface is computed from depth without sensor noise. In a world without
    ground truth, `reward/known_volume` = 0.4 x newly known cubic metres replaces `reward/coverage`, and `info` has
    `ground_truth` = False and no `is_success`.

    ## Starting State
    One of the scene's start poses, drawn from the seed (or `start_pose`); the first frame is mapped.

    ## Episode End
    1. Termination: the observed share of the surface reaches `coverage_target` (`info["is_success"]` is True).
    2. Termination: no candidate is left, or the chosen row ends the episode (source `finish`).
    3. Truncation: the frame budget is spent.

    ## Arguments
    | parameter | type | default | meaning |
    |---|---|---|---|
    | `scene` | str, Scene, or a sequence of them | per task | scene; from a sequence, one is drawn per episode |
    | `preset` | str | `"default"` | `rl`, `fast`, `default`, `full` or `paper` |
    | `frame_budget` | int | from the preset | frames per episode |
    | `features` | tuple of str | `("pixel",)` | features to evaluate for every candidate |
    | `config` | mapping | none | overrides by field, e.g. `{"sensor.depth_noise": "kinect"}` |
    | `reward` | mapping | none | overrides of `RewardConfig` |
    | `coverage_target` | float | 0.99 | observed share of the surface that ends the episode; None = no such end |
    | `max_planes` | int | 256; 64 in `rl` and `fast` | rows of the plane arrays; the largest planes are kept |
    | `observation_keys` | tuple of str | all | entries of the observation to return |
    | `start_pose` | (x, y, z, yaw_deg) or 4x4 | none | start pose of every episode |
    | `render_mode` | str | none | `"rgb_array"`: camera, map, and plan side by side; `"human"`: a live web page |

    ## Reset options
    | option | meaning |
    |---|---|
    | `scene` | scene of this episode only |
    | `start_pose` | start pose of this episode only |

    ## Info
    `action_mask`, `features` (names of the columns of `candidate_features`), `frames`, `metres`, `keyframes`,
    `gaussians`, `planes`, `reached`, `invalid_action`, `is_success` and the terms of the reward. It contains no
    wall-clock times, and no ground truth except in the reward and in `is_success`.

    ## Version History
    * v0: first version

    """

    metadata: dict[str, Any] = {"render_modes": list(get_args(RenderMode)), "render_fps": 2}
    observation_space: spaces.Dict
    action_space: spaces.Discrete

    def __init__(
        self,
        scene: Scenes,
        *,
        preset: Preset = "default",
        frame_budget: int | None = None,
        features: Sequence[str] | None = None,
        config: ReconstructionConfig | Mapping[str, Any] | None = None,
        reward: RewardConfig | Mapping[str, Any] | None = None,
        coverage_target: float | None = 0.99,
        max_planes: int | None = None,
        observation_keys: Sequence[str] | None = None,
        start_pose: Sequence[float] | np.ndarray | None = None,
        render_mode: RenderMode | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            modes = self.metadata["render_modes"]
            raise InputError(f"render_mode must be one of {modes} or None, got {short_repr(render_mode)}")
        if coverage_target is not None and not (
            isinstance(coverage_target, int | float | np.number)
            and not isinstance(coverage_target, bool)
            and 0 < coverage_target <= 1
        ):
            raise InputError(f"coverage_target is a share in (0, 1] or None, got {short_repr(coverage_target)}")
        if not isinstance(preset, str):
            raise InputError(f"preset must be a name, got {short_repr(preset)}")
        if max_planes is None:
            max_planes = _FEW_PLANES if preset in ("rl", "fast") else _PLANES
        if isinstance(max_planes, bool) or not isinstance(max_planes, int | np.integer) or max_planes < 1:
            raise InputError(f"max_planes must be a whole number of at least 1, got {short_repr(max_planes)}")
        if not isinstance(config, ReconstructionConfig):
            config = configure(preset, table_of("config", config))
        elif preset != "default":
            raise InputError(f"config is a whole configuration, so leave out preset, got {short_repr(preset)}")
        changes: dict[str, Any] = {}
        if frame_budget is not None:
            changes["frame_budget"] = frame_budget
        if features is not None:
            if isinstance(features, str) or not isinstance(features, Sequence | np.ndarray):
                raise InputError(f"features must be a list of names, got {short_repr(features)}")
            changes["features"] = tuple(features)
        self._scenes = list(scene) if isinstance(scene, Sequence) and not isinstance(scene, str) else [scene]
        if not self._scenes:
            raise InputError("scene must name at least one scene, got an empty sequence")
        if not all(
            isinstance(one, str | PathLike | Scene | GroundTruth | Layout) or is_world(one) for one in self._scenes
        ):
            raise InputError(
                f"scene must be a name, a path, a Scene, a World, or a sequence of them, got {short_repr(scene)}"
            )
        config = replaced(config, changes)
        self.reward_config = (
            reward if isinstance(reward, RewardConfig) else replaced(RewardConfig(), table_of("reward", reward))
        )
        self._world = only_world(self._scenes, start_pose)
        try:
            self.config = config if self._world is None else with_camera(config, self._world.camera)
            self.reconstruction = Reconstruction(self.config)
            self.observation_space = observation_space(self.config, max_planes, observation_keys)
        except BaseException:
            if self._world is not None and names_world(self._scenes[0]):  # made here: the caller cannot close it
                self._world.close()
            raise
        self.render_mode = render_mode
        self.coverage_target = coverage_target
        self.max_planes = max_planes
        self.action_space = spaces.Discrete(self.config.views.max_candidates)
        self._start_pose = None if start_pose is None else self._as_start(start_pose)
        self._loaded: dict[int, GroundTruth] = {}
        self._frame: Frame | None = None
        self._view: LiveView | None = None
        self._ended = True
        self._access = ExclusiveAccess()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode. ``options`` may hold ``scene`` and ``start_pose`` for this episode only."""
        with self._access.claim("reset"):
            return self._begin(seed, options)

    def _begin(self, seed: int | None, options: dict[str, Any] | None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode and return what `reset` returns."""
        super().reset(seed=seed)
        self._ended, self._frame = True, None  # after an error below, nothing continues or shows the previous episode
        options = dict(table_of("options", options))
        unknown = sorted(options.keys() - {"scene", "start_pose"})
        if unknown:
            raise InputError(f"unknown reset option {unknown[0]!r}. Known: scene, start_pose")
        if self._world is not None and options:
            raise InputError(f"an episode in a world has no reset options, got {', '.join(sorted(options))}")
        if names_world(options.get("scene")) or is_world(options.get("scene")):
            raise InputError(
                "reset() takes no world: give it when the environment is made, since its camera defines the space"
            )
        where: World | GroundTruth
        if self._world is not None:
            where, truth = self._world, getattr(self._world, "truth", None)
        else:
            where = truth = as_truth(options["scene"]) if "scene" in options else self._draw_scene()
        start_pose = self._as_start(options["start_pose"]) if "start_pose" in options else self._start_pose
        episode_seed = int(self.np_random.integers(2**31))
        self._frame = self.reconstruction.start(where, episode_seed, start_pose)
        warn_of_start(self.reconstruction)
        self._coverage = None if truth is None else SurfaceCoverage(truth.observable_surface.points, self.reward_config)
        self._count(self._frame, self.reconstruction.trajectory[0])
        self._ended = False
        share = None if self._coverage is None else 0.0
        terms = reward_terms(self.reward_config, share_gained=share, metres=0.0, invalid=False)
        if self.render_mode == "human":
            self._show_start()
        return self.observation(), self._info(terms, reached=True, invalid=False)

    def _as_start(self, value: Sequence[float] | np.ndarray) -> np.ndarray:  # [4, 4]
        """Convert to a start pose; raise `InputError` for a pose with roll, since motion keeps the camera level."""
        pose = as_pose(value)
        if not is_level(pose):
            raise InputError(
                "a start pose must be without roll (the image's right horizontal, its up not down), as all views are; "
                f"its right is {np.round(pose[:3, 0], 3).tolist()}: give (x, y, z, yaw_deg), or a level matrix"
            )
        return pose

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Move to row ``action`` of the candidate table."""
        with self._access.claim("step"):
            if self._ended:
                raise gym.error.ResetNeeded("this episode has ended (or never began): call reset() before step()")
            if not self.is_row(action):
                raise gym.error.InvalidAction(f"expected an integer in [0, {self.action_space.n}), got {action!r}")
            invalid = not int(action) < len(self.reconstruction.candidates)
            if self._view is not None:
                self._view.chosen(int(action))
            known = self._gained()
            try:
                result = self.reconstruction.move_to(int(action))
            except BaseException:
                self._ended = True  # the state is that of an interrupted movement: only `reset` helps
                raise
            return self._outcome(result, known, invalid=invalid)

    def is_row(self, action: Any) -> bool:
        """Return whether ``action`` is a row of the candidate table. Unlike Gymnasium's space, refuse ``True``."""
        return not isinstance(action, bool) and bool(self.action_space.contains(action))

    def _gained(self) -> float:
        """Return what the reward counts so far: the observed share of the surface, or the known volume in m^3."""
        return known_volume(self.reconstruction.volume) if self._coverage is None else self._coverage.share

    def _outcome(
        self, result: StepResult, before: float, *, invalid: bool
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Count the new keyframes and return what `step` returns; ``before`` is what `_gained` was before the step."""
        episode = self.reconstruction
        known = len(episode.keyframe_indices) - len(result.keyframes)
        for frame, index in zip(result.keyframes, episode.keyframe_indices[known:]):
            # Coverage uses the true pose; a frame holds the pose that the sensor reports.
            self._count(frame, episode.trajectory[index])
            self._frame = frame
        gained = self._gained() - before
        terms = reward_terms(
            self.reward_config,
            metres=result.metres,
            invalid=invalid,
            share_gained=None if self._coverage is None else gained,
            volume_gained=gained,
        )
        terminated = self._covered or episode.finished or not len(episode.candidates)
        truncated = episode.exhausted
        self._ended = terminated or truncated
        if self._view is not None:
            self._view.show()
            self._view.end() if self._ended else self._view.wait()
        info = self._info(terms, reached=result.reached, invalid=invalid)
        return self.observation(), float(sum(terms.values())), terminated, truncated, info

    def action_masks(self) -> np.ndarray:  # [K] bool
        """Return the action mask in the form that sb3-contrib's MaskablePPO requires."""
        if self._frame is None:
            raise gym.error.ResetNeeded("there are no candidates before reset()")
        return np.arange(self.action_space.n) < len(self.reconstruction.candidates)

    @property
    def coverage(self) -> SurfaceCoverage:
        """Return the observed surface that the reward counts. It is ground truth: policies must not read it."""
        if self._frame is None:
            raise gym.error.ResetNeeded("nothing is counted before reset()")
        if self._coverage is None:
            raise InputError("this world has no ground truth, so no surface is counted")
        return self._coverage

    def render(self) -> np.ndarray | None:  # [H, W, 3] uint8
        """Return one image: the camera image, the map rendered at its pose, and the plan with the path so far.

        Returns None with ``render_mode="human"``, which displays every step on the live page.
        """
        self._access.check_open("render")
        if self.render_mode is None:
            gym.logger.warn('render() shows nothing without a render mode: make the env with render_mode="rgb_array"')
            return None
        if self._frame is None:
            raise gym.error.ResetNeeded("there is nothing to render before reset()")
        if self.render_mode == "human":
            return None
        return draw_panel(self.reconstruction, self._frame)

    def close(self) -> None:
        """Release the sensor or the world, and the live page; further calls have no effect.

        A closed environment refuses `reset`, `step` and `render`. Its `reconstruction` can still be read.
        """
        self._access.closed = True
        if self._view is not None:
            self._view.close()
            self._view = None
        world = self._world if self._world is not None else getattr(self.reconstruction, "world", None)
        if world is not None:  # a world is released even if no episode has begun
            world.close()

    def _show_start(self) -> None:
        """Serve the live page, once per environment, and show the start of the episode."""
        if self._view is None:
            from activestructure_gym.viewer import LiveView

            self._view = LiveView(type(self).__name__ if self.spec is None else self.spec.id)
            write_line(sys.stderr, f"watch this environment at {self._view.url}")
        self._view.begin(self.reconstruction, self.config.features[0] if self.config.features else "")
        self._view.show()
        self._view.wait()

    def _count(self, frame: Frame, pose: np.ndarray) -> None:
        """Count the surface that a keyframe at the true ``pose`` [4, 4] sees."""
        if self._coverage is None:
            return
        depth = frame.depth
        if self._world is None and self.reward_config.noise_free and self.reconstruction.sensor.has_depth_noise:
            depth = self.reconstruction.sensor.true_depth(pose)
        self._coverage.add(depth, frame.camera, pose)

    @property
    def _covered(self) -> bool:
        if self.coverage_target is None or self._coverage is None:
            return False
        return self._coverage.share >= self.coverage_target

    def _draw_scene(self) -> GroundTruth:
        """Draw the scene of an episode."""
        index = int(self.np_random.integers(len(self._scenes))) if len(self._scenes) > 1 else 0
        if index not in self._loaded:
            # Only one scene is kept in memory, because a list of scenes can be long.
            self._loaded = {index: as_truth(self._scenes[index])}
        return self._loaded[index]

    def observation(self) -> dict[str, np.ndarray]:
        """Return the current observation again, as new arrays."""
        if self._frame is None:
            raise gym.error.ResetNeeded("there is no observation before reset()")
        encoded = encode(self.reconstruction, self._frame, self.max_planes)
        return {name: value for name, value in encoded.items() if name in self.observation_space.spaces}

    def _info(self, terms: dict[str, float], *, reached: bool, invalid: bool) -> dict[str, Any]:
        episode = self.reconstruction
        return {
            "action_mask": self.action_masks().astype(np.int8),
            "features": self.config.features,
            "frames": episode.frames,
            "metres": float(episode.metres),
            "keyframes": len(episode.keyframe_indices),
            "gaussians": int(episode.mapper.map.count),
            "planes": len(episode.planes.nodes),
            "reached": reached,
            "invalid_action": invalid,
            **({"ground_truth": False} if self._coverage is None else {"is_success": self._covered}),
            **terms,
        }
