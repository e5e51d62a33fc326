"""Compute features of candidate views from the current reconstruction, without ground truth.

A feature is a function of a `FeatureContext`. It returns one number per candidate [K], or C named columns [K, C]::

    @FEATURES.register("mine", unit="share", low=0.0, high=1.0)
    def mine(context):
        return (1 - context.alpha).mean(axis=(1, 2))

The environment evaluates the features that it is asked for (``features=("pixel", "mine")``). The name
``"package.module:function"`` works without registration, in every worker process. This package holds the features
that at least two planners use; `FEATURES` also finds those in the planners' folders. Their table is in
docs/reference/observation.md.
"""

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES, Feature, column_names, evaluate_features

__all__ = ["FEATURES", "Feature", "FeatureContext", "column_names", "evaluate_features"]
