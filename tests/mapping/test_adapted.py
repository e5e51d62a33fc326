"""A mapper of one's own, with the six names alone, in an episode."""

import dataclasses
import sys

import numpy as np
import pytest

from activestructure_gym import ReconstructionEnv
from activestructure_gym.config import configure
from activestructure_gym.errors import InputError
from activestructure_gym.mapping import MAPPERS, BaseMapperConfig, MapperConfig
from activestructure_gym.mapping.adapted import AdaptedMapper

OWN = '''
from dataclasses import dataclass

from activestructure_gym.mapping import BaseMapperConfig, MapperConfig


class Own:
    """Ours behind the six names, with every other frame left unoptimised."""

    def __init__(self, rng):
        self._inner = MapperConfig(iterations=2).make(rng, None)

    map = property(lambda self: self._inner.map)
    keyframes = property(lambda self: self._inner.keyframes)

    def observe(self, frame, *, iterations=None):
        return self._inner.observe(frame, iterations=len(self.keyframes) % 2)

    def refine(self, iterations, *, keyframe_indices=None):
        return self._inner.refine(iterations, keyframe_indices=keyframe_indices)

    def render(self, camera, world_from_camera):
        return self._inner.render(camera, world_from_camera)

    def render_depth_alpha(self, camera, world_from_camera):
        return self._inner.render_depth_alpha(camera, world_from_camera)


@dataclass(frozen=True)
class OwnConfig(BaseMapperConfig):
    shade: float = 0.5

    def make(self, rng, bounds, *, depth_noise_scale=0.0):
        return Own(rng)


class Plain(Own):
    def __init__(self, inner):
        self._inner = inner

    def observe(self, frame, *, iterations=None):
        return self._inner.observe(frame, iterations=iterations)


@dataclass(frozen=True)
class Same(MapperConfig):
    def make(self, rng, bounds, *, depth_noise_scale=0.0):
        return Plain(MapperConfig.make(self, rng, bounds, depth_noise_scale=depth_noise_scale))


class Nothing(BaseMapperConfig):
    pass


@dataclass(frozen=True)
class Half(BaseMapperConfig):
    def make(self, rng, bounds, *, depth_noise_scale=0.0):
        return object()
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "own_mapper_here.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "own_mapper_here"
    sys.modules.pop("own_mapper_here", None)


def test_it_is_found_by_its_name_and_has_its_own_fields(own):
    config = configure("fast", {"mapper.name": f"{own}:OwnConfig", "mapper.shade": 0.25}).mapper
    assert (config.name, config.shade, config.iterations) == (f"{own}:OwnConfig", 0.25, 0)
    recorded = dataclasses.asdict(configure("fast", {"mapper.name": f"{own}:OwnConfig"}))
    assert configure("default", recorded).mapper == dataclasses.replace(config, shade=0.5)
    with pytest.raises(InputError, match="unknown field 'seed_spacing' of OwnConfig"):
        configure("fast", {"mapper.name": f"{own}:OwnConfig", "mapper.seed_spacing": 0.1})


def test_an_episode_runs_on_it_with_features_that_follow_its_gaussians(own):
    env = ReconstructionEnv(
        scene="box", preset="fast", frame_budget=25, features=("pixel", "hole_area", "rt_guide"),
        config={"mapper.name": f"{own}:OwnConfig", "sensor.width": 48, "sensor.height": 27, "views.max_revisits": 4},
    )  # fmt: skip
    _, info = env.reset(seed=0)
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(int(np.flatnonzero(info["action_mask"])[0]))
        ended = terminated or truncated
    mapper = env.reconstruction.mapper
    assert isinstance(mapper, AdaptedMapper) and info["frames"] == 25 and info["gaussians"] == mapper.map.count > 0
    assert len(mapper.keyframe_psnr()) == len(mapper.keyframes) and mapper.events >= len(mapper.keyframes)
    env.close()


def test_the_same_map_as_ours_behind_six_names(own):
    maps = []
    for name in ("default", f"{own}:Same"):
        env = ReconstructionEnv(scene="box", preset="fast", frame_budget=60, features=("pixel",),
                                config={"mapper.name": name, "mapper.iterations": 1})  # fmt: skip
        env.reset(seed=0)
        env.step(0)
        gaussians = env.reconstruction.mapper.map
        maps.append(gaussians.parameters[:, : gaussians.count].tobytes())
        env.close()
    assert maps[0] == maps[1] and len(maps[0]) > 0


def test_what_is_no_mapper_is_refused_in_one_sentence(own):
    with pytest.raises(InputError, match="must be a BaseMapperConfig"):
        configure("fast", {"mapper.name": f"{own}:Own"})
    with pytest.raises(InputError, match="has no observe, refine, render, render_depth_alpha, keyframes, map"):
        ReconstructionEnv(scene="box", preset="fast", config={"mapper.name": f"{own}:Half"}).reset(seed=0)
    with pytest.raises(
        InputError, match="Nothing makes no mapper: set made_by = 'package.module:Class' or define make"
    ):
        ReconstructionEnv(scene="box", preset="fast", config={"mapper.name": f"{own}:Nothing"}).reset(seed=0)


def test_every_registered_mapper_is_a_configuration_under_its_name():
    ours = {"default", "splatam", "monogs", "gaussian_slam", "co_slam"}
    assert ours <= set(MAPPERS)
    for name in ours:
        config = MAPPERS.get(name)
        assert isinstance(config, BaseMapperConfig) and config.name == name
    assert type(MAPPERS.get("splatam")) is MapperConfig
