"""What the numbers of every gain are: for people, since a policy compares candidates with each other only."""

from __future__ import annotations

_SHARE = "share of the image"
_INFORMATION = "per Gaussian of the map"
_SUM = "share of the largest possible, plus weighted information"
_METRES = "m"
_INDEX = "index"

UNITS: dict[str, str] = {
    **dict.fromkeys(("activeinr", "activeinr_proxy"), "share of the uncertain surface"),
    **{f"{name}_{axis}": _METRES for name in ("activeinr", "activeinr_proxy") for axis in "xyz"},
    "activepolicy": _SHARE,
    "activesplat_information": "m3 x opacity",
    "activesplat_region": _INDEX,
    "activesplat_view": "sum of 1 - opacity",
    "activesplat_volume": "m3",
    **{f"{name}_clusters": "clusters" for name in ("anm_s", "anm_s_proxy")},
    **{f"{name}_looks": "views" for name in ("anm_s", "anm_s_proxy")},
    **{f"{name}_facing": "cosine" for name in ("anm_s", "anm_s_proxy")},
    "confidence": "weighted sum of shares",
    "deficiency": "as hole_area",
    **dict.fromkeys(("fisherrf", "gauss_mi"), _SUM),
    **dict.fromkeys(("fisherrf_pure",), _INFORMATION),
    "gauss_mi_pure": "nats, mean over pixels",
    "gs_planner_loss": "weighted error, mean over pixels",
    "gs_planner_volume": "share of the frustum",
    "hgs_coverage": "share",
    "hgs_planner": _SUM,
    "hole_area": "share of the largest possible",
    "in_horizon": "0 or 1",
    "naruto": "sum of uncertainties",
    **{f"naruto_look_{rank}_{axis}": _METRES for rank in range(10) for axis in "xyz"},
    "pixel": _SHARE,
    **{f"popgs_{name}": _SUM for name in ("cov_trace", "info_trace", "logdet", "min_eig")},
    **{f"popgs_{name}_pure": _INFORMATION for name in ("cov_trace", "info_trace", "logdet", "min_eig")},
    **{f"popgs_{name}_block": _SUM for name in ("cov_trace", "logdet")},
    **{f"popgs_{name}_block_pure": _INFORMATION for name in ("cov_trace", "logdet")},
    "rt_guide": "share of the Gaussians, net",
    "rt_guide_cuboid": _INDEX,
    "rt_guide_region": "mean uncertainty",
    "structure": "sum of deficits, 0..1 each",
    "uncovered": _SHARE,
    "unexplored": "share of the voxels",
    "view_angle": "0..1",
    **dict.fromkeys(("visited_distance",), _METRES),
    "voronoi_node": _INDEX,
}
