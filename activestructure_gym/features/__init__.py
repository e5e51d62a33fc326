"""Features: what a candidate view is worth, has or stands for, computed from the current reconstruction only.

A feature is a function of a `FeatureContext` that returns [K], or [K, C] with named columns::

    @FEATURES.register("mine", unit="share", low=0.0, high=1.0)
    def mine(context):
        return (1 - context.alpha).mean(axis=(1, 2))

The env evaluates those it is asked for (``features=("pixel", "mine")``); ``"package.module:function"`` works as a name
without registering, in every worker process. This room holds the features that two planners or more use; `FEATURES`
finds them and those in the planners' folders. The table in docs/guide/observation.md lists all of them.
"""

from activestructure_gym.features.context import FeatureContext
from activestructure_gym.features.registry import FEATURES, Feature, column_names, evaluate_features

__all__ = ["FEATURES", "Feature", "FeatureContext", "column_names", "evaluate_features"]
