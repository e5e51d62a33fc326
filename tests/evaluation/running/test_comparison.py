import itertools

import numpy as np
import pytest
import trimesh

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation import compare
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.api import refuse_names_of_this_process
from activestructure_gym.evaluation.running.comparison import Comparison
from activestructure_gym.policies import POLICIES, Policy
from activestructure_gym.scenes.library import SCENES


@pytest.fixture
def no_truth(monkeypatch):
    """Leave a scene's truth alone."""
    monkeypatch.setattr(StandardProtocol, "truth", lambda self, scene: None)


def test_the_grid_has_its_seeds_outside(no_truth):
    jobs = Comparison(["box", "box?seed=1", "box"], ["random", "pixel_only"], seeds=[3, 4]).prepare()
    cells = [(job.seed, job.scene, job.policy) for job in jobs]
    assert cells == list(itertools.product((3, 4), ("box", "box?seed=1"), ("random", "pixel_only")))
    assert len({job.hash for job in jobs}) == 8
    assert all(len(job.scene_hash) == 64 for job in jobs)


def test_a_file_spelt_in_two_ways_is_one_scene_and_a_twin_of_it_is_refused(no_truth, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        trimesh.creation.box((4.0, 3.0, 2.5)).export(tmp_path / folder / "h.glb")
    assert Comparison(["x/h.glb", "./x/h.glb", str(tmp_path / "x/h.glb")], ["random"]).scenes == (
        f"{tmp_path}/x/h.glb",
    )
    with pytest.raises(
        InputError, match=r"x/h.glb\?up=z' and '.*y/h.glb\?up=z' are one scene, by content and name: leave one"
    ):
        Comparison(["x/h.glb?up=z", "y/h.glb?up=z"], ["random"]).prepare()


def test_a_policy_spelt_in_two_ways_runs_once(no_truth, monkeypatch):
    from activestructure_gym.policies import POLICIES, Greedy

    class Plain(Greedy):
        required_features = ("pixel",)

    monkeypatch.setitem(POLICIES._entries, "plain", Plain)
    specs = ["plain?travel=shared", "plain", "plain?travel=native"]
    jobs = Comparison(["box"], specs).prepare()
    assert [job.policy for job in jobs] == ["plain?travel=shared", "plain"]
    assert len({job.hash for job in jobs}) == 2


@pytest.mark.parametrize(
    "change, message",
    [
        ({"scenes": []}, "at least one of scenes"),
        ({"policies": ["frontire"]}, "unknown policy 'frontire'"),
        ({"policies": ["randm"]}, "did you mean 'random'"),
        ({"policies": ["pixel_only?travel=shared"]}, "policy 'pixel_only' takes no options, got 'travel=shared'"),
        ({"policies": ["no_module:Policy"]}, "no module called 'no_module'"),
        ({"policies": ["os:path"]}, "must be a class derived from"),
        ({"scenes": ["bxo"]}, "unknown scene 'bxo'; did you mean 'box'"),
        ({"scenes": ["missing.glb"]}, "missing.glb"),
        ({"frame_budget": 0}, "frame budget must be at least 1"),
        ({"seeds": [-1]}, "seed"),
        ({"preset": "fats"}, "unknown preset 'fats'; did you mean 'fast'"),
        ({"overrides": {"sensor.widht": 3}}, "did you mean 'width'"),
        ({"overrides": {"sensor.width": -3}}, "-3"),
        ({"start_pose": (0.0, 0.0, -5.0, 0.0)}, "start"),
        ({"start_pose": (0.05, 0.0, 1.2, 0.0), "scenes": ["room"]}, "start"),
        ({"protocol": StandardProtocol(view_source="recorded")}, "recorded views"),
    ],
)
def test_everything_a_job_could_fail_on_is_said_in_one_sentence_before(change, message, request):
    if "protocol" not in change:
        request.getfixturevalue("no_truth")
    with pytest.raises(InputError) as error:
        shared = {name: change.pop(name) for name in ("preset", *vars(Conditions())) if name in change}
        grid = {"scenes": ["box"], "policies": ["random"]} | change
        Comparison(**grid, conditions=Conditions(**({"preset": "fast"} | shared))).prepare()
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_runs_without_a_map_are_announced(no_truth):
    with pytest.warns(InputWarning, match="the map is switched off"):
        Comparison(["box"], ["random"], conditions=Conditions(preset="rl")).prepare()


@pytest.mark.parametrize(
    "scene",
    [
        "bx",
        "nowhere/house.glb",
        "mesh:nowhere.glb",
        "missing.obj",
        "room?foo=1",
        "room?seed=abc",
        "procthor:nope.json",
        "gibson:nope",
    ],
)
def test_a_scene_that_cannot_be_loaded_is_refused_before_anything_is_compiled(scene, monkeypatch):
    from activestructure_gym.evaluation.running import comparison

    monkeypatch.setattr(comparison, "warming_up", lambda *given: pytest.fail("compiles"))
    with pytest.raises(InputError, match="unknown scene|there is no scene file|unknown option|whole number"):
        Comparison([scene], ["random"]).prepare()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": "box"}, r"scenes are a list, as \['box'\], got 'box'"),
        ({"policies": None}, "policies are a list"),
        ({"seeds": 3}, r"seeds are a list, as \[0\], got 3"),
        ({"seeds": "01"}, "seeds are a list"),
        ({"seeds": np.arange(0)}, "at least one of seeds"),
        ({"sweep": 5}, "a sweep has values by field"),
        ({"conditions": {"preset": "fast"}}, r"conditions must be Conditions\(...\)"),
        ({"limits": 2}, r"limits must be Limits\(...\)"),
    ],
)
def test_arguments_of_another_kind_are_refused(changes, message, tmp_path):
    with pytest.raises(InputError, match=message):
        compare(**{"scenes": ["box"], "policies": ["random"], "out": tmp_path / "out"} | changes)
    assert not any(tmp_path.iterdir())


class Here(Policy):
    def act(self, observation):
        raise AssertionError


def test_names_that_other_processes_lack_are_refused(no_truth, tmp_path, monkeypatch):
    def here():
        raise AssertionError

    monkeypatch.setitem(POLICIES._entries, "here", Here)
    monkeypatch.setitem(SCENES._entries, "here", here)
    for change, kind in (({"policies": ["here?option=1"]}, "policy"), ({"scenes": ["here?option=1"]}, "scene")):
        with pytest.raises(InputError, match=f"the {kind} 'here' is registered in this process only"):
            compare(**{"scenes": ["box"], "policies": ["random"], "out": tmp_path / "out"} | change)
    # A name is accepted if the module that registers it is named too.
    refuse_names_of_this_process(Comparison(["room"], [f"{__name__}:Here", "here", "hole_area"]))
    refuse_names_of_this_process(Comparison(["world:simulated?scene=box"], ["random"]))
