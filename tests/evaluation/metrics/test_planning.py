import numpy as np
import pytest

from activestructure_gym.evaluation.metrics.planning import ended_frame, first_reaching, late_rate, planning_scores

# Of 200 frames: 0 -> 40 -> 80 -> 90 % at frames 0, 50, 100, 200; PSNR and depth error beside it.
CURVE = [
    {"frames": 0, "observed": 0.0, "psnr": 10.0, "depth_l1_cm": 50.0},
    {"frames": 50, "observed": 40.0, "psnr": 14.0, "depth_l1_cm": 30.0},
    {"frames": 100, "observed": 80.0, "psnr": 18.0, "depth_l1_cm": 20.0},
    {"frames": 200, "observed": 90.0, "psnr": 21.0, "depth_l1_cm": 12.0},
]


def test_numbers_of_a_curve_worked_by_hand():
    scores, notes = planning_scores(CURVE, 200)
    assert scores["frames_to_80"] == 100.0  # on a point
    assert scores["frames_to_85"] == 150.0  # between two
    assert scores["frames_to_90"] == 200.0
    assert scores["frames_to_95"] is None and notes == {"frames_to_95": "> 200 frames: 90.0 % observed"}
    # Trapezoids of 50, 50 and 100 frames, mean heights 20, 60 and 85: (1000 + 3000 + 8500) / 200.
    assert scores["observed_area"] == pytest.approx(62.5)
    assert scores["late_psnr_rate"] == pytest.approx(3.0)
    assert scores["late_depth_rate"] == pytest.approx(-8.0)


def test_an_episode_that_ends_early_keeps_what_it_saw_and_is_paid_for_its_own_frames():
    scores, notes = planning_scores(CURVE[:3], 160)
    # 1000 + 3000 up to frame 100, then 60 frames at 80 %.
    assert scores["observed_area"] == pytest.approx((4000 + 4800) / 160)
    # From 16.4 dB at frame 80 to 18 at frame 100.
    assert scores["late_psnr_rate"] == pytest.approx(8.0)
    assert "frames_to_85" in notes and "late_psnr_rate" not in notes


def test_without_late_frames_or_without_what_was_observed_nothing_is_made_up():
    scores, notes = planning_scores(CURVE[:3], 200)
    assert scores["late_psnr_rate"] is None and notes["late_psnr_rate"] == "no points of the curve after 100 frames"
    scores, notes = planning_scores([{"frames": p["frames"], "psnr": p["psnr"]} for p in CURVE], 200)
    assert scores["observed_area"] is None and scores["frames_to_80"] is None and scores["late_depth_rate"] is None
    assert scores["late_psnr_rate"] == pytest.approx(3.0)
    assert notes["frames_to_80"] == notes["observed_area"] == "no curve of it"


def test_the_first_crossing_counts_and_a_start_above_costs_its_own_frames():
    frames, share = np.array([1.0, 11.0, 21.0]), np.array([50.0, 90.0, 88.0])
    assert first_reaching(frames, share, 85.0) == pytest.approx(1.0 + 10.0 * 35.0 / 40.0)
    assert first_reaching(frames, share, 50.0) == 1.0
    assert first_reaching(frames[:0], share[:0], 50.0) is None


def test_a_straight_line_has_its_own_slope_wherever_its_points_stand():
    rng = np.random.default_rng(0)
    frames = np.sort(rng.choice(400, 30, replace=False)).astype(float)
    assert late_rate(frames, 7.0 + 0.03 * frames, 300) == pytest.approx(3.0)


MOVED = [[11, 11, 0], [21, 21, 0]]  # two decisions of ten frames; the path begins with one pose


@pytest.mark.parametrize(
    "after, ended",
    [
        ([], 21),  # no candidate left before the budget
        ([[101, 100, 0]], None),  # the budget ends a movement
        ([[26, 26, 1], [31, 31, 1], [100, 100, 1]], 21),  # optimisation in place until the budget repeats the pose
        ([[26, 26, 1], [36, 36, 0], [41, 41, 1]], 36),  # a movement after a stay
        ([[21, 21, 0], [21, 21, 0]], 21),  # a switch of stages, then the row that ends the episode
    ],
)
def test_a_policy_has_ended_at_its_last_movement_if_it_only_stays_afterwards(after, ended):
    assert ended_frame(np.array([*MOVED, *after]), 100) == ended


def test_a_policy_without_any_movement_has_no_last_one():
    assert ended_frame(np.array([[6, 6, 1], [11, 11, 1]]), 100) is None
    assert ended_frame(np.zeros((0, 3), int), 100) is None
