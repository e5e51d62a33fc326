"""List the kernels that a first comparison compiles, which gives the total for its progress display."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

# Kernels that `warmup` compiles for any policy, by module without the package's name. A slow test compiles them all.
_ALWAYS = {
    "envs.reward": "_mark_seen",
    "evaluation.metrics.fusion_kernels": (
        "_add_free_space _add_row _cut _with_neighbours areas_of integrate mark_blocks range_of_tiles span triangles"
    ),
    "evaluation.metrics.nearest": "_box_distance _build _search _squared",
    "evaluation.metrics.windows": "_compare _down _first _next _products _window_sums",
    "evaluation.protocols.activegamer": "_mask",
    "features.hole_area": "_march",
    "geometry.depth_noise": "axial_sigma",
    "geometry.rotations": "_quaternions",
    "mapping.surface_boundaries": "_boundary_offsets _is_behind",
    "mapping.boxes": "renew_boxes",
    "mapping.density": "_choose _depth_at _means_in_view _on_plane _parts _sample _textured bucket same_surface",
    "mapping.occlusion_culling": "_farthest behind_the_measured",
    "mapping.map_passes": "faces_away too_wide unfit",
    "mapping.frustum_culling": "_reaches",
    "motion.clearance": "_first_blocked_edge",
    "motion.reachability": "_best_corner _lengths_at _spread",
    "motion.rrt": "_grow _measure _shorten _skip_vertices",
    "motion.trajectory": "_limit_turns _short_way _within",
    "planes.detection_kernels": (
        "_coplanar_gap _square_distance add_point block_moments explained_shares fit_planes grow_regions "
        "merge_coplanar noise refine_pixels refit segment_areas segment_moments spread_points"
    ),
    "planes.matching_kernels": "depth_gaps qualifying",
    "planes.quality_kernels": "_may_touch edge_sides open_sides tile_holes",
    "planes.sparseness": "_bits _coarse_tiles _mark _rank _spread",
    "planes.surface_kernels": "_lift cell_of count_hits image_sums join look_up_cells",
    "sensors.raycast": "_pixel_rays",
    "sensors.shading": "_displayed _wrapped_texel shade_pixels",
    "splatting.kernels": "blend compare prepare score shape unblend",
    "splatting.passes": "_median",
    "splatting.surface_depth": "_densest",
    "views.visibility": "_visible_cosines",
    "volume.depth_image": "_fill_pyramid",
    "volume.distance_field": (
        "_across_columns _along_columns _bounding_box join_distances sample sample_points segment_above "
        "segments_above sight_line"
    ),
    "volume.integration": "_nearest_in_footprint carve mark_hits",
}
_OURS = __name__.partition(".")[0]


def kernels_of(features: Sequence[str]) -> set[str]:
    """Return the names of the kernels that a comparison with these features compiles."""
    from activestructure_gym.features import FEATURES

    names = {f"{_OURS}.{module}.{name}" for module, of_module in _ALWAYS.items() for name in of_module.split()}
    return names.union(*(_kernels_in(FEATURES.get(FEATURES.owner(name)).__module__) for name in features))


def _kernels_in(module: str) -> set[str]:
    """Return the names of the kernels that a module of this package defines."""
    from activestructure_gym.compiling.decorator import name_of

    found = [thing for thing in vars(sys.modules[module]).values() if hasattr(thing, "py_func")]
    return {name for name in map(name_of, found) if name.startswith(f"{module}.")}


def not_compiled(names: Iterable[str], files: Iterable[Path]) -> set[str]:
    """Return the kernels among ``names`` without a file of compiled code among ``files``."""
    kept = {_parts(file) for file in files}
    return {name for name in names if tuple(name.split(".")[-3:]) not in kept}


def _parts(file: Path) -> tuple[str, str, str]:
    """Return package, module and function of a file of a compiled kernel.

    A file is named MODULE.FUNCTION-LINE.VERSION.DIGEST.kernel and is in PACKAGE/__pycache__ or in PACKAGE_DIGEST.
    """
    folder = file.parent.parent.name if file.parent.name == "__pycache__" else file.parent.name.rpartition("_")[0]
    module, _, rest = file.name.partition(".")
    return folder, module, rest.partition("-")[0]
