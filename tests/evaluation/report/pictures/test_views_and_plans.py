import numpy as np
import pytest
from PIL import Image

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import corner_label, paste_framed, text_width, tile_grid
from activestructure_gym.evaluation.report.pictures.floor_plan import FILLS, camera_height_text, draw_plan, plan_scale
from activestructure_gym.evaluation.report.pictures.views_and_plans import (
    compare_plans,
    compare_strip,
    compare_views,
    detailed_views,
    run_plan,
    run_views,
    typical_view,
)


def contains(page: Image.Image, tile: np.ndarray) -> bool:
    """Whether the tile stands somewhere on the page, pixel for pixel."""
    whole, (height, width) = np.asarray(page), tile.shape[:2]
    starts = np.argwhere((whole[: whole.shape[0] - height + 1, : whole.shape[1] - width + 1] == tile[0, 0]).all(axis=2))
    return any((whole[y : y + height, x : x + width] == tile).all() for y, x in starts)


def test_true_views_are_shown_pixel_for_pixel(make_run):
    run = make_run()
    page = run_views(run, title="title")
    for tile in run.pictures["true"]:
        assert contains(page, tile)
    # The rendered ones carry their PSNR in the lower right corner; the upper left is untouched.
    assert contains(page, run.pictures["rendered"][0][:4, :10])


def test_every_policy_is_compared_on_the_same_views(make_run):
    runs = [make_run(policy="a"), make_run(policy="b", seed=1)]
    page = compare_views(runs, title="title")
    assert contains(page, runs[0].pictures["true"][1])
    assert contains(page, runs[0].pictures["rendered"][1][:4, :10])
    assert contains(page, runs[1].pictures["rendered"][1][:4, :10])


def test_blank_views_are_not_shown_while_there_are_others(rng):
    true = rng.integers(100, 156, (6, 20, 30, 3), dtype=np.uint8)
    true[1], true[4] = 255, 7
    assert detailed_views(true) == [0, 2, 3, 5]
    assert detailed_views(true[:2]) == [0, 1]


def test_the_plan_stands_north_up_and_in_scale(make_run):
    run = make_run()
    plan = draw_plan(run.pictures, run.trajectory)
    scale = plan_scale(run.pictures["plan_extent"])
    assert plan.size == (round(5.0 * scale), round(4.0 * scale))
    pixels = np.asarray(plan).astype(int)

    def at(x: float, y: float) -> np.ndarray:  # world metres
        return pixels[int(plan.height - y * scale), int(x * scale)]

    np.testing.assert_allclose(at(1.0, 1.0), style.START, atol=3)
    np.testing.assert_allclose(at(4.0, 1.0), style.END, atol=3)
    np.testing.assert_allclose(at(3.0, 3.0), style.FREE, atol=3)
    np.testing.assert_allclose(at(0.2, 3.8), style.UNKNOWN, atol=3)
    np.testing.assert_allclose(at(2.2, 2.0), style.OCCUPIED, atol=3)
    assert np.abs(at(2.53, 1.0) - style.path_colour(0.5)).max() < 40


def test_a_gap_in_the_map_can_be_told_from_paper_and_from_what_nobody_saw():
    colours = [np.array(colour, float) for colour in (*FILLS.values(), style.PAPER)]
    apart = [np.abs(a - b).max() for k, a in enumerate(colours) for b in colours[:k]]
    assert min(apart) >= 50 and all("map" in name for name in list(FILLS)[1:])


def test_how_high_the_camera_flew_is_said_above_the_floor_that_was_seen(make_run):
    run = make_run(planes=True)
    run.trajectory["world_from_camera"][:, 2, 3] = np.linspace(1.31, 1.52, 20)
    assert "1.3 to 1.5 m above the floor" in camera_height_text([(run.trajectory, run.graph)])
    run.graph["centroids"][0, 2] = -1.0
    assert "2.3 to 2.5 m above the floor" in camera_height_text([(run.trajectory, run.graph)])
    assert "1.3 to 1.5 m in z" in camera_height_text([(run.trajectory, run.graph), (run.trajectory, None)])
    run.trajectory["world_from_camera"][:, 2, 3] = 1.5
    assert "1.5 m in z" in camera_height_text([(run.trajectory, None)])
    assert run_plan(run.pictures, run.trajectory, run.graph, title="t").width > 600  # the words have room


def test_the_first_picture_is_the_typical_view_and_the_plans(make_run):
    runs = [make_run(policy="a"), make_run(policy="b")]
    runs[0].pictures["psnr"] = np.array([30.0, 10.0, 20.0, 9.0])
    runs[1].pictures["psnr"] = np.array([20.0, 10.0, 0.0, 25.0])  # means 25, 10, 10, 17
    assert typical_view(runs) == 2
    blank = [make_run(policy="a")]
    blank[0].pictures["true"][1:3] = 200
    blank[0].pictures["true"] = np.concatenate([blank[0].pictures["true"]] * 2)
    blank[0].pictures["psnr"] = np.array([9.0, 11.0, 11.0, 13.0, 10.0, 11.0, 11.0, 12.0])  # 1, 2, 5 and 6 are bare
    assert typical_view(blank) == 4
    page = compare_strip(runs, title="title")
    assert contains(page, runs[0].pictures["true"][2]) and contains(page, runs[1].pictures["rendered"][2][:4, :10])


def test_large_scenes_are_drawn_smaller():
    assert plan_scale(np.array([64.0, 20.0])) == 10.0
    assert plan_scale(np.array([2.0, 3.0])) == 90.0


def test_plans_of_different_size_stand_side_by_side(make_run):
    small, large = make_run(policy="a"), make_run(policy="b")
    large.pictures["plan_extent"] = np.array([6.0, 5.0])
    page = compare_plans([small, large], title="title")
    assert page.width > 2 * 540 and page.height > 450


def test_plans_of_a_closet_leave_room_for_their_labels(make_run):
    runs = [make_run(policy=name) for name in ("a" * 80, "b" * 80)]
    for run in runs:
        run.pictures["plan_extent"] = np.array([1.2, 1.2])
    page = compare_plans(runs, title="title")
    assert page.width > sum(text_width(f"{run.policy}: 100 frames, 12.0 m", 14) for run in runs)


def test_path_colours_rise_in_lightness():
    grey = [np.dot(style.path_colour(share), (0.299, 0.587, 0.114)) for share in np.linspace(0, 1, 21)]
    assert (np.diff(grey) > 0).all()
    assert style.path_colour(-1) == style.path_colour(0) and style.path_colour(2) == style.path_colour(1)


def test_labels_and_frames_stay_where_they_belong():
    tile = Image.new("RGB", (60, 40), (200, 10, 10))
    corner_label(tile, "9.9")
    pixels = np.asarray(tile)
    assert (pixels[:10, :10] == (200, 10, 10)).all() and not (pixels[-3, -3] == (200, 10, 10)).all()
    page = Image.new("RGB", (80, 60), (255, 255, 255))
    paste_framed(page, tile, (10, 10))
    np.testing.assert_array_equal(np.asarray(page)[10:50, 10:70], pixels)


def test_a_long_title_is_not_cut():
    page = tile_grid([[Image.new("RGB", (40, 30))]], title="a title much longer than the only tile is wide")
    assert page.width > 400


@pytest.mark.parametrize("index", [0, 7, 8, 100])
def test_there_is_a_colour_for_any_number_of_policies(index):
    assert style.colour(index).startswith("#")
