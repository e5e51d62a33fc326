"""Choose views with the ground truth (oracles), or follow a given trajectory."""
