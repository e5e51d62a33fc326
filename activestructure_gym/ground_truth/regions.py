"""Find the regions of free space of a scene, and select the one used for the agent.

Real meshes are neither closed nor consistently oriented, so inside and outside are separated by visibility. A position
is enclosed if most directions hit a surface. An enclosed region is a connected set of such positions in which a body
fits. The rest of the scene's bounding box above ground is open air, limited by the box. The largest enclosed region is
used, unless another one has more level ground. Open ground is used if there is no enclosed region, or if the largest

- is the inside of a body: its surfaces, and the floor unless the space is empty, are seen from the back;
- is a void below the ground: empty, or with the back of the ground as its ceiling;
- is part of a larger place: much of its edge at camera height is open ground;
- is too small for a room.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth.level_ground import Ground, front_share, ground_of
from activestructure_gym.ground_truth.voxelized import VoxelizedScene, voxelized
from activestructure_gym.scenes.scene import Scene

BODY_CLEARANCE = 0.2  # metres; the smallest clearance a path may have (motion.MotionConfig.min_clearance)
MIN_VOLUME = 0.5  # m^3, minimum free space of a room
# Fraction of directions that must hit a surface. A room without ceiling has about 0.78 at eye height, a room with a
# glass front 0.95. Outside, next to a wall, it is at most 0.75 (half of all directions each for ground and wall).
ENCLOSED_SHARES = (0.75, 0.6)  # the second is for wide scans without ceiling in which the first finds no region
LISTED_GROUND = 1.0  # m^2 of level ground; regions with less (closed furniture) are listed only if used
ROOM_GROUND = 4.0  # m^2 of level ground; regions with less are ignored if open or inside a body
_FROM_BEHIND, _FROM_FRONT = 0.35, 0.65  # `front_share` below which a region can be inside a body, above which it is not
_MORE_GROUND = 1.1  # factor of level ground by which another enclosed region must exceed the largest to be used instead
_BELOW_GROUND = 0.8  # minimum fraction of the ceiling that is the back of a ground, for a region below ground
_OPEN_EDGE = 0.4  # fraction of open ground beyond the edge of a region above which it is part of a larger place
_NEAR = 2  # voxels; a point this close to a region and visible from it belongs to it


@dataclass(frozen=True, eq=False)
class Region:
    """Represent a connected set of free voxels."""

    grid: VoxelizedScene
    box: tuple[slice, ...]  # index ranges of a box around the region in the grid
    inside: np.ndarray  # bool, of the shape of the box: the region's voxels
    distances: np.ndarray  # [X, Y, Z] float32 metres to the nearest surface, in this and in other regions
    enclosed: bool  # True: enclosed by surfaces; False: open air

    @cached_property
    def voxels(self) -> np.ndarray:  # [X, Y, Z] bool
        """Return which voxels of the whole grid are in the region."""
        whole = np.zeros(self.grid.occupied.shape, dtype=bool)
        whole[self.box] = self.inside
        return whole

    @property
    def clearance(self) -> np.ndarray:  # [X, Y, Z] float32
        """Return the distance to the nearest surface in metres, 0 outside the region."""
        return np.where(self.voxels, self.distances, np.float32(0.0))

    @property
    def volume(self) -> float:
        """Return the volume of the region in cubic metres."""
        return float(np.count_nonzero(self.inside)) * self.grid.voxel_size**3

    @cached_property
    def ground(self) -> Ground:
        """Return the surfaces below and above the region, with the area of its level ground."""
        return ground_of(self.grid, self.inside, [side.start for side in self.box])

    @cached_property
    def front_share(self) -> float:
        """Return the fraction, 0..1, of rays from inside the region that hit a surface from its front."""
        return front_share(self.grid, np.argwhere(self.inside) + [side.start for side in self.box])

    def holds(self, point: np.ndarray, near: int = 0) -> bool:  # [3] metres
        """Return whether a point is in the region, or visible from one of its voxels at most ``near`` voxels away."""
        low = self.grid.voxel_of(point) - near
        high = np.maximum(low + 2 * near + 1, 0)
        low = np.maximum(low, 0)
        around = np.argwhere(self.voxels[tuple(slice(a, b) for a, b in zip(low, high))]) + low
        if not near or not len(around):
            return bool(len(around))
        return bool((~self.grid.scene.raycaster.occluded(np.asarray(point), self.grid.centers(around))).any())


class Regions:
    """Find the regions of free space of a scene. Expensive properties are computed on first use."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.grid = voxelized(scene)
        self.threshold, self.enclosed = _enclosed_regions(self.grid)

    @cached_property
    def used(self) -> Region:
        """Return the region that contains the scene's option ``inside``, or the default region without this option.

        Raises `InputError` if the point is in no region.
        """
        if self.scene.inside is None:
            return self.default
        point = np.array(self.scene.inside)
        found = self.at(point)
        if found is not None:
            return found
        nearest = self._nearest(point)
        hint = "no point of it is" if nearest is None else f"the nearest free point is {in_text(nearest)}"
        raise InputError(
            f"scene '{self.scene.name}': inside={in_text(point)} is not in free space, but {self.reason(point)}; {hint}"
        )

    @cached_property
    def default(self) -> Region:
        """Return the region used for a scene without the option ``inside``, by the rules of the module's docstring.

        Raises `InputError` if there is none.
        """
        if not self.enclosed:
            if not self.open_air:
                raise InputError(
                    f"scene '{self.scene.name}' has no free space: no region of {MIN_VOLUME} m^3 is "
                    f"{BODY_CLEARANCE} m away from all surfaces and either enclosed by them or above "
                    f"{ROOM_GROUND:g} m^2 of level ground. Expected rooms with walls and a floor, or open ground: "
                    "check the units and the up axis of the scene"
                )
            return max(self.open_air, key=self.level_area)
        largest, *others = self.enclosed
        area = self.level_area(largest)
        rooms = [other for other in others if not self._is_no_room(other)]
        if self._is_no_room(largest):
            rivals = rooms + [other for other in self.open_air if self._replaces(other, largest)]
        else:
            rivals = [
                other
                for other in rooms
                if (self.level_area(other) > _MORE_GROUND * area and not self._lies_below(other, largest))
                or (self.level_area(other) >= 0.8 * area and self._lies_below(largest, other))
            ]
            if self._may_be_below(largest):
                rivals += [other for other in self.open_air if self._replaces(other, largest)]
        return max(rivals, key=self.level_area, default=largest)

    @cached_property
    def open_air(self) -> list[Region]:
        """Return the open-air regions with at least 4 m^2 of level ground that enclosed regions do not share."""
        grid = self.grid
        free = ~grid.occupied & _within(grid) & _above_ground(grid)
        for region in self.enclosed:
            if self._is_body(region) or self._may_be_below(region):
                free[region.box] &= ~region.inside
        if np.count_nonzero(free & (grid.share < self.threshold)) * grid.voxel_size**3 < MIN_VOLUME:
            return []
        found = _connected(grid, free, grid.clearance(free), enclosed=False)
        return [one for one in found if self.level_area(one) >= ROOM_GROUND]

    @cached_property
    def places(self) -> list[Region]:
        """Return the regions that ``inside`` can select, the largest level ground first.

        They have level ground and are distinct: a region that is part of open ground is left out.
        """
        found = [region for region in self.open_air if not self._is_behind(region)]
        for region in self.enclosed:
            area, around = self.level_area(region), [one for one in self.open_air if _covers(one, region)]
            # A region connected to open ground is part of it.
            if region is self.default or (
                area >= (ROOM_GROUND if self._is_body(region) else LISTED_GROUND)
                and not any(one is self.default or self._is_part(region) for one in around)
            ):
                found.append(region)
        return sorted(found, key=lambda region: -self.level_area(region))

    def at(self, point: np.ndarray) -> Region | None:  # [3] metres
        """Return the region at a point, or None.

        A region that contains the point is preferred to a region next to the point that sees it. Of two such regions,
        an enclosed one is preferred.
        """
        order = sorted(self.places, key=lambda one: not one.enclosed)
        return next((one for near in (0, _NEAR) for one in order if one.holds(point, near)), None)

    def number(self, region: Region) -> int:
        """Return the number of a region in the list of `asg list scenes`, counted from 1."""
        return next(number for number, one in enumerate(self.places, 1) if one is region)

    def ground(self, region: Region) -> Ground:
        """Return the ground of a region; for open air, without the ground of enclosed regions."""
        if region.enclosed:
            return region.ground
        known = self.__dict__.setdefault("_grounds", {})
        if id(region) not in known:
            known[id(region)] = ground_of(self.grid, self._own(region))
        return known[id(region)]

    def level_area(self, region: Region) -> float:
        """Return the area in m^2 of level ground that belongs to this region alone."""
        return self.ground(region).level_area

    def name_of(self, region: Region) -> np.ndarray:  # [3] metres
        """Return a point that identifies the region: the point at camera height farthest from all surfaces.

        Without level ground, it is the point of the region farthest from all surfaces.
        """
        clearance = np.where(region.voxels if region.enclosed else self._own(region), region.distances, np.float32(0.0))
        over = np.zeros_like(clearance)
        standing = tuple(self.ground(region).standing(self.grid).T)
        over[standing] = clearance[standing]
        best = over if over.any() else clearance
        return self.grid.centers(np.array(np.unravel_index(int(best.argmax()), best.shape)))

    def reason(self, point: np.ndarray) -> str:  # [3] metres
        """Return where a point that is in no region is, as the end of a sentence."""
        grid, at = self.grid, self.grid.voxel_of(point)
        if ((at < 0) | (at >= grid.share.shape)).any() or grid.share[tuple(at)] < self.threshold:
            return "outside of the rooms, where no level ground is below or no body fits"
        return "inside a wall or furniture"

    def _own(self, region: Region) -> np.ndarray:  # [X, Y, Z] bool
        own = region.voxels & (self.grid.share < self.threshold)
        for other in self.enclosed:
            own[other.box] &= ~other.inside
        return own

    def _nearest(self, point: np.ndarray) -> np.ndarray | None:
        """Return the centre of the nearest voxel, in any region, where a body fits; None if there is none."""
        best, found = np.inf, None
        for region in self.places:
            centers = self.grid.centers(np.argwhere(region.clearance >= BODY_CLEARANCE))
            distance = np.linalg.norm(centers - point, axis=1)
            if len(centers) and distance.min() < best:
                best, found = float(distance.min()), centers[distance.argmin()]
        return found

    def _is_no_room(self, region: Region) -> bool:
        return self.level_area(region) < ROOM_GROUND or self._is_body(region) or self._open_edge(region) > _OPEN_EDGE

    def _is_body(self, region: Region) -> bool:
        ground = region.ground
        return region.front_share < _FROM_BEHIND and (ground.floor_behind_share >= 0.5 or ground.is_bare)

    def _is_part(self, region: Region) -> bool:
        return self._open_edge(region) > _OPEN_EDGE

    def _may_be_below(self, region: Region) -> bool:
        """Return whether a region can be a void below a ground.

        Its ceiling is the back of a ground, or the region is empty and shows many surfaces from the back.
        """
        ground = region.ground
        return ground.covered_share >= _BELOW_GROUND and (
            ground.ceiling_behind_share >= _BELOW_GROUND or (region.front_share < _FROM_FRONT and ground.is_bare)
        )

    def _lies_below(self, region: Region, other: Region) -> bool:
        """Return whether ``region`` is a void below the ground of ``other``."""
        two_empty_storeys = self.ground(other).is_bare and region.ground.ceiling_behind_share < _BELOW_GROUND
        return self._may_be_below(region) and not two_empty_storeys and self._is_over(other, region)

    def _is_over(self, other: Region, region: Region) -> bool:
        """Return whether at least half of the level ground of ``other`` is above ``region``."""
        ground = self.ground(other)
        lowest = self.grid.origin[2] + region.box[2].start * self.grid.voxel_size
        covered = np.asarray(region.voxels.any(axis=2))
        above = covered[tuple(ground.columns.T)] & (ground.below > lowest)
        return bool(ground.area[above].sum() >= 0.5 * ground.level_area)

    def _is_behind(self, other: Region) -> bool:
        """Return whether the open region ``other`` is behind the walls of the default region.

        From there, most surfaces are seen from the back.
        """
        default = self.default
        return (
            default.enclosed
            and default.front_share >= _FROM_FRONT
            and other.front_share < _FROM_BEHIND
            and not self._is_over(other, default)
        )

    def _open_edge(self, region: Region) -> float:
        """Return the fraction, 0..1, of a region's edge at camera height beyond which open ground continues."""
        grid, voxels, at = self.grid, region.voxels, region.ground.standing(self.grid)
        goes_on = ~grid.occupied & (grid.share < self.threshold) & _within(grid) & _above_ground(grid)
        edge, open_edge = 0, 0
        for step in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)):
            beyond = tuple((at + step).T)  # the grid has one spare voxel on each side
            left = ~voxels[beyond]
            edge += int(left.sum())
            open_edge += int((left & goes_on[beyond]).sum())
        return open_edge / max(edge, 1)

    def _replaces(self, other: Region, largest: Region) -> bool:
        """Return whether the open region ``other`` is preferred to the largest enclosed region.

        This depends on the reason why the enclosed region may not be a room, and on the areas of level ground.
        """
        area, given_up = self.level_area(other), self.level_area(largest)
        if self._is_body(largest) and other.front_share >= _FROM_FRONT:
            return area >= 0.1 * given_up
        if self._lies_below(largest, other):
            return area >= 0.5 * given_up
        if self._is_part(largest):
            return area >= 2.0 * given_up and _covers(other, largest)
        return self._is_no_room(largest) and area >= 4.0 * given_up


def _covers(region: Region, part: Region) -> bool:
    """Return whether at least half of the voxels of ``part`` are in ``region``."""
    return bool(np.mean(region.voxels[part.box][part.inside]) >= 0.5)


def in_text(point: np.ndarray | tuple[float, ...]) -> str:
    """Return a point (metres) as text in the form of the option ``inside``: ``1.25,0,-3.5``."""
    return ",".join(f"{round(float(value), 2) + 0.0:g}" for value in point)


def _enclosed_regions(grid: VoxelizedScene) -> tuple[float, list[Region]]:
    """Return the enclosed regions, the largest first, and the value of `ENCLOSED_SHARES` with which they were found.

    The size of a region is the number of voxels in which a body fits.
    """
    for threshold in ENCLOSED_SHARES:
        candidates = ~grid.occupied & (grid.share >= threshold)
        found = _connected(grid, candidates, grid.clearance(candidates), enclosed=True)
        if found and found[0].volume >= MIN_VOLUME:
            return threshold, [found[0], *(region for region in found[1:] if region.volume >= MIN_VOLUME)]
    return ENCLOSED_SHARES[-1], []


def _connected(grid: VoxelizedScene, candidates: np.ndarray, clearance: np.ndarray, *, enclosed: bool) -> list[Region]:
    """Return the connected regions of the voxels ``candidates`` in which a body can move, the largest first.

    ``clearance`` are metres to the nearest surface. Very small regions are left out.
    """
    from scipy import ndimage

    # Two neighbouring voxels on both sides of a thin wall cannot both be this far from it, so cores end at walls.
    core = candidates & (clearance >= max(BODY_CLEARANCE, 0.6 * grid.voxel_size))
    labels, count = ndimage.label(core)
    if not count:
        return []
    sizes = np.bincount(labels.ravel())[1:]
    order = np.argsort(-sizes, kind="stable")
    boxes = ndimage.find_objects(labels)
    # Extend each core to the walls, by the voxels that a body covers while its centre is in the core.
    steps = max(1, round(BODY_CLEARANCE / grid.voxel_size))
    found: list[Region] = []
    for index in order:
        if found and sizes[index] * grid.voxel_size**3 < 0.05 * MIN_VOLUME:
            break
        box = tuple(slice(max(0, side.start - steps), side.stop + steps) for side in boxes[index])
        inside = ndimage.binary_dilation(labels[box] == index + 1, iterations=steps, mask=candidates[box])
        found.append(Region(grid, box, inside, clearance, enclosed))
    return found


def _above_ground(grid: VoxelizedScene) -> np.ndarray:  # [X, Y, Z] bool
    """Return which voxels have a surface in them or below them."""
    return np.logical_or.accumulate(grid.occupied, axis=2)


def _within(grid: VoxelizedScene) -> np.ndarray:  # [X, Y, Z] bool
    """Return which voxels have their centre within the bounds of the scene."""
    low, high = grid.scene.bounds
    x, y, z = (
        (centers >= low[axis]) & (centers <= high[axis])
        for axis, centers in enumerate(
            grid.origin[axis] + (np.arange(size) + 0.5) * grid.voxel_size
            for axis, size in enumerate(grid.occupied.shape)
        )
    )
    return x[:, None, None] & y[None, :, None] & z[None, None, :]
