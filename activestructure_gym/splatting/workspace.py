"""Hold the buffers of one rendering, and run the kernels on them in order."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from activestructure_gym.compiling.thread_team import TEAM, default_threads
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import counters, image_losses, kernels, layout, stepping, tile_losses
from activestructure_gym.splatting.arguments import Comparison, Kept, Lists, Pictures, Step
from activestructure_gym.splatting.simd import LANES

MAX_ALPHA = 0.999  # upper limit of a Gaussian's opacity in a pixel
_NO_FLOATS = np.empty(0, np.float32)
_STRIP = 30  # approximate width of a strip in vectors: a third of a megabyte in the second-level cache
# Largest number of floats kept for the backward pass, and blocks per entry; a typical Gaussian reaches about 5 blocks
# of a tile.
_MAX_KEPT, _BLOCKS_PER_ENTRY = 1 << 24, 8


def make_view(
    camera: PinholeCamera,
    camera_from_world: np.ndarray,  # [4, 4] or [3, 4]
    max_alpha: float = MAX_ALPHA,
    *,
    centre_depth: bool = False,
    blur_variance: float = float(layout.BLUR_VARIANCE),  # px^2
) -> np.ndarray:  # [VIEW_SIZE] float32
    """Return the camera as an array in the layout that the kernels need (``layout.POSE ...``)."""
    view = _view_of(camera).copy()
    view[: layout.FX] = camera_from_world[:3].reshape(-1)
    view[layout.MAX_ALPHA] = max_alpha
    view[layout.SLANT] = 0.0 if centre_depth else 1.0
    view[layout.BLUR] = blur_variance
    return view


@lru_cache(64)
def _view_of(camera: PinholeCamera) -> np.ndarray:
    """Return the array of `make_view` without pose and blur: intrinsics, limits of the slopes, and constants."""
    view = np.zeros(layout.VIEW_SIZE, np.float32)
    view[layout.FX : layout.LOW_X] = camera.fx, camera.fy, camera.cx, camera.cy
    margin_x, margin_y = 0.5 * layout.CLAMP_MARGIN * camera.width, 0.5 * layout.CLAMP_MARGIN * camera.height
    view[layout.LOW_X] = (-camera.cx - margin_x) / camera.fx
    view[layout.HIGH_X] = (camera.width - camera.cx + margin_x) / camera.fx
    view[layout.LOW_Y] = (-camera.cy - margin_y) / camera.fy
    view[layout.HIGH_Y] = (camera.height - camera.cy + margin_y) / camera.fy
    view[layout.CONSTANTS : layout.CONSTANTS + len(layout.CONSTANT_VALUES)] = layout.CONSTANT_VALUES
    return view


def inverse_of_pose(pose: np.ndarray) -> np.ndarray:  # [4, 4] -> [3, 4]
    """Return the upper rows [3, 4] of the inverse of one rigid transform.

    Plain floats take a tenth of the time of numpy with nine small arrays.
    """
    (a, b, c, x), (d, e, f, y), (g, h, i, z) = np.asarray(pose, dtype=np.float64)[:3].tolist()
    return np.array([
        (a, d, g, -(a * x + d * y + g * z)), (b, e, h, -(b * x + e * y + h * z)), (c, f, i, -(c * x + f * y + i * z)),
    ])  # fmt: skip


@lru_cache(64)
def make_grid(count: int, capacity: int, camera: PinholeCamera) -> np.ndarray:  # [GRID_SIZE] int64, read-only
    """Return the sizes of a rendering as an array in the layout that the kernels need (``layout.COUNT ...``)."""
    grid = np.empty(layout.GRID_SIZE, np.int64)
    grid[layout.COUNT], grid[layout.CAPACITY] = count, capacity
    grid[layout.WIDTH], grid[layout.HEIGHT] = camera.width, camera.height
    grid[layout.TILES_X], grid[layout.TILES_Y] = -(-camera.width // layout.TILE), -(-camera.height // layout.TILE)
    grid[layout.BLOCKS_X], grid[layout.BLOCKS_Y] = -(-camera.width // 4), -(-camera.height // 4)
    grid[layout.CHUNKS] = max(1, -(-count // layout.CHUNK))  # an empty map has one empty chunk
    grid[layout.MARGIN], grid[layout.TILE_BLOCKS] = LANES, 64
    grid[layout.STRIDE] = 2 * LANES + LANES * -(-3 * camera.width // LANES)
    return grid


def fitted(parameters: np.ndarray) -> np.ndarray:
    """Return the parameters if the kernels can use this array, else a copy padded to a multiple of 16 columns."""
    rows, columns = parameters.shape
    if columns % LANES == 0 and parameters.flags.c_contiguous and parameters.flags.writeable:
        return parameters
    padded = np.zeros((rows, -(-columns // LANES) * LANES), np.float32)
    padded[:, :columns] = parameters
    return padded


def aligned_zeros(size: int, dtype: type = np.float32) -> np.ndarray:
    """Return a flat array of ``size`` zeros that starts on a cache line (64 bytes)."""
    room = np.zeros(size * np.dtype(dtype).itemsize + 64, np.uint8)
    start = -room.ctypes.data % 64
    return room[start : start + size * np.dtype(dtype).itemsize].view(dtype)


def flat(image: np.ndarray) -> np.ndarray:
    """Return an image as a flat, writeable float32 array.

    Numba would compile another kernel for other kinds of arrays.
    """
    return np.require(image, np.float32, ["C", "W"]).reshape(-1)


class Workspace:
    """Hold buffers that renderings reuse.

    They grow and never shrink, so that repeated renderings allocate no memory.
    """

    def __init__(self) -> None:
        self._buffers: dict[str, np.ndarray] = {}
        self.tickets = np.zeros(counters.TICKETS, np.int64)
        self._results = np.zeros(stepping.RESULTS)
        self.entries = np.empty((layout.ENTRY_ROWS, 0), np.uint64)

    def _buffer(self, name: str, size: int, dtype: type = np.float32) -> np.ndarray:
        """Return the flat buffer called ``name`` with at least ``size`` elements; a new buffer is zero."""
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) < size:
            buffer = self._buffers[name] = aligned_zeros(size + size // 4, dtype)
        return buffer

    def _image(self, name: str) -> np.ndarray:
        """Return the colour image called ``name`` with margins.

        The margins must be 0, so each image size has its own buffer.
        """
        shape = (int(self.grid[layout.HEIGHT]), int(self.grid[layout.STRIDE]), int(self.grid[layout.WIDTH]))
        name = f"{name} {shape}"
        if name not in self._buffers:
            self._buffers[name] = aligned_zeros(shape[0] * shape[1])
        return self._buffers[name]

    def prepare(
        self,
        parameters: np.ndarray,  # [14, capacity] float32, capacity a multiple of 16
        count: int,  # number of Gaussians
        camera: PinholeCamera,
        camera_from_world: np.ndarray,  # [4, 4]
        *,
        max_alpha: float = MAX_ALPHA,
        centre_depth: bool = False,
        blur_variance: float = float(layout.BLUR_VARIANCE),
        threads: int | None = None,
        unseen: np.ndarray | None = None,  # [chunks] bool, see below
    ) -> None:
        """Compute the records of the visible Gaussians, and the lists of the tiles that they reach.

        ``centre_depth`` uses the depth of each Gaussian's centre instead of the ray's intersection. ``blur_variance``,
        px^2, is added to its covariance in the image. ``unseen`` marks chunks of 1024 Gaussians that are known to be
        out of view, which cost nothing.
        """
        self.threads = threads or default_threads()
        self.parameters, self.camera = parameters, camera
        self.view = make_view(
            camera, camera_from_world, max_alpha, centre_depth=centre_depth, blur_variance=blur_variance
        )
        self.grid = grid = make_grid(count, parameters.shape[1], camera)
        taken = np.arange(grid[layout.CHUNKS]) if unseen is None else np.flatnonzero(~unseen)
        if not len(taken):  # nothing to render: use the one empty chunk of an empty map
            self.grid = grid = make_grid(0, parameters.shape[1], camera)
            taken = np.zeros(1, np.int64)
        tiles = int(grid[layout.TILES_X] * grid[layout.TILES_Y])
        chunks = int(taken[-1]) + 1
        self.records = self._buffer("records", chunks * layout.CHUNK * layout.RECORD)
        self.visible = self._buffer("visible", chunks * layout.CHUNK // LANES, np.int32)
        histogram = self._buffer("histogram", len(taken) * tiles, np.int32)
        chunk_entries = self._buffer("chunk entries", len(taken), np.int64)
        self.tile_start = self._buffer("tile start", tiles + 1, np.int64)
        self.tile_order = self._buffer("tile order", tiles + layout.PLACES, np.int64)
        self.tickets[:] = 0
        while self.tickets[counters.FILLED] < len(taken):
            self.total = int(self.tickets[counters.ENTRIES])
            if self.total > self.entries.shape[1]:
                self.entries = np.empty((layout.ENTRY_ROWS, self.total + self.total // 4), np.uint64)
            self.lists = Lists(
                self.view, grid, self.records, taken, self.visible, self.tile_start, self.tile_order, self.entries
            )
            self._run(kernels.prepare, parameters, self.lists, histogram, chunk_entries)
        self.total = int(self.tickets[counters.ENTRIES])
        self._scratch = self._buffer("scratch", self.threads * layout.SCRATCH)

    def render(
        self,
        parameters: np.ndarray,  # [14, capacity] float32, capacity a multiple of 16
        count: int,  # number of Gaussians
        camera: PinholeCamera,
        camera_from_world: np.ndarray,  # [4, 4]
        *,
        max_alpha: float = MAX_ALPHA,
        centre_depth: bool = False,
        blur_variance: float = float(layout.BLUR_VARIANCE),
        threads: int | None = None,
        keep: bool = True,  # whether to store data for `backward`
        unseen: np.ndarray | None = None,  # [chunks] bool, see `prepare`
    ) -> None:
        """Render the images ``color`` (with margins), ``depth`` and ``alpha``.

        With ``keep``, up to 64 MiB of data are stored that make `backward` faster.
        """
        self.prepare(
            parameters, count, camera, camera_from_world, max_alpha=max_alpha, centre_depth=centre_depth,
            blur_variance=blur_variance, threads=threads, unseen=unseen,
        )  # fmt: skip
        pixels = camera.width * camera.height
        self.depth, self.alpha = self._buffer("depth", pixels), self._buffer("alpha", pixels)
        self.color = self._image("color")
        self.blend(keep=keep)

    def blend(self, *, keep: bool = True) -> None:
        """Blend the tiles of `render` into ``color``, ``depth`` and ``alpha``; may be repeated with other colours."""
        tiles = int(self.grid[layout.TILES_X] * self.grid[layout.TILES_Y])
        most = min(_MAX_KEPT, _BLOCKS_PER_ENTRY * LANES * self.total)
        places = self._buffer("kept at", 2 * tiles, np.int64)
        self.kept = Kept(self._buffer("kept", most)[:most] if keep else _NO_FLOATS, places)
        self.tickets[:] = 0
        self._run(kernels.blend, self.lists, self._scratch, self.kept, self._rendered())

    def _rendered(self) -> Pictures:
        return Pictures(self.color, self.depth, self.alpha)

    def pictures(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return copies of colour ``[H, W, 3]``, accumulated depth ``[H, W]`` (metres) and alpha ``[H, W]``."""
        height, width = self.camera.height, self.camera.width
        shape, pixels = (height, width), height * width
        return (
            self.pixels_of(self.color),
            self.depth[:pixels].reshape(shape).copy(),
            self.alpha[:pixels].reshape(shape).copy(),
        )

    def show(self, image: np.ndarray, camera: PinholeCamera, *, threads: int | None = None) -> None:
        """Use ``image [H, W, 3]`` as if it had been rendered from an empty map, to compute losses of images."""
        self.threads = threads or default_threads()
        self.camera, self.grid = camera, make_grid(0, 0, camera)
        self.tickets[:] = 0
        self.color = self._padded("color", image)
        self.depth = self._buffer("depth", camera.width * camera.height)
        self.alpha = self._buffer("alpha", camera.width * camera.height)

    def pixels_of(self, image: np.ndarray) -> np.ndarray:  # [H, W, 3], a copy
        """Return a copy of a colour image without its margins."""
        margin, width = int(self.grid[layout.MARGIN]), self.camera.width
        rows = image.reshape(self.camera.height, int(self.grid[layout.STRIDE]))
        return rows[:, margin : margin + 3 * width].copy().reshape(-1, width, 3)

    def _padded(self, name: str, image: np.ndarray) -> np.ndarray:
        """Return ``image [H, W, 3]`` in the layout of the kernels, with margins."""
        margin, buffer = int(self.grid[layout.MARGIN]), self._image(name)
        rows = buffer.reshape(self.camera.height, int(self.grid[layout.STRIDE]))
        rows[:, margin : margin + 3 * self.camera.width] = np.asarray(image).reshape(self.camera.height, -1)
        return buffer

    def losses(
        self,
        target_rgb: np.ndarray,  # [H, W, 3] float32
        target_depth: np.ndarray,  # [H, W] float32
        of_color: float,  # weight of the mean |colour difference|
        of_ssim: float,  # weight of 1 - SSIM
        of_depth: float,  # weight of the depth error
        of_alpha: float = 0.0,  # weight of the mean squared missing opacity where there is a depth
        normalised_depth: bool = True,
    ) -> tuple[float, float, float]:
        """Return mean colour difference, depth error and SSIM (nan if its weight is 0).

        Also compute the gradient images. The depth error is that of depth / alpha where alpha is above 0.5, or with
        ``normalised_depth=False`` that of the accumulated depth. Its sum is divided by the number of pixels with a
        measured depth.
        """
        height, width = self.camera.height, self.camera.width
        target_depth = flat(target_depth)
        measured = max(1, int(np.count_nonzero(target_depth > 0)))
        columns, pieces = -(-3 * width // LANES), -(-height * width // image_losses.PIECE)
        terms = self._buffer("terms", columns * image_losses.TERMS + pieces * LANES)
        factors = self._factors(of_color, of_ssim, of_depth, of_alpha, normalised_depth, measured)
        by_depth, by_alpha = self._buffer("by depth", height * width), self._buffer("by alpha", height * width)
        self.by_pictures = Pictures(self._image("by color"), by_depth, by_alpha)
        self._by_layout = self.grid[[layout.STRIDE, layout.MARGIN]]
        scratch = self._buffer("scratch", self.threads * layout.SCRATCH)
        comparison = Comparison(flat(target_rgb), target_depth, factors, terms)
        self._run(
            kernels.compare, self._strip(columns), self.grid, self._rendered(), comparison, scratch, self.by_pictures
        )
        end = columns * image_losses.TERMS
        of_columns, of_pieces = terms[:end], terms[end:][: pieces * LANES]
        color, ssim = of_columns.reshape(columns, 2, LANES).sum(axis=(0, 2), dtype=np.float64) / (3 * height * width)
        error = of_pieces.sum(dtype=np.float64) / measured
        return float(color), float(error), float(ssim) if of_ssim else float("nan")

    def _strip(self, columns: int) -> int:
        """Return the number of vector columns that a thread compares at a time, so that threads get equal work."""
        rounds = max(1, round(columns / (_STRIP * self.threads)))
        return min(-(-columns // (rounds * self.threads)), layout.SCRATCH // image_losses.STRIP_FLOATS - 4)

    def _factors(self, of_color, of_ssim, of_depth, of_alpha, normalised_depth, measured) -> np.ndarray:
        """Return the weights of `losses` in the layout of the kernels (`tile_losses`).

        ``measured`` is the number of pixels with a measured depth; the other arguments are those of `losses`.
        """
        pixels = self.camera.height * self.camera.width
        factors = np.empty(tile_losses.FACTORS, np.float32)
        factors[tile_losses.OF_COLOR], factors[tile_losses.OF_SSIM] = of_color / (3 * pixels), -of_ssim / (3 * pixels)
        factors[tile_losses.OF_DEPTH] = of_depth / measured
        factors[tile_losses.OF_ALPHA] = 2.0 * of_alpha / pixels
        factors[tile_losses.MIN_ALPHA] = 0.5 if normalised_depth else -1.0
        factors[tile_losses.NORMALISED] = 1.0 if normalised_depth else 0.0
        return factors

    def fused_step(
        self,
        target_rgb: np.ndarray,  # [H, W, 3] float32
        target_depth: np.ndarray,  # [H, W] float32
        rates: np.ndarray,  # [20] float32, see `backward`
        first_moment: np.ndarray,  # [14, capacity] float32
        second_moment: np.ndarray,  # [14, capacity] float32
        *,
        of_color: float,  # weight of the mean |colour difference|
        of_depth: float,  # weight of the depth error
        of_alpha: float,  # weight of the mean squared missing opacity
        normalised_depth: bool,
    ) -> tuple[float, float]:
        """Blend after `prepare`, compute the losses without SSIM, and run the backward pass, without writing images.

        Returns mean colour difference and depth error, as `losses`.
        """
        target_depth, pixels = flat(target_depth), self.camera.height * self.camera.width
        measured = max(1, int(np.count_nonzero(target_depth > 0)))
        factors = self._factors(of_color, 0.0, of_depth, of_alpha, normalised_depth, measured)
        tiles = int(self.grid[layout.TILES_X] * self.grid[layout.TILES_Y])
        terms = self._buffer("terms", tiles * tile_losses.TILE_TERMS)
        comparison = Comparison(flat(target_rgb), target_depth, factors, terms)
        step = self._step(rates, first_moment, second_moment, self.parameters)
        self._run_through(kernels.fuse, self.lists, self._scratch, comparison, step)
        color, depth = self._results[stepping.OF_POSE :].tolist()
        return color / (3 * pixels), depth / measured

    def set_gradient_images(self, by_color: np.ndarray, by_depth: np.ndarray, by_alpha: np.ndarray) -> None:
        """Set the gradients of a loss by the three images: ``[H, W, 3]``, ``[H, W]`` and ``[H, W]``."""
        self.by_pictures = Pictures(flat(by_color), flat(by_depth), flat(by_alpha))
        self._by_layout = np.array([3 * self.camera.width, 0])

    def backward(
        self,
        rates: np.ndarray,  # [20] float32: 14 learning rates, then `layout.BETA1 ...`
        first_moment: np.ndarray,  # [14, capacity] float32
        second_moment: np.ndarray,  # [14, capacity] float32
        gradient: np.ndarray,  # [14, capacity] float32, zeros on entry
    ) -> np.ndarray:  # [3, 4] gradient by camera_from_world
        """Convert the gradient images to an Adam step in place, to ``gradient``, or to the gradient of the pose only.

        ``rates[MODE]`` selects the result.
        """
        self.tickets[:] = 0
        self._run_through(
            kernels.unblend, self.lists, self._scratch, self.kept, self._rendered(), self.by_pictures, self._by_layout,
            self._step(rates, first_moment, second_moment, gradient),
        )  # fmt: skip
        return self._by_pose()

    def _step(
        self, rates: np.ndarray, first_moment: np.ndarray, second_moment: np.ndarray, gradient: np.ndarray
    ) -> Step:
        """Return the arrays that a backward kernel needs for its Adam step or gradient; omitted rates are 0."""
        if len(rates) < layout.RATES:  # omitted rates are 0
            rates = np.concatenate([rates, np.zeros(layout.RATES - len(rates), np.float32)])
        slots = self._buffer("slots", self.total * LANES)
        pose_parts = self._buffer("pose parts", len(self.lists.taken) * LANES)
        return Step(self.parameters, first_moment, second_moment, rates, slots, gradient, pose_parts, self._results)

    def _by_pose(self) -> np.ndarray:  # [3, 4]
        """Return the gradient by camera_from_world that a backward kernel has computed."""
        return self._results[: stepping.OF_POSE].reshape(3, 4).astype(np.float32)

    def _run_through(self, kernel, *arguments) -> None:
        """Run a kernel until the step is taken in all chunks; a thread may return early, then the kernel runs again."""
        while self.tickets[counters.STEPPED] < len(self.lists.taken):
            self._run(kernel, *arguments)

    def _run(self, kernel, *arguments) -> None:
        self.tickets[counters.THREAD_TICKET] = self.tickets[counters.GIVEN_UP] = 0
        TEAM.run(kernel, (self.tickets, *arguments), self.threads)


class PooledWorkspace:
    """Take a workspace from the pool; it is returned when this object is deleted."""

    _free: list[Workspace] = []  # list.append and list.pop are atomic

    def __init__(self) -> None:
        try:
            self.workspace = PooledWorkspace._free.pop()
        except IndexError:
            self.workspace = Workspace()

    def __del__(self) -> None:
        free = type(self)._free  # at shutdown the interpreter has removed the names of the module
        if len(free) < 4:
            free.append(self.workspace)
