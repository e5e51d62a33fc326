"""With random weights: the published ones are nobody's to ship."""

import dataclasses
import hashlib
import sys

import numpy as np
import pytest
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.metrics import lpips
from activestructure_gym.evaluation.metrics.lpips import WeightFile, find_weights, load

LAYERS = {0: (3, 64, 11), 3: (64, 192, 5), 6: (192, 384, 3), 8: (384, 256, 3), 10: (256, 256, 3)}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Folder with both files, and what they are expected to be."""
    folder = tmp_path_factory.mktemp("weights")
    generator = torch.Generator().manual_seed(0)
    backbone, heads = {}, {}
    for number, (layer, (inputs, outputs, side)) in enumerate(LAYERS.items()):
        spread = 1.0 / np.sqrt(inputs * side * side)
        backbone[f"features.{layer}.weight"] = spread * torch.randn(outputs, inputs, side, side, generator=generator)
        backbone[f"features.{layer}.bias"] = 0.1 * torch.randn(outputs, generator=generator)
        heads[f"lin{number}.model.1.weight"] = torch.rand(1, outputs, 1, 1, generator=generator)
    expected = []
    for name, content in (("backbone.pth", backbone), ("heads.pth", heads)):
        torch.save(content, folder / name)
        data = (folder / name).read_bytes()
        expected.append(WeightFile(name, name, hashlib.sha256(data).hexdigest(), len(data)))
    return folder, tuple(expected)


def reference(weights, first: np.ndarray, second: np.ndarray) -> float:
    """The paper's formula through torch's own layers, and the distance by hand in numpy."""
    folder, _ = weights
    backbone, heads = (torch.load(folder / name, weights_only=True) for name in ("backbone.pth", "heads.pth"))
    strides = {0: (4, 2), 3: (1, 2), 6: (1, 1), 8: (1, 1), 10: (1, 1)}
    layers: list[torch.nn.Module] = []
    for layer, (inputs, outputs, side) in LAYERS.items():
        convolution = torch.nn.Conv2d(inputs, outputs, side, *strides[layer])
        convolution.load_state_dict({k: backbone[f"features.{layer}.{k}"] for k in ("weight", "bias")})
        layers += [convolution, torch.nn.ReLU()] + ([torch.nn.MaxPool2d(3, 2)] if layer in (0, 3) else [])
    network = torch.nn.Sequential(*layers)
    taps = []
    for image in (first, second):
        x = (2 * image - 1 - np.array([-0.030, -0.088, -0.188])) / np.array([0.458, 0.448, 0.450])
        x, found = torch.tensor(x, dtype=torch.float32).permute(2, 0, 1)[None], []
        for layer in network:
            x = layer(x)
            if isinstance(layer, torch.nn.ReLU):
                found.append(x[0].detach().numpy().astype(np.float64))
        taps.append(found)
    total = 0.0
    for number, (a, b) in enumerate(zip(*taps)):
        a, b = (f / np.sqrt(1e-8 + (f**2).sum(axis=0)) for f in (a, b))
        head = heads[f"lin{number}.model.1.weight"].numpy()[0, :, 0, 0]
        total += float(np.einsum("c,chw->hw", head, (a - b) ** 2).mean())
    return total


def test_equals_an_independent_computation(weights, rng):
    folder, expected = weights
    paths, reason = find_weights(str(folder), expected)
    assert reason == "" and [path.name for path in paths] == ["backbone.pth", "heads.pth"]
    network = load(paths)
    true = rng.uniform(size=(70, 95, 3))
    for noise in (0.02, 0.3):
        rendered = np.clip(true + rng.normal(scale=noise, size=true.shape), 0, 1)
        assert network(rendered, true) == pytest.approx(reference(weights, rendered, true), rel=1e-4)
    assert network(true, true) == 0.0


def test_one_of_the_files_is_enough_to_name_the_place(weights):
    folder, expected = weights
    assert find_weights(str(folder / "heads.pth"), expected)[1] == ""


def test_files_of_other_content_are_not_used(weights):
    folder, expected = weights
    other = (expected[0], dataclasses.replace(expected[1], sha256="0" * 64))
    paths, reason = find_weights(str(folder), other)
    assert paths == [] and "heads.pth, sha256 00000000" in reason and "backbone" not in reason.partition("hold")[2]


def test_nothing_is_unpickled(tmp_path):
    torch.save({"evil": np.random.default_rng}, tmp_path / "evil.pth")
    with pytest.raises(InputError, match="cannot be read as weights"):
        load([tmp_path / "evil.pth"])


def test_without_weights_there_is_a_reason_and_no_number(tmp_path, monkeypatch):
    monkeypatch.delenv(lpips.VARIABLE, raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "nowhere"))
    lpips._network.cache_clear()
    notes: dict[str, str] = {}
    with lpips.measuring(notes) as distance:
        assert distance is None
    assert str(tmp_path) not in notes["lpips"]  # results do not differ from user to user
    assert "weights not supplied" in notes["lpips"] and "alexnet-owt-7be5be79.pth" in notes["lpips"]
    assert lpips.weights_name() is None
    lpips._network.cache_clear()


def test_a_place_that_was_named_must_hold_them(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="do not exist"):
        find_weights(str(tmp_path / "nowhere"))
    monkeypatch.setenv(lpips.VARIABLE, str(tmp_path))
    with pytest.raises(InputError, match="weights not supplied"):
        lpips.weights_name()
    lpips._network.cache_clear()


@pytest.mark.parametrize(
    "places", [{}, {"XDG_CACHE_HOME": "/elsewhere"}, {"TORCH_HOME": "~/torch", "XDG_CACHE_HOME": "/elsewhere"}]
)
def test_torch_is_not_imported_to_learn_where_its_hub_is(places, monkeypatch):
    for name in ("TORCH_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in places.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(torch.hub, "_hub_dir", None)
    expected = torch.hub.get_dir()
    monkeypatch.delitem(sys.modules, "torch")
    assert str(lpips._hub_directory()) == expected
    assert "torch" not in sys.modules
