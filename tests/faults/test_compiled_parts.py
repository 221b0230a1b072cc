"""What compiled code may leave uncounted."""

import numpy as np
import pytest
from numpy.typing import NDArray

from models.compiled import borrowing, compiled


def _total(values: NDArray[np.float64]) -> float:
    total = 0.0
    for value in values:
        total += value
    return total


def _tail(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[1:]


total = borrowing(_total)


@compiled
def doubled(values: NDArray[np.float64]) -> float:
    return 2 * total(values)


def test_a_function_that_borrows_its_arrays_computes_the_same():
    values = np.arange(5.0)
    assert doubled(values) == total(values) + total(values) == 20.0


def test_a_function_that_returns_an_array_may_not_borrow():
    with pytest.raises(TypeError, match=r"_tail: returns .*only numbers"):
        borrowing(_tail)
