"""Define ``asg train bc``, ``rank`` and ``ppo``, which train a policy and write its checkpoint."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import NoNames, Out, PathName, Switch, option
from activestructure_gym.evaluation.cli.options import parse_overrides, split_list
from activestructure_gym.evaluation.cli.train.common import Episodes, check_empty
from activestructure_gym.evaluation.training.config import Method, Reward, TrainingConfig, WorldConfig

# Options that do not change the result of a training.
_MANNER = ("out", "resume", "workers", "data", "trust_code", "dry_run")


@dataclass(frozen=True)
class Learning(Episodes):
    """Hold the options that all training methods share."""

    method: ClassVar[Method]

    out: Out = None
    """Write the run into this directory (default: runs/<method>-<date>-<time>); its policy is learned:DIRECTORY."""
    resume: Switch = False
    """Go on with the run in --out, with its own options; give --data again if it was given."""
    seed: int = 0
    """Set the random seed of layouts, starts, noise and weights; equal seeds give equal networks on one machine."""
    layouts: Annotated[int | None, option("N", "(default: 240)")] = None
    """Train on this many procedural apartments."""
    features: NoNames = ()
    """Give the policy these features (default: pixel hole_area; without a map, as in rl: unknown_volume)."""
    use_planes: bool = True
    """Give the network the Plane Scene Graph, or an empty one (an ablation)."""
    noise: bool = True
    """Draw new sensor noise in every training episode; validation has none."""
    reward: Reward = "rate"
    """Reward new surface per frame (rate), area under the coverage curve (auc), or as the environment does (env)."""
    gamma: float = 0.3
    """Discount the reward by this factor per decision."""
    learning_rate: Annotated[float | None, option("X", "(default: 1e-3; ppo: 3e-4, from a checkpoint 5e-5)")] = None
    """Set the learning rate."""
    validate_every: int = 10
    """Validate after this many epochs or iterations."""
    validation_layouts: int = 36
    """Validate on this many apartments, one episode each."""

    def run(self) -> int:
        """Train; return 0 if the run has a best checkpoint, 1 if it has none, 130 if stopped."""
        workers = self.begin()

        from activestructure_gym.evaluation.cli.train.learning import check, learn, print_plan
        from activestructure_gym.evaluation.training.runs import CONFIG, read_config

        if self.resume and not self.out:
            raise InputError("--resume needs --out: the directory of the run to go on with")
        directory = Path(self.out or time.strftime(f"runs/{self.method}-%Y%m%d-%H%M%S"))
        begun = (directory / CONFIG).is_file()
        if begun and not self.resume:
            raise InputError(
                f"'{directory}' holds a training run already; add --resume to go on, or choose another --out"
            )
        bare = self.resume and self._is_bare()
        if not begun and not bare:
            check_empty(directory)
        config = read_config(directory) if bare else training_config(self)
        if config.method != self.method:
            raise InputError(f"'{directory}' holds a run of {config.method}, not of {self.method}")
        check(config)
        if self.dry_run:
            return print_plan(config, directory, workers)
        return learn(config, directory, data=getattr(self, "data", None), workers=workers, begun=begun)

    def _is_bare(self) -> bool:
        """Return whether all options that affect the result have their defaults."""
        manner = {field.name for field in dataclasses.fields(self)} & set(_MANNER)
        return self == type(self)(**{name: getattr(self, name) for name in manner})


@dataclass(frozen=True)
class _FromExpert(Learning):
    """Hold the options of methods that learn from an expert."""

    teacher: Annotated[str, option("NAME")] = "oracle"
    """Learn from this expert: oracle (true new surface of a view), oracle-way (per frame of its path), or a feature."""
    episodes: int = 480
    """Play this many episodes of the expert, two on each layout."""
    data: PathName = None
    """Keep the expert's episodes in this directory, to share them between runs (default: in --out)."""
    epochs: int = 60
    """Learn from all states this many times."""


@dataclass(frozen=True)
class Bc(_FromExpert):
    """Imitate an expert's choice among the candidates."""

    method: ClassVar[Method] = "bc"

    temperature: float = 0.04
    """Divide the expert's scores by this before the softmax; lower values give sharper start probabilities of ppo."""


@dataclass(frozen=True)
class Rank(_FromExpert):
    """Learn the order of an expert's scores."""

    method: ClassVar[Method] = "rank"


@dataclass(frozen=True)
class Ppo(Learning):
    """Learn from rewards; a start from a checkpoint of the method bc works best."""

    method: ClassVar[Method] = "ppo"

    workers: int = 0
    """Use one process per environment, with 1 only this process; results do not depend on it."""
    start: PathName = None
    """Start from this checkpoint (a run's directory or a file), with the network that it has."""
    iterations: int = 40
    """Train for this many iterations of --envs times --steps steps."""
    steps: int = 128
    """Make this many steps per environment and iteration."""
    envs: int = 8
    """Use this many environments at a time; unlike --workers, this changes results."""


def training_config(options: Learning) -> TrainingConfig:
    """Return the training configuration defined by the options; fields without an option have their defaults."""
    from activestructure_gym.config import known_preset
    from activestructure_gym.envs.observation import feature_columns
    from activestructure_gym.evaluation.training.training_env import default_features
    from activestructure_gym.policies.learned import learned_from
    from activestructure_gym.policies.learned.checkpoint import read_network_config

    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    overrides = parse_overrides(options.set)
    given["features"] = split_list(options.features) or default_features(known_preset(options.preset), overrides)
    if given.get("start") is not None:
        chosen = learned_from(given["start"].removeprefix("learned:"))
        if options.features and feature_columns(*given["features"]) != chosen.required_features:
            has = ", ".join(chosen.required_features)
            raise InputError(
                f"leave out --features, or give those of --start: {has}; got {', '.join(given['features'])}"
            )
        network = read_network_config(chosen.checkpoint)
        if network.use_planes and not options.use_planes:
            raise InputError("the network of --start reads the planes: leave out --no-use-planes")
        given |= {name: getattr(network, name) for name in ("planes", "candidates", "rounds", "use_planes")}
        given |= {"start": chosen.spec.removeprefix("learned:"), "features": chosen.required_features}
    if options.layouts is None:
        del given["layouts"]
    given["overrides"] = tuple(overrides.items())

    def of(kind: type[TrainingConfig | WorldConfig]) -> dict[str, Any]:
        return {field.name: given[field.name] for field in dataclasses.fields(kind) if field.name in given}

    return TrainingConfig(method=options.method, world=WorldConfig(**of(WorldConfig)), **of(TrainingConfig))
