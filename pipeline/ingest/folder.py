"""A numbered sequence of PNG, BMP, JPEG or single-page TIFF files in a folder, or one such image."""

import hashlib
import itertools
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.ingest.clip import HELD_LUMA, MAX_FRAMES, Clip, Pixels, as_pixels, check_size, frame_error
from pipeline.ingest.jpeg import read_jpeg
from pipeline.ingest.orientation import exif_orientation, upright
from pipeline.ingest.source import source
from pipeline.ingest.tiff import TiffFrames
from pipeline.records import Source

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_GRAY, PNG_RGB, PNG_GRAY_ALPHA, PNG_RGB_ALPHA = 0, 2, 4, 6
JPEG = {".jpg", ".jpeg"}
SUFFIXES = {".png", ".bmp", ".tif", ".tiff", *JPEG}
LOSSY = {"compression": "JPEG: lossy, in blocks of 8 × 8 pixels", "colour": HELD_LUMA}


class ImageFrames:
    """One image file a frame; None stands for a file that the numbering says is missing."""

    def __init__(self, folder: Path, files: Sequence[Path | None]):
        self._folder, self._files = folder, files

    def __len__(self) -> int:
        return len(self._files)

    def frame(self, index: int) -> Pixels:
        """Frame `index` as stored (`Clip.frames`), rows top-down; `InputError` if the file is missing or damaged."""
        file = self._files[index]
        if file is None:
            raise frame_error(self._folder, index, "missing: the numbering has a gap here")
        try:
            return read_image(file)
        except InputError as error:
            raise InputError(
                f"{self._folder}: frame {index}", f"unreadable image ({error})", "export it again"
            ) from error


def open_folder(folder: Path) -> Clip:
    """Sort a folder's images by their number; a missing one becomes a frame that cannot be read, so times stay right.

    Raises
    ------
    InputError
        If the folder has no image, images of several kinds or series, or a number twice.
    """
    found = _images(folder)
    kinds = sorted({file.suffix.lower() for file in found})
    if not found:
        raise InputError(
            folder, "a folder without PNG, BMP, JPEG or TIFF images", "give the folder that holds the frames"
        )
    if len(kinds) > 1:
        raise InputError(folder, f"images of several kinds ({', '.join(kinds)})", "keep one sequence in a folder")
    if len(found) == 1:
        return Clip(ImageFrames(folder, found), _metadata(f"folder of {kinds[0]}", kinds[0]))
    numbered: dict[int, Path] = {}
    series: dict[tuple[str, str], Path] = {}
    for file in found:
        match = re.fullmatch(r"(.*?)(\d+)(\D*)", file.stem, re.DOTALL)
        if match is None:
            raise InputError(folder, f"'{file.name}' has no number", "number every image of the sequence")
        series.setdefault((match[1], match[3]), file)
        if (number := int(match[2])) in numbered:
            other = numbered[number].name
            raise InputError(
                folder, f"'{other}' and '{file.name}' have the same number", "keep one sequence in a folder"
            )
        numbered[number] = file
    if len(series) > 1:
        names = " and ".join(f"'{file.name}'" for file in list(series.values())[:2])
        raise InputError(folder, f"more than one sequence ({names})", "keep one sequence in a folder")
    return _sequence(folder, numbered, kinds[0])


def _images(folder: Path) -> list[Path]:
    """The image files of a folder by name, hidden ones left out."""
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.name[0] != ".")


def _sequence(folder: Path, numbered: dict[int, Path], kind: str) -> Clip:
    numbers = sorted(numbered)
    metadata = _metadata(f"folder of {kind}", kind) | {"numbers": f"{numbers[0]} to {numbers[-1]}"}
    steps = [b - a for a, b in itertools.pairwise(numbers)]
    step = min(steps)
    if step > 1:
        metadata["numbers"] += f" in steps of {step}; the rate counts images, not numbers"
    span = (numbers[-1] - numbers[0]) // step + 1
    if any(s % step for s in steps) or span > min(2 * len(numbers), MAX_FRAMES):
        # More holes than images: the numbers are no count of frames (a clock, a hand-made choice).
        metadata["numbers"] += "; too irregular to count frames by, taken as consecutive"
        return Clip(ImageFrames(folder, [numbered[n] for n in numbers]), metadata)
    files = [numbered.get(n) for n in range(numbers[0], numbers[-1] + 1, step)]
    if missing := [str(n) for n in range(numbers[0], numbers[-1] + 1, step) if n not in numbered]:
        shown = ", ".join(missing[:10]) + (", …" if len(missing) > 10 else "")
        metadata["gaps"] = f"{len(missing)} missing: {shown}; kept as unreadable frames"
    return Clip(ImageFrames(folder, files), metadata)


def open_image(path: Path) -> Clip:
    """One PNG, BMP or JPEG file as a clip of one frame."""
    return Clip(ImageFrames(path, [path]), _metadata(path.suffix[1:].upper(), path.suffix.lower()))


def _metadata(form: str, suffix: str) -> dict[str, str]:
    return {"format": form} | (LOSSY if suffix in JPEG else {})


def read_image(path: Path) -> Pixels:
    """Read one image at full depth, gray or RGB, upright.

    Raises
    ------
    InputError
        If the file is damaged, is not what its name says, or has not 8 or 16 bits a channel.
    """
    if path.suffix.lower() in (".tif", ".tiff"):
        frames = TiffFrames(path)
        if len(frames) != 1:
            raise InputError(
                path, f"{len(frames)} pages", "one page a file, or one file with all pages outside a folder"
            )
        return frames.frame(0)
    reader = {".png": _read_png, ".bmp": _read_bmp}.get(path.suffix.lower(), read_jpeg)
    return as_pixels(reader(path, path.read_bytes()), path)


def _read_png(path: Path, data: bytes) -> NDArray[np.generic]:
    """Walk the chunks and their CRCs first: the decoder itself returns half an image from half a file."""
    chunks = list(_png_chunks(path, data))
    if chunks[0][0] != b"IHDR" or len(chunks[0][1]) != 13 or chunks[-1][0] != b"IEND":
        raise InputError(path, "cut short: no end chunk", "export it again")
    columns, rows, depth, colour = struct.unpack(">IIBB", chunks[0][1][:10])
    check_size(rows, columns, path)
    if colour not in (PNG_GRAY, PNG_RGB, PNG_GRAY_ALPHA, PNG_RGB_ALPHA) or depth not in (8, 16):
        raise InputError(path, f"PNG colour type {colour} with {depth} bits", "export in gray or RGB, 8 or 16 bits")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(path, f"damaged ({error.err})", "export it again") from error
    if image is None:
        raise InputError(path, "damaged: it does not decode", "export it again")
    exif = next((content for kind, content in chunks if kind == b"eXIf"), None)
    image = upright(image, exif_orientation(exif, path) if exif else 1, path)
    return image if image.ndim == 2 else image[..., [2, 1, 0, 3][: image.shape[2]]]


def _png_chunks(path: Path, data: bytes) -> Iterator[tuple[bytes, bytes]]:
    if not data.startswith(PNG_SIGNATURE):
        raise InputError(path, "not a PNG, whatever its name says", "export it again")
    at = len(PNG_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        size = int.from_bytes(data[at : at + 4])
        kind, end = data[at + 4 : at + 8], at + 12 + size
        if end > len(data):
            raise InputError(path, "cut short", "export it again")
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end]):
            raise InputError(path, f"damaged: the checksum of chunk {kind!r} is wrong", "export it again")
        yield kind, data[at + 8 : end - 4]
        at = end


def _read_bmp(path: Path, data: bytes) -> NDArray[np.generic]:
    """Uncompressed bitmaps only: rows padded to 4 bytes, bottom-up unless the height is negative."""
    if not data.startswith(b"BM") or len(data) < 54:
        raise InputError(path, "not a BMP, whatever its name says", "export it again")
    start, header, columns, rows, _, depth, compression = struct.unpack_from("<IIiiHHI", data, 10)
    check_size(abs(rows), columns, path)
    if header < 40 or depth not in (8, 24) or compression:
        raise InputError(
            path, f"BMP of {depth} bits, compression {compression}", "export with 8 or 24 bits, uncompressed"
        )
    stride = (columns * depth // 8 + 3) // 4 * 4
    if len(data) < start + stride * abs(rows):
        raise InputError(path, "cut short", "export it again")
    stored = np.frombuffer(data, np.uint8, stride * abs(rows), start).reshape(abs(rows), stride)
    lines = stored[:: -1 if rows > 0 else 1, : columns * depth // 8]
    if depth == 24:
        return lines.reshape(abs(rows), columns, 3)[..., ::-1]
    colours = struct.unpack_from("<I", data, 46)[0] or 256
    palette = np.frombuffer(data[14 + header : 14 + header + 4 * min(colours, 256)], np.uint8)
    palette = palette[: len(palette) // 4 * 4].reshape(-1, 4)[:, 2::-1]
    if int(lines.max()) >= len(palette):
        raise InputError(path, f"a pixel beyond the palette of {len(palette)} colours", "export it again")
    return palette[lines]


def folder_source(folder: Path, root: Path | None, *, hashed: bool = True) -> Source:
    """Identify a folder: SHA-256 over the sorted names of its images, each followed by that file's own SHA-256.

    Parameters
    ----------
    folder : the folder.
    root : folder that names are given relative to; a folder outside it keeps its bare name.
    hashed : whether to read the images for their SHA-256; else it is empty.
    """
    digest = hashlib.sha256()
    size = 0
    for file in _images(folder):
        image = source(file, hashed=hashed)
        digest.update(f"{image.name}\n{image.sha256}\n".encode())
        size += image.size
    below = root is not None and folder.resolve().is_relative_to(root.resolve())
    name = folder.resolve().relative_to(root.resolve()).as_posix() if root is not None and below else folder.name
    return Source(name, digest.hexdigest() if hashed else "", size)
