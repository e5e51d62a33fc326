"""Numbers and figures of the mapping benchmarks, from results made by hand."""

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from benchmarks.growth import GrowthRow
from benchmarks.mapping import MappedViews, MappingCourse, Recipe
from benchmarks.mapping_figures import (
    plot_growth,
    quality_row,
    quality_strip,
    with_means,
)

SIZE = (36, 64)


def _course():
    rng = np.random.default_rng(0)
    frames = [
        Frame(
            rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8),
            np.full(SIZE, 2.0, np.float32),
            np.eye(4),
            PinholeCamera.from_size(64, 36),
        )
        for _ in range(3)
    ]
    return MappingCourse(keyframes=frames[:1], truth=frames[1:])


def _mapped(course, *, recipe, color_error=0.1, depth=2.0):
    color = np.stack([np.abs(frame.rgb / 255.0 - color_error) for frame in course.truth])
    return MappedViews("room", recipe, color, np.full((2, *SIZE), depth, np.float32), 100, 0.02)


def test_a_row_measures_what_was_made():
    course = _course()
    mapped = _mapped(course, recipe=Recipe("default", 5), depth=2.03)
    mapped.depth[:, :, :16] = 0.0  # a quarter is missing
    row = quality_row(course, mapped)
    expected = np.mean([-10 * np.log10(np.mean((m - f.rgb / 255.0) ** 2)) for m, f in zip(mapped.color, course.truth)])
    assert row["psnr_db"] == pytest.approx(expected) and 0 < row["ssim"] < 1
    assert row["depth_cm"] == pytest.approx(0.75 * 3.0 + 0.25 * 200.0, rel=1e-4)
    assert row["median_depth_cm"] == pytest.approx(3.0, rel=1e-4)
    assert row["event_ms"] == 20.0 and row["gaussians"] == 100


def test_means_are_per_recipe():
    rows = [
        {"scene": s, "mapper": m, "iterations": 5, "psnr_db": p}
        for s, m, p in (("a", "x", 20.0), ("b", "x", 30.0), ("a", "y", 10.0))
    ]
    assert [(row["scene"], row["mapper"], row["psnr_db"]) for row in with_means(rows)[3:]] == [
        ("mean", "x", 25.0),
        ("mean", "y", 10.0),
    ]


def test_the_strip_holds_the_truth_and_the_renderings_pixel_by_pixel():
    course = _course()
    recipes = [Recipe("default", 5), Recipe("splatam", 5), Recipe("splatam", 15)]
    mapped = [_mapped(course, recipe=recipe, color_error=0.3) for recipe in recipes]
    page = np.asarray(quality_strip([course], [mapped], shown=("default at 5", "splatam at 15")))
    wanted = [max(course.truth, key=lambda f: np.abs(np.diff(f.rgb.astype(float), axis=1)).mean()).rgb]
    index = next(k for k, frame in enumerate(course.truth) if frame.rgb is wanted[0])
    wanted += [np.rint(255 * mapped[k].color[index]).astype(np.uint8) for k in (0, 2)]
    for picture in wanted:  # the left upper part, away from the label
        tile = picture.repeat(2, axis=0).repeat(2, axis=1)[:30, :60]
        windows = np.lib.stride_tricks.sliding_window_view(page[..., 0], tile.shape[:2])
        assert (windows == tile[..., 0]).all(axis=(2, 3)).any()


def test_the_growth_figure_is_written(tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra `dev`")
    rows = [GrowthRow(n, 800 * n, 5000, 24.0, 27.0, 200.0 + n, 300.0) for n in (10, 20, 400)]
    plot_growth(rows, tmp_path / "growth.jpg", title="growth")
    with Image.open(tmp_path / "growth.jpg") as image:
        assert image.width > 900 and np.asarray(image).std() > 10
