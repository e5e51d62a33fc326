"""Features: what a candidate view is worth, has or stands for, computed from the current reconstruction only.

A feature is a function of a `FeatureContext` that returns [K], or [K, C] with named columns, one file each::

    @FEATURES.register("mine", unit="share", low=0.0, high=1.0)
    def mine(context):
        return (1 - context.alpha).mean(axis=(1, 2))

The env evaluates those it is asked for (``gains=("pixel", "mine")``); ``"package.module:function"`` works as a name
without registering, in every worker process. The table in docs/guide/observation.md lists all of them.
"""

from activestructure_gym.features.activeinr import activeinr, activeinr_proxy
from activestructure_gym.features.activepolicy import activepolicy
from activestructure_gym.features.activesplat import activesplat
from activestructure_gym.features.aiisrfe import aiisrfe
from activestructure_gym.features.anm_s import anm_s, anm_s_proxy
from activestructure_gym.features.confidence import confidence
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.deficiency import deficiency
from activestructure_gym.features.fisherrf import fisherrf
from activestructure_gym.features.fisherrf_path import fisherrf_path
from activestructure_gym.features.gauss_mi import gauss_mi
from activestructure_gym.features.gavis import gavis
from activestructure_gym.features.gs_planner import gs_planner
from activestructure_gym.features.hgs_planner import hgs_coverage, hgs_planner, hgs_planner_raw
from activestructure_gym.features.hole_area import hole_area
from activestructure_gym.features.in_horizon import in_horizon
from activestructure_gym.features.magician import magician
from activestructure_gym.features.naruto import naruto, naruto_look
from activestructure_gym.features.next_best_sense import next_best_sense
from activestructure_gym.features.pixel import pixel
from activestructure_gym.features.popgs import popgs_cov_trace, popgs_info_trace, popgs_logdet, popgs_min_eig
from activestructure_gym.features.popgs_block import popgs_cov_trace_block, popgs_logdet_block
from activestructure_gym.features.r3_recon import r3_recon
from activestructure_gym.features.registry import FEATURES, Feature, column_names, evaluate_features
from activestructure_gym.features.rt_guide import rt_guide
from activestructure_gym.features.structure import structure
from activestructure_gym.features.uncovered import uncovered
from activestructure_gym.features.unexplored import unexplored
from activestructure_gym.features.unknown_volume import unknown_volume
from activestructure_gym.features.unseen_sides import unseen_sides
from activestructure_gym.features.view_angle import view_angle
from activestructure_gym.features.visited_distance import visited_distance
from activestructure_gym.features.voronoi_node import floor_graph, voronoi_node

__all__ = [
    "FEATURES",
    "Feature",
    "FeatureContext",
    "activeinr",
    "activeinr_proxy",
    "activepolicy",
    "activesplat",
    "aiisrfe",
    "anm_s",
    "anm_s_proxy",
    "column_names",
    "confidence",
    "deficiency",
    "evaluate_features",
    "fisherrf",
    "fisherrf_path",
    "floor_graph",
    "gauss_mi",
    "gavis",
    "gs_planner",
    "hgs_coverage",
    "hgs_planner",
    "hgs_planner_raw",
    "hole_area",
    "in_horizon",
    "magician",
    "naruto",
    "naruto_look",
    "next_best_sense",
    "pixel",
    "popgs_cov_trace",
    "popgs_cov_trace_block",
    "popgs_info_trace",
    "popgs_logdet",
    "popgs_logdet_block",
    "popgs_min_eig",
    "r3_recon",
    "rt_guide",
    "structure",
    "uncovered",
    "unexplored",
    "unknown_volume",
    "unseen_sides",
    "view_angle",
    "visited_distance",
    "voronoi_node",
]
