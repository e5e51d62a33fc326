"""ActiveSplat (Li et al., RA-L 2025): integer scores of Voronoi nodes, subregion by subregion, and local views at each.

Read in this order: `policy` (the loop), `nodes` (score and choice of a node), `features` (panoramas at the nodes,
subregions, visible gaps). It shares the features `voronoi_node`, `visited_distance` and `in_horizon` with ANM-S; the
panorama is ``activestructure_gym/views/panorama.py``, the graph ``activestructure_gym/motion/voronoi.py``.
"""

from activestructure_gym.policies.activesplat.nodes import Nodes, choose_node, node_scores
from activestructure_gym.policies.activesplat.policy import ActiveSplat

__all__ = ["ActiveSplat", "Nodes", "choose_node", "node_scores"]
