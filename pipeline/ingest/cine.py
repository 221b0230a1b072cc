"""Phantom .cine files: gray, uncompressed in 8 or 16 bits, or packed as P12L or P10.

Layout after Vision Research's "Cine File Format": CINEFILEHEADER, BITMAPINFOHEADER, SETUP, tagged blocks, table of
frame offsets, frames. Only the few fields that a measurement needs are read. pims 0.7 has a reader too; it is the
tests' second opinion and is not used here, because it turns the time stamps into floats of the local clock, gives P10
pixels without their look-up table, and raises anything on a damaged header.

P10 holds 12 bits in 10 by the camera's fixed table of 1024 levels (`p10_lut.csv`): about a straight line up to code
158, then about a power of 2.22. The same levels stand in the public readers that were found, such as CineFiles.jl
(MIT, src/LUT.jl). In it black lies at 64 and white at 4064.
"""

import os
import struct
import weakref
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled
from pipeline.errors import InputError
from pipeline.ingest.clip import MAX_FRAMES, Clip, Pixels, check_size, frame_error, read_pixels
from pipeline.ingest.packed import unpack_10, unpack_12
from pipeline.records import Array

FILE_HEADER = struct.Struct("<2sHHHiIiIIIIQ")
BITMAP_HEADER = struct.Struct("<IiiHHIIiiII")
TAG = struct.Struct("<IHH")

# Offsets in SETUP [byte]; it is packed, grew over the years, and states its own length.
MARK_LENGTH = 140
FLIP_H, FLIP_V, FRAME_RATE, CFA, ROTATE, REAL_BPP = 756, 760, 768, 808, 884, 896

TIME_TAG = 1002
MIN_ANNOTATION = 8
"""Bytes before a frame's image, at least."""
UNCOMPRESSED, P10, P12L = 0, 256, 1024
PACKED_BITS = {P10: 10, P12L: 12}
NAMES = {P10: "P10", P12L: "P12L"}
PACKED_DEPTH = 12
"""Significant bits of packed pixels: P10 has them after its table."""
RIGHT = "save the cine again in the vendor's software: gray, as 16 bit or P12L"


class CineFrames:
    """Frames of a .cine file, each read from the disk when asked for."""

    def __init__(self, path: Path, offsets: NDArray[np.uint64], shape: tuple[int, int], bit_count: int, packing: int):
        self._path, self._offsets, self._shape = path, offsets, shape
        self._bit_count, self._packing = bit_count, packing
        self._size = shape[0] * shape[1] * PACKED_BITS.get(packing, bit_count) // 8
        self._annotation = MIN_ANNOTATION
        self._file = path.open("rb", buffering=0)
        self._end = os.fstat(self._file.fileno()).st_size
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        return len(self._offsets)

    def frame(self, index: int) -> Pixels:
        """Frame `index`, shape (rows, columns), rows top-down; `InputError` if it is cut short or damaged."""
        data = self._pixels(index)
        if self._packing == P12L:
            return unpack_12(data).reshape(self._shape)
        if self._packing == P10:
            return unpack_10(data, p10_levels()).reshape(self._shape)
        # Uncompressed rows are stored bottom-up, as in every Windows bitmap; packed ones top-down.
        _turn_over(data.reshape(self._shape[0], -1))
        return data.view("u1" if self._bit_count == 8 else "<u2").reshape(self._shape)

    def _pixels(self, index: int) -> NDArray[np.uint8]:
        """The bytes of a frame's image."""
        start = int(self._offsets[index])
        if start + MIN_ANNOTATION > self._end:
            raise frame_error(self._path, index, "cut off: the file ends before it")
        # A frame starts with its annotation, whose first word is its length and whose last word is the image's. Both
        # are read at once, as if it were as long as the last one: each call of the system costs time.
        data = self._read(start)
        annotation = int.from_bytes(data[:4].tobytes(), "little")
        if annotation < MIN_ANNOTATION or start + annotation > self._end:
            raise frame_error(self._path, index, f"a frame header of {annotation} bytes")
        if annotation != self._annotation:
            self._annotation = annotation
            data = self._read(start)
        size = int.from_bytes(data[annotation - 4 : annotation].tobytes(), "little")
        data = data[annotation:]
        if size != self._size:
            raise frame_error(self._path, index, f"{size} bytes where the image size needs {self._size}")
        if len(data) < size:
            raise frame_error(self._path, index, f"cut short: {len(data)} of {size} bytes")
        return data if annotation % 2 == 0 else data.copy()  # pixels of two bytes stand at even places

    def _read(self, start: int) -> NDArray[np.uint8]:
        self._file.seek(start)
        return read_pixels(self._file, self._annotation + self._size)


@compiled
def _turn_over(lines: NDArray[np.uint8]) -> None:
    """Reverse the order of lines of bytes in place: a copy would take about twice as long."""
    count, size = lines.shape
    for i in range(count // 2):
        upper, lower = lines[i], lines[count - 1 - i]
        for j in range(size):
            upper[j], lower[j] = lower[j], upper[j]


def open_cine(path: Path) -> Clip:
    """Read the headers of a .cine file.

    Raises
    ------
    InputError
        If a header is cut short or contradicts itself, or if the pixels are in colour, compressed or packed as P10.
    """
    with path.open("rb") as file:
        end = file.seek(0, 2)
        header = FILE_HEADER.unpack(_read(path, file, 0, FILE_HEADER.size, "file header"))
        compression, first_image, count = header[2], header[6], header[7]
        bitmap_at, setup_at, table_at, trigger = header[8:12]
        bitmap = BITMAP_HEADER.unpack(_read(path, file, bitmap_at, BITMAP_HEADER.size, "bitmap header"))
        columns, rows, bit_count, packing = bitmap[1], bitmap[2], bitmap[4], bitmap[5]
        setup = _read_setup(path, file, setup_at)
        if not 0 < count <= min(MAX_FRAMES, end // 8):
            raise InputError(path, f"{count} frames in {end} bytes", "a damaged header: copy the clip again")
        offsets = np.frombuffer(_read(path, file, table_at, 8 * count, "table of frames"), "<u8").astype(np.uint64)
        stamps = _read_stamps(file, setup_at + len(setup), table_at, count)

    _check_pixels(path, compression, packing, bit_count, _word(setup, CFA))
    check_size(rows, columns, path)
    if rows * columns * PACKED_BITS.get(packing, 8) % 8:
        raise InputError(path, f"{columns} × {rows} pixels, which {NAMES[packing]} cannot pack into bytes", RIGHT)
    metadata = {
        "format": f"cine, {NAMES.get(packing, f'{bit_count} bit uncompressed')}",
        "first_image": str(first_image),
        "trigger_utc": _utc(trigger),
        "nominal_rate": str(_word(setup, FRAME_RATE)),
    }
    settings = {"flipped left to right": FLIP_H, "flipped upside down": FLIP_V, "rotated": ROTATE}
    if shown := [text for text, at in settings.items() if _word(setup, at)]:
        metadata["orientation"] = (
            f"as the sensor stored it; the vendor's viewer is set to show it {' and '.join(shown)}, "
            "which is not applied here (a flip swaps S and Z)"
        )
    if len(stamps):
        metadata["first_frame_from_trigger_s"] = f"{(int(stamps[0]) - trigger) / 2**32:.9f}"
    if packing == P10:
        metadata["levels"] = "12 bit by the camera's table: black lies at 64, white at 4064"
    frames = CineFrames(path, offsets, (rows, columns), bit_count, packing)
    bits = PACKED_DEPTH if packing in PACKED_BITS else _bits(setup, bit_count)
    return Clip(frames, metadata, bits, _seconds(stamps))


def read_clock(path: Path) -> tuple[Array, float]:
    """The times from the first frame [s], shape (n,), and the nominal rate [1/s] of a .cine or .chd header.

    Raises
    ------
    InputError
        If the header is cut short or contradicts itself; no times are there if it has no whole block of them.
    """
    with path.open("rb") as file:
        end = file.seek(0, 2)
        header = FILE_HEADER.unpack(_read(path, file, 0, FILE_HEADER.size, "file header"))
        count, setup_at = header[7], header[9]
        if header[0] != b"CI":
            raise InputError(path, "not a cine header, whatever its name says", "copy it again, or take it away")
        setup = _read_setup(path, file, setup_at)
        stamps = _read_stamps(file, setup_at + len(setup), end, min(count, MAX_FRAMES, end // 8))
    return _seconds(stamps), float(_word(setup, FRAME_RATE))


@cache
def p10_levels() -> NDArray[np.uint16]:
    """The 12-bit level of each 10-bit code of P10, shape (1024,)."""
    return np.loadtxt(Path(__file__).with_name("p10_lut.csv"), np.uint16, delimiter=",").reshape(-1)


def _read(path: Path, file: BinaryIO, at: int, size: int, name: str) -> bytes:
    file.seek(at)
    data = file.read(size)
    if len(data) < size:
        raise InputError(path, f"the {name} is cut short ({len(data)} of {size} bytes)", "copy the clip again")
    return data


def _read_setup(path: Path, file: BinaryIO, at: int) -> bytes:
    start = _read(path, file, at, MARK_LENGTH + 4, "camera set-up")
    mark, length = start[MARK_LENGTH : MARK_LENGTH + 2], int.from_bytes(start[MARK_LENGTH + 2 :], "little")
    if mark != b"ST":
        raise InputError(path, f"the camera set-up is marked {mark!r}", "a damaged header (b'ST'): copy the clip again")
    return _read(path, file, at, length, "camera set-up")


def _word(setup: bytes, at: int) -> int:
    """A 32-bit field of SETUP; 0 where the file's version of it ends before the field."""
    return int.from_bytes(setup[at : at + 4], "little") if at + 4 <= len(setup) else 0


def _read_stamps(file: BinaryIO, at: int, end: int, count: int) -> NDArray[np.uint64]:
    """Stamps in 32.32 fixed point seconds, shape (count,); empty if the file has no whole block of them."""
    while at + TAG.size <= end:
        file.seek(at)
        head = file.read(TAG.size)
        if len(head) < TAG.size:
            break
        size, kind, more = TAG.unpack(head)
        if kind == TIME_TAG and size == TAG.size + 8 * count:
            data = file.read(8 * count)
            return np.frombuffer(data, "<u8").astype(np.uint64) if len(data) == 8 * count else np.empty(0, np.uint64)
        if size < TAG.size or not more:
            break
        at += size
    return np.empty(0, np.uint64)


def _seconds(stamps: NDArray[np.uint64]) -> Array:
    """Seconds from the first stamp; subtracted as integers, because POSIX seconds as floats lose 0.24 µs."""
    return (stamps - stamps[:1]).astype(np.int64) / 2.0**32


def _bits(setup: bytes, container: int) -> int | None:
    real = _word(setup, REAL_BPP)
    return real if 8 <= real <= container else None


def _utc(stamp: int) -> str:
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=stamp >> 32)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{(stamp & 0xFFFFFFFF) * 10**6 >> 32:06d}Z"


def _check_pixels(path: Path, compression: int, packing: int, bit_count: int, cfa: int) -> None:
    if cfa or bit_count in (24, 48):
        raise InputError(path, "frames of a colour camera", "record with a gray camera, or export in gray")
    if compression or packing not in (UNCOMPRESSED, P10, P12L):
        raise InputError(path, f"compressed frames (compression {compression}, biCompression {packing})", RIGHT)
    if packing == UNCOMPRESSED and bit_count not in (8, 16):
        raise InputError(path, f"{bit_count} bits per pixel", RIGHT)
