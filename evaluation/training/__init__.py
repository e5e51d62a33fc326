"""Train learned policies on procedural layouts, from an expert with ground truth or by reinforcement learning.

Training needs environments, scenes and the true surface. Policies must not import these, so training is a package of
its own. Its result is a checkpoint, which `activestructure_gym.policies.learned` loads as a policy.

- ``config``: configuration of a training run
- ``training_env``: the environment of an episode: layout, start and sensor noise are drawn from the seed
- ``oracle``: share of the surface that each candidate would newly show, from ground truth, as label and as reference
- ``rollout``: one episode of any policy, and the area under its coverage curve
- ``demonstrations``: episodes of an expert, with its scores of all candidates
- ``targets``: training targets from scores: probabilities, or ranks in bins of equal size
- ``mirror``: data augmentation by reflection
- ``supervised``: behaviour cloning and ranking
- ``reinforcement``: PPO
- ``validation``: scores on validation layouts, where random choice is 0 and the oracle is 1
- ``runs``: directory of a run: checkpoints, log, resuming
- ``curve``: chart of the log
- ``forecast``: expected time of a run, from a short trial
- ``stopwatch``: seconds of each part of a run
- ``process_pool``: spawned processes with one thread each
- ``scoring``: table of coverage on held-out episodes, with intervals
"""
