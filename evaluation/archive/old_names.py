"""Names that policies had in runs of older formats, and what they are called now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

# Up to format 2 the plain name was the gain with `hole_area` added, and the published rule alone had ``_pure``.
_WITH_COVERAGE = (
    "fisherrf", "gauss_mi", "popgs_cov_trace", "popgs_cov_trace_block", "popgs_info_trace", "popgs_logdet",
    "popgs_logdet_block", "popgs_min_eig",
)  # fmt: skip
RENAMED: Mapping[str, str] = {
    **{name: f"{name}_cov" for name in _WITH_COVERAGE},
    **{f"{name}_pure": name for name in _WITH_COVERAGE},
}
_LAST_FORMAT = 2


def current_name(policy: str, run_format: int) -> str:
    """What the policy of a stored run is called now; its options stay."""
    if run_format > _LAST_FORMAT:
        return policy
    name, mark, options = policy.partition("?")
    return RENAMED.get(name, name) + mark + options


def renamed_among(policies: Iterable[str], run_format: int) -> dict[str, str]:
    """Those of the policies of a stored comparison that have another name now, with that name."""
    found = {policy: current_name(policy, run_format) for policy in policies}
    return {old: new for old, new in found.items() if old != new}
