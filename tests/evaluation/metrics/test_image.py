import numpy as np
import pytest

from activestructure_gym.evaluation.metrics.image import (
    channel_psnr,
    depth_l1,
    halved,
    ms_ssim,
    psnr,
    similarities,
    ssim,
)


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


@pytest.mark.parametrize("shape, noise", [((161, 200, 3), 0.05), ((180, 320, 3), 0.3), ((163, 171, 3), 0.1)])
def test_ms_ssim_equals_pytorch_msssim(rng, shape, noise):
    torch = pytest.importorskip("torch")
    oracle = pytest.importorskip("pytorch_msssim")
    smooth = np.linspace(0, 1, shape[1])[None, :, None] * np.linspace(1, 0.2, shape[0])[:, None, None]
    true = np.clip(np.broadcast_to(smooth, shape) + rng.normal(scale=0.03, size=shape), 0, 1)
    rendered = np.clip(true + rng.normal(scale=noise, size=shape), 0, 1)
    # Its window is rounded to single precision.
    first, second = (torch.tensor(image).permute(2, 0, 1)[None] for image in (rendered, true))
    assert ms_ssim(rendered, true) == pytest.approx(float(oracle.ms_ssim(first, second, data_range=1.0)), abs=1e-5)
    single = float(oracle.ssim(first, second, data_range=1.0))
    assert ssim(rendered, true) == pytest.approx(single, abs=1e-5)


def test_ms_ssim_needs_161_pixels(rng):
    image = rng.uniform(size=(160, 300, 3))
    assert ms_ssim(image, image) is None
    assert similarities(image, image) == (pytest.approx(1.0), None)


@pytest.mark.parametrize("shape", [(6, 8, 3), (7, 9, 3), (6, 9, 1)])
def test_halving_equals_torch(rng, shape):
    functional = pytest.importorskip("torch.nn.functional")
    import torch

    image = rng.uniform(size=shape)
    padding = [side % 2 for side in shape[:2]]
    expected = functional.avg_pool2d(torch.tensor(image).permute(2, 0, 1)[None], 2, padding=padding)
    np.testing.assert_allclose(halved(image), expected[0].permute(1, 2, 0).numpy(), atol=1e-15)


def test_psnr_by_channel_is_blind_to_one_bad_channel():
    # 0.1, 0.1 and 0.4 off: 20, 20 and 7.96 dB; pooled MSE = (0.01 + 0.01 + 0.16) / 3 = 0.06, 12.22 dB.
    true = np.zeros((4, 4, 3))
    rendered = true + [0.1, 0.1, 0.4]
    assert channel_psnr(rendered, true) == pytest.approx((20 + 20 - 10 * np.log10(0.16)) / 3)
    assert psnr(rendered, true) == pytest.approx(-10 * np.log10(0.06))


@pytest.mark.parametrize("measure", [psnr, ssim, ms_ssim])
def test_whole_numbers_are_refused(rng, measure):
    image = rng.integers(0, 256, (192, 192, 3), np.uint8)
    with pytest.raises(ValueError, match=r"floats in \[0, 1\], got uint8: divide 0 to 255 by 255"):
        measure(image, image)
    assert measure(image / 255.0, image / 255.0) > 0.999
