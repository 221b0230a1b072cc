"""Compilation to machine code by numba, kept on disk until a source file changes that it may have been made from.

numba's own check looks only at the file of the outermost function, so a changed equation in another file would go
unseen: here the place on disk is named after the content of this package's sources, and of those beside the function.
"""

import hashlib
import inspect
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast, get_args, get_type_hints

import numba
from numba.core import config
from numba.extending import overload, typeof_impl  # pyright: ignore[reportUnknownVariableType]

Function = TypeVar("Function", bound=Callable[..., Any])

PART: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Settings of what compiled code calls: ways in for other callers took a fifth of the compile time."""


@cache
def _cache_folder(package: Path) -> str:
    """Where machine code of functions in the folder `package` is kept."""
    here = Path(__file__).parent
    sources = sorted({*here.rglob("*.py"), *package.rglob("*.py")})
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]
    beside = package / "__pycache__"
    if not os.access(beside if beside.is_dir() else package, os.W_OK):
        beside = Path.home() / ".cache" / "yarnval"  # never a folder that others may write to: machine code is run
    return str(beside / f"{package.name}-{digest}")


def compiled(function: Function) -> Function:
    """Compile on the first call and keep the machine code on disk."""
    settings: Any = config  # numba makes its settings at import, where no type checker sees them
    shared = settings.CACHE_DIR
    settings.CACHE_DIR = _cache_folder(Path(inspect.getfile(function)).parent)
    try:
        return cast(Function, numba.njit(cache=True, error_model="numpy", nogil=True)(function))
    finally:
        settings.CACHE_DIR = shared


ANY_ORDER: dict[str, Any] = {"fastmath": {"reassoc"}}
"""Setting of sums whose terms may be added up in any order: only those become vector instructions."""
NUMBERS = {float, int, bool, type(None)}
"""What functions may return whose references are not counted."""


class _Part:
    """A part of compiled code. Called from elsewhere it runs as plain Python."""

    def __init__(self, function: Callable[..., Any], settings: dict[str, Any]):
        self.function, self.compiled = function, numba.njit(**settings)(function)

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)


@typeof_impl.register(_Part)
def _type_of_part(part: _Part, _: Any) -> Any:
    return numba.types.Dispatcher(part.compiled)


def inner(function: Function) -> Function:
    """Compile as a part of the compiled functions that call it."""
    return cast(Function, _Part(function, PART))


def borrowing(function: Function) -> Function:
    """Compile in the place of each call, references uncounted; for functions that make no arrays and return numbers.

    numba counts references to every array of every argument at each call, by atomic operations, up to twenty in a group
    of arrays: half the time of the fast mode's package. The callers hold the arrays meanwhile. And a call passes each
    array as seven numbers, 190 in all for a package and its room: a sixth of the time that was left.

    Raises
    ------
    TypeError
        If the function does not say that it returns numbers, or nothing: an array would be freed too early.
    """
    return _borrowing(function, {})


def borrowing_sums(function: Function) -> Function:
    """Compile as `borrowing`, for sums whose terms may be added up in any order, as `summing`.

    Raises
    ------
    TypeError
        As `borrowing`.
    """
    return _borrowing(function, ANY_ORDER)


def borrowing_apart(function: Function) -> Function:
    """Compile as `borrowing`, but not in the place of each call: large functions would be compiled again at each.

    Raises
    ------
    TypeError
        As `borrowing`.
    """
    return _borrowing(function, {"forceinline": False})


def _borrowing(function: Function, settings: dict[str, Any]) -> Function:
    returned = get_type_hints(function)["return"]
    if not {*(get_args(returned) or (returned,))} <= NUMBERS:
        raise TypeError(f"{function.__name__}: returns {returned}; only numbers may be returned uncounted")
    return cast(Function, _Part(function, {**PART, "_nrt": False, "forceinline": True, **settings}))


def merged(function: Function) -> Function:
    """Compile as a part of the loops that call it: without a call between them they can become vector instructions."""
    return cast(Function, _Part(function, {**PART, "forceinline": True}))


def summing(function: Function) -> Function:
    """Compile as `inner`, for sums whose terms may be added up in any order."""
    return cast(Function, _Part(function, {**PART, **ANY_ORDER}))


def spliced(function: Function) -> Function:
    """Compile in the place of each call, for thin layers: apart, each costs the compile time of all that it calls."""
    return cast(Function, numba.njit(error_model="numpy", inline="always")(function))


def implement(
    generic: Callable[..., Any], kind: type[Any], implementation: Callable[..., Any], *, merge: bool = False
) -> None:
    """Let compiled calls of `generic` run `implementation` where the first argument is a NamedTuple of type `kind`.

    This, rather than a function as an argument: machine code that holds a function's address cannot be kept on disk.
    Both functions must name their arguments alike. With `merge` there is no call left, as for `merged`.
    """
    own = _plain(implementation)
    _overload(generic, lambda first: own if getattr(first, "instance_class", None) is kind else None, merge=merge)


def implement_complex(generic: Callable[..., Any], implementation: Callable[..., Any]) -> None:
    """Let compiled calls of `generic` run `implementation` for a complex first argument and its own code for others."""
    own, real = _plain(implementation), _plain(generic)
    _overload(generic, lambda first: own if isinstance(first, numba.types.Complex) else real, merge=True)


def _plain(function: Callable[..., Any]) -> FunctionType:
    """The function without annotations, which numba would compare with those of the choosing function."""
    given = cast(FunctionType, function)
    return FunctionType(given.__code__, given.__globals__, given.__name__, given.__defaults__, given.__closure__)


def _overload(generic: Callable[..., Any], pick: Callable[[Any], Callable[..., Any] | None], *, merge: bool) -> None:
    def choose(first: Any, *_: Any) -> Callable[..., Any] | None:
        return pick(first)

    choose.__signature__ = inspect.signature(_plain(generic))  # pyright: ignore[reportFunctionMemberAccess]
    settings: Any = {**PART, "forceinline": merge}
    overload(generic, jit_options=settings)(choose)
