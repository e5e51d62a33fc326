"""Define the configuration of a training run; on one machine, equal configurations train equal networks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

from activestructure_gym.envs.observation import feature_columns
from activestructure_gym.errors import InputError, listed, short_repr, unknown_name
from activestructure_gym.policies.learned.config import NetworkConfig
from activestructure_gym.ranges import check_ranges

if TYPE_CHECKING:
    from activestructure_gym.config import Preset

Method = Literal["bc", "rank", "ppo"]
Reward = Literal["rate", "auc", "env"]
ORACLE = "oracle"  # expert with the true new surface of a view
ORACLE_WAY = "oracle-way"  # expert with the true new surface along the path to a view
WITH_TRUTH = (ORACLE, ORACLE_WAY)
_WORLD_RANGES = {
    "layouts": "[1, 1000000]",
    "frames": "[1, 1000000]",
    "rooms": "[1, 7]",
    "max_planes": "[1, 4096]",
    "episodes_per_layout": "[1, 100000]",
}
_RANGES = {
    "seed": "[0, 4294967295]",  # the range of seeds that numpy and torch both accept
    **dict.fromkeys(("validation_layouts", "episodes"), "[1, 1000000]"),
    **dict.fromkeys(("validate_every", "epochs", "iterations", "ppo_epochs"), "[1, 10000000]"),
    **dict.fromkeys(("batch", "ppo_batch", "steps"), "[1, 1000000]"),
    "envs": "[1, 1024]",
    "bins": "[2, 1000]",
    "critic_first": "[0, 10000000]",
    **dict.fromkeys(("explore", "gamma", "gae_lambda", "weight_decay"), "[0, 1]"),
    "temperature": "[1e-6, 1e6]",
    "clip": "(0, 1]",
    **dict.fromkeys(("entropy", "target_kl"), "[0, 1000]"),
    "learning_rate": "(0, 1]",
}


@dataclass(frozen=True)
class WorldConfig:
    """Hold the settings of the training episodes."""

    layouts: int = 240  # number of procedural apartments; GenNBV found that this number matters most
    rooms: tuple[int, ...] = (1, 2, 3)  # numbers of rooms; consecutive layouts take them in turn
    preset: Preset = "fast"
    frames: int | None = None  # frame budget of an episode; None: that of the preset
    overrides: tuple[tuple[str, Any], ...] = ()  # (field, value) pairs that replace fields of the preset
    features: tuple[str, ...] = ("pixel", "hole_area")  # features of every candidate that the network reads
    max_planes: int = 64  # rows of the plane table in an observation
    noise: bool = True  # whether every episode draws its own sensor noise
    episodes_per_layout: int = 2  # consecutive episodes of the expert; in PPO an env has one layout per iteration
    reward: Reward = "rate"  # see `learning_reward`

    def __post_init__(self) -> None:
        for name in ("rooms", "features"):
            if not isinstance(getattr(self, name), list | tuple):
                raise InputError(f"{name} of a training world is a list, got {short_repr(getattr(self, name))}")
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(
            self, "overrides", tuple(sorted((str(k), _fixed(v)) for k, v in dict(self.overrides).items()))
        )
        check_ranges(self, _WORLD_RANGES)
        _check_kinds(self, texts=("preset",), flags=("noise",))
        if self.reward not in get_args(Reward):
            raise unknown_name("reward", self.reward, get_args(Reward))


@dataclass(frozen=True)
class TrainingConfig:
    """Hold the learning method, the settings of its episodes and its constants; raise `InputError` for wrong values."""

    method: Method = "bc"
    seed: int = 0
    world: WorldConfig = field(default_factory=WorldConfig)
    planes: int = 32  # ``planes`` to ``use_planes`` are fields of `NetworkConfig`
    candidates: int = 48
    rounds: int = 2
    use_planes: bool = True
    validation_layouts: int = 36  # number of layouts for validation, with one episode on each
    validate_every: int = 10  # epochs, or PPO iterations
    # Methods that learn from an expert:
    teacher: str = ORACLE  # the expert: one of WITH_TRUTH, or a feature, for an expert that maximises it greedily
    episodes: int = 480  # episodes of the expert
    explore: float = 0.25  # share of random actions, so the data contain states that the expert does not reach itself
    # Temperature of the soft labels, relative to the best candidate's score. At 0.04, a candidate with 0.9 of the best
    # score has a twelfth of the best one's probability. PPO from such a checkpoint starts with these probabilities.
    temperature: float = 0.04
    mirror: bool = True  # in every epoch, reflect a random half of the states
    weight_decay: float = 1e-4
    bins: int = 15  # ranks of the ordinal targets, as in VIN-NBV
    epochs: int = 60
    batch: int = 64  # states
    # PPO; constants without a comment are from docs/notebook/lab_notes.md:
    iterations: int = 40
    envs: int = 8  # environments, each with one layout per iteration
    steps: int = 128  # steps per env and iteration
    ppo_epochs: int = 4
    ppo_batch: int = 256  # steps per batch; gradients of small batches are mostly noise
    gamma: float = 0.3  # nearly greedy, as in Hestia: with a larger discount factor, wrong views get later rewards
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.003
    target_kl: float = 0.05
    critic_first: int = 2  # first iterations of PPO from a checkpoint, in which only the critic learns
    learning_rate: float | None = None  # None: 1e-3 for bc and rank, 5e-5 for PPO from a checkpoint, 3e-4 for other PPO
    start: str | None = None  # checkpoint from which PPO starts, with its checksum: FILE@1a2b3c4d

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise unknown_name("method", self.method, get_args(Method))
        check_ranges(self, _RANGES)
        _check_kinds(self, texts=("teacher", "start"), flags=("mirror", "use_planes"))
        if self.start is not None and self.method != "ppo":
            raise InputError("a checkpoint to begin from belongs to ppo; bc and rank begin from nothing")
        if (self.envs * self.steps) % self.ppo_batch == 1:
            raise InputError(
                f"{self.envs} envs x {self.steps} steps leave one step for the last batch of {self.ppo_batch}, whose "
                "advantage cannot be normalised: choose other envs or steps"
            )
        self._network(self.world.features)

    def network(self) -> NetworkConfig:
        """Return the configuration of the network; a feature with several columns has one input per column."""
        return self._network(feature_columns(*self.world.features))

    def _network(self, features: tuple[str, ...]) -> NetworkConfig:
        return NetworkConfig(
            features, self.planes, self.candidates, self.rounds, self.use_planes, self.world.max_planes
        )

    @property
    def rate(self) -> float:
        """Return ``learning_rate``, or the default of the method if it is None."""
        if self.learning_rate is not None:
            return self.learning_rate
        return 1e-3 if self.method != "ppo" else 5e-5 if self.start else 3e-4

    @property
    def units(self) -> int:
        """Return the number of epochs, or of PPO iterations."""
        return self.iterations if self.method == "ppo" else self.epochs

    def as_dict(self) -> dict[str, Any]:
        """Return the configuration as a dictionary for JSON."""
        content = dataclasses.asdict(self)
        content["world"]["overrides"] = dict(self.world.overrides)
        return content

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> TrainingConfig:
        """Return the configuration of a dictionary from `as_dict`; raise `InputError` for other content."""
        values = dict(content)
        world = values.pop("world", None)
        for part, kind, given in (("run", cls, values), ("world", WorldConfig, world)):
            known = {field.name for field in dataclasses.fields(kind)} - {"world"}
            if not isinstance(given, Mapping) or not given.keys() <= known:
                raise InputError(f"this is not a description of a training {part}: expected {listed(sorted(known))}")
        assert isinstance(world, Mapping)
        changes = world.get("overrides", {})
        if not isinstance(changes, Mapping):
            raise InputError(f"overrides of a training world are names with values, got {short_repr(changes)}")
        overrides = tuple(changes.items())
        return cls(**values, world=WorldConfig(**{**world, "overrides": overrides}))


def _check_kinds(config: Any, *, texts: Sequence[str], flags: Sequence[str]) -> None:
    for names, kind, words in ((texts, str, "a text"), (flags, bool, "true or false")):
        for name in names:
            value = getattr(config, name)
            if not isinstance(value, kind) and not (value is None and name == "start"):
                raise InputError(f"{name} of a training run is {words}, got {short_repr(value)}")


def _fixed(value: Any) -> Any:
    """Convert lists, also nested ones, to tuples; JSON turns tuples into lists."""
    return tuple(map(_fixed, value)) if isinstance(value, list | tuple) else value
