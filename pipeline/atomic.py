"""Files and folders that are there whole or not at all."""

import ctypes
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from pipeline.errors import InputError

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


@contextmanager
def whole_file(path: Path) -> Iterator[TextIO]:
    """Open a text file for writing that takes the place of `path` only when the block ends without an error.

    Raises
    ------
    InputError
        If the folder is missing or not writable, or `path` is a folder.
    """
    with _replacing(path) as handle, os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
        yield file


def whole_bytes(path: Path, content: bytes) -> None:
    """Write a binary file that takes the place of `path` only when all of it is written.

    Raises
    ------
    InputError
        If the folder is missing or not writable, or `path` is a folder.
    """
    with _replacing(path) as handle, os.fdopen(handle, "wb") as file:
        file.write(content)


@contextmanager
def _replacing(path: Path) -> Iterator[int]:
    """Descriptor of a new file, for the block to write and close, that takes the place of `path` if it ends well."""
    if path.is_dir():
        raise InputError(path, "is a folder", "give a path of a file")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise InputError(path, f"cannot be written ({error.strerror})", "give a path in a writable folder") from None
    try:
        yield handle
        os.chmod(name, 0o644)  # mkstemp makes files private; results are for sharing
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


@contextmanager
def whole_folder(folder: Path, ours: Callable[[str], bool], what: str) -> Iterator[Path]:
    """Give an empty hidden folder beside `folder`, which takes the place of `folder` if the block ends well.

    What lay there before stays as it was until then, also if the process is killed. What a killed process left is
    removed by the next write to the same place.

    Parameters
    ----------
    folder : the place to fill; its parents are made.
    ours : says whether a file of this name belongs to what is written, and may be replaced.
    what : what is written, with its article: "a report".

    Raises
    ------
    InputError
        If `folder` holds something that is not ours, or cannot be written.
    """
    folder = Path(os.path.abspath(folder))
    refuse_strangers(folder, ours, what)
    part = folder.with_name(f".{folder.name}.part-{os.getpid()}")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _clear_leftovers(folder)
        part.mkdir()
    except OSError as error:
        right = "a place where a folder can be made is needed"
        raise InputError(folder, f"cannot be written ({error.strerror})", right) from error
    try:
        yield part
        refuse_strangers(folder, ours, what)
        if folder.exists():
            _exchange(part, folder)
        else:
            part.rename(folder)
    finally:
        # What lies here now is the earlier folder, or an unfinished one.
        shutil.rmtree(part, ignore_errors=True)


def refuse_strangers(folder: Path, ours: Callable[[str], bool], what: str) -> None:
    """Raise `InputError` if `folder` is a file or holds anything that is not ours; arguments as of `whole_folder`."""
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "a file, not a folder", f"a folder for {what}, or a new one, is needed")
    strangers = sorted(p.name for p in folder.glob("*") if not ours(p.name))
    if strangers:
        right = f"a new or empty folder, or one that holds {what} only, is needed: it is replaced whole"
        raise InputError(folder, f"holds {strangers[0]!r}, which is not part of {what}", right)


def _clear_leftovers(folder: Path) -> None:
    """Remove the unfinished folders of processes that are no more; put back an earlier one that they had set aside."""
    aside = folder.with_name(f".{folder.name}.earlier")
    if aside.exists() and not folder.exists():
        aside.rename(folder)
    shutil.rmtree(aside, ignore_errors=True)
    for left in folder.parent.glob(f".{folder.name}.part-*"):
        if not _alive(int(left.name.rpartition("-")[2])):
            shutil.rmtree(left, ignore_errors=True)


def _alive(process: int) -> bool:
    if process == os.getpid():
        return False  # a folder of this number is a namesake's
    with suppress(ProcessLookupError):
        os.kill(process, 0)
        return True
    return False


def _exchange(part: Path, folder: Path) -> None:
    """Let the two folders change places."""
    if sys.platform == "linux":
        # One step for the file system, so that no moment is without the folder: renameat2(2).
        libc = ctypes.CDLL(None, use_errno=True)
        if hasattr(libc, "renameat2") and not libc.renameat2(
            _AT_FDCWD, os.fsencode(part), _AT_FDCWD, os.fsencode(folder), _RENAME_EXCHANGE
        ):
            return
    # Two steps elsewhere; `_clear_leftovers` mends a stop between them.
    aside = folder.with_name(f".{folder.name}.earlier")
    folder.rename(aside)
    part.rename(folder)
    shutil.rmtree(aside, ignore_errors=True)
