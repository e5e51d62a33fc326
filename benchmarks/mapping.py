"""Measure the quality of maps on held-out views: several mapper recipes map the same walk through a scene.

A recipe is a mapper with a number of iterations. Frames and true views have 160 x 90 pixels, no
noise, and 4 x 4 supersampling, since aliasing alone would limit PSNR to about 30 dB. This module maps and renders;
`benchmarks.mapping_figures` measures and draws.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.bench import print_rows
from activestructure_gym.evaluation.cli.options import split_scenes
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.mapping.config import MapperConfig
from activestructure_gym.mapping.mapper import Mapper
from activestructure_gym.mapping.registry import mapper_config
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.streams import escape
from benchmarks.command import measuring, run, write_rows
from benchmarks.mapping_views import (
    KEYFRAME_EVERY,
    capture,
    held_out_poses,
    random_walk,
    true_volume,
)

SIZE = (160, 90)  # width and height in pixels, as in comparisons
SUPERSAMPLE = 4  # samples per pixel along each image axis
PROCEDURAL_SCENES = ("apartment?seed=0", "apartment?seed=1&rooms=4")


@dataclass(frozen=True)
class Recipe:
    """Define a mapper that is compared."""

    mapper: str  # name of the mapper
    iterations: int  # optimiser iterations per frame

    def __str__(self) -> str:
        return f"{self.mapper} at {self.iterations}"

    def make(self, rng: np.random.Generator) -> Mapper:
        """Return a mapper of this recipe with an empty map."""
        config = mapper_config(self.mapper)
        if not isinstance(config, MapperConfig):
            raise InputError(f"mapper '{self.mapper}' is not a recipe of MapperConfig")
        return Mapper(replace(config, iterations=self.iterations), rng)


RECIPES = (
    Recipe("default", 5),
    Recipe("default", 15),
    Recipe("splatam", 5),
    Recipe("splatam", 15),
)


@dataclass(frozen=True)
class MappingCourse:
    """Hold the keyframes that every recipe maps, and the held-out views that it renders."""

    keyframes: list[Frame]
    truth: list[Frame]  # true held-out views


@dataclass(frozen=True)
class MappedViews:
    """Hold V held-out views rendered from one recipe's map, and the cost of mapping."""

    scene: str
    recipe: Recipe
    color: np.ndarray  # [V, H, W, 3] float32 0..1
    depth: np.ndarray  # [V, H, W] float32 metres: accumulated depth divided by alpha; 0: no surface
    gaussians: int  # number of Gaussians in the map
    event_seconds: float  # mean processor time per keyframe


def make_course(
    scene: Scene,
    *,
    keyframes: int = 60,
    views: int = 24,
    size: tuple[int, int] = SIZE,
    seed: int = 0,
    advance: Callable[[], None] = lambda: None,  # called after every rendered frame
) -> MappingCourse:
    """Render the keyframes of a random walk from the scene's first start pose, and held-out views.

    ``keyframes`` and ``views`` are their numbers, and ``size`` is (width, height) in pixels. Every fifth frame of the
    walk is a keyframe. `held_out_poses` chooses the held-out views; it raises `InputError` if there are too few.
    """
    camera = PinholeCamera.from_size(*size)
    walk, held_out = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    start = ground_truth_of(scene).free_space.start_poses[0]
    poses = random_walk(true_volume(scene), start, (keyframes - 1) * KEYFRAME_EVERY + 1, walk)[::KEYFRAME_EVERY]
    frames = capture(scene, camera, poses, supersample=SUPERSAMPLE, advance=advance)
    chosen = held_out_poses(scene, camera, frames, views, held_out)
    return MappingCourse(frames, capture(scene, camera, chosen, supersample=SUPERSAMPLE, advance=advance))


def map_course(
    course: MappingCourse,
    recipe: Recipe,
    *,
    scene: str = "",
    seed: int = 0,
    advance: Callable[[], None] = lambda: None,  # called after every mapping event
) -> MappedViews:
    """Map the keyframes of a course in order by a recipe, and render the held-out views; ``scene`` is a label."""
    # The first keyframe is mapped once without timing, which compiles the kernels.
    recipe.make(np.random.default_rng(seed)).observe(course.keyframes[0])
    mapper = recipe.make(np.random.default_rng(seed))
    seconds = 0.0
    for frame in course.keyframes:
        before = time.process_time()
        mapper.observe(frame)
        seconds += time.process_time() - before
        advance()
    shown = [mapper.render(frame.camera, frame.world_from_camera) for frame in course.truth]
    depth = [np.where(r.alpha > 1e-3, r.depth / np.maximum(r.alpha, 1e-10), np.float32(0.0)) for r in shown]
    return MappedViews(
        scene=scene,
        recipe=recipe,
        color=np.stack([np.clip(rendering.color, 0.0, 1.0) for rendering in shown]),
        depth=np.stack(depth),
        gaussians=mapper.map.count,
        event_seconds=seconds / max(1, len(course.keyframes)),
    )


def run_quality_benchmark(
    scenes: Sequence[Scene],
    *,
    recipes: Sequence[Recipe] = RECIPES,
    keyframes: int = 60,
    views: int = 24,
    size: tuple[int, int] = SIZE,
    seed: int = 0,
    advance: Callable[[], None] = lambda: None,
) -> Iterator[tuple[MappingCourse, list[MappedViews]]]:
    """Yield, for every scene, its course and one result per recipe.

    The arguments are as in `make_course`; ``advance`` is called `quality_steps` times.
    """
    for scene in scenes:
        course = make_course(scene, keyframes=keyframes, views=views, size=size, seed=seed, advance=advance)
        yield (
            course,
            [map_course(course, recipe, scene=scene.name, seed=seed, advance=advance) for recipe in recipes],
        )


def quality_steps(scenes: int, recipes: int, keyframes: int, views: int) -> int:
    """Return how often `run_quality_benchmark` calls ``advance``, for these numbers of scenes, recipes and so on."""
    return scenes * (keyframes + views + recipes * keyframes)


@dataclass(frozen=True)
class Quality:
    """Measure the quality of maps on held-out views, with every recipe of the mapper."""

    scenes: tuple[str, ...] = ()
    """Use these scenes, separated by commas or spaces; by default two apartments."""
    out: str | None = None
    """Write mapping.jpg and mapping.json to this folder; by default print only."""
    quick: bool = False
    """Run a small version, which shows only that the benchmark works."""

    def run(self) -> int:
        """Measure, print a table, and return 0."""
        console = make_console()
        rows = _quality(console, split_scenes(self.scenes), quick=self.quick, out=self.out)
        print_rows(console, rows, "quality of maps on held-out views")
        return 0


def _quality(console: Console, scenes: Sequence[str], *, quick: bool, out: str | None) -> list[dict[str, Any]]:
    from activestructure_gym.scenes.library import load_scene
    from benchmarks.mapping_figures import quality_row, quality_strip, with_means

    keyframes, views, recipes = (10, 3, RECIPES[::3]) if quick else (60, 24, RECIPES)
    size = (96, 54) if quick else (160, 90)
    with console.status("loading the scenes"):
        loaded = [load_scene(spec) for spec in scenes or (("box",) if quick else PROCEDURAL_SCENES)]
    rows, courses, results = [], [], []
    with measuring(console, quality_steps(len(loaded), len(recipes), keyframes, views)) as advance:
        for course, mapped in run_quality_benchmark(
            loaded, recipes=recipes, keyframes=keyframes, views=views, size=size, advance=advance
        ):
            rows += [quality_row(course, entry) for entry in mapped]
            courses.append(course)
            results.append(mapped)
    rows = with_means(rows)
    if out is not None:
        folder = write_rows(out, "mapping.json", {"keyframes": keyframes, "views": views, "size": size}, rows)
        quality_strip(courses, results).save(folder / "mapping.jpg", quality=85)
        console.print(f"written: {escape(str(folder / 'mapping.jpg'))}, {escape(str(folder / 'mapping.json'))}")
    return rows


if __name__ == "__main__":
    sys.exit(run(Quality))
