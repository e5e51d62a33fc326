import numpy as np

from activestructure_gym.evaluation.report.curves import band, curve_of, plot_convergence, policy_curves


def test_turning_in_place_costs_no_metres_so_the_last_value_counts(make_run):
    run = make_run()
    run.metrics["curve"][:] = [
        {"frames": 1, "metres": 0.0, "psnr": 5.0},
        {"frames": 9, "metres": 0.0, "psnr": 7.0},
        {"frames": 20, "metres": 2.0, "psnr": 8.0},
    ]
    np.testing.assert_array_equal(curve_of(run, "metres", "psnr"), [[0.0, 2.0], [7.0, 8.0]])
    np.testing.assert_array_equal(curve_of(run, "frames", "psnr"), [[1, 9, 20], [5, 7, 8]])


def test_the_band_ends_where_the_shortest_run_ends():
    grid, mean, low, high = band(
        [(np.array([0.0, 10.0]), np.array([0.0, 10.0])), (np.array([1.0, 5.0]), np.array([3.0, 3.0]))]
    )
    assert (grid[0], grid[-1]) == (1.0, 5.0)
    np.testing.assert_allclose([mean[0], low[0], high[0]], [2.0, 1.0, 3.0])
    np.testing.assert_allclose([mean[-1], low[-1], high[-1]], [4.0, 3.0, 5.0])


def test_with_several_scenes_a_curve_is_one_seeds_mean_over_them(make_run):
    runs = [make_run("room", seed=0), make_run("box", seed=0), make_run("room", seed=1), make_run("box", seed=1)]
    curves = policy_curves(runs, "frames", "psnr")
    assert len(curves) == 2
    np.testing.assert_allclose([y[-1] for _, y in curves], [13.0, 14.0])


def test_the_figure_is_written(make_run, tmp_path):
    runs = [make_run(policy=policy, seed=seed) for policy in ("a", "b") for seed in range(2)]
    plot_convergence(runs, tmp_path / "curve.png", title="Convergence")
    from PIL import Image

    with Image.open(tmp_path / "curve.png") as image:
        assert min(image.size) > 600
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
    for colour in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)):  # both policies' lines
        assert (np.abs(pixels.astype(int) - colour).max(axis=1) < 8).sum() > 500
