"""``asg bench grid``, ``evaluation``, ``policies`` and ``env``: what episodes are made of, and many of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.bench.tables import SceneNames, print_rows, split_names
from activestructure_gym.evaluation.cli.fields import Count, NoNames, PresetName, Switch
from activestructure_gym.evaluation.cli.options import split_policies
from activestructure_gym.evaluation.cli.output import make_console, working
from activestructure_gym.streams import escape


@dataclass(frozen=True)
class Grid:
    """What the supervisor of a comparison costs: the same jobs by hand and through it."""

    scene: SceneNames = None
    """The scenes that are explored, separated by commas; room if not given."""
    quick: Switch = False
    """In small, to see that it runs."""

    def run(self) -> int:
        """Measure and print."""
        from activestructure_gym.evaluation.benchmarks.grid import run_grid_benchmark

        console = make_console()
        size: dict[str, Any] = {"frames": 8, "seeds": (0,), "repeats": 1} if self.quick else {}
        with working(console, "measuring the grid") as notify:
            chosen = split_names(self.scene) or (["box"] if self.quick else ["room"])
            rows = run_grid_benchmark(chosen, notify=notify, **size)
        print_rows(console, rows, "the same jobs by hand and through the supervisor")
        return 0


@dataclass(frozen=True)
class Evaluation:
    """What the evaluation of an episode costs, by stages."""

    scene: SceneNames = None
    """The scenes that are explored, separated by commas; a room and an apartment if not given."""
    quick: Switch = False
    """In small, to see that it runs."""

    def run(self) -> int:
        """Measure and print."""
        from activestructure_gym.evaluation.benchmarks.episode_evaluation import measure_evaluation

        console = make_console()
        rows = measure_evaluation(console, split_names(self.scene), quick=self.quick)
        print_rows(console, rows, "cost of an episode's evaluation, the truth in the cache")
        return 0


@dataclass(frozen=True)
class Policies:
    """Seconds of a decision by every policy, in one state of an episode."""

    scene: SceneNames = None
    """The scenes where they decide, separated by commas; apartment?rooms=3 if not given."""
    policies: NoNames = ()
    """Who decides; everybody if nobody is named."""
    gaussians: Count = None
    """The state is taken when the map has as many and 256 views are on offer; 30,000 if not given."""
    frames: Count = None
    """Or after so many frames; 400 if not given."""
    repeats: Count = None
    """Decisions of everybody that are timed, beside a first one that is not; 7 if not given."""
    quick: Switch = False
    """In small, to see that it runs."""

    def run(self) -> int:
        """Measure and print."""
        from activestructure_gym.evaluation.benchmarks import policies as benchmark
        from activestructure_gym.policies import make_policy

        console = make_console()
        size: dict[str, Any] = {"preset": "fast", "frames": 25, "repeats": 1} if self.quick else {}
        given = {"gaussians": self.gaussians, "frames": self.frames, "repeats": self.repeats}
        for name, value in given.items():
            if value is not None and value < 1:
                raise InputError(f"--{name} must be at least 1, got {value}")
        size |= {name: value for name, value in given.items() if value is not None}
        names = split_policies(self.policies)
        for name in names:
            make_policy(name)  # it refuses what there is not, before anything is explored
        with console.status("measuring the policies") as status:
            rows = [
                row | {"scene": spec}
                for spec in split_names(self.scene) or ["box" if self.quick else benchmark.SCENE]
                for row in benchmark.run_policy_benchmark(
                    spec, policies=names, notify=lambda line: status.update(escape(line)), **size
                )
            ]
        print_rows(console, rows, "seconds of a decision, median and quartiles")
        return 0


@dataclass(frozen=True)
class Env:
    """Steps per second of the environment in one process and in two, and where their time goes."""

    scene: SceneNames = None
    """The scenes in which steps are taken, separated by commas; apartment?rooms=3 if not given."""
    preset: PresetName = "fast"
    """What `asg config PRESET` prints."""
    quick: Switch = False
    """In small, to see that it runs."""

    def run(self) -> int:
        """Measure and print."""
        from activestructure_gym.config import known_preset
        from activestructure_gym.evaluation.benchmarks.env import SCENES, run_env_benchmark

        console = make_console()
        size: dict[str, Any] = {"rounds": 1, "seconds": 0.5} if self.quick else {}
        with console.status("measuring the environment") as status:
            speed, rows = run_env_benchmark(
                split_names(self.scene) or (["box"] if self.quick else SCENES),
                preset=known_preset(self.preset),
                notify=lambda line: status.update(f"measuring the {escape(line)}"),
                **size,
            )
        print_rows(console, speed, "steps of the environment on this machine")
        print_rows(console, rows, "where the time of a step goes, milliseconds of processor time")
        return 0
