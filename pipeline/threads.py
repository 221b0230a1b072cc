"""How many threads linear algebra may use."""

from contextlib import AbstractContextManager
from typing import Any

from threadpoolctl import ThreadpoolController

_BLAS = ThreadpoolController()


def one_thread() -> AbstractContextManager[Any]:
    """Keep linear algebra to one thread in a block of solves: on matrices this small, more only wait for each other."""
    return _BLAS.limit(limits=1)
