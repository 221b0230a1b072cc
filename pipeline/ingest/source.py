"""Where data came from: the name, size and SHA-256 of a file."""

import hashlib
from pathlib import Path

from pipeline.errors import InputError
from pipeline.records import Source


def source(path: Path, root: Path | None = None, *, hashed: bool = True) -> Source:
    """Identify a file by its bytes, read in blocks: constant memory whatever its size.

    Parameters
    ----------
    path : the file.
    root : folder that names are given relative to; a file outside it keeps its bare name.
    hashed : whether to read it for its SHA-256, which takes nearly as long as measuring a clip; else that is empty.

    Raises
    ------
    pipeline.errors.InputError
        If there is no such file or it cannot be read.
    """
    try:
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest() if hashed else ""
            size = stream.seek(0, 2)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "give an existing, readable file") from None
    below = root is not None and path.resolve().is_relative_to(root.resolve())
    name = path.resolve().relative_to(root.resolve()).as_posix() if root is not None and below else path.name
    return Source(name=name, sha256=digest, size=size)
