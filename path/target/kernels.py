"""The middle of a surface's depths, compiled; ``path.target.place`` says what it means."""

from __future__ import annotations

from path.arrays import Array, Depths
from path.compiled import inner, kernel

MAD_TO_SIGMA = 1.4826
OUTLIER_SIGMAS = 3.0


@inner
def median(values: Array, n: int) -> float:
    """Return the median of the first ``n`` values (Hoare's selection).

    It puts them into another order.
    """
    k = n // 2
    low = 0
    high = n - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i = low
        j = high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    if n % 2 == 1:
        return values[k]
    below = values[0]
    for i in range(1, k):
        below = max(below, values[i])
    return (below + values[k]) / 2.0


@kernel
def middle(
    depths_mm: Depths,
    least_mm: float,
    most_mm: float,
    sigma_at_1m_m: float,
    room: Array,
) -> tuple[int, float, float]:
    """Return how many depths are within the limits, their spread, and a median, mm.

    The median is of those near their median.

    Args:
        depths_mm: shape (n,), contiguous.
        sigma_at_1m_m: standard deviation of depth at 1 m, which grows with its square: the spread
            is never less.
        room: for as many numbers.
    """
    count = 0
    for depth in depths_mm:
        if least_mm <= depth <= most_mm:
            room[count] = depth
            count += 1
    if count == 0:
        return 0, 0.0, 0.0
    about = median(room, count)
    for i in range(count):
        room[i] = abs(room[i] - about)
    about_m = about / 1000.0
    spread = max(MAD_TO_SIGMA * median(room, count), 1000.0 * (sigma_at_1m_m * about_m * about_m))
    near = 0
    for depth in depths_mm:
        if least_mm <= depth <= most_mm and abs(depth - about) <= OUTLIER_SIGMAS * spread:
            room[near] = depth
            near += 1
    return count, spread, median(room, near)
