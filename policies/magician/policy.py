"""MAGICIAN as a policy ([magician])."""

from __future__ import annotations

from typing import Literal, get_args

from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import POLICIES, Observation, best_valid, nearest_new, without_revisits
from activestructure_gym.policies.greedy import Planner, Travel

Search = Literal["beam", "greedy"]


@POLICIES.register("magician")
class Magician(Planner):
    """plan* = argmax sum of G over its views, G the imagined surface that no earlier one of the plan has seen.

    Its first view is taken, then everything is planned anew. By abstract and digest of [magician], without
    equation numbers.

    Parameters
    ----------
    search
        ``"beam"`` plans ahead; ``"greedy"`` takes the view that alone sees most of it, the paper's N_b = N_d = 1.
    """

    criterion = "imagined surface that a plan of several views would see"
    travel_term = "frames bound the plan"
    source = "by a digest of Li et al., MAGICIAN, CVPR 2026"
    required_features = ("magician",)

    def __init__(self, travel: Travel = "native", search: Search = "beam") -> None:
        super().__init__(travel)
        if search not in get_args(Search):
            raise InputError(f"option search must be {' or '.join(get_args(Search))}, got '{search}'")
        self.search = search

    def act(self, observation: Observation) -> int:
        """The valid row that the best plan begins with; the nearest new view where nothing is imagined in sight."""
        observation = without_revisits(observation)
        candidates = self.candidates(observation)
        gain = candidates["magician_plan" if self.search == "beam" else "magician_view"]
        if gain[candidates.valid].any():
            choice = best_valid(self.scores(gain, observation), observation)
        else:
            choice = nearest_new(observation)
        plan, view = (float(candidates[f"magician_{name}"][choice]) for name in ("plan", "view"))
        self._trace = {"plan": plan, "view": view, "travel": float(self.travel_factor(observation)[choice])}
        return choice
