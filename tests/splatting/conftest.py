"""Scenes of Gaussians that try the rasteriser, each as float64 tensors."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from activestructure_gym.geometry import PinholeCamera, se3_exp
from activestructure_gym.splatting import backend_status
from activestructure_gym.splatting.reference import (
    BLUR_VARIANCE,
    MIN_ALPHA,
    MIN_TRANSMITTANCE,
    project_gaussians,
)
from tests.splatting.gsplat_on_cpu import on_cpu


@dataclass
class Splats:
    """Float64 leaves whose values are exactly representable in float32."""

    means: torch.Tensor
    quaternions: torch.Tensor
    log_scales: torch.Tensor
    opacity_logits: torch.Tensor
    colors: torch.Tensor
    camera_from_world: torch.Tensor
    camera: PinholeCamera

    @property
    def tensors(self):
        return (self.means, self.quaternions, self.log_scales, self.opacity_logits, self.colors)

    def parameters(self, capacity=None):
        block = torch.cat([t.detach() if t.dim() > 1 else t.detach()[:, None] for t in self.tensors], dim=1).T
        capacity = capacity or block.shape[1]
        padded = np.zeros((14, capacity), np.float32)
        padded[:, : block.shape[1]] = block.numpy()
        return padded

    @property
    def world_from_camera(self):
        return np.linalg.inv(self.camera_from_world.detach().numpy())


def make_splats(kind: str, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    camera = PinholeCamera(70, 50, 40.0, 42.0, 34.0, 26.0)
    count = 200
    depth = rng.permutation(np.linspace(0.6, 5.0, count))
    at = rng.uniform(-1.1, 1.1, (count, 2))
    size = rng.uniform(-4.0, -1.8, (count, 1)) + rng.uniform(-0.7, 0.7, (count, 3))
    logits = rng.uniform(-3.0, 4.0, count)
    if kind == "behind":
        depth = rng.permutation(np.linspace(-3.0, 3.0, count))
        depth[:5] = [0.009, 0.0101, 0.02, 0.05, -0.001]
        at[:5] *= 0.2
        size[:5] -= 3.0
    elif kind == "border":
        at = np.where(rng.random((count, 2)) < 0.5, np.sign(at) * rng.uniform(0.7, 1.5, (count, 2)), at)
        size += 0.8
    elif kind == "clamped":
        logits = rng.uniform(6.0, 20.0, count)
    elif kind == "crowd":
        count = 1600  # more than a chunk of the kernels (1024)
        camera = PinholeCamera(35, 25, 20.0, 21.0, 17.0, 13.0)  # what autograd takes grows with pixels x Gaussians
        depth = rng.permutation(np.linspace(1.0, 4.0, count))
        at = np.broadcast_to([0.013, -0.021], (count, 2)) + rng.normal(0, 0.02, (count, 2))
        size = rng.uniform(-4.5, -3.0, (count, 1)) + rng.uniform(-0.3, 0.3, (count, 3))
        logits = rng.uniform(-5.6, -3.5, count)
    elif kind == "needle":
        size = np.stack([rng.uniform(-1.5, 0.3, count), *rng.uniform(-7.0, -5.0, (2, count))], axis=1)
    elif kind == "flat":
        size = np.stack([*rng.uniform(-3.0, -1.5, (2, count)), rng.uniform(-9.0, -7.0, count)], axis=1)
    elif kind == "large":
        size = rng.uniform(-1.0, 1.5, (count, 3))
        logits = rng.uniform(-5.0, -2.0, count)
    elif kind == "empty":
        count = 0
    elif kind == "pixel":
        camera = PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5)
    elif kind != "random":
        raise ValueError(kind)
    if kind == "empty":
        points, size, logits = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    else:
        scale = np.array([camera.cx / camera.fx, camera.cy / camera.fy])
        points = np.concatenate([at * scale * np.abs(depth)[:, None], depth[:, None]], axis=1)
    quaternions = rng.normal(size=(count, 4)) * rng.uniform(0.5, 2.0, (count, 1))
    colors = rng.uniform(0.0, 1.0, (count, 3))
    camera_from_world = se3_exp(np.array([0.2, -0.1, 0.3, 0.4, -0.5, 0.2]))
    points = (points - camera_from_world[:3, 3]) @ camera_from_world[:3, :3]

    def leaf(values):
        return torch.tensor(np.asarray(values, np.float32).astype(np.float64), requires_grad=True)

    return Splats(
        leaf(points), leaf(quaternions), leaf(size), leaf(logits), leaf(colors), leaf(camera_from_world), camera
    )


def settled_pixels(
    splats: Splats, max_alpha: float = 0.999, slack: float = 1e-4, blur_variance: float = BLUR_VARIANCE
) -> torch.Tensor:  # [H, W] bool
    """Pixels where no Gaussian is so close to a threshold that float32 and float64 may decide differently."""
    camera = splats.camera
    with torch.no_grad():
        position, inverse, depth = project_gaussians(
            *splats.tensors[:3], splats.camera_from_world, camera, blur_variance
        )
        order = torch.argsort(depth)
        order = order[depth[order] >= 0.01]
        position, inverse = position[order], inverse[order]
        v, u = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
        dx, dy = u[..., None] - position[:, 0], v[..., None] - position[:, 1]
        power = -0.5 * (inverse[:, 0] * dx**2 + inverse[:, 2] * dy**2) - inverse[:, 1] * dx * dy
        log_alpha = torch.nn.functional.logsigmoid(splats.opacity_logits[order]) + power
        alpha = torch.where(log_alpha < math.log(MIN_ALPHA), 0.0, log_alpha.exp().clamp(max=max_alpha))
        after = torch.cumprod(1 - alpha, dim=2)
        reached = torch.cat([torch.ones_like(after[..., :1]), after[..., :-1]], dim=2) > MIN_TRANSMITTANCE
        doubtful = ((log_alpha - math.log(MIN_ALPHA)).abs() < slack) | ((log_alpha - math.log(max_alpha)).abs() < slack)
        doubtful |= (alpha > 0) & ((after / MIN_TRANSMITTANCE).log().abs() < 10 * slack)
        return ~(doubtful & reached).any(dim=2)


KINDS = ("random", "behind", "border", "clamped", "crowd", "needle", "flat", "large", "empty", "pixel")


@pytest.fixture
def splats_of():
    return make_splats


@pytest.fixture
def settled():
    return settled_pixels


@pytest.fixture(params=["stand-ins", pytest.param("cuda", marks=pytest.mark.gpu)])
def gsplat_device(request):
    """Where gsplat runs: on the CPU with stand-ins for its compiled functions, or as it is on a CUDA device."""
    pytest.importorskip("gsplat")
    if request.param == "cuda":
        state = backend_status()["gsplat"]
        if state != "works":
            pytest.skip(state)
        yield "cuda"
        return
    with on_cpu():
        yield "cpu"


def at_both_blurs(kinds: tuple[str, ...]) -> list:
    """Cases of (kind, blur): ours and gsplat's, of which the second of the crowd takes its time."""
    slow = [pytest.mark.slow]
    return [
        *((kind, BLUR_VARIANCE) for kind in kinds),
        *(pytest.param(kind, 0.3, marks=slow if kind == "crowd" else []) for kind in kinds),
    ]
