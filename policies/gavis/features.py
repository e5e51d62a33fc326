"""Compute GAVIS: the entropy of a view's colours, which are known only from sides seen so far ([gavis])."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.view_directions import ViewDirections, view_directions
from activestructure_gym.mapping.boxes import BLOCK, block_boxes
from activestructure_gym.mapping.frustum_culling import MapParts, may_be_seen
from activestructure_gym.mapping.gaussian_map import COLOR, LOG_SCALE, ROWS, GaussianMap
from activestructure_gym.volume import VoxelVolume

KAPPA = 2.0  # concentration kappa of `visibility`: a larger value requires nearer directions (own choice)
VIRTUAL_SHARE = 0.1  # maximum number of virtual Gaussians, as a share of the Gaussians of the map (own choice)
MIN_VIRTUAL = 1000  # maximum number of virtual Gaussians in a map of less than 10,000 Gaussians (own choice)
VIRTUAL_OPACITY_LOGIT = 0.0  # logit of the opacity 0.5 of virtual Gaussians (own choice)
VIRTUAL_SIGMA = 0.35  # standard deviation of a virtual Gaussian, divided by their distance (own choice)
KNOWN_VARIANCE = 0.01**2  # variance of a known colour channel in 0..1 ([nvf]: of the background)
UNSEEN_VARIANCE = 1.0  # variance of an unknown colour channel ([nvf])
# Distance up to which entropy counts less, divided by the diagonal of the workspace: 6 / 20.6 in the room of [nvf].
NEAR_SHARE = 0.29


@FEATURES.register("gavis", unit="nats, mean over pixels", low=0.0)
def gavis(context: FeatureContext) -> np.ndarray:  # [K]
    """Compute the mean over pixels of the entropy of sum w_i v_i N(c_i, q) + N(mu_0, q_0) sum w_i (1 - v_i) in nats.

    w_i is the weight of Gaussian i in the pixel, c_i its colour, and v_i its visibility from the pixel's direction
    (`visibility`). q and q_0 are the variances of known and unknown colours. Virtual Gaussians with v = 0 fill
    unobserved space (`virtual_gaussians`), so that it does not count as free. `excess_entropy` bounds the entropy of a
    pixel from above, and `near_factor` reduces it near the camera. Source: [gavis], the mixture and the arg max of its
    entropy; [nvf], the variances of background and unseen colours, the bound and the factor.
    """
    everything, real = with_virtual(context.mapper.map, context.volume)
    camera, render = context.camera, context.mapper.rasterizer.render
    parameters, count = everything.parameters, everything.count
    brightness = context.mapper.map.parameters[COLOR, :real].mean(axis=0)
    parameters[COLOR] = 0.0
    moments = _view_moments(view_directions(context.mapper))
    boxes, parts = block_boxes(parameters, real), MapParts(everything)
    red, green, blue = parameters[COLOR]
    near = NEAR_SHARE * float(np.linalg.norm(context.bounds[1] - context.bounds[0]))
    per_depth = np.linalg.norm(camera.rays().astype(np.float64), axis=-1)  # distance from the camera per metre of depth
    gains = np.zeros(len(context.world_from_camera))
    for k, pose in enumerate(context.world_from_camera):
        seen = may_be_seen(boxes, camera, pose)
        visibility(parameters, real, seen, pose[:3, 3].astype(np.float64), moments, red)
        green[:real] = red[:real] * brightness
        blue[:real] = green[:real] * brightness
        shown = render(parameters, count, camera, pose, unseen=parts.unseen(camera, pose))
        alpha = shown.alpha.astype(np.float64)
        entropy = excess_entropy(shown.color.astype(np.float64), alpha)
        gains[k] = (entropy * near_factor(shown.depth * per_depth, alpha, near)).mean()
    return gains


def excess_entropy(
    moments: np.ndarray,  # [h, w, 3] sums of w v, w v c and w v c^2
    alpha: np.ndarray,  # [h, w] sum of w
) -> np.ndarray:  # [h, w] >= 0 nats
    """Return an upper bound of the entropy of each pixel's mixture, minus the entropy of a known colour.

    The mixture has three parts: the known Gaussians with weight k = sum w v, unknown colours with weight
    u = alpha - k, and a known background with weight 1 - alpha. The bound is the sum of -p log p over the
    three weights p, plus 3/2 (k log(q_k / q) + u log(q_0 / q)) for three channels. q_k is q plus the variance of the
    brightness c over the known Gaussians. [nvf, code] has the same bound without the factor 1/2 of the logarithms.
    """
    known, first, second = (np.maximum(moments[..., i], 0.0) for i in range(3))
    weights = np.clip([known, alpha - known, 1.0 - alpha], 0.0, 1.0)
    whole = np.maximum(known, 1e-9)
    spread = np.maximum(second / whole - (first / whole) ** 2, 0.0)
    logs = weights[0] * np.log1p(spread / KNOWN_VARIANCE) + weights[1] * np.log(UNSEEN_VARIANCE / KNOWN_VARIANCE)
    return 1.5 * logs - (weights * np.log(np.maximum(weights, 1e-12))).sum(axis=0)


def near_factor(
    distance: np.ndarray,  # [h, w] metres, sum of weight times distance
    alpha: np.ndarray,  # [h, w] sum of weights
    near: float,  # metres
) -> np.ndarray:  # [h, w] 0..1
    """Return min(d / near, 1)^2 with the mean distance d of each pixel; 0 where nothing is rendered.

    A pixel at a short distance shows little surface. Without this factor of [nvf], the views nearest to unseen walls
    have the highest entropy.
    """
    return np.minimum(distance / np.maximum(alpha, 1e-9) / near, 1.0) ** 2


def with_virtual(gaussians: GaussianMap, volume: VoxelVolume) -> tuple[GaussianMap, int]:
    """Return a copy of the map with virtual Gaussians appended, and the number of Gaussians before these."""
    real = gaussians.count
    added = virtual_gaussians(volume, max(MIN_VIRTUAL, int(VIRTUAL_SHARE * real)))
    everything = GaussianMap(real + added.shape[1] + 1)
    everything.append(gaussians.parameters[:, :real])
    everything.append(added)
    return everything, real


def virtual_gaussians(volume: VoxelVolume, most: int) -> np.ndarray:  # [14, V] float32
    """Return the parameters of V spherical Gaussians in unobserved space, on the finest lattice with V <= ``most``.

    A Gaussian represents a cube of the lattice whose voxels are all unobserved. No ray of a keyframe passed the centres
    of the voxels, so the visibility 1 - prod(1 - Phi T) of [gavis] is 0.
    """
    inner = volume.unobserved[1:-1, 1:-1, 1:-1]  # the outermost layer is outside the workspace
    side = 1
    while True:
        x, y, z = (size // side for size in inner.shape)
        even = inner[: x * side, : y * side, : z * side].reshape(x, side, y, side, z, side)
        cubes = np.argwhere(even.all(axis=(1, 3, 5)))
        if len(cubes) <= most:
            break
        side += 1
    spacing = side * volume.config.voxel_size
    balls = np.zeros((ROWS, len(cubes)), np.float32)
    balls[:3] = (volume.origin + volume.config.voxel_size + (cubes + 0.5) * spacing).T
    balls[3] = 1.0
    balls[LOG_SCALE] = np.log(VIRTUAL_SIGMA * spacing)
    balls[10] = VIRTUAL_OPACITY_LOGIT
    return balls


class ViewMoments(NamedTuple):
    """Hold sums over the keyframes that saw each Gaussian, from which `visibility` computes its series to degree 2."""

    number: np.ndarray  # [N] float64, number of these keyframes
    sum: np.ndarray  # [N, 3] sum of the unit directions v to the cameras
    products: np.ndarray  # [N, 6] sum of v v^T, upper triangle row by row
    keyframes: int  # number of all keyframes
    factors: np.ndarray  # [3] coefficients of degree 0, 1 and 2, see `degree_factors`


def _view_moments(seen: ViewDirections) -> ViewMoments:
    return ViewMoments(seen.count.astype(np.float64), seen.sum, seen.products, seen.keyframes, degree_factors(KAPPA))


def degree_factors(kappa: float) -> np.ndarray:  # [3]
    """Return the coefficients e^-kappa (2 l + 1) i_l(kappa) of P_l(cos) in the series of exp(kappa (cos - 1)).

    i_l are the modified spherical Bessel functions of the first kind. The coefficients are those of [gavis] by the
    addition theorem: sum over m of Y_lm(a) Y_lm(b)* = (2 l + 1) / (4 pi) P_l(a b).
    """
    i0 = np.sinh(kappa) / kappa
    i1 = (kappa * np.cosh(kappa) - np.sinh(kappa)) / kappa**2
    i2 = i0 - 3.0 * i1 / kappa
    return np.exp(-kappa) * np.array([i0, 3.0 * i1, 5.0 * i2])


@kernel
def visibility(
    parameters: np.ndarray,  # [14, capacity] float32
    count: int,  # number of Gaussians
    seen: np.ndarray,  # [blocks] bool; Gaussians of other blocks keep their value
    eye: np.ndarray,  # [3] metres, world: camera position
    moments: ViewMoments,
    result: np.ndarray,  # [N] float32 0..1, written
) -> None:
    """Write V = 1 - (1 - V~ / P)^P, the bound of [gavis] on the probability that one of P keyframes saw this side.

    V~ = sum over the keyframes that saw the Gaussian of exp(kappa (d d_p - 1)), to degree 2 of spherical harmonics. d
    and d_p are the unit directions from the Gaussian to ``eye`` and to the keyframe.
    """
    number, total, products, keyframes, factors = moments
    if keyframes == 0:
        result[:count] = 0.0
        return
    for block in range(len(seen)):
        if not seen[block]:
            continue
        for i in range(block * BLOCK, min(count, (block + 1) * BLOCK)):
            x, y, z = eye[0] - parameters[0, i], eye[1] - parameters[1, i], eye[2] - parameters[2, i]
            length = max(np.sqrt(x * x + y * y + z * z), 1e-9)
            x, y, z = x / length, y / length, z / length
            p = products[i]
            squares = x * x * p[0] + y * y * p[3] + z * z * p[5] + 2.0 * (x * y * p[1] + x * z * p[2] + y * z * p[4])
            once = factors[0] * number[i] + factors[1] * (x * total[i, 0] + y * total[i, 1] + z * total[i, 2])
            once += factors[2] * 0.5 * (3.0 * squares - number[i])
            share = min(max(once / keyframes, 0.0), 1.0)
            result[i] = 1.0 - (1.0 - share) ** keyframes
