"""Gains: one number per candidate view, computed from the current reconstruction only.

A gain is a function ``gain(context) -> [K]`` registered by name, one file each::

    @GAINS.register("mine")
    def mine(context):
        return (1 - context.alpha).mean(axis=(1, 2))

The env evaluates the gains it is asked for (``gains=("pixel", "mine")``); ``"package.module:function"`` works as a
name without registering, in every worker process.
"""

from activestructure_gym.views.gains import activeinr, anm_s  # noqa: F401  several columns each
from activestructure_gym.views.gains.activepolicy import activepolicy
from activestructure_gym.views.gains.activesplat import (
    activesplat_information,
    activesplat_region,
    activesplat_view,
    activesplat_volume,
)
from activestructure_gym.views.gains.base import GAINS, Gain, GainContext, evaluate_gains
from activestructure_gym.views.gains.confidence import confidence
from activestructure_gym.views.gains.deficiency import deficiency
from activestructure_gym.views.gains.fisherrf import fisherrf
from activestructure_gym.views.gains.gauss_mi import gauss_mi
from activestructure_gym.views.gains.gs_planner import gs_planner_loss, gs_planner_volume
from activestructure_gym.views.gains.hgs_planner import hgs_coverage, hgs_planner
from activestructure_gym.views.gains.hole_area import hole_area
from activestructure_gym.views.gains.in_horizon import in_horizon
from activestructure_gym.views.gains.naruto import naruto
from activestructure_gym.views.gains.pixel import pixel
from activestructure_gym.views.gains.popgs import popgs_cov_trace, popgs_info_trace, popgs_logdet, popgs_min_eig
from activestructure_gym.views.gains.popgs_block import popgs_cov_trace_block, popgs_logdet_block
from activestructure_gym.views.gains.rt_guide import rt_guide, rt_guide_cuboid, rt_guide_region
from activestructure_gym.views.gains.structure import structure
from activestructure_gym.views.gains.uncovered import uncovered
from activestructure_gym.views.gains.unexplored import unexplored
from activestructure_gym.views.gains.view_angle import view_angle
from activestructure_gym.views.gains.visited_distance import visited_distance
from activestructure_gym.views.gains.voronoi_node import floor_graph, voronoi_node

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
