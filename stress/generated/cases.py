"""All generated cases."""

from stress.generated import deep_starts, far_steps, kinks, leading_edges, sharp_tips

__all__ = ["ALL_CASES"]

ALL_CASES = [
    *far_steps.CASES,
    *kinks.CASES,
    *leading_edges.CASES,
    *deep_starts.CASES,
    *sharp_tips.CASES,
]
