import numpy as np
import pytest
import torch

from activestructure_gym.splatting import ssim_and_gradient


def _pair(shape, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.random(shape, dtype=np.float32)
    return x, np.clip(x + rng.normal(0, 0.2, shape), 0, 1).astype(np.float32)


def _ssim_torch(x, y):
    taps = torch.exp(-0.5 * ((torch.arange(11, dtype=torch.float64) - 5) / 1.5) ** 2)
    window = torch.outer(taps, taps) / taps.sum() ** 2

    def blur(values):
        return torch.nn.functional.conv2d(values.permute(2, 0, 1)[:, None], window[None, None], padding=5)

    mx, my = blur(x), blur(y)
    numerator = (2 * mx * my + 0.01**2) * (2 * (blur(x * y) - mx * my) + 0.03**2)
    return (numerator / ((mx**2 + my**2 + 0.01**2) * (blur(x * x) - mx**2 + blur(y * y) - my**2 + 0.03**2))).mean()


@pytest.mark.parametrize("shape", [(50, 70, 3), (1, 1, 3), (7, 40, 3), (64, 64, 3), (33, 3, 3), (9, 700, 3)])
def test_value_and_gradient_against_float64_autograd(shape):
    x, y = _pair(shape)
    leaf = torch.tensor(x, dtype=torch.float64, requires_grad=True)
    expected = _ssim_torch(leaf, torch.tensor(y, dtype=torch.float64))
    (by_leaf,) = torch.autograd.grad(expected, leaf)
    value, gradient = ssim_and_gradient(x, y)
    assert value == pytest.approx(expected.item(), abs=2e-6)
    assert np.linalg.norm(gradient - by_leaf.numpy()) <= 2e-5 * by_leaf.norm().item()


def test_threads_do_not_change_a_bit():
    # every number of threads cuts the picture into other strips
    x, y = _pair((21, 300, 3))
    value, gradient = ssim_and_gradient(x, y, threads=1)
    for threads in (2, 3, 7):
        again, by_image = ssim_and_gradient(x, y, threads=threads)
        assert again == value
        np.testing.assert_array_equal(by_image, gradient)


def test_interior_agrees_with_scikit_image():
    from skimage.metrics import structural_similarity

    x, y = _pair((60, 60, 3))
    # Away from the border padding plays no role: compare the mean over a crop through two oversized images that differ
    # only there. skimage gives the whole map; ours gives means, so equal pixels outside contribute exactly 1.
    y[:20], y[40:], y[:, :20], y[:, 40:] = x[:20], x[40:], x[:, :20], x[:, 40:]
    expected = structural_similarity(
        x.astype(np.float64), y.astype(np.float64), channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )[1]  # fmt: skip
    value, _ = ssim_and_gradient(x, y)
    assert value == pytest.approx(expected.mean(), abs=2e-6)
    assert value < 0.99


def test_equal_images_score_one():
    x, _ = _pair((20, 30, 3))
    value, gradient = ssim_and_gradient(x, x)
    assert value == pytest.approx(1.0, abs=1e-6)
    assert np.abs(gradient).max() < 1e-6
    with pytest.raises(ValueError, match="one size"):
        ssim_and_gradient(x, x[:5])
