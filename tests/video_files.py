"""Synthetic clips of known pixels in every format that a test can write."""

import struct
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import tifffile

SAMPLES = Path(__file__).parents[1].parent / "shared" / "samples" / "cine"


def random_frames(seed: int, n: int, rows: int, columns: int, bits: int) -> np.ndarray:
    """Uniform pixels of `bits` bits, with the largest value in every frame; shape (n, rows, columns)."""
    frames = np.random.default_rng(seed).integers(0, 1 << bits, (n, rows, columns))
    frames[:, 0, 0] = (1 << bits) - 1
    return frames.astype(np.uint8 if bits <= 8 else np.uint16)


def write_container(
    path: Path,
    frames: np.ndarray,
    pixels: str,
    codec: str = "ffv1",
    rate: int = 25,
    rows: int | None = None,
    **options: str,
):
    """Frames already in the array layout of the pixel format `pixels`; `rows` where that is not an array's height."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=options)
        stream.height, stream.width, stream.pix_fmt = rows or frames.shape[1], frames.shape[2], pixels
        for i, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(image, format=pixels)
            frame.pts, frame.time_base = i, Fraction(1, rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def pack_12(frame: np.ndarray) -> bytes:
    """Two pixels in three bytes, most significant bits first."""
    a, b = frame.reshape(-1, 2).T.astype(int)
    return np.stack((a >> 4, (a & 15) << 4 | b >> 8, b & 255), axis=1).astype(np.uint8).tobytes()


def pack_10(codes: np.ndarray) -> bytes:
    """Four pixels in five bytes, most significant bits first."""
    bits = (codes.reshape(-1, 1) >> np.arange(9, -1, -1)) & 1
    return np.packbits(bits.astype(np.uint8).reshape(-1)).tobytes()


CINE_PACKING = {"": 0, "P10": 256, "P12L": 1024}


def cine_bytes(frames: np.ndarray, bits: int, stamps: list[int], packing: str = "", nominal: int = 1000) -> bytes:
    """A minimal .cine file: one block of time stamps (32.32 fixed point) and the frames; those of P10 are codes."""
    n, rows, columns = frames.shape
    setup = bytearray(1000)
    setup[140:144] = b"ST" + struct.pack("<H", len(setup))
    struct.pack_into("<I", setup, 768, nominal)
    struct.pack_into("<I", setup, 896, bits)
    tags = struct.pack("<IHH", 8 + 8 * n, 1002, 0) + np.array(stamps, "<u8").tobytes() if stamps else b""
    table_at = 84 + len(setup) + len(tags)
    images = []
    for frame in frames:
        if packing:
            images.append((pack_10 if packing == "P10" else pack_12)(frame))
        else:
            images.append(frame[::-1].astype("<u2" if frame.itemsize == 2 else "u1").tobytes())
    at = table_at + 8 * n
    table, body = b"", b""
    for image in images:
        table += struct.pack("<Q", at + len(body))
        body += struct.pack("<II", 8, len(image)) + image
    depth = 8 * frames.itemsize
    header = struct.pack("<2sHHHiIiIIIIQ", b"CI", 44, 0, 1, 0, n, 0, n, 44, 84, table_at, stamps[0] if stamps else 0)
    bitmap = struct.pack(
        "<IiiHHIIiiII", 40, columns, rows, 1, depth, CINE_PACKING[packing], len(images[0]), 45454, 45454, 0, 0
    )
    return header + bitmap + bytes(setup) + tags + table + body


CIHX = """!!! This file can not be edited. !!!\0\0CIHX<?xml version="1.0" encoding="utf-8"?>\r
<cih><imageFileInfo><fileFormat>Mraw</fileFormat></imageFileInfo>
<imageDataInfo><resolution><width>{columns}</width><height>{rows}</height></resolution>
<colorInfo><type>Raw</type><bit>{bits}</bit></colorInfo>
<effectiveBit><depth>{depth}</depth><side>Lower</side></effectiveBit></imageDataInfo>
<frameInfo><totalFrame>{n}</totalFrame><skipFrame>1</skipFrame></frameInfo>
<recordInfo><recordRate>1024</recordRate><shutterSpeed>50000</shutterSpeed></recordInfo></cih>\r\n\2\0"""


def write_mraw(path: Path, frames: np.ndarray, bits: int, depth: int) -> Path:
    """A Photron clip of 8, 12 (packed) or 16 bits with its .cihx, which is returned."""
    data = [pack_12(frame) if bits == 12 else frame.astype("<u2" if bits == 16 else "u1").tobytes() for frame in frames]
    path.write_bytes(b"".join(data))
    n, rows, columns = frames.shape
    header = path.with_suffix(".cihx")
    header.write_text(CIHX.format(n=n, rows=rows, columns=columns, bits=bits, depth=depth), newline="")
    return header


def write_sequence(folder: Path, frames: np.ndarray, suffix: str, start: int = 1) -> list[Path]:
    """Images img_<number><suffix>, numbered without leading zeros."""
    folder.mkdir()
    files = [folder / f"img_{start + i}{suffix}" for i in range(len(frames))]
    for file, frame in zip(files, frames, strict=True):
        if suffix == ".tif":
            tifffile.imwrite(file, frame)
        else:
            assert cv2.imwrite(str(file), frame)
    return files


def write_clip(folder: Path, kind: str, frames: np.ndarray, bits: int) -> Path:
    """The same frames as a clip of any kind in `KINDS`."""
    path = folder / f"clip.{kind.split(maxsplit=1)[0]}"
    if kind.startswith("cine"):
        stamps = [(1_700_000_000 << 32) + i * (1 << 22) for i in range(len(frames))]
        path.write_bytes(cine_bytes(frames, bits, stamps, packing=kind.partition(" ")[2]))
    elif kind.startswith("tif"):
        options = {"compression": "zlib", "metadata": None} if "deflate" in kind else {}
        if "big-endian" in kind:
            options = {"byteorder": ">"}
        tifffile.imwrite(path, frames, photometric="minisblack", **options)
    elif kind.startswith("mraw"):
        write_mraw(path, frames, 12 if "packed" in kind else 8 * frames.itemsize, bits)
    elif kind.startswith("folder"):
        path = folder / "frames"
        write_sequence(path, frames, kind.split()[1])
    else:
        names = {8: "gray", 10: "gray10le", 12: "gray12le", 16: "gray16le"}
        write_container(path, frames, names[bits])
    return path


KINDS = {
    "cine": (8, 12, 16),
    "cine P12L": (12,),
    "mraw": (8, 12, 16),
    "mraw packed": (12,),
    "tif": (8, 12, 16),
    "tif deflate": (8, 12, 16),
    "tif big-endian": (8, 12, 16),
    "mkv": (8, 10, 12, 16),
    "avi": (8, 10, 12, 16),
    "mp4": (8, 10, 12, 16),
    "folder .png": (8, 12, 16),
    "folder .bmp": (8,),
    "folder .tif": (8, 12, 16),
}
"""Every kind that can be written here, with the depths that it holds."""
