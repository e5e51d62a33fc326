"""A planner with a feature and a candidate source of its own is added by one folder, and by nothing else."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym import policies
from activestructure_gym.config import configure
from activestructure_gym.features import FEATURES
from activestructure_gym.features.table import feature_table
from activestructure_gym.policies import POLICIES, make_env_and_policy
from activestructure_gym.sources import SOURCES

PLANNER = {
    "__init__.py": '"""Looks up."""\n',
    "policy.py": '''
from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import NativeSettings


@POLICIES.register("upward")
class Upward(Greedy):
    """argmax of the height of the view's axis."""

    criterion = "how far up a view looks"
    source = "this test"
    required_features = ("height_of_axis",)
    native_settings = NativeSettings(stages=(("upward_turns?rows=4",),), candidates=8)
''',
    "features.py": '''
from activestructure_gym.features import FEATURES


@FEATURES.register("height_of_axis", unit="-", low=0.0, high=2.0)
def height_of_axis(context):
    """1 + z of the view's axis."""
    return 1.0 + context.world_from_camera[:, 2, 2]
''',
    "sources.py": '''
from dataclasses import dataclass

import numpy as np

from activestructure_gym.geometry import look_along
from activestructure_gym.sources import SOURCES, Proposals, Source


@SOURCES.register("upward_turns")
@dataclass(frozen=True)
class UpwardTurns(Source):
    """Turns on the spot, each 10 degrees further up."""

    rows: int = 4

    def propose(self, context):
        angles = np.radians(10.0 * np.arange(self.rows))
        axes = np.stack([np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1)
        return Proposals(np.array([look_along(context.agent.pose[:3, 3], axis) for axis in axes]))
''',
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A second place of planners, with one in it."""
    place = tmp_path / "upward"
    place.mkdir()
    for name, text in PLANNER.items():
        (place / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(policies, "__path__", [*policies.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    yield
    POLICIES._entries.pop("upward", None)
    FEATURES._entries.pop("height_of_axis", None)
    SOURCES._entries.pop("upward_turns", None)
    for module in [name for name in sys.modules if name.startswith(f"{policies.__name__}.upward")]:
        del sys.modules[module]
    vars(policies).pop("upward", None)


def test_one_folder_is_found_listed_and_played(folder: None) -> None:
    assert "upward" in POLICIES and "height_of_axis" in FEATURES and "upward_turns" in SOURCES
    assert POLICIES.module_of("upward") is None  # this package's own: it is no code that a user has to trust
    assert "| `height_of_axis` | itself | - | 0 to 2 | `policies/upward/features.py` |" in feature_table()
    small = {"sensor": {"width": 48, "height": 27}}
    env, policy = make_env_and_policy("upward", "box", preset="fast", frame_budget=12, setup="native", config=small)
    observation, info = env.reset(seed=0)
    policy.reset(0)
    assert info["features"] == ("height_of_axis",)
    heights = policy.candidates(observation)["height_of_axis"]
    valid = observation["action_mask"].astype(bool)
    np.testing.assert_allclose(np.sort(heights[valid]), 1.0 + np.sin(np.radians([0, 10, 20, 30])), atol=1e-6)
    assert policy.act(observation) == int(np.argmax(np.where(valid, heights, -1.0)))
    env.close()


@pytest.mark.parametrize(
    "ask", [lambda: POLICIES.get("upward"), lambda: configure("fast", {"features": ("height_of_axis",)})]
)
def test_a_name_is_found_without_a_list_being_read(folder: None, ask) -> None:
    ask()


def test_a_class_is_imported_from_its_folder() -> None:
    for name in POLICIES:
        kind = POLICIES.get(name)
        if kind.__module__.startswith(f"{policies.__name__}."):
            folder = importlib.import_module(kind.__module__.rpartition(".")[0])
            assert issubclass(kind, getattr(folder, kind.__name__)), name  # a checkpoint has a class of its own


def test_without_the_folder_there_is_no_such_name() -> None:
    assert "upward" not in POLICIES and "height_of_axis" not in FEATURES and "upward_turns" not in SOURCES


def test_a_policy_is_found_without_its_features() -> None:
    """So that lists of policies, and policies in other processes, load neither numba nor the map."""
    import subprocess

    code = (
        "import sys; from activestructure_gym.policies import POLICIES; list(POLICIES); POLICIES.get('naruto');"
        "print([m for m in sys.modules if m.endswith(('.features', '.sources')) or m in ('numba', 'torch')])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
