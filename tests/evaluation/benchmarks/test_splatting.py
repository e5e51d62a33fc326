import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.benchmarks.splatting import count_work, run_splatting_benchmark
from activestructure_gym.evaluation.benchmarks.workload import make_workload
from activestructure_gym.splatting import LossWeights, kernels, mapping_step, render, render_depth_alpha, scoring


def test_workloads_are_real_and_repeatable():
    work, again = make_workload("W1"), make_workload("W1")
    assert work.count == 20_000 and np.array_equal(work.parameters, again.parameters)
    rendering = render(work.parameters, work.count, work.camera, work.poses[0])
    # Seeded from the view itself: it must look like the target, before any optimisation.
    covered = rendering.alpha > 0.8
    assert covered.mean() > 0.6
    assert np.abs(rendering.color - work.target_rgb)[covered].mean() < 0.1
    error = np.abs(rendering.depth[covered] / rendering.alpha[covered] - work.target_depth[covered])
    assert np.median(error) < 0.05


def test_same_bits_for_any_number_of_threads_on_a_whole_workload():
    # Long enough phases for the other threads to take part: 20 chunks, 20 tiles, 15 groups of rows.
    work, rates = make_workload("W1"), np.full(14, 1e-3, np.float32)
    results = []
    for threads in (1, 2, 3):
        parameters = work.parameters.copy()
        first, second = np.zeros_like(parameters), np.zeros_like(parameters)
        losses = [
            mapping_step(
                parameters, first, second, work.count, work.camera, pose, work.target_rgb, work.target_depth,
                weights=LossWeights(), learning_rates=rates, threads=threads,
            )
            for pose in work.poses
        ]  # fmt: skip
        scores = render_depth_alpha(parameters, work.count, work.camera, work.poses, threads=threads)
        results.append((losses, parameters, first, second, *scores))
    for other in results[1:]:
        assert other[0] == results[0][0]
        assert all(np.array_equal(a, b) for a, b in zip(other[1:], results[0][1:]))


@pytest.mark.slow
def test_rows_of_the_benchmark():
    lines = []
    rows = run_splatting_benchmark(["W4"], repeats=2, threads=(1, 2), baseline=False, progress=lines.append)
    assert [(row["task"], row["threads"]) for row in rows] == [("score 64 views", 1), ("score 64 views", 2)]
    assert all(0 < row["low_ms"] <= row["median_ms"] <= row["high_ms"] for row in rows)
    assert all(0 < row["floor_share"] < 1 and np.isnan(row["vs_torch"]) for row in rows)
    assert rows[0]["vs_one"] == 1.0 and rows[1]["vs_one"] == rows[0]["median_ms"] / rows[1]["median_ms"]
    assert lines == ["splatting workload W4"]
    with pytest.raises(InputError, match="W3"):
        run_splatting_benchmark(["W33"])


@pytest.mark.slow
def test_scoring_is_measured_against_torch():
    own, torch = run_splatting_benchmark(["W4"], repeats=1, threads=(1,))
    assert torch["task"] == "score 64 views, torch" and np.isnan(torch["floor_share"])
    assert own["vs_torch"] == pytest.approx(torch["median_ms"] / own["median_ms"])


def test_an_iteration_is_measured_against_torch_and_through_autograd():
    rows = run_splatting_benchmark(["W1"], repeats=1, threads=(1,))
    assert all(row["floor_share"] != row["floor_share"] for row in rows if row["task"].endswith(", torch"))
    ratios = {row["task"]: row["vs_torch"] for row in rows}
    assert [task for task, ratio in ratios.items() if ratio == ratio] == [
        "iteration, L1", "iteration, L1 + SSIM", "iteration, L1, through autograd"
    ]  # fmt: skip
    alone = run_splatting_benchmark(["W1"], repeats=1, threads=(1,), baseline=False)
    assert {row["task"] for row in alone} == set(ratios) - {"iteration, L1, through autograd", "iteration, L1, torch"}


@pytest.mark.parametrize("name, count, visible, per_pixel", [("W1", 20_000, 6_670, 15.2), ("W4", 50_000, None, 14.7)])
def test_workloads_ask_for_as_much_as_those_of_the_prototypes(name, count, visible, per_pixel):
    work = make_workload(name)
    counts = np.array([count_work(work, pose) for pose in (work.poses[:1] if name == "W1" else work.poses[::8])])
    assert work.count == count
    assert counts[:, 1].mean() / work.target_depth.size == pytest.approx(per_pixel, rel=0.1)
    assert visible is None or counts[:, 0].mean() == pytest.approx(visible, rel=0.1)


def test_one_compiled_version_of_every_kernel():
    # A second signature (read-only or strided input that slipped through) would cost seconds in the middle of a run.
    work = make_workload("W1")
    moments, target = np.zeros((2, *work.parameters.shape), np.float32), work.target_rgb.copy()
    target.flags.writeable = False
    mapping_step(
        work.parameters, *moments, work.count, work.camera, work.poses[0], target, work.target_depth,
        weights=LossWeights(), learning_rates=np.zeros(14, np.float32),
    )  # fmt: skip
    pixelwise = LossWeights(l1_share=1.0)
    mapping_step(
        work.parameters, *moments, work.count, work.camera, work.poses[0], target, work.target_depth, weights=pixelwise,
        learning_rates=np.zeros(14, np.float32),
    )  # fmt: skip
    render_depth_alpha(work.parameters, work.count, work.camera, work.poses[:1])
    frozen = work.parameters[:, :100].copy()
    frozen.flags.writeable = False
    render(frozen, 100, work.camera, work.poses[0])
    render(work.parameters[:, ::2], 100, work.camera, work.poses[0])
    for name in ("prepare", "blend", "compare", "unblend", "fuse"):
        assert len(getattr(kernels, name).signatures) == 1, name
    assert len(scoring.score.signatures) == len(scoring.shape.signatures) == 1


def test_kernels_compile_where_no_cache_can_be_written(monkeypatch):
    from numba import njit
    from numba.core import caching

    from activestructure_gym.compiling import files, kernel

    for name in ("CacheImpl", "_CacheImpl"):  # the name differs between versions of numba
        if hasattr(caching, name):
            monkeypatch.setattr(getattr(caching, name), "_locator_classes", [])

    def double(x):
        return 2 * x

    with pytest.raises(RuntimeError, match="cannot cache"):
        njit(cache=True)(double)
    monkeypatch.setattr(files, "not_kept", [])
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        assert kernel(double)(21) == 42


def test_torch_tiles_and_the_kernel_agree_on_a_whole_workload():
    import torch

    from activestructure_gym.evaluation.benchmarks.torch_tiles import rasterize_torch_tiles
    from activestructure_gym.geometry import invert_rigid

    work = make_workload("W1")
    live = torch.from_numpy(work.parameters[:, : work.count])
    pose = torch.from_numpy(invert_rigid(work.poses[0]).astype(np.float32))
    with torch.no_grad():
        picture = rasterize_torch_tiles(live[:3].T, live[3:7].T, live[7:10].T, live[10], live[11:].T, pose, work.camera)
    rendering = render(work.parameters, work.count, work.camera, work.poses[0], centre_depth=True)
    # 20,000 Gaussians in several chunks and tiles; float32 on both sides, so a few pixels may cross a threshold, and on
    # a wall seen head-on neighbours at one depth may change places, which moves colour but neither alpha nor depth.
    difference = np.abs(picture[..., 4].numpy() - rendering.alpha)
    assert np.quantile(difference, 0.99) < 2e-5 and difference.max() < 0.02
    assert np.quantile(np.abs(picture[..., 3].numpy() - rendering.depth), 0.99) < 1e-4
    difference = np.abs(picture[..., :3].numpy() - rendering.color)
    assert np.quantile(difference, 0.9) < 2e-5 and difference.max() < 0.1
