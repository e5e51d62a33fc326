"""Training learned policies: worlds that differ in every episode, an expert who knows the truth, and three methods.

Here, and not beside the policies, because training needs what a policy must never touch: environments, scenes, the
true surface. What leaves this room is a checkpoint, which `activestructure_gym.policies.learned` turns into a policy.

    config.py          what decides a training run
    layouts.py         which procedural layouts train, validate and test; they share none
    world.py           the env of an episode: layout, start, sensor noise drawn from the seed
    oracle.py          the truth: newly seen surface per candidate; labels and a reference, never an observation
    playing.py         one episode of anybody, and the area under its coverage
    demonstrations.py  episodes of an expert with the labels of every candidate
    targets.py         soft labels, and ordinal bins with equal mass
    mirror.py          the same states with left and right exchanged
    supervised.py      behaviour cloning and ranking
    reinforcement.py   PPO
    validation.py      scores on layouts never trained on, normalised between random and the oracle
    runs.py            a run's directory: checkpoints, log, resuming
    curve.py           its log as a picture
    timing.py          how long what took
    scoring.py         the final table, with intervals
"""
