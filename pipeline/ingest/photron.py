"""Photron: bare pixels in .mraw, described by a header of the same name, .cihx (XML) or the older .cih (text).

Frames lie one after another, rows top-down, in 8 bits, 16 bits (little-endian) or packed 12 bits. pyMRAW (MIT) reads
them too, but loads packed clips whole; it agrees on the sample (tests/ingest/test_video_photron.py).
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import InputError
from pipeline.ingest.clip import Clip, Pixels, check_size, count_frames, frame_error, read_pixels
from pipeline.ingest.header_xml import MAX_BYTES, parse_header
from pipeline.ingest.packed import unpack_12

PIXELS = ".mraw"
HEADERS = (".cihx", ".cih")

TEXT_KEYS = {
    "imageDataInfo/resolution/width": "Image Width",
    "imageDataInfo/resolution/height": "Image Height",
    "imageDataInfo/colorInfo/type": "Color Type",
    "imageDataInfo/colorInfo/bit": "Color Bit",
    "imageDataInfo/effectiveBit/depth": "EffectiveBit Depth",
    "imageDataInfo/effectiveBit/side": "EffectiveBit Side",
    "imageFileInfo/fileFormat": "File Format",
    "frameInfo/totalFrame": "Total Frame",
    "frameInfo/skipFrame": "Save Step",
    "recordInfo/recordRate": "Record Rate(fps)",
    "recordInfo/shutterSpeed": "Shutter Speed(s)",
    "recordInfo/shutterSpeedNsec": "Shutter Type2(nsec)",
    "deviceInfo/deviceName": "Camera Type",
}
"""Where .cihx keeps what a measurement needs, and the key of the same in .cih."""

DISPLAY = {
    "plugin/geometry/flipH": "flipped left to right",
    "plugin/geometry/flipV": "flipped upside down",
    "plugin/geometry/rotate": "rotated",
}
RIGHT = "copy the .mraw and its .cihx again from the camera"


class MrawFrames:
    """Frames of a .mraw file, each read from the disk when asked for."""

    def __init__(self, path: Path, shape: tuple[int, int], bits: int, count: int):
        self._path, self._shape, self._bits, self._count = path, shape, bits, count
        self._size = shape[0] * shape[1] * bits // 8

    def __len__(self) -> int:
        return self._count

    def frame(self, index: int) -> Pixels:
        """Frame `index`, shape (rows, columns), rows top-down; `InputError` if it is cut short."""
        with self._path.open("rb", buffering=0) as file:
            file.seek(index * self._size)
            data = read_pixels(file, self._size)
        if len(data) < self._size:
            raise frame_error(self._path, index, f"cut short: {len(data)} of {self._size} bytes")
        pixels = unpack_12(data) if self._bits == 12 else data.view("u1" if self._bits == 8 else "<u2")
        return pixels.reshape(self._shape)


def open_photron(path: Path) -> Clip:
    """Read the header of a Photron clip; `path` names either of its two files.

    Raises
    ------
    InputError
        If the other file is missing, or if the header is damaged, in colour or contradicts the pixels.
    """
    pixels, header_path = _pair(path)
    header = _read_header(header_path)
    rows, columns = header.whole("imageDataInfo/resolution/height"), header.whole("imageDataInfo/resolution/width")
    bits = header.whole("imageDataInfo/colorInfo/bit")
    _check(header, bits)
    check_size(rows, columns, header_path)
    if rows * columns * bits % 8:
        raise InputError(header_path, f"an odd number of pixels ({columns} × {rows}) packed in {bits} bits", RIGHT)
    size = rows * columns * bits // 8
    held = pixels.stat().st_size
    found, promised = held // size, header.whole("frameInfo/totalFrame")
    if not found:
        raise InputError(pixels, f"{held} bytes where one frame needs {size}", RIGHT)
    count = promised if 0 < promised <= found else count_frames(found, promised)
    metadata = {
        "format": f"Photron .mraw, {bits} bit{' packed' if bits == 12 else ''}",
        "camera": header.text("deviceInfo/deviceName"),
    }
    if held != promised * size:
        metadata["frames"] = f"the header states {promised} frames, the file holds {held / size:.6g}"
    if exposure := _exposure(header):
        metadata["exposure_s"] = f"{exposure:.9g}"
    step = max(1, header.whole("frameInfo/skipFrame", default=1))
    if step > 1:
        metadata["saved"] = f"one frame in {step}: the rate is the recording rate divided by {step}"
    if shown := [text for key, text in DISPLAY.items() if header.text(key).lower() not in ("", "false", "0", "0.0")]:
        metadata["orientation"] = (
            f"as stored; the vendor's viewer is set to show it {' and '.join(shown)}, "
            "which is not applied here (a flip swaps S and Z)"
        )
    depth = header.whole("imageDataInfo/effectiveBit/depth", default=0)
    if bits == 16 and header.text("imageDataInfo/effectiveBit/side").lower() == "higher":
        metadata["levels"] = f"left-justified: the upper {depth} of 16 bits are significant"
        depth = 16
    other = header_path if path == pixels else pixels
    return Clip(
        MrawFrames(pixels, (rows, columns), bits, count),
        metadata,
        bits=depth if 8 <= depth <= bits else None,
        rate=header.number("recordInfo/recordRate") / step,
        beside=(other,),
    )


@dataclass(frozen=True, slots=True)
class _Header:
    path: Path
    values: Mapping[str, str]
    """By the place in .cihx."""

    def text(self, key: str) -> str:
        return self.values.get(key, "")

    def number(self, key: str) -> float:
        """A finite number; NaN where the header has none."""
        try:
            value = float(self.text(key))
        except ValueError:
            return math.nan
        return value if math.isfinite(value) else math.nan

    def whole(self, key: str, default: int | None = None) -> int:
        """A whole number of at most 9 digits; without a default it has to be there."""
        text = self.text(key)
        if re.fullmatch(r"\d{1,9}", text):
            return int(text)
        if default is not None:
            return default
        name = key if self.path.suffix.lower() == ".cihx" else TEXT_KEYS[key]
        raise InputError(f"{self.path}: {name}", f"found '{text[:40]}'" if text else "missing", RIGHT)


def _pair(path: Path) -> tuple[Path, Path]:
    """The .mraw and its header, whichever of the two `path` is."""
    wanted = HEADERS if path.suffix.lower() == PIXELS else (PIXELS,)
    for suffix in wanted:
        for other in (path.with_suffix(suffix), path.with_suffix(suffix.upper())):
            if other.is_file():
                return (path, other) if path.suffix.lower() == PIXELS else (other, path)
    names = " or ".join(f"'{path.with_suffix(suffix).name}'" for suffix in wanted)
    what = "header" if wanted is HEADERS else "pixels"
    raise InputError(path, f"its {what} {names} is not beside it", "keep both files of the clip in one folder")


def _read_header(path: Path) -> _Header:
    if path.suffix.lower() == ".cihx":
        root = parse_header(path, "cih")
        if root is None:
            raise InputError(path, "no <cih> element in it", RIGHT)
        return _Header(path, {key: (root.findtext(key) or "").strip() for key in (*TEXT_KEYS, *DISPLAY)})
    with path.open("rb") as file:
        text = file.read(MAX_BYTES).decode("utf-8", "replace")
    # Device lists follow the clip's own keys after an empty line and may repeat them.
    lines = text.replace("\r\n", "\n").partition("\n\n")[0].split("\n")
    pairs = dict(line.split(" : ", 1) for line in lines if " : " in line)
    return _Header(path, {key: pairs[name].strip() for key, name in TEXT_KEYS.items() if name in pairs})


def _check(header: _Header, bits: int) -> None:
    form = header.text("imageFileInfo/fileFormat")
    if form.lower() != "mraw":
        raise InputError(header.path, f"file format '{form}'", "save the clip as MRAW, or as TIFF and give the folder")
    if header.text("imageDataInfo/colorInfo/type").lower() not in ("raw", "mono") or "-C-" in header.text(
        "deviceInfo/deviceName"
    ):
        raise InputError(header.path, "frames of a colour camera", "record with a gray camera, or export in gray")
    if bits not in (8, 12, 16):
        raise InputError(header.path, f"{bits} bits per pixel", "save the clip as MRAW with 8, 12 or 16 bits")


def _exposure(header: _Header) -> float:
    """Exposure time [s]: 50000 and 1/50000 both mean 1/50000 s; 0 where it is not stated."""
    nanoseconds = header.number("recordInfo/shutterSpeedNsec")
    if nanoseconds > 0:
        return nanoseconds * 1e-9
    text = header.text("recordInfo/shutterSpeed").removeprefix("1/")
    try:
        speed = float(text)
    except ValueError:
        return 0.0
    return 1 / speed if 1 <= speed < math.inf else 0.0
