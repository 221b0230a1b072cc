"""Open a high-speed clip of any readable format: frames one at a time at full depth, with their true times."""

import contextlib
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.errors import InputError
from pipeline.ingest.cine import open_cine
from pipeline.ingest.clip import OWN_LUMA, Clip, Pixels, luma
from pipeline.ingest.container import open_container
from pipeline.ingest.folder import folder_source, open_folder, open_image
from pipeline.ingest.photron import open_photron
from pipeline.ingest.sidecar import with_sidecar
from pipeline.ingest.source import source
from pipeline.ingest.tiff import open_tiff
from pipeline.records import Array, Frames, RawVideo

READABLE = (
    "readable are Phantom .cine, Photron .mraw with .cihx, .tif, .avi, .mkv, .mp4, .mov, .png, .bmp, .jpg, and "
    "a folder of PNG, BMP, JPEG or TIFF images"
)

Reader = Callable[[Path], Clip]

READERS: dict[str, tuple[Reader, set[str]]] = {
    "cine": (open_cine, {".cine"}),
    "TIFF": (open_tiff, {".tif", ".tiff"}),
    "AVI": (open_container, {".avi"}),
    "Matroska": (open_container, {".mkv"}),
    "MP4": (open_container, {".mp4", ".m4v", ".mov"}),
    "PNG": (open_image, {".png"}),
    "BMP": (open_image, {".bmp"}),
    "JPEG": (open_image, {".jpg", ".jpeg"}),
    "Photron": (open_photron, {".mraw", ".cihx", ".cih"}),
}

RATE_TOLERANCE = 0.01
"""Relative difference from which a stated rate is said to contradict the time stamps."""

DEPTHS = (8, 10, 12, 14, 16)
"""Significant bits that cameras write into 16-bit pixels."""


class UniformFrames:
    """A clip's frames in gray, each held against the shape and the depth of the first readable one."""

    def __init__(self, frames: Frames, path: Path, first: Pixels):
        self._frames, self._path, self._shape, self._dtype = frames, path, first.shape[:2], first.dtype

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> Pixels:
        """Frame `index` from 0, shape (rows, columns); see `pipeline.records.Frames`."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        image = luma(self._frames.frame(index))
        if image.shape != self._shape or image.dtype != self._dtype:
            raise InputError(
                f"{self._path}: frame {index}",
                f"{image.shape[1]} × {image.shape[0]} pixels, {image.dtype}",
                f"{self._shape[1]} × {self._shape[0]} pixels, {self._dtype}, as the first frame",
            )
        return image


def open_video(
    path: Path, *, fps: float | None = None, bits: int | None = None, root: Path | None = None, hashed: bool = True
) -> RawVideo:
    """Open a clip; its frames stay on the disk.

    Parameters
    ----------
    path : a file, or a folder with an image sequence. The name's ending and the content must agree.
    fps : recording rate [1/s]; needed where a clip has no time stamps per frame. Where it has, they win, and
        `metadata['rate']` says so.
    bits : significant bits of a 16-bit pixel, where the file does not state them; without it, the smallest of 8, 10,
        12, 14 and 16 that holds some frames' maximum, which `metadata['bits']` calls assumed.
    root : folder that the source's name is given relative to.
    hashed : whether the source gets its SHA-256: a pass over the whole clip that takes nearly as long as measuring it.

    Raises
    ------
    InputError
        If the file is missing, empty, of unknown or contradictory kind, has no readable frame, or if the
        recording rate is missing. Single unreadable frames raise it only when they are asked for.
    """
    if fps is not None and not (math.isfinite(fps) and fps > 0):
        raise InputError(path, f"a recording rate of {fps:g}", "a positive number of frames per second")
    if path.is_dir():
        clip, origin = open_folder(path), folder_source(path, root, hashed=hashed)
    else:
        clip, origin = _reader(path)(path), source(path, root, hashed=hashed)
    if not len(clip.frames):
        raise InputError(path, "a clip without frames", "copy or export the clip again")
    if not len(clip.stamps):
        clip = with_sidecar(path, clip)
    metadata = dict(clip.metadata)
    if clip.beside:
        files = [source(file) for file in clip.beside]
        metadata["beside"] = "; ".join(f"{file.name}, SHA-256 {file.sha256}" for file in files)
    time, rate = _times(path, clip, fps, metadata)
    _, image = _first_readable(clip.frames)
    if image.ndim == 3:
        metadata["colour"] = OWN_LUMA
    frames = UniformFrames(clip.frames, path, image)
    depth = _bits(path, frames, clip.bits, bits, metadata)
    shape = (image.shape[0], image.shape[1])
    return RawVideo(origin, frames, time, rate, depth, shape, metadata, clip.sequential)


def _reader(path: Path) -> Reader:
    """The reader for a file, by its content; the name must agree."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "give an existing file or folder") from None
    if not head:
        raise InputError(path, "an empty file (0 bytes)", "copy the clip again")
    suffix = path.suffix.lower()
    # Photron's pixels are bare: only the name tells, and the header beside them.
    kind = "Photron" if suffix == ".mraw" else _kind(head)
    if kind is None or not any(suffix in suffixes for _, suffixes in READERS.values()):
        what = f"the ending '{path.suffix}'" if kind else "its content"
        raise InputError(path, f"{what} is of no readable kind", READABLE)
    reader, suffixes = READERS[kind]
    if suffix not in suffixes:
        raise InputError(path, f"the name ends in {path.suffix} but the content is {kind}", "name it by its content")
    return reader


def _kind(head: bytes) -> str | None:
    """The kind of a file by its first 16 bytes."""
    starts = {
        b"CI\x2c\0": "cine",
        b"II*\0": "TIFF",
        b"MM\0*": "TIFF",
        b"II+\0": "TIFF",
        b"MM\0+": "TIFF",
        b"\x1aE\xdf\xa3": "Matroska",
        b"\x89PNG": "PNG",
        b"!!! ": "Photron",
        b"#Cam": "Photron",
    }
    if head[:4] == b"RIFF" and head[8:12] == b"AVI ":
        return "AVI"
    if head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free"):
        return "MP4"
    if head[:3] == b"\xff\xd8\xff":
        return "JPEG"
    return starts.get(head[:4], "BMP" if head[:2] == b"BM" else None)


def _times(path: Path, clip: Clip, fps: float | None, metadata: dict[str, str]) -> tuple[Array, float]:
    """Times of the frames and the recording rate: from the stamps, else the header's rate, else the caller's.

    A still has no rate, NaN.
    """
    steps = np.diff(clip.stamps)
    step = float(np.median(steps)) if len(steps) else 0.0
    if step <= 0 and clip.rate > 0:
        metadata["rate"] = "from the file's header"
        if fps and abs(fps / clip.rate - 1) > RATE_TOLERANCE:
            metadata["rate"] += f"; the given rate of {fps:g} 1/s contradicts it and is not used"
        return np.arange(len(clip.frames)) / clip.rate, clip.rate
    if step <= 0:
        if fps is None and len(clip.frames) == 1:
            metadata["rate"] = "none: one frame"
            return np.zeros(1), math.nan
        if fps is None:
            stated = metadata.get("playback_rate")
            found = f"no recording rate in the file{f' ({stated} 1/s is for playback)' if stated else ''}"
            if "times" in metadata:
                found += f"; {metadata['times']}"
            raise InputError(path, found, "give the recording rate: --fps or fps in case.toml")
        metadata["rate"] = "as given"
        nominal = float(metadata.get("nominal_rate", 0))
        if nominal and abs(fps / nominal - 1) > RATE_TOLERANCE:
            metadata["rate"] += f"; the nominal rate of {nominal:g} 1/s contradicts it and is not used"
        return np.arange(len(clip.frames)) / fps, float(fps)
    rate = 1.0 / step
    notes = ["median interval of the time stamps"]
    for name, stated in (("nominal rate", float(metadata.get("nominal_rate", 0))), ("given rate", fps or 0.0)):
        if stated and abs(stated / rate - 1) > RATE_TOLERANCE:
            notes.append(f"the {name} of {stated:g} 1/s contradicts it and is not used")
    if backward := int(np.count_nonzero(steps <= 0)):
        notes.append(f"{backward} stamps do not advance")
    if longer := int(np.count_nonzero(steps > 1.5 * step)):
        notes.append(f"{longer} intervals are longer than 1.5 of it")
    metadata["rate"] = "; ".join(notes)
    return clip.stamps, rate


def _first_readable(frames: Frames) -> tuple[int, Pixels]:
    """The first frame that can be read; if none can, the first frame's error."""
    for index in range(len(frames)):
        with contextlib.suppress(InputError):
            return index, frames.frame(index)
    return 0, frames.frame(0)


def _bits(path: Path, frames: Frames, known: int | None, given: int | None, metadata: dict[str, str]) -> int:
    """Significant bits, from the file, the caller or the data, in this order."""
    first, image = _first_readable(frames)
    container = 8 * image.dtype.itemsize
    if container == 8:
        known = known or 8
    last = len(frames) - 1
    peak, low = 0, 0
    for index in [first] if known or given else sorted({first, last // 4, last // 2, 3 * last // 4, last}):
        with contextlib.suppress(InputError):
            image = frames.frame(index)
            peak, low = max(peak, int(image.max())), low | int(np.bitwise_or.reduce(image, axis=None))
    bits, origin = (known, "from the file") if known else (given, "as given")
    if bits is None:
        bits, origin = next(depth for depth in DEPTHS if peak < 1 << depth), "assumed from the data"
        if empty := (low & -low).bit_length() - 1 if low else 0:
            bits = container
            origin += f": left-justified, the lowest {empty} bits are 0 in every pixel looked at"
    elif not 1 <= bits <= container or peak >= 1 << bits:
        right = f"bits that hold it, at most {container}"
        raise InputError(path, f"a pixel of {peak} does not go with {bits} significant bits", right)
    if known and given and given != known:
        origin += f"; the given {given} contradicts it and is not used"
    metadata["bits"] = f"{bits}, {origin}"
    return bits
