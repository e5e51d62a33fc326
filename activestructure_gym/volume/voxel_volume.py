"""Map unknown, free and occupied space in a voxel grid, with a distance field for motion and a TSDF for evaluation."""

from __future__ import annotations

import math
from numbers import Integral

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera, invert_rigid, rotation_angle
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.volume import distance_field, integration
from activestructure_gym.volume.config import VolumeConfig, grid_shape
from activestructure_gym.volume.depth_image import fill_gaps, minimum_pyramid, solid_gaps
from activestructure_gym.volume.integration import FREE, OCCUPIED, UNKNOWN
from activestructure_gym.volume.no_return import Grid, mark_crossed
from activestructure_gym.volume.occupancy import occupancy
from activestructure_gym.volume.rays import PixelRays, rays_of_pixels

_NONE = -1  # no state of a voxel


class VoxelVolume:
    """Hold a dense axis-aligned voxel grid over the workspace, updated from depth images.

    All space that is not proven free counts as an obstacle: unknown voxels, and space outside the grid. Arrays are
    indexed [x, y, z]. The centre of voxel ``i`` is ``origin + (i + 0.5) * voxel_size`` in metres.
    """

    def __init__(
        self,
        bounds: np.ndarray,  # [2, 3] metres, world: lower and upper corner; one voxel is added on each side
        config: VolumeConfig | None = None,
    ) -> None:
        self.config = config or VolumeConfig()
        bounds = np.asarray(bounds, dtype=np.float64)
        if bounds.shape != (2, 3) or not np.isfinite(bounds).all() or not (bounds[1] > bounds[0]).all():
            raise ValueError(f"bounds must be [2, 3] with upper above lower, got {bounds.tolist()}")
        size = self.config.voxel_size
        self.voxel_size = size
        self.truncation = max(self.config.truncation, 3.0 * size)
        self.shape = grid_shape(bounds, size)
        # The grid is centred on the bounds, so both sides get an equal part of the voxels that exceed them.
        self.origin = bounds.mean(axis=0) - 0.5 * size * np.array(self.shape)
        self.state = np.full(self.shape, UNKNOWN, dtype=np.uint8)
        # Signed distance / truncation distance; 1 is far in front of a surface. Valid where weight > 0.
        self.tsdf = np.zeros(self.shape, dtype=np.float32)
        self.weight = np.zeros(self.shape, dtype=np.float32)  # number of observations, limited to max_weight
        self.no_return = np.zeros(self.shape, dtype=bool)  # voxels that a ray without return crossed (`mark_crossed`)
        self._solidity = np.zeros(self.shape, dtype=np.int16)
        self._miss_chance = np.ones(self.shape, dtype=np.float32)
        self._parts = np.zeros(self.shape, dtype=np.uint64)
        self._last_hit = np.full(self.shape, -1, dtype=np.int32)
        self._images = 0
        self._last_view: np.ndarray | None = None
        self._clearance: np.ndarray | None = None
        self._occupancy: np.ndarray | None = None

    # -- updates --------------------------------------------------------------------------------------------------

    def integrate(
        self,
        frame: Frame,
        *,
        sensor_range: float | None = None,  # metres up to which the sensor returns every surface; None = unknown
        dropouts: bool = False,  # whether the sensor also loses single returns within its range
    ) -> None:
        """Integrate one depth image (1 to 3 ms at 0.1 m for an apartment, almost independent of the image size).

        A pixel without return proves nothing, unless ``sensor_range`` is given. Then its ray is free up to that range,
        which an agent needs in halls longer than the range. Pixels of NaN, and those in `Frame.unmeasured`, prove no
        space free. With ``dropouts`` only blocks of 5 x 5 pixels without return are free. Other pixels without depth,
        also unmeasured ones, get the smallest depth of their neighbours, and thin structures need views from half the
        distance.
        """
        config, camera, view = self.config, frame.camera, np.asarray(frame.world_from_camera, dtype=np.float64)
        if frame.depth.shape != (camera.height, camera.width):
            raise ValueError(
                f"depth has the shape {frame.depth.shape}, but its camera has {(camera.height, camera.width)}"
            )
        depth = np.ascontiguousarray(frame.depth, dtype=np.float32)
        unmeasured = frame.unmeasured
        if not np.isfinite(depth).all():
            unmeasured = np.isnan(depth) if unmeasured is None else unmeasured | np.isnan(depth)
            depth = np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0)
        fresh = self._last_view is None or bool(
            math.dist(view[:3, 3].tolist(), self._last_view[:3, 3].tolist()) > 0.02
            or rotation_angle(view, self._last_view) > np.radians(1.0)
        )
        if fresh:
            self._last_view = view.copy()
        voxels = integration.VoxelFields(
            self.origin, self.voxel_size, self.state, self._solidity, self._miss_chance, self._parts, self._last_hit,
            self.tsdf, self.weight,
        )  # fmt: skip
        integration.mark_hits(
            depth, camera.lens, view, voxels, config.max_range, self._images, config.hit_gain, config.hit_ceiling
        )
        free_to = fill_gaps(depth, sensor_range, dropouts=dropouts, unmeasured=unmeasured)
        if sensor_range is not None:
            self._mark_no_return(frame, depth, free_to, unmeasured, float(sensor_range))
        # Lost returns leave fewer rays, so rays count as twice as far apart.
        thinnest = config.thinnest / (2.0 if dropouts else 1.0)
        camera_from_world = invert_rigid(view)
        planes = integration.frustum_planes(camera, camera_from_world, self.voxel_size, config.max_range)
        lower, upper = self._frustum_box(frame, float(free_to.max(initial=0.0)))
        pyramid, levels = minimum_pyramid(free_to)
        integration.carve(
            integration.Look(self._images, fresh, depth, pyramid, levels, camera.lens, camera_from_world),
            integration.Frustum(*planes, lower, upper),
            voxels,
            integration.Caution(
                config.margin, config.margin_growth, thinnest, config.max_miss_chance, self.truncation,
                config.max_weight,
            ),
        )  # fmt: skip
        self._images += 1
        self._changed()

    def _mark_no_return(
        self, frame: Frame, depth: np.ndarray, free_to: np.ndarray, unmeasured: np.ndarray | None, sensor_range: float
    ) -> None:
        """Record the voxels on rays that show no surface, such as those through windows and to dark objects.

        Of pixels that were not measured, only blocks of 5 x 5 count, and their rays end at occupied voxels. They do not
        count if they are half of the image or more, as after a failure of the camera or too near to a surface.
        """
        # The last voxel of a ray is left out: it can contain an unseen surface just beyond the sensor's range.
        reach = min(max(0.0, sensor_range - 3.0**0.5 * self.voxel_size), self.config.max_range)
        camera, view = frame.camera, np.asarray(frame.world_from_camera, dtype=np.float64)
        # Large images have more rays than needed: half a voxel between rays is enough.
        stride = max(1, int(0.5 * self.voxel_size * min(camera.fx, camera.fy) / max(reach, self.voxel_size)))
        rays = [((depth <= 0) & (free_to >= np.float32(sensor_range)), _NONE)]
        if unmeasured is not None and unmeasured.mean() < 0.5:
            rays.append((solid_gaps(depth) & unmeasured, OCCUPIED))
        grid = Grid(self.state, self.no_return, self.origin, self.voxel_size)
        for empty, end in rays:
            if empty.any():
                mark_crossed(grid, empty, stride, camera.lens, view, reach, end)

    def mark_free_sphere(self, center: np.ndarray, radius: float) -> None:
        """Mark the voxels inside a sphere as free, because the agent's body occupies it.

        ``center`` [3] and ``radius`` are in metres. Voxels partly inside become free when views prove the rest.
        Occupied voxels remain occupied. Call it only where the body is known to fit, such as at a checked start pose.
        """
        center = np.asarray(center, dtype=np.float64)
        lower = np.clip(self.voxel_of(center - radius), 0, self.shape)
        upper = np.clip(self.voxel_of(center + radius) + 1, 0, self.shape)
        box = tuple(slice(a, b) for a, b in zip(lower, upper))
        bits = self._parts_inside(center, radius, lower, upper)
        self._parts[box] |= np.where(self._solidity[box] == 0, bits, np.uint64(0))
        inside = self._parts[box] == integration.ALL_PARTS
        self.state[box][inside] = FREE
        self._miss_chance[box][inside] = 0.0
        self._changed()

    def _parts_inside(
        self, center: np.ndarray, radius: float, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:  # [X, Y, Z] uint64, one bit per part
        """Return the parts that are inside a sphere, for each voxel in the box [lower, upper)."""
        side, steps = integration.PARTS_PER_SIDE, self.voxel_size * integration.part_steps()
        squares = []  # per axis [voxels * parts]: square of the distance from the centre to the far side of each part
        for axis in range(3):
            centers = self.origin[axis] + (np.arange(lower[axis], upper[axis]) + 0.5) * self.voxel_size
            farthest = np.abs(centers[:, None] + steps - center[axis]) + 0.5 * self.voxel_size / side
            squares.append((farthest * farthest).ravel())
        x, y, z = squares
        inside = np.sqrt(x[:, None, None] + y[:, None] + z) <= radius
        shape = tuple(upper - lower)
        bits = inside.reshape(shape[0], side, shape[1], side, shape[2], side).transpose(0, 2, 4, 1, 3, 5)
        return np.packbits(bits.reshape(*shape, side**3), axis=-1, bitorder="little").view("<u8")[..., 0]

    def _frustum_box(self, frame: Frame, farthest: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the box [lower, upper) of voxels around the view frustum, up to the largest depth that changes voxels.

        ``farthest`` is the largest free distance of a ray in metres.
        """
        deepest = min(farthest + self.truncation, self.config.max_range)
        world = deepest * integration.corner_rays(frame.camera)
        world = world @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]
        lower = np.clip(self.voxel_of(world.min(axis=0)), 0, self.shape)
        upper = np.clip(self.voxel_of(world.max(axis=0)) + 1, 0, self.shape)
        return lower.astype(np.int64), upper.astype(np.int64)

    def _changed(self) -> None:
        self._clearance = self._occupancy = None

    # -- the grid -------------------------------------------------------------------------------------------------

    def voxel_of(self, points: np.ndarray) -> np.ndarray:  # [..., 3] metres -> [..., 3] int64, also outside the grid
        """Return the index of the voxel that contains each point, also for points outside the grid."""
        return np.floor((np.asarray(points, dtype=np.float64) - self.origin) / self.voxel_size).astype(np.int64)

    def center_of(self, indices: np.ndarray) -> np.ndarray:  # [..., 3] -> [..., 3] metres, world
        """Return the centre of each voxel in metres."""
        return self.origin + (np.asarray(indices) + 0.5) * self.voxel_size

    def contains(self, points: np.ndarray) -> np.ndarray:  # [..., 3] -> [...] bool
        """Return whether each point (metres, world) is inside the grid."""
        voxels = self.voxel_of(points)
        return np.all((voxels >= 0) & (voxels < np.array(self.shape)), axis=-1)

    def state_at(self, points: np.ndarray) -> np.ndarray:  # [N, 3] -> [N] uint8
        """Return the state of the voxel that contains each point (metres, world); UNKNOWN outside the grid."""
        return self._at(points, self.state, UNKNOWN)

    def occupancy_at(self, points: np.ndarray) -> np.ndarray:  # [N, 3] -> [N] float32
        """Return the occupancy of the voxel that contains each point (metres, world); 0.5 outside the grid."""
        return self._at(points, self.occupancy, 0.5)

    def _at(self, points: np.ndarray, values: np.ndarray, outside: float) -> np.ndarray:  # [N] of the type of values
        points = np.ascontiguousarray(points, dtype=np.float64)
        found: np.ndarray = integration.values_at(points, self.origin, self.voxel_size, values, outside)
        return found

    def _grid_coordinates(self, points: np.ndarray) -> np.ndarray:  # voxels, centre of voxel (0, 0, 0) at 0
        points = np.asarray(points, dtype=np.float64)
        return np.ascontiguousarray((points - self.origin) / self.voxel_size - 0.5)

    @property
    def states(self) -> np.ndarray:  # [X, Y, Z] uint8, read-only
        """Return the state of each voxel: UNKNOWN (0), FREE (1) or OCCUPIED (2)."""
        return _read_only(self.state)

    @property
    def occupancy(self) -> np.ndarray:  # [X, Y, Z] float32 in 0..1, read-only
        """Return the probability that each voxel is occupied; computed at the first use after a change.

        It is 0.5 to 0.97 in OCCUPIED voxels, exactly 0.5 in voxels without evidence, and at most 0.05 in voxels that
        rays crossed, FREE or not. `volume.occupancy` has the formula.
        """
        if self._occupancy is None:
            self._occupancy = occupancy(self._solidity, self._miss_chance, self._crossed, self.config.hit_gain)
        return _read_only(self._occupancy)

    @property
    def unobserved(self) -> np.ndarray:  # [X, Y, Z] bool
        """Return a mask of the unobserved voxels: neither free nor occupied, and without a ray through the centre.

        Use it to select targets for new views; use `state` for motion. In front of every surface is a layer of unknown
        voxels that rays crossed without proving them free: within the margin, with partial footprints, or beyond 2.4 m,
        where several views are needed. More views of the surface do not prove the layer free, so it is not in this
        mask. Neither are the voxels that a ray without return crossed (`no_return`).
        """
        return (self.state == UNKNOWN) & ~self._crossed

    @property
    def _crossed(self) -> np.ndarray:  # [X, Y, Z] bool: a ray crossed the centre, or a ray without a return the voxel
        return ((self.weight > 0) & (self.tsdf > 0)) | self.no_return

    @property
    def observed_share(self) -> float:
        """Return the fraction of the grid's voxels that are free or occupied."""
        return float(np.count_nonzero(self.state)) / self.state.size

    # -- rays -----------------------------------------------------------------------------------------------------

    def rays(
        self,
        camera: PinholeCamera,
        world_from_camera: np.ndarray,  # [K, 4, 4], or [4, 4] for one view
        *,
        stride: int | None = None,  # pixels from one ray to the next; None: about 40 rays per image row
        reach: float | None = None,  # metres along a ray; None: `VolumeConfig.max_range`
    ) -> PixelRays:
        """Return the rays of every ``stride``-th pixel of K views; raise `InputError` for a wrong argument."""
        shape = np.shape(world_from_camera)
        if len(shape) not in (2, 3) or shape[-2:] != (4, 4):
            raise InputError(f"world_from_camera is one pose, [4, 4], or several, [K, 4, 4], got the shape {shape}")
        if stride is not None and not (isinstance(stride, Integral) and stride >= 1):
            raise InputError(f"stride must be a whole number of at least 1 pixel, or None, got {short_repr(stride)}")
        if reach is not None and not 0.0 < reach < np.inf:  # a ray outside the grid would never end
            raise InputError(f"reach must be a finite number of metres above 0, or None, got {short_repr(reach)}")
        poses, rays = rays_of_pixels(camera, world_from_camera, stride)
        unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        length = self.config.max_range if reach is None else float(reach)
        return PixelRays(self.origin, float(self.voxel_size), self.occupied, poses, unit, length)

    # -- distances ------------------------------------------------------------------------------------------------

    @property
    def clearance(self) -> np.ndarray:  # [X, Y, Z] float32 metres
        """Return the distance from each free voxel's centre to the nearest cube of a voxel that is not free, in metres.

        Unknown voxels and space outside the grid count as ``unknown_slack`` farther away than they are. So the true
        clearance is at least the returned one minus this slack. It is 0 in voxels that are not free. It is computed at
        the first use after a change, and only in the box around the free voxels.
        """
        if self._clearance is None:
            self._clearance = np.zeros(self.shape, dtype=np.float32)
            free = self.state == FREE
            if free.any():
                self._measure_clearance(self._clearance, *distance_field.bounding_box(free))
        return self._clearance

    def clearance_around(
        self,
        points: np.ndarray,  # [N, 3] voxels; the centre of voxel (0, 0, 0) is at (0, 0, 0)
        *,
        enough: float,  # metres; larger clearances need not be exact
    ) -> np.ndarray:  # [X, Y, Z] float32 metres
        """Return the `clearance` field around the given points, exact only below ``enough``.

        Values interpolated inside the box of the points equal `clearance` if that is below ``enough``, and are at least
        ``enough`` otherwise. Outside the box they are undefined. After a change of a large volume this is several times
        faster than `clearance`.
        """
        if self._clearance is not None:
            return self._clearance
        # If one corner of a cell has this clearance, all eight corners are free with at least ``enough``.
        reach = (enough + self.config.unknown_slack) / self.voxel_size + np.sqrt(3.0)
        border = int(np.ceil(reach)) + 1
        lower = np.maximum(np.floor(points.min(axis=0)).astype(np.int64), 0)
        upper = np.minimum(np.floor(points.max(axis=0)).astype(np.int64) + 2, self.shape)
        field = np.zeros(self.shape, dtype=np.float32)
        if (lower < upper).all():
            self._measure_clearance(field, lower, upper, border=border, at_most=reach)
        return field

    def _measure_clearance(
        self,
        field: np.ndarray,  # [X, Y, Z] float32 metres, output inside the box
        lower: np.ndarray,  # [3] int64 indices of the box
        upper: np.ndarray,  # [3] int64, exclusive
        *,
        border: int = 0,  # voxels around the box in which the nearest obstacle may be; increased if the slack needs it
        at_most: float = np.inf,  # voxels; larger distances need not be exact
    ) -> None:
        slack = self.config.unknown_slack / self.voxel_size
        # Obstacles that are farther outside the free space than the slack cannot be nearer than the unknown layer
        # around it.
        border = max(border, int(np.ceil(slack)) + 1)
        state = distance_field.cut_out(self.state, lower - border, upper + border)  # UNKNOWN is 0
        inner = (slice(border, -border),) * 3
        any_kind = distance_field.squared_distances(state != FREE, at_most)[inner]
        most = np.float32(at_most**2)
        farthest = min(float(distance_field.root_of(int(any_kind.max()), most)) + slack, at_most)
        occupied = distance_field.squared_distances(state == OCCUPIED, farthest)[inner]
        box = tuple(slice(a, b) for a, b in zip(lower, upper))
        distance_field.join_distances(
            any_kind, most, occupied, np.float32(farthest**2), np.float32(slack),
            np.float32(self.voxel_size), field[box],
        )  # fmt: skip

    def clearance_at(self, points: np.ndarray) -> np.ndarray:  # [N, 3] metres -> [N] float32 metres
        """Return the clearance at points, interpolated between voxel centres; 0 outside the grid.

        Next to a wall it differs from the exact distance by at most an eighth of a voxel.
        """
        return distance_field.sample_points(self.clearance, self._grid_coordinates(points).reshape(-1, 3))

    def segments_free(
        self,
        starts: np.ndarray,  # [N, 3] metres, or [3] for all
        ends: np.ndarray,  # [N, 3] metres, or [3] for all
        *,
        min_clearance: float,  # metres
        step: float | None = None,  # metres between samples; None = half a voxel
    ) -> np.ndarray:  # [N] bool
        """Return whether the clearance is at least ``min_clearance`` along each whole segment."""
        starts, ends = np.broadcast_arrays(np.atleast_2d(starts), np.atleast_2d(ends))
        step_voxels = 0.5 if step is None else step / self.voxel_size
        return distance_field.segments_above(
            self.clearance, self._grid_coordinates(starts), self._grid_coordinates(ends), min_clearance, step_voxels
        )

    def line_of_sight_free(
        self,
        starts: np.ndarray,  # [N, 3] metres, or [3] for all
        ends: np.ndarray,  # [N, 3] metres, or [3] for all
    ) -> np.ndarray:  # [N] bool
        """Return whether each line of sight crosses no occupied voxel.

        The last two voxels before each end may be occupied, since they contain the target surface.
        """
        starts, ends = np.broadcast_arrays(np.atleast_2d(starts), np.atleast_2d(ends))
        return distance_field.sight_lines(
            self.occupied, self.in_voxels(starts), self.in_voxels(ends), distance_field.SPARED
        )

    @property
    def occupied(self) -> np.ndarray:  # [X, Y, Z] bool
        """Return a mask of the occupied voxels, the form that `distance_field.sight_line` needs."""
        return self.state == OCCUPIED

    def in_voxels(self, points: np.ndarray) -> np.ndarray:  # [..., 3] metres -> [..., 3] voxels
        """Return points in voxel units; the lower corner of voxel (0, 0, 0) is at 0."""
        return self._grid_coordinates(points) + 0.5


def _read_only(array: np.ndarray) -> np.ndarray:
    """Return a view of the array that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view
