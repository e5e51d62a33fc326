"""Define MAGICIAN ([magician]): plan several views over imagined surface by a beam search."""

from __future__ import annotations

from typing import Literal, get_args

from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import POLICIES, Observation, best_valid, nearest_new, without_revisits
from activestructure_gym.policies.greedy import Planner, Travel

Search = Literal["beam", "greedy"]


@POLICIES.register("magician")
class Magician(Planner):
    """Choose the first view of plan* = argmax of the sum of G over its views.

    G is the imagined surface that a view sees and that no earlier view of the plan has seen. Imagined surface extends
    the known planes through unseen space (feature `magician`). Each decision plans anew. The source is the abstract and
    a summary of [magician], without equation numbers.

    Parameters
    ----------
    search
        ``"beam"`` plans several views. ``"greedy"`` scores a view by its own G, the paper's N_b = N_d = 1.
    """

    criterion = "imagined surface that a plan of several views would see"
    travel_term = "frames bound the plan"
    source = "by a digest of Li et al., MAGICIAN, CVPR 2026"
    required_features = ("magician",)

    def __init__(self, travel: Travel = "native", search: Search = "beam") -> None:
        """Store the travel term and the kind of search; raise `InputError` for an unknown kind."""
        super().__init__(travel)
        if search not in get_args(Search):
            raise InputError(f"option search must be {' or '.join(get_args(Search))}, got '{search}'")
        self.search = search

    def act(self, observation: Observation) -> int:
        """Return the first view of the best plan.

        If no plan sees imagined surface, for it is too far away, the view that sees most is chosen; if none does, the
        nearest new view.
        """
        observation = without_revisits(observation)
        candidates = self.candidates(observation)
        gain = candidates["magician_plan" if self.search == "beam" else "magician_view"]
        if not gain[candidates.valid].any():
            gain = candidates["magician_view"]
        if gain[candidates.valid].any():
            choice = best_valid(self.scores(gain, observation), observation)
        else:
            choice = nearest_new(observation)
        plan, view = (float(candidates[f"magician_{name}"][choice]) for name in ("plan", "view"))
        self._trace = {"plan": plan, "view": view, "travel": float(self.travel_factor(observation)[choice])}
        return choice
