import numpy as np
import pytest

from activestructure_gym.evaluation.metrics.image import depth_l1, psnr, ssim


def pair(rng, shape=(48, 64, 3), noise=0.1):
    true = rng.uniform(size=shape)
    return np.clip(true + rng.normal(scale=noise, size=shape), 0, 1), true


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.4])
def test_ssim_equals_scikit_image(rng, noise):
    metrics = pytest.importorskip("skimage.metrics")
    rendered, true = pair(rng, noise=noise)
    expected = metrics.structural_similarity(
        rendered, true, channel_axis=-1, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    assert ssim(rendered, true) == pytest.approx(expected, abs=1e-12)


def test_psnr_equals_scikit_image(rng):
    metrics = pytest.importorskip("skimage.metrics")
    rendered, true = pair(rng)
    assert psnr(rendered, true) == pytest.approx(metrics.peak_signal_noise_ratio(true, rendered, data_range=1.0))


def test_psnr_pools_the_channels():
    # One channel off by 0.3: pooled MSE = 0.09 / 3 = 0.03, so 15.23 dB. The mean over channels would be infinite.
    true = np.zeros((4, 4, 3))
    rendered = true.copy()
    rendered[..., 0] = 0.3
    assert psnr(rendered, true) == pytest.approx(-10 * np.log10(0.03))


def test_equal_images_reach_the_ceiling(rng):
    _, true = pair(rng)
    assert psnr(true, true) == 100.0
    assert ssim(true, true) == pytest.approx(1.0)


def test_ssim_refuses_images_without_a_whole_window(rng):
    with pytest.raises(ValueError, match="11 x 11"):
        ssim(*pair(rng, shape=(10, 64, 3)))
    with pytest.raises(ValueError, match="one shape"):
        ssim(np.zeros((20, 20, 3)), np.zeros((20, 21, 3)))


def test_depth_error_counts_holes_in_full_and_ignores_open_windows():
    true = np.array([[2.0, 2.0], [4.0, 0.0]])
    rendered = np.array([[2.1, 0.0], [4.0, 7.0]])
    assert depth_l1(rendered, true) == pytest.approx((0.1 + 2.0 + 0.0) / 3)
    assert depth_l1(rendered, np.zeros((2, 2))) is None
