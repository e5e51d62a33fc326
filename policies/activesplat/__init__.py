"""Provide ActiveSplat (Li et al., RA-L 2025): visit Voronoi nodes by integer scores, with local views at each.

Read in this order: `policy` (the loop), `nodes` (score and choice of a node), `features` (panoramas at the nodes,
subregions, visible gaps). The features `voronoi_node` and `visited_distance` are shared with ANM-S. The
panorama is in ``activestructure_gym/views/panorama.py``, the graph in ``activestructure_gym/motion/voronoi.py``.
"""

from activestructure_gym.policies.activesplat.nodes import Nodes, choose_node, node_scores
from activestructure_gym.policies.activesplat.policy import ActiveSplat

__all__ = ["ActiveSplat", "Nodes", "choose_node", "node_scores"]
