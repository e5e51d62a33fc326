"""Run a training from its beginning, or from its last finished epoch or iteration."""

from __future__ import annotations

import shlex
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from activestructure_gym.cores import core_count
from activestructure_gym.errors import InputError, pluralised
from activestructure_gym.evaluation.cli.closing import print_next
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.evaluation.cli.train.live import Live
from activestructure_gym.evaluation.machine.threads import single_threaded_children
from activestructure_gym.streams import complain, escape

if TYPE_CHECKING:
    from activestructure_gym.evaluation.training.config import TrainingConfig


def check(config: TrainingConfig) -> None:
    """Raise `InputError` if ``config`` names a feature or a field that does not exist, or a teacher of many columns."""
    from activestructure_gym.envs.observation import feature_columns
    from activestructure_gym.evaluation.training.config import WITH_TRUTH
    from activestructure_gym.evaluation.training.training_env import world_config

    extra = () if config.teacher in WITH_TRUTH or config.method == "ppo" else (config.teacher,)
    world_config(config.world, (*config.world.features, *extra))
    if extra and extra != (columns := feature_columns(*extra)):
        raise InputError(f"the feature '{config.teacher}' has the columns {', '.join(columns)}: give one as --teacher")


def print_plan(config: TrainingConfig, directory: Path, workers: int) -> int:
    """Print the training that `learn` would run, without running it; return 0."""
    from activestructure_gym.evaluation.training.training_env import world_config

    world = config.world
    if config.method == "ppo":
        amount = f"{config.units} iterations of {config.envs} environments x {config.steps} steps"
    else:
        amount = f"{config.episodes} episodes of {config.teacher}, {config.units} epochs"
    if config.method == "ppo" and workers > 1:
        workers = config.envs
    frames = world_config(world).frame_budget
    make_console().print(
        f"{config.method}: {amount}, on {world.layouts} layouts, {frames} frames per episode, preset {world.preset}, "
        f"{pluralised(workers, 'process', 'processes')}, into {escape(str(directory))}: nothing was run (--dry-run)"
    )
    return 0


def learn(config: TrainingConfig, directory: Path, *, data: str | None, workers: int, begun: bool) -> int:
    """Begin or resume a training run in ``directory``, and return the exit code.

    ``data`` is the directory of the demonstrations, by default a folder of the run. ``workers`` is the number of
    processes, and ``begun`` says whether the run is resumed. The exit code is 0 if the run has a best checkpoint, 1
    without one, and 130 if stopped.
    """
    from activestructure_gym.evaluation.archive.directory_lock import hold

    console = make_console()
    began = time.monotonic()
    try:
        with hold(directory), Live(console) as live:
            if begun:
                console.print(f"going on with {escape(str(directory))}")
            best, validated = _run(config, directory, data, workers, live)
    except KeyboardInterrupt:
        words = f"asg train {config.method} --out {shlex.quote(str(directory))} --resume"
        if data:
            words += f" --data {shlex.quote(data)}"
        words += _trusting(config)
        complain(f"stopped; what is finished is kept, go on with: {words}")
        return 130
    console.print(
        f"{config.units} {_unit(config)}, {time.monotonic() - began:.0f} s"
        + ("" if best is None else f"; best validation: coverage {100 * best:.1f} %")
    )
    trust = _trusting(config).split()
    print_next(console, [["asg", "compare", "--policies", f"learned:{directory},pixel_only", *trust]])
    return 0 if validated else 1


def _trusting(config: TrainingConfig) -> str:
    """Return " --trust-code" if a training run's files name code outside this package, else an empty text."""
    from activestructure_gym.evaluation.archive.jobs import named_in_overrides

    features = (*config.world.features, config.teacher)
    named = named_in_overrides({**dict(config.world.overrides), "features": features})
    return " --trust-code" if any(registry.imports(name.name) for registry, name in named) else ""


def _run(
    config: TrainingConfig, directory: Path, data: str | None, workers: int, live: Live
) -> tuple[float | None, bool]:
    """Train by the configured method; return the best validation score, and whether a best checkpoint exists."""
    import torch

    from activestructure_gym.evaluation.archive.temporary import refuse_links
    from activestructure_gym.evaluation.training import demonstrations
    from activestructure_gym.evaluation.training.process_pool import one_thread
    from activestructure_gym.evaluation.training.runs import BEST, TrainingRun
    from activestructure_gym.evaluation.training.validation import Validation

    torch.set_num_threads(1)
    one_thread()
    run = TrainingRun(directory, config)
    episodes = Path(data) if data else directory / demonstrations.DATA
    _announce(config, run.position, episodes, workers, live)
    validate = Validation(config, directory, live.say)
    try:
        if config.method == "ppo":
            from activestructure_gym.evaluation.training.reinforcement import train_ppo, vector_env
            from activestructure_gym.evaluation.training.training_env import TrainingEnv, learning_layouts

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
            except (EOFError, ConnectionError) as error:
                raise InputError(
                    "the process of an environment was killed, perhaps because memory ran out: use --workers 1; "
                    "finished iterations are kept, and --resume goes on with them"
                ) from error
            finally:
                with suppress(EOFError, OSError):  # from a child that has ended; they must not hide the first error
                    envs.close()
        else:
            from activestructure_gym.evaluation.training.supervised import train_supervised

            refuse_links(directory, demonstrations.DATA)  # a directory given by --data may be a link
            live.begin(f"demonstrations of {config.teacher}", 1, 0)

            def update(done: int, total: int) -> None:
                live.files(done, total)
                run.timing.save()

            run.timing.switch("collecting")
            missing = demonstrations.collect(config, episodes, workers=workers, notify=update)
            states = demonstrations.load(config, episodes)
            if missing:
                run.timing.count("collecting", len(states))
            live.begin(f"{config.method} on {len(states)} states", config.units, run.position)
            train_supervised(config, states, run, validate, live.unit)
    finally:
        run.close()
    return run.best, (directory / BEST).is_file()


def _announce(config: TrainingConfig, position: int, episodes: Path, workers: int, live: Live) -> None:
    """Print the expected time of the rest of a run, whose first ``position`` units are finished."""
    from activestructure_gym.evaluation.training.demonstrations import missing_files
    from activestructure_gym.evaluation.training.forecast import forecast, run_trial

    files = 0 if config.method == "ppo" else len(missing_files(config, episodes))
    units = config.units - position
    if units or files:
        if config.method == "ppo":
            workers = min(core_count(), config.envs) if workers > 1 else 1
        wall, processor = forecast(config, run_trial(config), workers=workers, files=files, units=units)
        live.note(f"expected: {wall:.1f} minutes, {processor:.1f} processor minutes (from a short trial)")


def _unit(config: TrainingConfig) -> str:
    return "iterations" if config.method == "ppo" else "epochs"
