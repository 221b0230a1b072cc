"""What compiled code may leave uncounted."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from models.compiled import borrowing, borrowing_apart, borrowing_sums, compiled


def _total(values: NDArray[np.float64]) -> float:
    total = 0.0
    for value in values:
        total += value
    return total


def _tail(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[1:]


total, total_apart, total_in_any_order = borrowing(_total), borrowing_apart(_total), borrowing_sums(_total)


@compiled
def totals(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return total(values), total_apart(values), total_in_any_order(values)


def test_a_function_that_borrows_its_arrays_computes_the_same():
    values = np.arange(5.0)
    assert totals(values) == (total(values),) * 3 == (10.0,) * 3


@pytest.mark.parametrize("decorate", [borrowing, borrowing_apart, borrowing_sums])
def test_a_function_that_returns_an_array_may_not_borrow(decorate: Callable[..., Any]):
    with pytest.raises(TypeError, match=r"_tail: returns .*only numbers"):
        decorate(_tail)
