"""The paper's results (arXiv 2011.00400), to stand next to ours."""

from __future__ import annotations

METHODS = ("dwa", "A", "A+c", "A+B", "A+B+c", "A+B+D", "A+B+D+c")  # "+c" = with the confidence measure

# Tables II and III: traversal time [s], mean and standard deviation of 5 trials, stuck = 200 s. The paper's APPLI (A)
# is A+c, its APPLI (A+B) is A+B+c, its full demonstration is A+B+D+c.
COURSES: dict[str, dict[str, tuple[float, float]]] = {
    "training": {"dwa": (134.0, 60.6), "A+c": (77.4, 2.8), "A+B+c": (70.6, 3.2), "A+B+D+c": (78.0, 2.7)},
    "unseen": {"dwa": (109.2, 50.8), "A+c": (71.0, 0.7), "A+B+c": (59.0, 0.7), "A+B+D+c": (62.0, 2.0)},
}
COURSE_NAMES = {"dwa": "default", "A+c": "APPLI (A)", "A+B+c": "APPLI (A+B)", "A+B+D+c": "full demonstration"}

# Table IV: percentage of the 300 BARN worlds in which the row is significantly worse than the column, in its order.
TABLE_IV_ORDER = ("A", "dwa", "A+c", "A+B+D+c", "A+B+D", "A+B+c", "A+B")
_TABLE_IV = (
    (0, 50, 53, 62, 63, 68, 66),
    (10, 0, 6, 33, 40, 44, 47),
    (6, 4, 0, 31, 37, 45, 45),
    (5, 7, 11, 0, 25, 31, 33),
    (5, 7, 7, 10, 0, 21, 21),
    (3, 3, 4, 3, 5, 0, 9),
    (2, 5, 5, 6, 4, 6, 0),
)
TABLE_IV: dict[tuple[str, str], int] = {
    (row, column): value
    for row, values in zip(TABLE_IV_ORDER, _TABLE_IV, strict=True)
    for column, value in zip(TABLE_IV_ORDER, values, strict=True)
    if row != column
}


def in_order(names: set[str], order: tuple[str, ...] = METHODS) -> tuple[str, ...]:
    """Names in the paper's order; what the paper does not have comes last, by name."""
    return (*(name for name in order if name in names), *sorted(names - set(order)))
