"""The state of a reference run in a file, so that an interrupted run goes on where it was."""

import hashlib
import io
import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.winding.result import Kept
from models.winding.scene import WindingScene
from pipeline.atomic import whole_bytes
from pipeline.errors import InputError
from pipeline.winding.study import WindingCase

_SCENE = "scene_sha256"
_FORM = 2
"""Of what a run keeps: raised when that changes, so that no state of an older version is gone on from."""


class FileCheckpoint:
    """Keeps the state of one scene's run in an .npz file, which is there whole or as it was before."""

    def __init__(self, path: Path, scene: WindingScene):
        self.path = path
        self._scene = hashlib.sha256(f"{_FORM} {scene!r}".encode()).hexdigest()
        self._state = self._read() if path.exists() else None

    def load(self) -> Kept | None:
        """The state that the file held when this was made; None where there was no file."""
        return self._state

    def save(self, kept: Kept) -> None:
        """Replace what the file holds.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        buffer = io.BytesIO()
        arrays: dict[str, Any] = {_SCENE: np.array(self._scene), **kept}
        np.savez(buffer, **arrays)
        whole_bytes(self.path, buffer.getvalue())

    def _read(self) -> Kept:
        right = "give the file of an interrupted run, or a new one"
        try:
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                if _SCENE not in file:
                    raise InputError(self.path, "no state of a winding run", right)
                if str(file[_SCENE]) != self._scene:
                    found = "the state of another scene, or of another version of this program"
                    raise InputError(self.path, found, f"{right}: both must be the same")
                return {name: file[name] for name in file.files if name != _SCENE}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(self.path, f"not a whole .npz file ({error})", right) from None


def checkpoints(path: Path, cases: Sequence[WindingCase]) -> dict[str, FileCheckpoint]:
    """By label of the case, its checkpoint: `path` itself for one case, else 'STEM-LABEL.SUFFIX' beside it.

    Raises
    ------
    InputError
        If a file is there and is not the state of that scene, or the folder is not there, or `path` is one.
    """
    if path.is_dir():
        raise InputError(path, "a folder", "give a file in it")
    if not path.parent.is_dir():
        raise InputError(path, "no such folder", "give a file in an existing folder")
    if len(cases) == 1:
        return {cases[0].label: FileCheckpoint(path, cases[0].scene)}
    return {
        case.label: FileCheckpoint(path.with_stem(f"{path.stem}-{_slug(case.label, index)}"), case.scene)
        for index, case in enumerate(cases)
    }


def _slug(label: str, index: int) -> str:
    """A part of a file's name that no other case has."""
    return f"{index:02d}-" + re.sub(r"[^A-Za-z0-9.-]+", "-", label).strip("-")[:60]
