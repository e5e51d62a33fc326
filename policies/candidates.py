"""Define `Candidates`: the candidate views of one observation with their features by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, candidate_columns, feature_columns
from activestructure_gym.errors import InputError

Observation = dict[str, np.ndarray]

(_LENGTH,), (_FRAMES,), (_REVISIT,) = (candidate_columns(name) for name in ("path_length", "frames", "revisit"))
_XYZ, _LOOK = candidate_columns("x", "y", "z"), candidate_columns("look_x", "look_y", "look_z")


def check_observation(observation: Any, reader: str = "a policy") -> None:
    """Raise `InputError` if ``observation`` is the whole tuple that ``env.reset`` or ``env.step`` returns."""
    if isinstance(observation, tuple):
        raise InputError(
            f"{reader} chooses from an observation, got a tuple of {len(observation)} things, as reset() and step() "
            "return them; take it out first: observation, info = env.reset(seed=0)"
        )


class Candidates:
    """Read the K candidate views of an observation by name. The arrays are views of it: do not change them.

    Parameters
    ----------
    observation : mapping of str to array
        Observation of one env, as `ReconstructionEnv` returns it.
    columns : sequence of str, optional
        Full names of the columns of ``candidate_features``, in order: ``env.config.features`` or
        ``info["features"]``. Without them no feature can be read.
    reader : str
        Name of the reading class or function in error messages.
    rows : sequence of str
        Names of the columns of ``candidates``: ``env.observation_space["candidates"].names``.

    Raises
    ------
    InputError
        The observation is a tuple, such as ``env.reset`` and ``env.step`` return.

    Examples
    --------
    >>> import numpy as np
    >>> views = {"candidates": np.array([[0, 0, 1, 1, 0, 0, 2.5, 30, 0]]), "action_mask": np.array([1])}
    >>> seen = Candidates(views | {"candidate_features": np.array([[0.25]])}, ("pixel",))
    >>> seen.path_length, seen.valid, seen["pixel"]
    (array([2.5]), array([ True]), array([0.25]))
    """

    def __init__(
        self,
        observation: Mapping[str, np.ndarray],
        columns: Sequence[str] | None = None,
        reader: str = "this policy",
        rows: Sequence[str] = CANDIDATE_COLUMNS,
    ) -> None:
        check_observation(observation, reader)
        self._observation, self._columns, self._reader, self._rows = observation, columns, reader, rows

    def __len__(self) -> int:
        return len(self._observation["action_mask"])

    @property
    def xyz(self) -> np.ndarray:  # [K, 3]
        """Return the camera positions of the candidates in metres, world."""
        return self._table[:, _XYZ]

    @property
    def view_direction(self) -> np.ndarray:  # [K, 3]
        """Return the view directions of the candidates as unit vectors, world; 0 in rows without a candidate."""
        return self._table[:, _LOOK]

    @property
    def path_length(self) -> np.ndarray:  # [K]
        """Return the length in metres of the shortest path through known free space to each candidate."""
        return self._table[:, _LENGTH]

    @property
    def frames(self) -> np.ndarray:  # [K]
        """Return the number of frames of the motion along the grid path; the executed path can be slightly shorter."""
        return self._table[:, _FRAMES]

    @property
    def revisit(self) -> np.ndarray:  # [K] bool
        """Return which candidates are revisits: views with the pose of a stored keyframe."""
        return self._table[:, _REVISIT] > 0

    @property
    def valid(self) -> np.ndarray:  # [K] bool, a new array
        """Return which rows hold a candidate."""
        return self._observation["action_mask"].astype(bool)

    @property
    def views(self) -> np.ndarray:  # [K] bool, a new array
        """Return which rows hold a view; other valid rows end the episode or switch stages, and their features are 0.

        Of the sources, only ``finish`` is known to end the episode.
        """
        others = [name for name in self._rows if name.startswith("ask_") or name.partition("?")[0] == "from_finish"]
        rows = self.valid
        for name in others:
            rows &= ~(self._row(name) > 0)
        return rows

    def offers(self, source: str) -> bool:
        """Return whether the env has this candidate source in any stage, such as ``"lattice?spacing_m=1"``."""
        return f"from_{source}" in self._rows or (source == "pool" and tuple(self._rows) == CANDIDATE_COLUMNS)

    def source(self, name: str) -> np.ndarray:  # [K] bool
        """Return which rows come from a candidate source; raise `InputError` if the env does not have it."""
        if not self.offers(name):
            known = [column.removeprefix("from_") for column in self._rows if column.startswith("from_")] or ["pool"]
            raise InputError(
                f"{self._reader} asks for the candidate source '{name}', and the env it is bound to offers "
                f"{listed(known)}: name it in views.stages of the configuration"
            )
        return self._row(f"from_{name}") > 0 if f"from_{name}" in self._rows else self.valid

    def stage_switch(self, stage: int) -> int | None:
        """Return the row that switches to ``stage`` (counted from 0) of the candidate sources.

        The result is None if the stage is active, or if it was active since the last step that cost a frame.
        """
        column = f"ask_{stage}"
        rows = np.nonzero(self._row(column) > 0)[0] if column in self._rows else np.zeros(0, int)
        return int(rows[0]) if len(rows) else None

    @property
    def stay(self) -> np.ndarray:  # [K]
        """Return the number of rounds of optimisation in place for each candidate; 0 for a motion."""
        return self._row("stay") if "stay" in self._rows else np.zeros(len(self), np.float32)

    @property
    def fixation_point(self) -> np.ndarray:  # [K, 3]
        """Return the point (metres, world) that the camera faces along the path to each candidate; NaN for none."""
        if "fixates" not in self._rows:
            return np.full((len(self), 3), np.nan, np.float32)
        points = np.stack([self._row(f"at_{axis}") for axis in "xyz"], axis=-1)
        return np.where(self._row("fixates")[:, None] > 0, points, np.float32(np.nan))

    def _row(self, column: str) -> np.ndarray:  # [K]
        """Return the named column of the candidate table."""
        return self._table[:, list(self._rows).index(column)]

    def __getitem__(self, column: str) -> np.ndarray:  # [K]
        """Return the feature column of this full name, such as ``"hole_area"`` or ``"gs_planner_volume"``.

        Raises `InputError` if the names of the columns are not known, or if the name is not among them.
        """
        return self._columns_of(column, (column,))[:, 0]

    def feature(self, name: str) -> np.ndarray:  # [K, C]
        """Return all columns of a feature; raise `InputError` if it is unknown or not in the observation."""
        return self._columns_of(name, None)

    @property
    def _table(self) -> np.ndarray:  # [K, 9 and more]
        return self._observation["candidates"]

    def _columns_of(self, feature: str, names: tuple[str, ...] | None) -> np.ndarray:  # [K, C]
        """Return the feature columns ``names``; if None, all columns of ``feature``.

        Raises `InputError` if the names of the columns are not known, or if one is not among them.
        """
        known, table, reader = self._columns, self._observation["candidate_features"], self._reader
        if known is None:
            raise InputError(
                f"{reader} is not bound, so the column of the feature '{feature}' is unknown: call policy.bind(env) "
                "before act(), or make both with env, policy = make_env_and_policy(...)"
            )
        if table.shape[1:] != (len(known),):
            raise InputError(
                f"{reader} is bound to an env with the features {listed(known)}, but this observation's "
                f"candidate_features has the shape {table.shape}: call policy.bind(env) with the env that made it"
            )
        names = feature_columns(feature) if names is None else names
        if not set(names) <= set(known):
            raise InputError(
                f"{reader} reads the feature '{feature}', and the env offers {listed(known)}: name it in "
                "required_features"
            )
        return table[:, [known.index(name) for name in names]]


def listed(names: Sequence[str]) -> str:
    """Return the names joined by commas, for a message; "none" if there are none."""
    return ", ".join(names) or "none"
