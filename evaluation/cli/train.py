"""``asg train``: from the options to a checkpoint, or to the table that compares checkpoints."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.commands import Train
from activestructure_gym.evaluation.cli.options import (
    parse_overrides,
    parse_seeds,
    split_list,
    split_policies,
    split_scenes,
    use_trust,
)
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.evaluation.machine.threads import capped_environment, core_count

if TYPE_CHECKING:
    from activestructure_gym.evaluation.training.config import TrainingConfig, WorldConfig

_SCORE_LAYOUTS = 24
_BASELINE = "pixel_only"
# How and where a run is made, and not what is learnt.
_MANNER = ("what", "out", "resume", "workers", "data", "trust_code")
_SHOWN = ("train/loss", "train/agreement", "rollout/reward_per_episode", "train/approx_kl")


def train(options: Train) -> int:
    """Train or score; 0 when done, 130 if stopped."""
    # Before torch is loaded: small networks gain nothing from a second thread, and one thread makes equal results.
    os.environ.update(capped_environment(1))
    use_trust(options.trust_code)
    console = make_console()
    if options.workers < 0:
        raise InputError(f"--workers is a number of processes, or 0 for one per core, got {options.workers}")
    workers = options.workers or core_count()
    return _score(options, console, workers) if options.what == "score" else _train(options, console, workers)


def _train(options: Train, console: Console, workers: int) -> int:
    from activestructure_gym.evaluation.archive.directory_lock import hold
    from activestructure_gym.evaluation.training.runs import CONFIG, read_config

    if options.resume and not options.out:
        raise InputError("--resume needs --out: the directory of the run to go on with")
    directory = Path(options.out or time.strftime(f"runs/{options.what}-%Y%m%d-%H%M%S"))
    begun = (directory / CONFIG).is_file()
    if begun and not options.resume:
        raise InputError(f"'{directory}' holds a training run already; add --resume to go on, or choose another --out")
    bare = options.resume and options == Train(**{name: getattr(options, name) for name in _MANNER})
    if not begun and not bare:
        _check_empty(directory)
    config = read_config(directory) if bare else training_config(options)
    if config.method != options.what:
        raise InputError(f"'{directory}' holds a run of {config.method}, not of {options.what}")
    _check(config)
    began = time.monotonic()
    try:
        with hold(directory), Live(console) as live:
            if begun:
                console.print(f"going on with {escape(str(directory))}")
            best, validated = _run(config, directory, options, workers, live)
    except KeyboardInterrupt:
        words = f"asg train {options.what} --out {shlex.quote(str(directory))} --resume"
        if options.data:
            words += f" --data {shlex.quote(options.data)}"
        print(f"asg: stopped; what is finished is kept, go on with: {words}", file=sys.stderr)
        return 130
    console.print(
        f"{config.units} {_unit(config)}, {time.monotonic() - began:.0f} s"
        + ("" if best is None else f"; best validation: coverage {100 * best:.1f} %")
    )
    console.print(f"Compare it: [bold]asg compare --policies learned:{escape(str(directory))},pixel_only[/]")
    return 0 if validated else 1


def _check_empty(directory: Path) -> None:
    if directory.exists() and any(path.name != ".lock" for path in directory.iterdir()):
        raise InputError(f"'{directory}' holds other files: choose another --out")


def training_config(options: Train) -> TrainingConfig:
    """What the options ask for."""
    from activestructure_gym.evaluation.training.config import TrainingConfig
    from activestructure_gym.policies.learned import learned_from

    if options.data is not None and options.what == "ppo":
        raise InputError("--data holds an expert's episodes, for bc and rank; ppo plays its own")
    gains = split_list(options.gains)
    start = None
    if options.start is not None:
        chosen = learned_from(options.start.removeprefix("learned:"))
        if options.gains != Train(what="ppo").gains and gains != chosen.required_gains:
            told = ", ".join(chosen.required_gains)
            raise InputError(f"the checkpoint to begin from is told {told}, not {', '.join(gains)}: leave --gains out")
        start, gains = chosen.spec.removeprefix("learned:"), chosen.required_gains
    same = (
        "seed", "teacher", "episodes", "temperature", "epochs", "iterations", "steps", "envs", "gamma",
        "learning_rate", "validate_every", "validation_layouts",
    )  # fmt: skip
    return TrainingConfig(
        method=options.what,
        world=_world(options, gains),
        start=start,
        **{name: getattr(options, name) for name in same},
    )


def _world(options: Train, gains: tuple[str, ...]) -> WorldConfig:
    from activestructure_gym.evaluation.training.config import WorldConfig

    return WorldConfig(
        layouts=WorldConfig().layouts if options.layouts is None else options.layouts,
        rooms=options.rooms,
        preset=options.preset,
        frames=options.frames,
        overrides=tuple(parse_overrides(options.set).items()),
        gains=gains,
        noise=options.noise,
        reward=options.reward,
    )


def _check(config: TrainingConfig) -> None:
    """What would fail later: names of gains, fields of the configuration."""
    from activestructure_gym.evaluation.training.config import ORACLE
    from activestructure_gym.evaluation.training.world import world_config

    extra = () if config.teacher == ORACLE or config.method == "ppo" else (config.teacher,)
    world_config(config.world, (*config.world.gains, *extra))


def _run(
    config: TrainingConfig, directory: Path, options: Train, workers: int, live: Live
) -> tuple[float | None, bool]:
    """Train; returns the best validation, and whether there is a checkpoint to use."""
    import torch

    from activestructure_gym.evaluation.training import demonstrations
    from activestructure_gym.evaluation.training.runs import BEST, TrainingRun
    from activestructure_gym.evaluation.training.spreading import one_thread
    from activestructure_gym.evaluation.training.validation import Validation

    torch.set_num_threads(1)
    one_thread()
    run = TrainingRun(directory, config)
    validate = Validation(config, directory, live.say)
    try:
        if config.method == "ppo":
            from activestructure_gym.evaluation.training.reinforcement import train_ppo, vector_env
            from activestructure_gym.evaluation.training.spreading import single_threaded_children
            from activestructure_gym.evaluation.training.world import TrainingEnv, learning_layouts

            layouts = learning_layouts(config.world, "train", config.world.layouts)
            live.say("starting the environments")
            with single_threaded_children():
                envs = vector_env(
                    [partial(TrainingEnv, config.world, layouts)] * config.envs,
                    processes=workers > 1 and config.envs > 1,
                )
            live.begin("ppo", config.units, run.position, config.envs * config.steps)
            try:
                train_ppo(config, envs, run, validate, live.unit)
            finally:
                envs.close()
        else:
            from activestructure_gym.evaluation.training.supervised import train_supervised

            data = Path(options.data) if options.data else directory / demonstrations.DATA
            live.begin(f"demonstrations of {config.teacher}", 1, 0)

            def tell(done: int, total: int) -> None:
                live.files(done, total)
                run.timing.save()

            run.timing.switch("collecting")
            missing = demonstrations.collect(config, data, workers=workers, tell=tell)
            states = demonstrations.load(config, data)
            if missing:
                run.timing.count("collecting", len(states))
            live.begin(f"{config.method} on {len(states)} states", config.units, run.position)
            train_supervised(config, states, run, validate, live.unit)
    finally:
        run.close()
    return run.best, (directory / BEST).is_file()


def _score(options: Train, console: Console, workers: int) -> int:
    from activestructure_gym.evaluation.archive.directory_lock import hold
    from activestructure_gym.evaluation.training import scoring
    from activestructure_gym.evaluation.training.world import world_config
    from activestructure_gym.policies import canonical_policy, make_policy

    policies = [canonical_policy(name) for name in split_policies(options.policies)]
    asked = options.baseline or tuple(name for name in policies if name == _BASELINE)
    baselines = [canonical_policy(name) for name in split_policies(asked)]
    for baseline in baselines:
        if baseline not in (*policies, scoring.RANDOM):
            raise InputError(f"--baseline is one of the policies, {', '.join(policies)}; got '{baseline}'")
    layouts = _SCORE_LAYOUTS if options.layouts is None else options.layouts
    world = _world(dataclasses.replace(options, layouts=None, noise=False), split_list(options.gains))
    for name in policies:
        world_config(world, tuple(make_policy(name).required_gains))
    cells = scoring.cells(layouts, world.rooms, split_scenes(options.scenes), parse_seeds(options.seeds))
    directory = Path(options.out or time.strftime("runs/score-%Y%m%d-%H%M%S"))
    if not (directory / scoring.RECORD).is_file():
        _check_empty(directory)
    with hold(directory), Live(console) as live:
        live.begin("episodes", len(cells), 0)
        live.say(f"{len(policies) + 2} policies each, {workers} at a time")
        scoring.play_cells(world, policies, cells, directory, workers=workers, tell=live.files)
    rows = scoring.table(directory, policies, cells, baselines)
    (directory / "score.md").write_text(scoring.markdown(rows, baselines), encoding="utf-8")
    shown = plain_table(
        "mean coverage over the budget; normalised: 0 = random, 1 = one-step oracle; 95 %",
        *scoring.headings(rows, baselines),
    )
    for entries in scoring.entries(rows):
        shown.add_row(*map(escape, entries))
    print_whole(console, shown)
    console.print(f"written: {escape(str(directory / 'score.md'))}")
    return 0


class Live:
    """A bar with the latest numbers; validations are printed above it and stay. A context manager."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[numbers]}"),
            TimeRemainingColumn(),
            TextColumn("[dim]{task.fields[stage]}"),
            console=console,
            refresh_per_second=4,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task: TaskID | None = None
        self._steps, self._tenth = 0, 0
        self._last = (0, time.monotonic())

    def __enter__(self) -> Live:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def begin(self, title: str, total: int, done: int, steps: int = 0) -> None:
        """A new bar; ``steps`` of an environment are made per unit."""
        if self._task is not None:
            self._progress.remove_task(self._task)
        self._task = self._progress.add_task(escape(title), total=total, completed=done, numbers="", stage="")
        self._steps, self._last = steps, (done, time.monotonic())
        self._tenth = 0
        if not self._console.is_terminal:
            self._console.print(escape(title) + (f", {done} of {total} done before" if done else ""), highlight=False)

    def say(self, stage: str) -> None:
        """What happens just now."""
        if self._task is not None:
            self._progress.update(self._task, stage=escape(stage))

    def files(self, done: int, total: int) -> None:
        """Move the bar of files or episodes."""
        if self._task is not None:
            self._progress.update(self._task, completed=done, total=total)
        if not self._console.is_terminal and 10 * done // max(1, total) > self._tenth:
            self._tenth = 10 * done // max(1, total)
            self._console.print(f"[dim]{done}/{total}", highlight=False)

    def unit(self, done: int, row: Mapping[str, float]) -> None:
        """An epoch or an iteration is done."""
        numbers = [f"{name.rpartition('/')[2]} {row[name]:.3g}" for name in _SHOWN if name in row]
        if self._steps and done > self._last[0]:
            seconds = time.monotonic() - self._last[1]
            numbers.append(f"{self._steps * (done - self._last[0]) / max(seconds, 1e-9):.0f} steps/s")
        self._last = (done, time.monotonic())
        if self._task is not None:
            self._progress.update(self._task, completed=done, numbers="  ".join(numbers), stage="")
        if "validation/normalised" in row:
            self._console.print(
                f"[green]✓[/] after {done}: coverage {100 * row['validation/auc']:.1f} %, normalised "
                f"{row['validation/normalised']:.3f}[dim]  {'  '.join(numbers)}",
                highlight=False,
            )


def _unit(config: TrainingConfig) -> str:
    return "iterations" if config.method == "ppo" else "epochs"
