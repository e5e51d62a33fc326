"""MAGICIAN: views planned ahead by a beam search over geometry that nobody has seen yet, but that is imagined."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from activestructure_gym.compiling import kernel
from activestructure_gym.features.context import FeatureContext, grid_rays
from activestructure_gym.features.registry import FEATURES
from activestructure_gym.features.unknown_volume import worth_a_look
from activestructure_gym.geometry import rotation_angle
from activestructure_gym.motion import Agent
from activestructure_gym.planes import PlaneNode
from activestructure_gym.volume import VoxelVolume

BEAMS = 10  # N_b of the paper
STEPS = 10  # N_d of the paper: views of a plan
FRAMES_PER_STEP = 5  # a plan may cost so many frames a step (own choice: the keyframe interval)
CAP = 1.0  # metres that a plane is imagined beyond what was seen of it (own choice)
_COLUMNS = 40  # of rays in a view, about


@FEATURES.register("magician", columns=("plan", "view"), unit="m^2", low=0.0)
def magician(context: FeatureContext) -> np.ndarray:  # [K, 2]
    """Imagined surface that the best plan which begins with a view would see, and that the view alone would.

    A plan is a sequence of candidates; G of a view is the imagined surface in its sight that no earlier view of the
    plan has seen (the paper's novelty: from 1 to 0 with the first look, the geometry fixed while planning), and a plan
    is worth sum G. Beam search: of all extensions of the `BEAMS` best plans by any candidate the best stay, `STEPS`
    times. The paper's steps all cost the same; these do not, so a plan is as long as 10 steps of 5 frames pay for, over
    straight ways but for the first, and of plans of one worth the one with fewer frames is better (`search`).

    What is imagined: every plane of the Plane Scene Graph goes on from the seen border through space that nobody has
    looked into, up to 1 m (`imagined`), instead of what a trained network fills in. Source: [magician], by abstract
    and digest.
    """
    poses, agent = context.world_from_camera, context.agent
    surface = imagined(context)
    sights = cells_in_sight(context, surface)
    alone = sights.sum(axis=1).astype(np.float64)
    area = context.volume.config.voxel_size**2
    if agent is None or not len(poses):
        return np.column_stack([alone, alone]) * area
    costs = Costs(agent.least_frames(poses), frames_between(poses, agent))
    return np.column_stack([search(sights, costs, BEAMS, STEPS, STEPS * FRAMES_PER_STEP), alone]) * area


def imagined(context: FeatureContext) -> np.ndarray:  # [X, Y, Z] bool
    """Voxels in which a plane is thought to go on."""
    wanted = worth_a_look(context)
    found = np.zeros_like(wanted)
    for node in context.planes.nodes:
        centres = continuation(node, context.volume, wanted)
        found[tuple(context.volume.voxel_of(centres).T)] = True
    return found & wanted


def continuation(
    node: PlaneNode,
    volume: VoxelVolume,
    wanted: np.ndarray,  # [X, Y, Z] bool
) -> np.ndarray:  # [n, 3] metres, on the plane
    """Centres of the cells that can be reached from the seen ones over wanted voxels, within `CAP`."""
    grid = node.surface
    margin = int(np.ceil(CAP / grid.cell))
    seen = np.pad(grid.seen.astype(bool), margin)
    rows, columns = np.indices(seen.shape)
    centres = grid.cell_centres(rows.ravel() - margin, columns.ravel() - margin)
    open_ = volume.contains(centres)
    open_[open_] = wanted[tuple(volume.voxel_of(centres[open_]).T)]
    open_cells = open_.reshape(seen.shape) & ~seen
    reached = ndimage.binary_dilation(seen, np.ones((3, 3), bool), iterations=margin, mask=open_cells | seen) & ~seen
    # The square steps reach farther across corners than along the axes.
    near = ndimage.distance_transform_edt(~seen) * grid.cell <= CAP if seen.any() else seen
    return np.asarray(centres[(reached & near).ravel()])


def cells_in_sight(context: FeatureContext, surface: np.ndarray) -> np.ndarray:  # [X, Y, Z] bool -> [K, M] bool
    """Which of the M imagined voxels each candidate would see: rays end at the first occupied or imagined one."""
    number = np.full(surface.shape, -1, np.int32)
    number[surface] = np.arange(surface.sum())
    stride = max(1, round(context.camera.width / _COLUMNS))
    origin, voxel_size, poses, rays = grid_rays(context.volume, context.camera, context.world_from_camera, stride)
    sights = np.zeros((len(poses), int(surface.sum())), np.bool_)
    reach = min(context.max_range, context.volume.config.max_range)
    _look(context.volume.occupied, number, origin, voxel_size, poses, rays, reach, sights)
    return sights


@kernel
def _look(
    occupied: np.ndarray,  # [X, Y, Z] bool
    number: np.ndarray,  # [X, Y, Z] int32, -1 where nothing is imagined
    origin: np.ndarray,  # [3] corner of voxel (0, 0, 0)
    voxel_size: float,
    poses: np.ndarray,  # [K, 4, 4] world_from_camera
    rays: np.ndarray,  # [h, w, 3] camera frame, depth 1
    reach: float,  # metres of depth
    sights: np.ndarray,  # [K, M] bool, set
) -> None:
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
                        sights[k, number[i, j, m]] = True
                        break
                    if occupied[i, j, m]:
                        break


class Costs(NamedTuple):
    """Frames of the steps of plans."""

    first: np.ndarray  # [K] to each candidate from where the agent stands; inf where there is no way
    between: np.ndarray  # [K, K]


def frames_between(poses: np.ndarray, agent: Agent) -> np.ndarray:  # [K, 4, 4] -> [K, K]
    """Frames from each candidate to each other one, straight: its steps or its turns, and at least one."""
    steps = np.linalg.norm(poses[:, None, :3, 3] - poses[None, :, :3, 3], axis=2) / agent.motion.max_step_m
    turns = np.stack([np.degrees(rotation_angle(poses, pose)) for pose in poses]) / agent.motion.max_turn_deg
    return np.maximum(np.ceil(np.maximum(steps, turns) - 1e-6), 1.0)


def search(
    sights: np.ndarray,  # [K, M] bool
    costs: Costs,
    beams: int,
    steps: int,
    frames: float,  # that a plan may cost
) -> np.ndarray:  # [K]
    """Cells that the best plan found would see, by the candidate that it begins with; 0 where none can.

    Less half of the share of ``frames`` that it costs: so little that it tells plans of one worth apart and no others.
    """
    best = np.zeros(len(sights))
    numbers = sights.astype(np.float32)
    novel, at, spent, worth, begun = _start(numbers, costs, frames)
    np.maximum.at(best, begun, _value(worth, spent, frames))
    for step in range(steps):
        if step:
            gains = (numbers @ novel.T).T.astype(np.float64)  # [B, K], sums of 0 and 1: exact in any order
            after = spent[:, None] + costs.between[at]
            total = np.where((after <= frames) & (gains > 0), worth[:, None] + gains, -np.inf)
            beam, row = np.nonzero(np.isfinite(total))
            if not len(beam):
                break
            order = np.lexsort((after[beam, row], -total[beam, row]))[:beams]
            beam, row = beam[order], row[order]
            novel = novel[beam] * (1.0 - numbers[row])
            at, spent, worth, begun = row, after[beam, row], total[beam, row], begun[beam]
        else:
            order = np.lexsort((spent, -worth))[:beams]
            novel, at, spent, worth, begun = novel[order], at[order], spent[order], worth[order], begun[order]
        np.maximum.at(best, begun, _value(worth, spent, frames))
    return best


def _value(worth: np.ndarray, spent: np.ndarray, frames: float) -> np.ndarray:
    return np.where(worth > 0, worth - 0.5 * spent / frames, 0.0)


def _start(
    numbers: np.ndarray, costs: Costs, frames: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Plans of one view: what is novel after them, where they stand, what they cost, their worth, their beginning."""
    rows = np.flatnonzero(costs.first <= frames)
    return 1.0 - numbers[rows], rows, costs.first[rows], numbers[rows].sum(axis=1).astype(np.float64), rows
