import json

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import save_with_panels, stored_panels
from activestructure_gym.evaluation.report.pictures.psg_3d import compass, corner_view, draw_planes_3d
from activestructure_gym.evaluation.report.pictures.psg_figures import run_planes_3d, run_planes_plan
from activestructure_gym.evaluation.report.pictures.psg_legend import SMOOTH
from activestructure_gym.evaluation.report.pictures.psg_plan import (
    draw_planes_plan,
    observed_intervals,
    view_from_above,
)


def at(picture, view, point) -> np.ndarray:
    x, y = view.pixels(np.asarray(point, float)) / SMOOTH
    return np.asarray(picture)[int(y), int(x)].astype(int)


def near(pixel: np.ndarray, colour: tuple[int, int, int], tolerance: int) -> bool:
    return bool(np.abs(pixel - np.array(colour)).max() <= tolerance)


def test_from_above_strokes_and_areas_stand_where_the_planes_do(wall_and_floor, make_run):
    plan = make_run().pictures
    by_type, by_deficit = draw_planes_plan(wall_and_floor, plan)
    view = view_from_above(wall_and_floor, plan)
    aside = [1.4, 1.5 - 0.02, 0]  # south of the wall, the side it was seen from
    assert near(at(by_type, view, aside), style.OBJECT, 30)
    assert near(at(by_deficit, view, aside), style.deficit_colour(0.05), 30)
    assert not near(at(by_type, view, [1.4, 1.6, 0]), style.OBJECT, 60)
    floor, beside = at(by_type, view, [0.5, 2.5, 0]), at(by_type, view, [-0.2, 2.5, 0])
    assert floor[2] - floor[0] > 40  # blue over the plan
    assert np.ptp(beside) < 15  # nothing but the grey plan
    assert near(at(by_deficit, view, [3.15, 0.45, 0]), style.PAPER, 10)  # the mark of the hole


def test_in_3d_patches_have_the_colours_of_their_type_and_deficit(wall_and_floor):
    by_type, by_deficit = draw_planes_3d(wall_and_floor)
    view, shift = (
        corner_view(wall_and_floor, 0),
        np.array([(620 - corner_view(wall_and_floor, 0).size[0] // SMOOTH) // 2, 20]),
    )
    assert compass(view.towards) == "south-east"

    def pixel(picture, point):
        x, y = (view.pixels(np.asarray(point, float)) / SMOOTH + shift).astype(int)
        return np.asarray(picture)[y, x].astype(int)

    wall, floor = [1.3, 1.5, 0.8], [0.4, 0.4, 0.0]
    orange, blue = pixel(by_type, wall), pixel(by_type, floor)
    assert orange[0] > orange[2] + 60 and blue[2] > blue[0] + 60
    assert near(pixel(by_deficit, wall), style.deficit_colour(0.05), 25)
    assert near(pixel(by_deficit, floor), style.deficit_colour(0.0), 25)
    # From the other side the wall shows its back and is left out: no dark deficit in the picture.
    other = np.asarray(draw_planes_3d(wall_and_floor, 1)[1]).astype(int).reshape(-1, 3)
    assert not (np.abs(other - style.deficit_colour(0.05)).max(axis=1) < 25).any()


def test_the_tree_runs_between_centroids(wall_and_floor, make_run):
    plan = make_run().pictures
    wall_and_floor["centroids"] = np.array([[0.5, 0.5, 0.0], [2.0, 1.5, 0.5]])
    view = view_from_above(wall_and_floor, plan)
    middle = [1.25, 1.0, 0.0]
    line = at(draw_planes_plan(wall_and_floor, plan)[0], view, middle)
    assert line.max() < 120
    aside = at(draw_planes_plan(wall_and_floor, plan)[0], view, [1.25, 1.0 - 2.5 / 120, 0.0])
    assert aside[2] - aside[0] > 40  # a hair line: two pixels beside it the floor is seen
    wall_and_floor["edge_in_tree"] = np.array([False])
    assert at(draw_planes_plan(wall_and_floor, plan)[0], view, middle).max() > 110
    assert near(at(draw_planes_plan(wall_and_floor, plan)[0], view, [0.5, 0.5, 0.0]), style.STRUCTURAL, 20)


def test_the_tree_runs_under_the_walls_and_over_the_floor(wall_and_floor, make_run):
    plan = make_run().pictures
    wall_and_floor["centroids"] = np.array([[0.6, 1.42, 0.0], [2.6, 1.5, 0.5]])  # the line ends along the wall
    view = view_from_above(wall_and_floor, plan)
    by_type = draw_planes_plan(wall_and_floor, plan)[0]
    assert near(at(by_type, view, [2.1, 1.48, 0]), style.OBJECT, 30)
    assert at(by_type, view, [1.1, 1.44, 0]).max() < 130


def test_what_belongs_to_a_wall_that_is_cut_away_is_cut_away_with_it(wall_and_floor):
    """Seen from behind, the wall with its node, its edge and its holes leaves no pixel."""
    wall_and_floor["centroids"] = np.array([[2.0, 1.5, 0.0], [2.0, 1.5, 3.0]])  # far above what is drawn
    wall_and_floor["deficiency_centres"] = np.array([[2.0, 1.5, 3.0]])
    wall_and_floor["deficiency_normals"] = np.array([[0.0, -1.0, 0.0]])

    def marks(side: int) -> list[int]:
        pair = draw_planes_3d(wall_and_floor, side)
        view = corner_view(wall_and_floor, side)
        x, y = (view.pixels(np.array([2.0, 1.5, 3.0])) / SMOOTH + [(620 - view.size[0] // SMOOTH) // 2, 20]).astype(int)
        assert 0 <= y < pair[0].height
        return [int(np.ptp(np.asarray(page)[y - 4 : y + 5, x - 4 : x + 5])) for page in pair]

    wall_and_floor["patch_corners"][0, 2] = 3.0  # a ceiling-high floor keeps that place inside of the picture
    assert min(marks(0)) > 60
    floor_only = {**wall_and_floor, "edges": np.zeros((0, 2), int), "edge_in_tree": np.zeros(0, bool)}
    floor_only["deficiency_centres"], floor_only["deficiency_normals"] = np.zeros((0, 3)), np.zeros((0, 3))
    floor_only["deficiency_areas"] = np.zeros(0)
    for with_marks, without in zip(draw_planes_3d(wall_and_floor, 1), draw_planes_3d(floor_only, 1)):
        np.testing.assert_array_equal(np.asarray(with_marks), np.asarray(without))


def test_a_wall_with_a_doorway_is_two_strokes(wall_and_floor):
    wall = np.ones((20, 10), np.uint8)
    wall[8:13] = 0
    start = wall_and_floor["patch_starts"][1]
    wall_and_floor["patch_bits"] = np.concatenate([wall_and_floor["patch_bits"][:start], np.packbits(wall)])
    ends = sorted(sorted((a[0], b[0])) for a, b in observed_intervals(wall_and_floor, 1))
    np.testing.assert_allclose(ends, [[1.0, 1.8], [2.3, 3.0]], atol=0.051)


def test_an_empty_graph_draws_no_plane(no_planes, make_run):
    plan = make_run().pictures
    for picture in draw_planes_plan(no_planes, plan):
        pixels = np.asarray(picture).astype(int)
        assert np.ptp(pixels, axis=2).max() < 15  # grey throughout
    assert run_planes_3d(no_planes, title="nothing")[0].width > 600


def test_the_more_is_missing_the_darker():
    deficits = [0.0, *style.DEFICIT_BOUNDS]
    lightness = [np.dot(style.deficit_colour(deficit), (0.299, 0.587, 0.114)) for deficit in deficits]
    assert (np.diff(lightness) < -15).all()
    assert style.deficit_colour(1.0) == style.DEFICIT_COLOURS[-1]


def test_the_panels_of_a_stored_page_are_the_drawings(wall_and_floor, make_run, tmp_path):
    plan = make_run().pictures
    for page, drawn in (
        (run_planes_plan(wall_and_floor, plan, title="a run"), draw_planes_plan(wall_and_floor, plan)),
        (run_planes_3d(wall_and_floor, title="a run"), draw_planes_3d(wall_and_floor)),
    ):
        save_with_panels(page[0], tmp_path / "page.png", page[1])
        for stored, panel in zip(stored_panels(tmp_path / "page.png"), drawn, strict=True):
            np.testing.assert_array_equal(np.asarray(stored), np.asarray(panel))
    page[0].save(tmp_path / "without-panels.png")
    assert stored_panels(tmp_path / "without-panels.png") is None
    assert stored_panels(tmp_path / "missing.png") is None


def test_a_large_plan_around_few_planes_is_drawn_smaller(wall_and_floor, make_run):
    plan = {**make_run().pictures, "plan_extent": np.array([500.0, 400.0])}
    view = view_from_above(wall_and_floor, plan)
    assert view.rows[0, 0] * 500 <= 3000 * SMOOTH
    draw_planes_plan(wall_and_floor, plan)


def with_boxes(path, text):
    about = PngInfo()
    about.add_text("asg:panels-2", text)
    Image.new("RGB", (20, 10)).save(path, "PNG", pnginfo=about)


@pytest.mark.parametrize(
    "write",
    [
        lambda path: with_boxes(path, json.dumps([[0, 0, 10**6, 10**6], [0, 0, 2, 2]])),
        lambda path: with_boxes(path, json.dumps([[5, 5, 2, 2], [0, 0, 2, 2]])),
        lambda path: with_boxes(path, "[[0, 0, 1e999, 3]]"),
        lambda path: with_boxes(path, "[" * 100_000),
        lambda path: Image.new("1", (10_000, 10_000)).save(path, "PNG"),
        lambda path: Image.new("RGB", (20, 10)).save(path, "EPS"),
        lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(60)),
        lambda path: path.mkdir(),
    ],
)
def test_a_stored_page_that_is_none_of_ours_is_drawn_again(write, tmp_path):
    write(tmp_path / "page.png")
    assert stored_panels(tmp_path / "page.png") is None
    with_boxes(tmp_path / "ours.png", json.dumps([[0, 0, 10, 10], [10, 0, 20, 10]]))
    assert [panel.size for panel in stored_panels(tmp_path / "ours.png")] == [(10, 10), (10, 10)]
