"""JPEG (ITU-T T.81), baseline and progressive, of 8 bits: gray, or the luma of a colour picture.

OpenCV decodes. Decoders make up what a damaged file does not hold, and JPEG has no checksum; so all codes of the file
are walked first: each must be one of its table, and each interval must hold as many blocks as it should, to the last
byte. What this cannot see is a bit that only changes the value of a coefficient.
"""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner
from pipeline.errors import InputError
from pipeline.ingest.clip import check_size
from pipeline.ingest.orientation import exif_orientation, upright

EOI, SOS, DQT, DHT, DRI, APP0, APP1, APP14, COM = 0xD9, 0xDA, 0xDB, 0xC4, 0xDD, 0xE0, 0xE1, 0xEE, 0xFE
BASELINE, EXTENDED, PROGRESSIVE = 0xC0, 0xC1, 0xC2
OTHER_FRAMES = {0xC3, *range(0xC5, 0xC8), *range(0xC9, 0xCC), *range(0xCD, 0xD0)}
"""Lossless, hierarchical and arithmetic coding."""
ASIDE = {*range(0xE0, 0xF0), COM} - {APP0, APP14}
"""Applications' data and comments, which do not come before the decoder: only JFIF and Adobe tell it of colour."""
EXIF, JFIF, ADOBE = b"Exif\0\0", b"JFIF\0", b"Adobe"
ADOBE_RGB, ADOBE_YCC = 0, 1
MAX_SCANS = 256
"""More scans are taken for damage: encoders write about ten."""
SLACK = 512
"""Bytes after an interval that a damaged block may be read into before the end is noticed."""
MAX_DC, MAX_AC = 11, 10
"""Largest sizes of a coefficient [bit] with samples of 8 bits (T.81, tables F.1 and F.2)."""
MAX_SHIFT = 13
"""Lowest bit that a progressive picture may begin with (T.81, G.1.1.1.1)."""
MARKER = re.compile(rb"\xff+([^\0\xd0-\xd7\xff])", re.DOTALL)
RESTART = re.compile(rb"\xff+([\xd0-\xd7])")
RIGHT = "copy or export it again"

Table = NDArray[np.uint16]
"""For each 16 bits that may come next: length of the code that they start with × 256 + its symbol; 0 where none."""


@dataclass(slots=True)
class _State:
    """What the segments before a scan have stated."""

    path: Path
    tables: Table = field(default_factory=lambda: np.zeros((8, 1 << 16), np.uint16))
    """Tables of DC 0 to 3 and AC 0 to 3."""
    frame: int = 0
    """Marker of the frame header; 0 before it."""
    rows: int = 0
    columns: int = 0
    components: dict[int, tuple[int, int, int, int]] = field(default_factory=dict)
    """By identifier: sampling across and down, place of the first block in `nonzero`, blocks in a row there."""
    nonzero: NDArray[np.uint64] = field(default_factory=lambda: np.empty(0, np.uint64))
    """For each block, which coefficients a progressive scan has made known as not zero."""
    interval: int = 0
    """Units between restarts; 0 for none."""
    known: dict[int, NDArray[np.int64]] = field(default_factory=dict)
    """By identifier: the lowest bit of each coefficient that a scan has brought, shape (64,); −1 for none."""
    orientation: int = 1
    adobe: int = 1
    """What Adobe's segment says of the components, where there is one."""


def read_jpeg(path: Path, data: bytes) -> NDArray[np.generic]:
    """Decode a JPEG: gray levels, or the luma Y′ that a colour picture is stored as; upright, shape (rows, columns).

    Raises
    ------
    InputError
        If the file is no JPEG, damaged or cut short, or if it is of a kind that is not read: 12 bits, CMYK, lossless
        or arithmetic coding.
    """
    if not data.startswith(b"\xff\xd8\xff"):
        raise InputError(path, "not a JPEG, whatever its name says", "name it by its content, or export it again")
    state = _State(path)
    at, scans, kept = 2, 0, [data[:2]]
    marker = 0
    while marker != EOI:
        start = at
        marker, segment, at = _segment(path, data, at)
        if marker == SOS:
            scans += 1
            if scans > MAX_SCANS:
                raise _damaged(path, f"more than {MAX_SCANS} scans")
            at = _scan(state, segment, data, at)
        elif marker != EOI:
            _note(state, marker, segment)
        if marker not in ASIDE:
            kept.append(data[start:at])
    if state.adobe not in (ADOBE_RGB, ADOBE_YCC):
        raise _damaged(path, f"colours of an unknown kind ({state.adobe})")
    if not state.frame or any(known[0] < 0 for known in state.known.values()):
        raise _damaged(path, "it ends before all of its picture came")
    try:
        image = cv2.imdecode(np.frombuffer(b"".join(kept), np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:
        raise _damaged(path, error.err) from error
    if image is None or image.shape != (state.rows, state.columns):
        raise _damaged(path, "it does not decode")
    return upright(image, state.orientation, path)


def _damaged(path: Path, found: str) -> InputError:
    return InputError(path, f"damaged: {found}", RIGHT)


def _segment(path: Path, data: bytes, at: int) -> tuple[int, bytes, int]:
    """The marker at a place, what its segment holds, and the place after it."""
    match = MARKER.match(data, at)
    if match is None:
        found = "cut short: no end marker" if at + 2 > len(data) else f"damaged: no marker at byte {at}"
        raise InputError(path, found, RIGHT)
    marker, at = match[1][0], match.end()
    if marker == EOI:
        return marker, b"", at
    size = int.from_bytes(data[at : at + 2])
    if size < 2 or at + size > len(data):
        raise InputError(path, "cut short" if size >= 2 else "damaged: a segment without a size", RIGHT)
    return marker, data[at + 2 : at + size], at + size


def _note(state: _State, marker: int, segment: bytes) -> None:
    """Take what a segment between scans states."""
    if marker == DHT:
        _tables(state, segment)
    elif marker == DRI:
        state.interval = int.from_bytes(segment[:2])
    elif marker in (BASELINE, EXTENDED, PROGRESSIVE):
        _frame(state, marker, segment)
    elif marker == APP1 and segment.startswith(EXIF):
        state.orientation = exif_orientation(segment[len(EXIF) :], state.path)
    elif marker in OTHER_FRAMES:
        found = f"a lossless, hierarchical or arithmetic-coded JPEG (marker FF{marker:X})"
        raise InputError(state.path, found, "export as baseline JPEG, PNG or TIFF")
    elif marker == APP0 and segment.startswith(JFIF) and segment[5:6] != b"\1":
        raise _damaged(state.path, "an unknown version of JFIF")
    elif marker == APP14 and segment.startswith(ADOBE):
        state.adobe = int.from_bytes(segment[11:12])
    elif marker not in ASIDE | {DQT, APP0, APP14}:
        raise _damaged(state.path, f"a marker FF{marker:02X} that does not belong there")


def _tables(state: _State, segment: bytes) -> None:
    """Huffman tables: class and number, how many codes of 1 to 16 bits, the codes' symbols (T.81, B.2.4.2)."""
    while segment:
        kind, counts = segment[0], np.frombuffer(segment[1:17], np.uint8).astype(np.int64)
        total = int(counts.sum())
        symbols = np.frombuffer(segment[17 : 17 + total], np.uint8)
        lengths = np.repeat(np.arange(1, len(counts) + 1), counts)
        spans = 1 << (16 - lengths)
        if kind & 0xEC or len(counts) < 16 or len(symbols) < total or spans.sum() > 1 << 16:
            raise _damaged(state.path, "a table of codes that is none")
        table = state.tables[(kind >> 4) * 4 + (kind & 3)]
        table[:] = 0
        table[: spans.sum()] = np.repeat(lengths << 8 | symbols, spans)
        segment = segment[17 + total :]


def _frame(state: _State, marker: int, segment: bytes) -> None:
    """The frame header: bits, size, components and their sampling (T.81, B.2.2)."""
    path = state.path
    if state.frame or len(segment) < 6 or len(segment) != 6 + 3 * segment[5]:
        raise _damaged(path, "a frame header of the wrong size, or two of them")
    bits, rows, columns, count = segment[0], int.from_bytes(segment[1:3]), int.from_bytes(segment[3:5]), segment[5]
    if bits != 8:
        raise InputError(path, f"JPEG of {bits} bits a sample", "export as JPEG of 8 bits, or as PNG or TIFF of 16")
    if count not in (1, 3):
        kind = " (CMYK)" if count == 4 else ""
        raise InputError(path, f"JPEG of {count} colour components{kind}", "export in gray or RGB")
    check_size(rows, columns, path)
    sampled = [(segment[i], segment[i + 1] >> 4, segment[i + 1] & 15) for i in range(6, len(segment), 3)]
    if len({one for one, _, _ in sampled}) < count or not all(1 <= h <= 4 and 1 <= v <= 4 for _, h, v in sampled):
        raise _damaged(path, "components that are none")
    across, down = max(h for _, h, _ in sampled), max(v for _, _, v in sampled)
    at = 0
    for name, h, v in sampled:
        stride = math.ceil(columns / (8 * across)) * h
        state.components[name] = (h, v, at, stride)
        state.known[name] = np.full(64, -1)
        at += stride * math.ceil(rows / (8 * down)) * v
    state.nonzero = np.zeros(at if marker == PROGRESSIVE else 0, np.uint64)
    state.frame, state.rows, state.columns = marker, rows, columns


def _scan(state: _State, segment: bytes, data: bytes, at: int) -> int:
    """Walk a scan (T.81, B.2.3) that starts at a place; return the place of the marker after it."""
    path = state.path
    count = segment[0] if segment else 0
    names = segment[1 : 1 + 2 * count : 2]
    if len(segment) != 4 + 2 * count or not count or not set(names) <= set(state.components) or len({*names}) < count:
        raise _damaged(path, "a scan header that does not go with the frame's")
    first, last, earlier, lowest = segment[-3], segment[-2], segment[-1] >> 4, segment[-1] & 15
    if state.frame != PROGRESSIVE:
        fits = (first, last, earlier, lowest) == (0, 63, 0, 0)
    else:
        fits = first <= last < 64 and (last == 0 if first == 0 else count == 1)
        fits &= lowest == earlier - 1 if earlier else lowest <= MAX_SHIFT
    for name in names:
        known = state.known[name]
        fits &= bool(np.all(known[first : last + 1] == (earlier or -1))) and (first == 0 or known[0] >= 0)
        known[first : last + 1] = lowest
    if not fits:
        raise _damaged(path, f"a scan of coefficients {first} to {last} out of order")
    units, per_row, parts = _units(state, segment[1 : 1 + 2 * count])
    end = MARKER.search(data, at)
    if end is None:
        raise InputError(path, "cut short: no end marker", RIGHT)
    pieces = RESTART.split(data[at : end.start()])
    step = state.interval or units
    restarts = [piece[0] & 7 for piece in pieces[1::2]]
    if restarts != [i % 8 for i in range(math.ceil(units / step) - 1)]:
        raise _damaged(path, "cut short, or restart markers out of order")
    for i, piece in enumerate(pieces[::2]):
        codes = piece.replace(b"\xff\0", b"\xff")
        padded = np.frombuffer(codes + bytes(SLACK), np.uint8)
        start, stop = i * step, min((i + 1) * step, units)
        kind = (state.frame == PROGRESSIVE, first, last, earlier)
        left = 8 * len(codes) - _walk(padded, state.tables, parts, kind, start, stop, per_row, state.nonzero)
        if not 0 <= left < 8:
            raise _damaged(path, "codes that do not make up its picture")
    return end.start()


def _units(state: _State, chosen: bytes) -> tuple[int, int, NDArray[np.int64]]:
    """How many units a scan has, in all and in a row, and for each component: tables, blocks, place, blocks in a row.

    A unit is one block where a scan has one component, else that many of each as it is sampled (T.81, A.2).
    """
    across = max(h for h, _, _, _ in state.components.values())
    down = max(v for _, v, _, _ in state.components.values())
    parts = []
    for name, numbers in zip(chosen[::2], chosen[1::2], strict=True):
        h, v, at, stride = state.components[name]
        parts.append((numbers >> 4 & 3, 4 + (numbers & 3), h, v, at, stride))
    if len(parts) > 1:
        per_row = math.ceil(state.columns / (8 * across))
        return per_row * math.ceil(state.rows / (8 * down)), per_row, np.array(parts)
    dc, ac, h, v, at, stride = parts[0]
    per_row = math.ceil(math.ceil(state.columns * h / across) / 8)
    per_column = math.ceil(math.ceil(state.rows * v / down) / 8)
    return per_row * per_column, per_row, np.array([(dc, ac, 1, 1, at, stride)])


@inner
def _peek(codes: NDArray[np.uint8], at: int, count: int) -> int:
    """The next bits, up to 16."""
    i = at >> 3
    word = int(codes[i]) << 16 | int(codes[i + 1]) << 8 | int(codes[i + 2])
    return (word >> (24 - (at & 7) - count)) & ((1 << count) - 1)


@inner
def _symbol(codes: NDArray[np.uint8], at: int, table: Table) -> tuple[int, int]:
    """The next code's symbol and the place after it; −1 where there is no such code."""
    entry = int(table[_peek(codes, at, 16)])
    return (entry & 255, at + (entry >> 8)) if entry else (-1, at)


@inner
def _sequential(codes: NDArray[np.uint8], at: int, dc: Table, ac: Table) -> int:
    """The place after a block of a sequential scan (T.81, F.2.2); −1 for damage."""
    size, at = _symbol(codes, at, dc)
    if not 0 <= size <= MAX_DC:
        return -1
    at += size
    k = 1
    while k < 64:
        symbol, at = _symbol(codes, at, ac)
        if symbol == 0:
            return at
        run, size = symbol >> 4, symbol & 15
        k += run
        if symbol < 0 or size > MAX_AC or k > 63 or (size == 0 and run < 15):
            return -1
        at += size
        k += 1
    return at


@inner
def _first_pass(
    codes: NDArray[np.uint8], at: int, ac: Table, first: int, last: int, known: NDArray[np.uint64]
) -> tuple[int, int]:
    """The place after a block's coefficients that come for the first time (T.81, G.1.2.2), and how many blocks after
    it have none; −1 for damage.
    """
    k = first
    while k <= last:
        symbol, at = _symbol(codes, at, ac)
        if symbol < 0:
            return -1, 0
        run, size = symbol >> 4, symbol & 15
        if size == 0 and run < 15:
            return at + run, (1 << run) - 1 + _peek(codes, at, run)
        k += run
        if size > MAX_AC or k > last:
            return -1, 0
        if size:
            known[0] |= np.uint64(1) << np.uint64(k)
            at += size
        k += 1
    return at, 0


@inner
def _refinement(
    codes: NDArray[np.uint8], at: int, ac: Table, first: int, last: int, known: NDArray[np.uint64], ended: int
) -> tuple[int, int]:
    """The place after one more bit of a block's coefficients (T.81, G.1.2.3), and how many blocks after it get no new
    ones; `ended` counts this block, too, if it is one of those; −1 for damage.
    """
    k = first
    while ended == 0 and k <= last:
        symbol, at = _symbol(codes, at, ac)
        run, size = symbol >> 4, symbol & 15
        if symbol < 0 or size > 1:
            return -1, 0
        if size == 0 and run < 15:
            ended = (1 << run) + _peek(codes, at, run)
            at += run
            break
        at += size
        while k <= last:
            if known[0] >> np.uint64(k) & np.uint64(1):
                at += 1
            elif run == 0:
                break
            else:
                run -= 1
            k += 1
        if k > last:
            return -1, 0
        if size:
            known[0] |= np.uint64(1) << np.uint64(k)
        k += 1
    if ended == 0:
        return at, 0
    while k <= last:
        at += int(known[0] >> np.uint64(k) & np.uint64(1))
        k += 1
    return at, ended - 1


@compiled
def _walk(
    codes: NDArray[np.uint8],
    tables: Table,
    parts: NDArray[np.int64],
    kind: tuple[bool, int, int, int],
    start: int,
    stop: int,
    per_row: int,
    nonzero: NDArray[np.uint64],
) -> int:
    """The place [bit] after the units `start` to `stop` of a scan; past the codes' end for damage."""
    progressive, first, last, earlier = kind
    damage = 8 * codes.size
    end = damage - 8 * SLACK
    at, ended = 0, 0
    for unit in range(start, stop):
        for p in range(parts.shape[0]):
            dc, ac = tables[parts[p, 0]], tables[parts[p, 1]]
            across, down = parts[p, 2], parts[p, 3]
            for block in range(across * down):
                if not progressive:
                    at = _sequential(codes, at, dc, ac)
                elif first == 0 and earlier:
                    at += 1
                elif first == 0:
                    size, at = _symbol(codes, at, dc)
                    at = at + size if 0 <= size <= MAX_DC else -1
                else:
                    row = unit // per_row * down + block // across
                    place = parts[p, 4] + row * parts[p, 5] + unit % per_row * across + block % across
                    known = nonzero[place : place + 1]
                    if earlier:
                        at, ended = _refinement(codes, at, ac, first, last, known, ended)
                    elif ended:
                        ended -= 1
                    else:
                        at, ended = _first_pass(codes, at, ac, first, last, known)
                if not 0 <= at <= end:
                    return damage
    return at if ended == 0 else damage
