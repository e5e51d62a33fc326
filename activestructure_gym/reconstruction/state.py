"""Hold the state of one episode, which candidate views and features are computed from."""

from __future__ import annotations

import time
from collections import defaultdict

import numpy as np

from activestructure_gym.config import ReconstructionConfig
from activestructure_gym.features import FeatureContext
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.motion import Agent, DistanceMap
from activestructure_gym.planes import PlaneSceneGraph
from activestructure_gym.scenes import Scene
from activestructure_gym.sensors import RGBDSensor
from activestructure_gym.sources import make_stages
from activestructure_gym.splatting.rasterizers import rasterizer
from activestructure_gym.views import CandidatePool, CandidateTable
from activestructure_gym.volume import VoxelVolume
from activestructure_gym.worlds import World


class EpisodeState:
    """Hold the parts, the path and the counts of one episode; `Reconstruction` sets and changes them."""

    world: World
    scene: Scene  # in a `SceneWorld` only
    sensor: RGBDSensor  # in a `SceneWorld` only
    bounds: np.ndarray  # [2, 3] metres, world: lowest and highest corner of the space to explore
    mapper: KeyframeMapper
    volume: VoxelVolume
    planes: PlaneSceneGraph
    pool: CandidatePool
    candidates: CandidateTable
    features: np.ndarray  # [n, G] features; one column per name in config.features
    visible: np.ndarray  # [n, N] bool: planes of the graph visible from each candidate
    distances: DistanceMap  # path lengths from the agent's position
    pose: np.ndarray  # [4, 4] world_from_camera of the agent, without roll in worlds that report their poses
    stage: int  # index into ``views.stages``
    _planning_rng: np.random.Generator

    def __init__(self, config: ReconstructionConfig) -> None:
        rasterizer(config.mapper.backend)  # raises if the backend cannot run here
        self.config = config
        self.scoring_camera = config.sensor.camera.resized(
            max(1, round(config.sensor.width * config.views.scoring_scale)),
            max(1, round(config.sensor.height * config.views.scoring_scale)),
        )
        self._sources = make_stages(config.views.stages, config.views.max_candidates)

    def _begin_at(self, world_from_camera: np.ndarray) -> None:
        """Set the path and all counts to those of an episode that begins at a pose [4, 4]."""
        self.stage = 0
        self.finished = False  # whether a row that ends the episode was chosen
        self.trajectory = [world_from_camera]  # every executed pose
        self.keyframe_indices: list[int] = []  # into trajectory
        self.refine_factors: list[int] = []  # iteration factor of each keyframe
        # At the end of each decision: number of poses executed, frames used, 1 if they were spent optimising in place.
        self.legs: list[tuple[int, int, int]] = []
        self.stops: list[np.ndarray] = []  # final pose of each decision
        self.frames = 0
        self.metres = 0.0
        self.decisions = 0
        self.chosen: int | None = None  # row of the candidate table that is executed
        # wall-clock time by stage; never part of an observation
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @property
    def agent(self) -> Agent:
        """Return the agent's pose, budget and travel distances, for sources and features."""
        return Agent(
            pose=self.pose.copy(),  # a copy: plug-in sources and features may write to it
            frames=self.frames,
            frame_budget=self.frame_budget,
            keyframe_every=self.config.keyframe_every,
            motion=self.config.motion,
            distances=self.distances,
            rng=self._planning_rng,
            stops=np.array(self.stops).reshape(-1, 4, 4),
        )

    @property
    def frame_budget(self) -> int:
        """Return the number of frames that the episode may use, the first one included."""
        return self.config.frame_budget

    @property
    def exhausted(self) -> bool:
        """Return whether the frame budget is used up."""
        return self.frames >= self.config.frame_budget

    def feature_context(
        self,
        world_from_camera: np.ndarray,  # [K, 4, 4] views
        revisit: np.ndarray | None = None,  # [K] bool, which are a stored keyframe's pose
    ) -> FeatureContext:
        """Return the context that features read: the current state, with these views as candidates."""
        return FeatureContext(
            mapper=self.mapper,
            volume=self.volume,
            planes=self.planes,
            camera=self.scoring_camera,
            bounds=self.bounds.copy(),
            coverage_alpha=self.config.views.coverage_alpha,
            max_range=self.config.sensor.max_range,
            world_from_camera=world_from_camera.copy(),
            agent=self.agent,
            revisit=None if revisit is None else revisit.copy(),
        )

    def _timed(self, stage: str) -> _Clock:
        return _Clock(self.seconds, stage)


class _Clock:
    """Add the time spent in a ``with`` block to one entry of a table; a generator would take three times as long."""

    def __init__(self, seconds: defaultdict[str, float], stage: str) -> None:
        self._seconds, self._stage = seconds, stage

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._stage] += time.perf_counter() - self._began
