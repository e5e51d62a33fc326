"""Compute MAGICIAN's gain: imagined surface that a plan of several views would see, found by a beam search."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext, grid_rays
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unknown_volume import target_voxels
from activestructure_gym.geometry import PinholeCamera, rotation_angle
from activestructure_gym.motion import Agent
from activestructure_gym.planes import PlaneNode
from activestructure_gym.volume import VoxelVolume

WIDEST = 4.0  # sides of an image in focal lengths up to which rays are added; their number grows with the sides
BEAMS = 10  # N_b of the paper: number of plans kept in each step of the beam search
STEPS = 10  # N_d of the paper: maximum number of views of a plan
FRAMES_PER_STEP = 5  # maximum mean number of frames per view of a plan (own choice: the keyframe interval)
CAP = 1.0  # metres by which planes are extended beyond their observed part (own choice)


@FEATURES.register("magician", columns=("plan", "view"), unit="m^2", low=0.0)
def magician(context: FeatureContext) -> np.ndarray:  # [K, 2]
    """Compute the imagined surface (m^2) that the best plan beginning with a candidate sees, and the candidate alone.

    A plan is a sequence of candidates. G of a view is the imagined surface that it sees and that no earlier view of the
    plan has seen, the paper's novelty. The score of a plan is sum G. A beam search extends the ten best plans by any
    candidate and keeps the ten best, ten times. Unlike the paper's, steps differ in cost. A plan therefore costs at
    most 10 x 5 frames, along straight lines except for the first step. Of plans with equal G, the one with fewer frames
    is better (`search`).

    Imagined surface extends every plane of the Plane Scene Graph through unseen space by up to 1 m (`imagined`). The
    original uses a trained network. Source: [magician], by its abstract and a summary.
    """
    poses, agent = context.world_from_camera, context.agent
    surface = imagined(context)
    visible = visible_cells(context, surface)
    alone = visible.sum(axis=1).astype(np.float64)
    area = context.volume.config.voxel_size**2
    if agent is None or not len(poses):
        return np.column_stack([alone, alone]) * area
    costs = Costs(agent.least_frames(poses), frames_between(poses, agent))
    return np.column_stack([search(visible, costs, BEAMS, STEPS, STEPS * FRAMES_PER_STEP), alone]) * area


def imagined(context: FeatureContext) -> np.ndarray:  # [X, Y, Z] bool
    """Return which voxels contain imagined surface: extensions of the planes of the scene graph into unseen space."""
    wanted = target_voxels(context)
    found = np.zeros_like(wanted)
    for node in context.planes.nodes:
        centres = continuation(node, context.volume, wanted)
        found[tuple(context.volume.voxel_of(centres).T)] = True
    return found & wanted


def continuation(
    node: PlaneNode,
    volume: VoxelVolume,
    wanted: np.ndarray,  # [X, Y, Z] bool: unseen voxels, see `target_voxels`
) -> np.ndarray:  # [n, 3] metres, world, on the plane
    """Return the centres of the grid cells of a plane that extend its observed cells through unseen space.

    They are at most 1 m from an observed cell, and connected to one by cells in ``wanted`` voxels.
    """
    grid = node.surface
    margin = int(np.ceil(CAP / grid.cell))
    seen = np.pad(grid.seen.astype(bool), margin)
    rows, columns = np.indices(seen.shape)
    centres = grid.cell_centres(rows.ravel() - margin, columns.ravel() - margin)
    open_ = volume.contains(centres)
    open_[open_] = wanted[tuple(volume.voxel_of(centres[open_]).T)]
    open_cells = open_.reshape(seen.shape) & ~seen
    reached = ndimage.binary_dilation(seen, np.ones((3, 3), bool), iterations=margin, mask=open_cells | seen) & ~seen
    # Dilation by squares reaches farther along diagonals, so the distance is tested too.
    near = ndimage.distance_transform_edt(~seen) * grid.cell <= CAP if seen.any() else seen
    return np.asarray(centres[(reached & near).ravel()])


def ray_image(camera: PinholeCamera, apart: float) -> PinholeCamera:
    """Return ``camera`` with pixels of 1 / ``apart`` focal lengths, but at most `WIDEST` times ``apart`` a side."""
    spans = camera.width / camera.fx, camera.height / camera.fy
    return camera.resized(*(int(np.ceil(min(span, WIDEST) * apart)) for span in spans))


def visible_cells(context: FeatureContext, surface: np.ndarray) -> np.ndarray:  # [X, Y, Z] bool -> [K, M] bool
    """Return which of the M voxels of ``surface`` each candidate sees; rays end at occupied and imagined voxels.

    On surface that faces the camera, the rays are at most a voxel apart where they end, so that no voxel between them
    counts as unseen by a plan. They are farther apart on oblique surface, and in images of more than 127 degrees.
    """
    number = np.full(surface.shape, -1, np.int32)
    number[surface] = np.arange(surface.sum())
    reach, camera = min(context.max_range, context.volume.config.max_range), context.camera
    fine = ray_image(camera, reach / context.volume.voxel_size)
    origin, voxel_size, poses, rays = grid_rays(context.volume, fine, context.world_from_camera, stride=1)
    visible = np.zeros((len(poses), int(surface.sum())), np.bool_)
    _mark_visible(context.volume.occupied, number, origin, voxel_size, poses, rays, reach, visible)
    return visible


@kernel
def _mark_visible(
    occupied: np.ndarray,  # [X, Y, Z] bool
    number: np.ndarray,  # [X, Y, Z] int32, index of an imagined voxel; -1 for others
    origin: np.ndarray,  # [3] corner of voxel (0, 0, 0)
    voxel_size: float,  # metres
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    rays: np.ndarray,  # [h, w, 3] camera frame, depth 1
    reach: float,  # metres of depth
    visible: np.ndarray,  # [K, M] bool, set
) -> None:
    """Set ``visible`` to True for the imagined voxels that each candidate sees, with rays in steps of half a voxel."""
    size = occupied.shape
    for k in range(len(poses)):
        pose = poses[k]
        start = (pose[:3, 3] - origin) / voxel_size
        for row in range(rays.shape[0]):
            for column in range(rays.shape[1]):
                ray = rays[row, column]
                scale = 0.5 / np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
                dx = (pose[0, 0] * ray[0] + pose[0, 1] * ray[1] + pose[0, 2] * ray[2]) * scale
                dy = (pose[1, 0] * ray[0] + pose[1, 1] * ray[1] + pose[1, 2] * ray[2]) * scale
                dz = (pose[2, 0] * ray[0] + pose[2, 1] * ray[1] + pose[2, 2] * ray[2]) * scale
                x, y, z = start[0], start[1], start[2]
                for _ in range(int(reach / (voxel_size * scale))):
                    x, y, z = x + dx, y + dy, z + dz
                    i, j, m = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
                    if i < 0 or j < 0 or m < 0 or i >= size[0] or j >= size[1] or m >= size[2]:
                        break
                    if number[i, j, m] >= 0:
                        visible[k, number[i, j, m]] = True
                        break
                    if occupied[i, j, m]:
                        break


class Costs(NamedTuple):
    """Hold the number of frames of the motions between views."""

    first: np.ndarray  # [K] frames from the agent to each candidate; inf without a path
    between: np.ndarray  # [K, K] frames between candidates, along straight lines


def frames_between(poses: np.ndarray, agent: Agent) -> np.ndarray:  # [K, 4, 4] -> [K, K]
    """Return the number of frames of straight motions between candidates, at least 1.

    It is the larger of the number of steps and the number of turns that the agent's motion limits require.
    """
    steps = np.linalg.norm(poses[:, None, :3, 3] - poses[None, :, :3, 3], axis=2) / agent.motion.max_step_m
    turns = np.stack([np.degrees(rotation_angle(poses, pose)) for pose in poses]) / agent.motion.max_turn_deg
    return np.maximum(np.ceil(np.maximum(steps, turns) - 1e-6), 1.0)


def search(
    visible: np.ndarray,  # [K, M] bool: voxels that each candidate sees
    costs: Costs,
    beams: int,  # number of plans kept in each step
    steps: int,  # maximum number of views of a plan
    frames: float,  # maximum cost of a plan
) -> np.ndarray:  # [K]
    """Return the number of voxels seen by the best plan that begins with each candidate; 0 without such a plan.

    0.5 x cost / ``frames`` is subtracted from the number. It only orders plans with equally many voxels.
    """
    best = np.zeros(len(visible))
    numbers = visible.astype(np.float32)
    novel, at, spent, score, begun = _start(numbers, costs, frames)
    np.maximum.at(best, begun, _value(score, spent, frames))
    for step in range(steps):
        if step:
            gains = (numbers @ novel.T).T.astype(np.float64)  # [B, K], sums of 0 and 1, exact in any order
            after = spent[:, None] + costs.between[at]
            total = np.where((after <= frames) & (gains > 0), score[:, None] + gains, -np.inf)
            beam, row = np.nonzero(np.isfinite(total))
            if not len(beam):
                break
            order = np.lexsort((after[beam, row], -total[beam, row]))[:beams]
            beam, row = beam[order], row[order]
            novel = novel[beam] * (1.0 - numbers[row])
            at, spent, score, begun = row, after[beam, row], total[beam, row], begun[beam]
        else:
            order = np.lexsort((spent, -score))[:beams]
            novel, at, spent, score, begun = novel[order], at[order], spent[order], score[order], begun[order]
        np.maximum.at(best, begun, _value(score, spent, frames))
    return best


def _value(score: np.ndarray, spent: np.ndarray, frames: float) -> np.ndarray:
    return np.where(score > 0, score - 0.5 * spent / frames, 0.0)


def _start(
    numbers: np.ndarray, costs: Costs, frames: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the plans of one view that cost at most ``frames``, as five arrays with one entry per plan.

    They are the voxels not seen yet, the last candidate, the cost in frames, the score, and the first candidate.
    ``numbers`` [K, M] is 1 where a candidate sees a voxel.
    """
    rows = np.flatnonzero(costs.first <= frames)
    return 1.0 - numbers[rows], rows, costs.first[rows], numbers[rows].sum(axis=1).astype(np.float64), rows
