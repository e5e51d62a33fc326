"""Report which implementations of the rasteriser can run here."""

from __future__ import annotations

import functools
import importlib.util
from typing import Literal, get_args

Backend = Literal["cpu", "gsplat", "reference"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)


def backend_status() -> dict[str, str]:
    """Return for every backend ``"works"`` or one sentence on what is missing (shown by ``asg doctor``)."""
    return {"cpu": "works", "gsplat": _gsplat_status(), "reference": "works"}


@functools.cache
def _gsplat_status() -> str:
    """Test gsplat by rendering one Gaussian.

    Importing gsplat succeeds without a compiler or CUDA device.
    """
    if importlib.util.find_spec("gsplat") is None:
        return "package gsplat is missing: pip install 'activestructure-gym[gpu]'"
    import torch

    if not torch.cuda.is_available():
        return "no CUDA device is visible to torch"
    from activestructure_gym.geometry import PinholeCamera
    from activestructure_gym.splatting.gsplat_backend import rasterize_gsplat

    try:
        device = torch.device("cuda")
        color, _, _, _ = rasterize_gsplat(
            torch.tensor([[0.0, 0.0, 1.0]], device=device),
            torch.tensor([[1.0, 0.0, 0.0, 0.0]], device=device),
            torch.full((1, 3), -2.0, device=device),
            torch.full((1,), 3.0, device=device),
            torch.ones((1, 3), device=device),
            torch.eye(4, device=device)[None],
            PinholeCamera.from_size(16, 16),
        )
    except Exception as error:  # a missing compiler, driver or wheel causes errors of many types
        return f"gsplat cannot render: {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
    return "works" if bool(color[0, 8, 8, 0] > 0.5) else "gsplat renders a black picture"
