"""Gains: one number per candidate view, computed from the current reconstruction only.

A gain is a function ``gain(context) -> [K]`` registered by name, one file each::

    @GAINS.register("mine")
    def mine(context):
        return (1 - context.alpha).mean(axis=(1, 2))

The env evaluates the gains it is asked for (``gains=("pixel", "mine")``); ``"package.module:function"`` works as a
name without registering, in every worker process.
"""

from activestructure_gym.features import activeinr, anm_s  # noqa: F401  several columns each
from activestructure_gym.features.activepolicy import activepolicy
from activestructure_gym.features.activesplat import (
    activesplat_information,
    activesplat_region,
    activesplat_view,
    activesplat_volume,
)
from activestructure_gym.features.base import GAINS, Gain, GainContext, evaluate_gains
from activestructure_gym.features.confidence import confidence
from activestructure_gym.features.deficiency import deficiency
from activestructure_gym.features.fisherrf import fisherrf
from activestructure_gym.features.gauss_mi import gauss_mi
from activestructure_gym.features.gs_planner import gs_planner_loss, gs_planner_volume
from activestructure_gym.features.hgs_planner import hgs_coverage, hgs_planner
from activestructure_gym.features.hole_area import hole_area
from activestructure_gym.features.in_horizon import in_horizon
from activestructure_gym.features.naruto import naruto
from activestructure_gym.features.pixel import pixel
from activestructure_gym.features.popgs import popgs_cov_trace, popgs_info_trace, popgs_logdet, popgs_min_eig
from activestructure_gym.features.popgs_block import popgs_cov_trace_block, popgs_logdet_block
from activestructure_gym.features.rt_guide import rt_guide, rt_guide_cuboid, rt_guide_region
from activestructure_gym.features.structure import structure
from activestructure_gym.features.uncovered import uncovered
from activestructure_gym.features.unexplored import unexplored
from activestructure_gym.features.view_angle import view_angle
from activestructure_gym.features.visited_distance import visited_distance
from activestructure_gym.features.voronoi_node import floor_graph, voronoi_node

__all__ = [
    "GAINS",
    "Gain",
    "GainContext",
    "activepolicy",
    "activesplat_information",
    "activesplat_region",
    "activesplat_view",
    "activesplat_volume",
    "confidence",
    "deficiency",
    "evaluate_gains",
    "fisherrf",
    "floor_graph",
    "gauss_mi",
    "gs_planner_loss",
    "gs_planner_volume",
    "hgs_coverage",
    "hgs_planner",
    "hole_area",
    "in_horizon",
    "naruto",
    "pixel",
    "popgs_cov_trace",
    "popgs_cov_trace_block",
    "popgs_info_trace",
    "popgs_logdet",
    "popgs_logdet_block",
    "popgs_min_eig",
    "rt_guide",
    "rt_guide_cuboid",
    "rt_guide_region",
    "structure",
    "uncovered",
    "unexplored",
    "view_angle",
    "visited_distance",
    "voronoi_node",
]
