"""The elimination of models/newton.py against LAPACK, and where there is nothing to eliminate."""

import numpy as np
import pytest

from models.newton import lu_factor, lu_solve


@pytest.mark.parametrize("n", [1, 2, 3, 6, 31])
def test_it_solves_what_lapack_solves(n: int) -> None:
    rng = np.random.default_rng(n)
    matrix, right = rng.standard_normal((n, n)), rng.standard_normal(n)
    factors, pivots = matrix.copy(), np.empty(n, np.int64)
    assert lu_factor(factors, pivots)
    np.testing.assert_allclose(lu_solve(factors, pivots, right), np.linalg.solve(matrix, right), rtol=1e-11)


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_a_singular_matrix_is_told_and_leaves_pivots_inside_of_it(rank: int) -> None:
    """Left as they were, they sent the next solve to memory of others: a frame of noise 17 rows high was enough."""
    matrix, pivots = np.diag(np.arange(4) < rank).astype(float), np.full(4, 2**40)
    assert not lu_factor(matrix, pivots)
    assert np.all((pivots >= 0) & (pivots < 4))
