"""``asg train bc``, ``rank`` and ``ppo``: from the options to a checkpoint."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import Count, Names, PathName, Switch, option
from activestructure_gym.evaluation.cli.options import parse_overrides, split_list
from activestructure_gym.evaluation.cli.train.common import Episodes, check_empty
from activestructure_gym.evaluation.training.config import Method, Reward, TrainingConfig, WorldConfig

# How and where a run is made, and not what is learnt.
_MANNER = ("out", "resume", "workers", "data", "trust_code")


@dataclass(frozen=True)
class Learning(Episodes):
    """Options of every method."""

    method: ClassVar[Method]

    out: PathName = None
    """The run's directory; runs/<method>-<date>-<time> if not given. Its policy is learned:DIRECTORY."""
    resume: Switch = False
    """Go on with the run in --out, with everything as it was begun; no other option is needed but --data, if given."""
    seed: int = 0
    """Of everything: layouts, starts, noise, weights. Equal seeds give equal networks on one machine."""
    layouts: Count = None
    """Procedural apartments to train on; 240 if not given."""
    gains: Names = ("pixel", "hole_area")
    """What the policy is told about every candidate (see `asg features`)."""
    planes_told: bool = True
    """Whether the network sees the Plane Scene Graph; without it, an ablation."""
    noise: bool = True
    """Another sensor noise in every training episode; validation is without."""
    reward: Reward = "rate"
    """What the critic values: new surface per frame spent, the area under the coverage, or the environment's reward."""
    gamma: float = 0.3
    """Discount of the reward per decision."""
    learning_rate: Annotated[float | None, option("X", "")] = None
    """1e-3; of ppo 3e-4, from a checkpoint 5e-5."""
    validate_every: int = 10
    """Epochs or iterations between validations."""
    validation_layouts: int = 36
    """Apartments to validate on, one episode each."""

    def run(self) -> int:
        """0 when there is a checkpoint to use, 1 if there is none, 130 if stopped."""
        workers = self.begin()

        from activestructure_gym.evaluation.cli.train.learning import check, learn
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
        return learn(config, directory, data=getattr(self, "data", None), workers=workers, begun=begun)

    def _is_bare(self) -> bool:
        """Whether every option that decides what is learnt has its default."""
        manner = {field.name for field in dataclasses.fields(self)} & set(_MANNER)
        return self == type(self)(**{name: getattr(self, name) for name in manner})


@dataclass(frozen=True)
class _FromExpert(Learning):
    """Options of the methods that learn from an expert."""

    teacher: Annotated[str, option("NAME")] = "oracle"
    """oracle (the true new surface of every candidate), oracle-way (of the way there, per frame), or the gain a greedy
    expert goes by (hole_area)."""
    episodes: int = 480
    """Episodes of the expert, two on each layout."""
    data: PathName = None
    """Directory of the expert's episodes, to share it between runs; --out's own if not given."""
    epochs: int = 60
    """How often all states are learnt from."""


@dataclass(frozen=True)
class Bc(_FromExpert):
    """Copy an expert: its choice among the candidates."""

    method: ClassVar[Method] = "bc"

    temperature: float = 0.04
    """How sharply its probabilities fall with the expert's score; what PPO begins from draws from them."""


@dataclass(frozen=True)
class Rank(_FromExpert):
    """Learn the order of an expert's gains."""

    method: ClassVar[Method] = "rank"


@dataclass(frozen=True)
class Ppo(Learning):
    """Learn from rewards, best from a checkpoint of bc."""

    method: ClassVar[Method] = "ppo"

    start: PathName = None
    """The checkpoint to begin from (a run's directory or a file)."""
    iterations: int = 40
    """Of --envs times --steps steps each."""
    steps: int = 128
    """Per environment and iteration."""
    envs: int = 8
    """Environments at a time; changes results, unlike --workers."""


def training_config(options: Learning) -> TrainingConfig:
    """The training configuration that the options ask for; defaults where a method has no option."""
    from activestructure_gym.envs.observation import feature_columns
    from activestructure_gym.policies.learned import learned_from

    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    given["gains"] = split_list(options.gains)
    if given.get("start") is not None:
        chosen = learned_from(given["start"].removeprefix("learned:"))
        if options.gains != type(options)().gains and feature_columns(*given["gains"]) != chosen.required_gains:
            told = ", ".join(chosen.required_gains)
            raise InputError(
                f"the checkpoint to begin from is told {told}, not {', '.join(given['gains'])}: leave --gains out"
            )
        given |= {"start": chosen.spec.removeprefix("learned:"), "gains": chosen.required_gains}
    if options.layouts is None:
        del given["layouts"]
    given["overrides"] = tuple(parse_overrides(options.set).items())

    def of(kind: type[TrainingConfig | WorldConfig]) -> dict[str, Any]:
        return {field.name: given[field.name] for field in dataclasses.fields(kind) if field.name in given}

    return TrainingConfig(method=options.method, world=WorldConfig(**of(WorldConfig)), **of(TrainingConfig))
