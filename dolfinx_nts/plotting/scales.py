"""Prefixes of units and rounded ranges, so that numbers in pictures are easy to read."""

import math

__all__ = ["prefixed", "rounded"]

# Prefixes by power of ten.
_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
# Steps between labels, as multiples of a power of ten [-].
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_INTERVALS = 4  # approximate number of steps between labels


def prefixed(value: float) -> tuple[float, str]:
    """SI prefix with which a number is between 0.1 and 100, if there is one.

    Args:
        value: The number; its sign is ignored.

    Returns:
        Divisor of numbers, and the prefix, as ``(1e3, "k")`` for 8000.
    """
    size = abs(value)
    power = 3 * math.floor((math.log10(size) + 1) / 3) if 0 < size < math.inf else 0
    power = max(min(power, max(_PREFIXES)), min(_PREFIXES))
    return 10.0**power, _PREFIXES[power]


def rounded(low: float, high: float) -> tuple[float, float, int]:
    """Widen a range to multiples of a step that is easy to read.

    Args:
        low: Smallest value.
        high: Largest value.

    Returns:
        Ends of the wider range, and number of labels.
    """
    if not high > low:
        return low, high, 2
    width = (high - low) / _INTERVALS
    unit = 10.0 ** math.floor(math.log10(width))
    step = unit * min(s for s in _STEPS if s * unit >= width * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return first * step, last * step, last - first + 1
