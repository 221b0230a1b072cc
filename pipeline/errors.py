"""The errors a user can cause. Each is one line that names the place, what was found and what is right."""

from difflib import get_close_matches
from pathlib import Path


class YarnvalError(Exception):
    """Base of every error that is shown to the user as one line, with exit code 2."""


class InputError(YarnvalError):
    """An input or a call is wrong.

    Parameters
    ----------
    where : the file, and the line, key or column in it.
    found : what stands there.
    right : what would be right.
    """

    def __init__(self, where: str | Path, found: str, right: str):
        super().__init__(where, found, right)  # as given, so that the error survives the way between processes

    def __str__(self) -> str:
        where, found, right = self.args
        return f"{where}: {found}; {right}"


def nearest(name: str, known: list[str]) -> str:
    """Say which known name an unknown one was probably meant to be, or list the known ones."""
    close = get_close_matches(name, known, n=1)
    return f"did you mean '{close[0]}'?" if close else f"known: {', '.join(sorted(known))}"


def refuse_unknown(where: str | Path, what: str, name: str, known: list[str]) -> None:
    """Raise an `InputError` that names the nearest known name, unless `name` is a known one."""
    if name not in known:
        raise InputError(where, f"unknown {what} '{name}'", nearest(name, known))
