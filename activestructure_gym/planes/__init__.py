"""Detect planes, fuse them into the Plane Scene Graph, and assess their quality and surprise.

`PlaneSceneGraph.update` processes a keyframe in four steps: planar segments are detected (`detection`), matched to
planes of the graph (`matching`) and fused into them (`nodes`, `surface`). Then the graph is assessed (`topology`,
`quality`, `surprise`). An episode runs the last step once per decision. `arrays` encodes the result for observations.
"""

from activestructure_gym.planes.arrays import (
    PLANE_FEATURE_HIGH,
    PLANE_FEATURE_LOW,
    PLANE_FEATURES,
    PlaneArrays,
    encode_planes,
    plane_features,
)
from activestructure_gym.planes.detection import (
    PlaneDetection,
    PlaneDetectionConfig,
    PlaneSegment,
    depth_noise_scale,
    detect_planes,
    segment_planes,
)
from activestructure_gym.planes.graph import PlaneGraphConfig, PlaneSceneGraph
from activestructure_gym.planes.matching import MatchingConfig
from activestructure_gym.planes.nodes import PlaneNode
from activestructure_gym.planes.quality import (
    QUALITY_MODES,
    Deficiencies,
    Quality,
    QualityConfig,
    assess_quality,
    find_deficiencies,
)
from activestructure_gym.planes.sparseness import MapPoints
from activestructure_gym.planes.state import GraphState
from activestructure_gym.planes.surprise import (
    Surprise,
    SurpriseConfig,
    information_deficit,
    structural_surprise,
)
from activestructure_gym.planes.topology import (
    TopologyConfig,
    classify_structural,
    edge_weights,
    spanning_forest,
    tree_betweenness,
)

__all__ = [
    "PLANE_FEATURES",
    "PLANE_FEATURE_HIGH",
    "PLANE_FEATURE_LOW",
    "QUALITY_MODES",
    "Deficiencies",
    "GraphState",
    "MapPoints",
    "MatchingConfig",
    "PlaneArrays",
    "PlaneDetection",
    "PlaneDetectionConfig",
    "PlaneGraphConfig",
    "PlaneNode",
    "PlaneSceneGraph",
    "PlaneSegment",
    "Quality",
    "QualityConfig",
    "Surprise",
    "SurpriseConfig",
    "TopologyConfig",
    "assess_quality",
    "classify_structural",
    "depth_noise_scale",
    "detect_planes",
    "edge_weights",
    "encode_planes",
    "find_deficiencies",
    "information_deficit",
    "plane_features",
    "segment_planes",
    "spanning_forest",
    "structural_surprise",
    "tree_betweenness",
]
