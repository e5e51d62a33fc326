"""Read and write the directory of a training run. A unit is an epoch, or for PPO an iteration.

- ``config.json``: configuration, versions and machine
- ``state.safetensors``: weights, optimiser and number of finished units; replaced atomically
- ``best.safetensors``, ``best.json``: checkpoint with the best validation score, loaded by `learned:DIRECTORY`
- ``last.safetensors``, ``last.json``: checkpoint of the last unit, written at the end
- ``log.jsonl``: one line per unit, without times; unit 0 is the checkpoint from which PPO started
- ``curve.svg``: chart of the log
- ``timing.json``: seconds of each part of the run, and the machine
- ``tensorboard/``: the log for TensorBoard, if it is installed
- ``demonstrations/``: training data of bc and rank
- ``references.json``: scores of random and the oracle on the validation layouts

The random numbers of a unit depend only on the seed and the unit's number. Its log line is written before its state.
Therefore a killed and resumed run ends with the same weights and the same log as an uninterrupted run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import named_in_overrides
from activestructure_gym.evaluation.archive.json_files import json_line, plain, read_json, write_json
from activestructure_gym.evaluation.archive.schema import Mismatch, checked_json, maybe, number, table
from activestructure_gym.evaluation.archive.temporary import refuse_links, unlinked
from activestructure_gym.evaluation.machine import hardware as machine
from activestructure_gym.evaluation.training.config import TrainingConfig
from activestructure_gym.evaluation.training.curve import learning_curve
from activestructure_gym.evaluation.training.stopwatch import Timing
from activestructure_gym.features import FEATURES
from activestructure_gym.files import UNFINISHED, replaced
from activestructure_gym.policies.learned.checkpoint import MAX_WEIGHT_BYTES
from activestructure_gym.registry import refuse_code

if TYPE_CHECKING:
    import torch

    from activestructure_gym.policies.learned.network import CandidateNetwork

CONFIG = "config.json"
STATE = "state.safetensors"
_TENSORBOARD = "tensorboard"  # a folder
LOG = "log.jsonl"
CURVE = "curve.svg"
TIMING = "timing.json"
BEST, LAST = "best.safetensors", "last.safetensors"
SCORE = "validation/auc"  # entry of a log row by which the best checkpoint is chosen
_META = "training"  # metadata entry of the state file: number of finished units and best score, as JSON
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # state of Adam and AdamW per parameter
_MAX_STATE_BYTES = 3 * MAX_WEIGHT_BYTES  # largest state file: the weights, and two moments per weight
_BEGIN_AGAIN = "begin the run again in another --out"
_ROW = table({"unit": number(0, whole=True)}, others=maybe(number()))
_STATE_NOTES = table({"position": number(0, whole=True), "best": maybe(number())})


def read_config(directory: Path) -> TrainingConfig:
    """Read the configuration of the training run in ``directory``.

    Raise `InputError` if it is missing or damaged, or if it names a plugin whose code the user has not trusted.
    """
    file = directory / CONFIG
    if not file.exists():
        raise InputError(f"'{directory}' holds no training run to go on with: it has no {CONFIG}")
    content = read_json(file, table({"training": table({"world": table()})}), remedy=_BEGIN_AGAIN)
    try:
        config = TrainingConfig.from_dict(content["training"])
    except InputError as error:
        raise InputError(f"'{file}' is damaged: {error}; {_BEGIN_AGAIN}") from error
    features = [(FEATURES, name) for name in (*config.world.features, config.teacher) if isinstance(name, str)]
    for registry, name in [*features, *named_in_overrides(dict(config.world.overrides))]:
        if registry.imports(name):
            refuse_code(registry.kind, name, file)
    return config


class TrainingRun:
    """Open the directory of a new or a stopped training run, and write its files.

    The caller must hold the directory's lock while the object is in use.
    """

    def __init__(self, directory: Path, config: TrainingConfig) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        refuse_links(directory, _TENSORBOARD)
        self.directory, self.config = directory, config
        self.position = 0  # number of finished units
        self.best: float | None = None  # best validation score so far
        self.tensors: dict[str, torch.Tensor] = {}  # of the last saved state; empty in a new run
        if (directory / CONFIG).is_file():
            if read_config(directory) != config:
                raise InputError(f"'{directory}' holds a training run of another configuration: choose another --out")
        else:
            record = {"training": config.as_dict(), "versions": machine.versions(), "hardware": machine.hardware()}
            write_json(directory / CONFIG, record)
        self._load()
        self._cut_log()
        self.timing = Timing(directory / TIMING)
        self._tensorboard = _tensorboard_writer(directory / _TENSORBOARD, self.position)

    def restore(self, module: torch.nn.Module, optimizer: torch.optim.Optimizer) -> None:
        """Load the saved weights into ``module`` and the saved moments into ``optimizer``.

        Raise `InputError` if their names or shapes do not fit.
        """
        weights = {name.removeprefix("module."): v for name, v in self.tensors.items() if name.startswith("module.")}
        expected = {name: value.shape for name, value in module.state_dict().items()}
        if {name: value.shape for name, value in weights.items()} != expected:
            raise self._damaged_state(Mismatch("it does not hold the weights of the configured network"))
        module.load_state_dict(weights)
        moments: dict[int, dict[str, torch.Tensor]] = {}
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        for name, value in self.tensors.items():
            kind, _, rest = name.partition(".")
            number, _, key = rest.partition(".")
            if kind != "optimizer":
                continue
            known = number.isdecimal() and len(number) < 10 and int(number) < len(parameters) and key in _MOMENTS
            if not known or value.shape != (() if key == "step" else parameters[int(number)].shape):
                raise self._damaged_state(Mismatch(f"it holds '{name[:80]}' of the shape {tuple(value.shape)}"))
            if key != "exp_avg" and bool((value < 0).any()):  # "step" is a count, "exp_avg_sq" a mean of squares
                raise self._damaged_state(Mismatch(f"it holds '{name[:80]}' below 0"))
            moments.setdefault(int(number), {})[key] = value
        if any(len(own) != len(_MOMENTS) for own in moments.values()):
            raise self._damaged_state(Mismatch("it lacks moments of the optimiser"))
        optimizer.load_state_dict({**optimizer.state_dict(), "state": moments})

    @property
    def ended(self) -> bool:
        """Return whether all units are finished."""
        return self.position >= self.config.units

    def finish_unit(
        self, row: Mapping[str, float], network: CandidateNetwork, tensors: Mapping[str, torch.Tensor]
    ) -> None:
        """Log the unit that has just ended, write its checkpoint if it is the best, and save the state.

        ``row`` is its line of the log, and ``tensors`` are the weights and the state of the optimiser.
        """
        self.keep_if_best(row, network, self.position + 1)
        self.position += 1
        self._log(row)
        if self.ended:  # written before the state, so a run whose state says that it has ended has this checkpoint
            self._checkpoint(LAST, row, network, self.position)
        self._save(tensors)
        self.timing.save()

    def begin_with(self, row: Mapping[str, float], network: CandidateNetwork) -> None:
        """Log the scores ``row`` of the network from which PPO starts as unit 0, and write it as best checkpoint."""
        self.keep_if_best(row, network, 0)
        self._log(row)

    def keep_if_best(self, row: Mapping[str, float], network: CandidateNetwork, position: int) -> None:
        """Write the network as the best checkpoint if ``row`` has a validation score above the best so far.

        ``position`` is the number of the unit.
        """
        score = row.get(SCORE)
        if score is not None and (self.best is None or score > self.best):
            self.best = score
            self._checkpoint(BEST, row, network, position)

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of the log, one per unit."""
        file = self.directory / LOG
        if not file.is_file():
            return []
        try:
            lines = file.read_bytes().splitlines(keepends=True)
            return [checked_json(line, _ROW) for line in lines if line.endswith(b"\n") and line.strip()]
        except (OSError, Mismatch) as error:
            raise InputError(f"'{file}' is damaged: {error}; {_BEGIN_AGAIN}") from error

    def close(self) -> None:
        """Stop the stopwatch and close the TensorBoard log."""
        self.timing.switch(None)
        self.timing.save()
        if self._tensorboard is not None:
            self._tensorboard.close()

    def _checkpoint(self, name: str, row: Mapping[str, float], network: CandidateNetwork, position: int) -> None:
        from activestructure_gym.policies.learned.checkpoint import save_checkpoint

        notes = {"configuration": self.config.as_dict(), "unit": position, "log": dict(row)}
        save_checkpoint(self.directory / name, network, plain(notes) | {"versions": machine.versions()})

    def _log(self, row: Mapping[str, float]) -> None:
        with open(unlinked(self.directory / LOG), "a", encoding="utf-8") as file:
            file.write(json_line({"unit": self.position, **row}))
            file.flush()
            os.fsync(file.fileno())
        picture = learning_curve(self.config.method, self.rows())
        if picture is not None:
            self._replace(CURVE, picture.encode())
        if self._tensorboard is not None:
            for name, value in row.items():
                self._tensorboard.add_scalar(name, value, self.position)
            self._tensorboard.flush()

    def _save(self, tensors: Mapping[str, torch.Tensor]) -> None:
        from safetensors.torch import save

        self.tensors = {name: tensor.contiguous() for name, tensor in tensors.items()}
        meta = {"position": self.position, "best": self.best}
        self._replace(STATE, save(self.tensors, {_META: json.dumps(meta)}))

    def _replace(self, name: str, content: bytes) -> None:
        """Write ``content`` atomically to the file ``name`` of the directory."""
        with replaced(self.directory / name, durable=True) as file:
            file.write(content)

    def _load(self) -> None:
        from activestructure_gym.policies.learned.checkpoint import read_tensors

        for temporary in self.directory.glob(UNFINISHED):
            temporary.unlink(missing_ok=True)
        file = self.directory / STATE
        if not file.is_file():
            return
        try:
            self.tensors, notes = read_tensors(file, most=_MAX_STATE_BYTES)
            meta = checked_json(notes.get(_META, "").encode(), _STATE_NOTES)
            if meta["position"] > self.config.units:
                raise Mismatch(f"it is of unit {meta['position']}, of {self.config.units}")
        except (InputError, Mismatch) as error:
            raise self._damaged_state(error) from error
        self.position, self.best = meta["position"], meta["best"]

    def _damaged_state(self, reason: Exception) -> InputError:
        return InputError(f"'{self.directory / STATE}' is damaged: {reason}; {_BEGIN_AGAIN}")

    def _cut_log(self) -> None:
        """Remove the log lines of units after the last saved state, since these units are repeated."""
        if not (self.directory / LOG).is_file():
            return
        kept = [row for row in self.rows() if row["unit"] <= self.position] if self.position else []
        self._replace(LOG, "".join(json_line(row) for row in kept).encode())


def optimizer_tensors(optimizer: torch.optim.Optimizer) -> dict[str, torch.Tensor]:
    """Return the state of an optimiser as tensors with names such as "optimizer.3.exp_avg", for a safetensors file."""
    state = optimizer.state_dict()["state"]
    return {f"optimizer.{n}.{key}": value for n, entries in state.items() for key, value in entries.items()}


def module_tensors(module: torch.nn.Module) -> dict[str, torch.Tensor]:
    """Return copies of a module's weights, with names such as "module.critic.bias", for a safetensors file."""
    return {f"module.{name}": value.detach().clone() for name, value in module.state_dict().items()}


def _tensorboard_writer(directory: Path, done: int) -> Any:
    """Return TensorBoard's writer for ``directory``, or None if TensorBoard is not installed.

    Its numbers are also in the log. Rows after the first ``done`` units are removed, since these units are repeated.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(directory), purge_step=done + 1 if done else 0)
