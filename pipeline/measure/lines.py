"""The yarn cut along the frame's own lines: its rows where it stands more upright than flat, else its columns.

On a line the distance from the axis grows by q = max(|sin|, |cos|) of the axis' angle with each pixel, so to lay the
pixels of all lines side by side by their distance w takes a shift by a fraction of a pixel, the same all along one
line: no pixel needs a place of its own. From line to line it is 1/q along the axis. Laid side by side, what is square
to the axis leans: at w it lies w times the shear further on.

Where the axis is bent, w is the distance from a parabola: its place on each line follows the bend, and square to it is
what is square to its tangent in the middle; the error of that changes sign from one end to the other.

The shift is by cubic convolution (Keys, IEEE Trans. ASSP 29, 1981): exact for quadratics, and it blurs less than linear
interpolation does. It is symmetric, so it moves no edge.
"""

import math

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner
from pipeline.records import Array

Image = NDArray[np.float32]
Pixels = NDArray[np.uint8] | NDArray[np.uint16]

TAPS = 4
"""Pixels that a value is interpolated from."""
BLOCK = 8
"""Lines of a block, over which a form is given."""


@compiled
def step_across(angle: float) -> float:
    """Return q, the distance from the axis between pixels of a line [px]; from line to line it is 1/q along it."""
    return max(abs(math.sin(angle)), abs(math.cos(angle)))


@compiled
def span(rows: int, columns: int, x: float, y: float, angle: float, half: float) -> tuple[float, float]:
    """Return the positions along the axis between which a band of this half width lies inside the frame.

    The first is not below the second where it lies inside nowhere.
    """
    low, high = -math.inf, math.inf
    c, s = math.cos(angle), math.sin(angle)
    for side in (-half, half):
        for start, step, last in ((x + side * s, c, columns - 1.0), (y + side * c, -s, rows - 1.0)):
            if abs(step) >= 1e-9:
                first, second = -start / step, (last - start) / step
                low, high = max(low, min(first, second)), min(high, max(first, second))
            elif not 0 <= start <= last:
                return 0.0, 0.0
    return low, high


@inner
def _shear(angle: float) -> float:
    """Return how many lines further on is what lies square to the axis, for each pixel to its right [1/px]."""
    c, s = math.cos(angle), math.sin(angle)
    return math.copysign(c, -c * s) if abs(s) >= abs(c) else math.copysign(s, c * s)


@inner
def _lines(x: float, y: float, angle: float, count: int) -> tuple[bool, int, int, int, float, float, float]:
    """Return where `count` lines along the axis are whose middle is next to (x, y).

    Returns
    -------
    Whether they are rows; the first one, and the step from one to the next in the axis' direction, 1 or -1; the step
    between pixels to the axis' right, 1 or -1; the pixel of the first line that the axis crosses, and how much further
    the next one's is; the first line's place along the axis, from (x, y) [px].
    """
    c, s = math.cos(angle), math.sin(angle)
    if abs(s) >= abs(c):
        step = -1 if s > 0 else 1
        first = round(y - step * (count - 1) / 2)
        return True, first, step, 1 if s > 0 else -1, x + (y - first) * c / s, -step * c / s, (y - first) / s
    step = 1 if c > 0 else -1
    first = round(x - step * (count - 1) / 2)
    return False, first, step, step, y - (first - x) * s / c, -step * s / c, (first - x) / c


@inner
def _bent(bend: float, lean: float, along: float) -> float:
    """Return how far to the right of its tangent a bent axis is where a line of the frame crosses it [px].

    Parameters
    ----------
    bend : of the axis, to its right [1/px].
    lean : how much further back along the tangent the line is, for each pixel to its right.
    along : where the line crosses the tangent [px].
    """
    across = 0.0
    for _ in range(3):
        place = along - lean * across
        across = 0.5 * bend * place * place
    return across


@inner
def _form_at(form: Array, line: float) -> float:
    """Return a form, see `unrolled`, at a line counted from the middle, by linear interpolation."""
    place = min(max(line / BLOCK + (form.size - 1) / 2, 0.0), form.size - 1.0)
    near = min(math.floor(place), form.size - 2)
    return float(form[near] + (place - near) * (form[near + 1] - form[near]))


@inner
def taps(t: float) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Return the weights of the pixels at -1, 0, 1 and 2 for the value at t in [0, 1)."""
    u = 1 - t
    return (
        np.float32(-0.5 * t * u * u),
        np.float32(1 + t * t * (1.5 * t - 2.5)),
        np.float32(1 + u * u * (1.5 * u - 2.5)),
        np.float32(-0.5 * u * t * t),
    )


@inner
def _set_line(
    frame: Image | Pixels, rows: bool, line: int, place: float, side: int, window: Image, values: Image
) -> None:
    """Set values, shape (2 half + 1,), to a line's at whole pixels from `place`, to the axis' right if `side` is 1.

    Pixels beyond the frame are taken for those at its border. `window` is overwritten, shape (2 half + TAPS,).
    """
    far = frame.shape[1] if rows else frame.shape[0]
    line = min(max(line, 0), (frame.shape[0] if rows else frame.shape[1]) - 1)
    before = math.floor(side * place)
    first = side * (before - values.size // 2 - 1)
    last = first + side * (window.size - 1)
    low = min(first, last)
    whole = low >= 0 and max(first, last) < far
    if not whole:
        for i in range(window.size):
            at = min(max(first + side * i, 0), far - 1)
            window[i] = frame[line, at] if rows else frame[at, line]
    elif rows:  # unsigned, so that no place counts from the end: with a test for that there would be no vectors
        for i in range(window.size):
            window[i] = frame[line, np.uint64(low + i)]
    else:
        for i in range(window.size):
            window[i] = frame[np.uint64(low + i), line]
    if whole and side < 0:
        last = window.size - 1
        for i in range(window.size // 2):
            window[i], window[last - i] = window[last - i], window[i]
    a, b, c, d = taps(side * place - before)
    for i in range(values.size):
        values[i] = a * window[i] + b * window[i + 1] + c * window[i + 2] + d * window[i + 3]


@inner
def _laid(
    frame: Image | Pixels, x: float, y: float, angle: float, bend: float, half: int, count: int
) -> tuple[Image, float, float]:
    """Lay the lines of a frame side by side by distance from the axis, for `count` places along it about (x, y).

    Returns
    -------
    Shape (2 half + 1, lines), rows q apart; where in a row the first place lies; and how many lines further on for each
    pixel to the axis' right.
    """
    shear, q = _shear(angle), step_across(angle)
    margin = math.ceil(half * q * abs(shear)) + TAPS
    lines = count + 2 * margin
    rows, first, step, side, place, slope, begin = _lines(x, y, angle, lines)
    laid = np.empty((2 * half + 1, lines), np.float32)
    window, values = np.empty(2 * half + TAPS, np.float32), np.empty(2 * half + 1, np.float32)
    for j in range(lines):
        middle = place + slope * j + side * _bent(bend, shear / q, begin + j / q) / q
        _set_line(frame, rows, first + step * j, middle, side, window, values)
        for i in range(values.size):
            laid[i, j] = values[i]
    return laid, -begin * q - (count - 1) / 2, shear


@compiled
def block_means(
    frame: Image | Pixels, x: float, y: float, angle: float, bend: float, half: int, count: int, block: int
) -> Image:
    """Return the means over lengths of yarn, square to the axis to a quarter of a block, by distance from it.

    Parameters
    ----------
    frame : shape (rows, columns).
    x, y, angle : a point of the axis [px] and its angle there, counter-clockwise from +x as displayed.
    bend : curvature of the axis, to its right [1/px].
    half : pixels of a line on each side of the axis.
    count : number of blocks, their middle at (x, y).
    block : lines in each, an even number.

    Returns
    -------
    Shape (count, 2 half + 1), columns to the right of the axis and `step_across` apart.
    """
    shear, q = _shear(angle), step_across(angle)
    size, part, lean = 2 * half + 1, block // 2, shear * q
    # halves of blocks first, which all pixels of a line belong to, then blocks of those that lie square to the axis
    halves = 2 * count + 2 * math.ceil(half * abs(lean) / part) + 2
    rows, first, step, side, place, slope, begin = _lines(x, y, angle, part * halves)
    sums, window, values = (
        np.zeros((halves, size), np.float32),
        np.empty(size + TAPS - 1, np.float32),
        np.empty(size, np.float32),
    )
    for k in range(halves):
        total = sums[k]
        for j in range(part * k, part * (k + 1)):
            middle = place + slope * j + side * _bent(bend, shear / q, begin + j / q) / q
            _set_line(frame, rows, first + step * j, middle, side, window, values)
            for i in range(size):
                total[i] += values[i]
    start = -begin * q - (count * block - 1) / 2  # the line that the first block begins with
    means = np.empty((count, size), np.float32)
    for i in range(size):
        one = round((start + (i - half) * lean) / part)
        for k in range(count):
            means[k, i] = (sums[one + 2 * k, i] + sums[one + 2 * k + 1, i]) / np.float32(block)
    return means


@compiled
def unrolled(
    frame: Image | Pixels, x: float, y: float, angle: float, bend: float, form: Array, across: Array, count: int
) -> Image:
    """Return the frame's level at distances from the axis, square to it.

    Parameters
    ----------
    frame, x, y, angle, bend : see `block_means`.
    form : the yarn's width over the mean, of which distances from the axis are a share, on blocks of `BLOCK` lines side
        by side, their middle at (x, y), shape (blocks,); empty where it does not vary.
    across : distances from the axis, to its right [px], shape (n,).
    count : places along the axis, 1/`step_across` apart, their middle at (x, y).

    Returns
    -------
    Shape (n, count).
    """
    q = step_across(angle)
    widest = np.max(form) if form.size else 1.0
    half = math.ceil(np.max(np.abs(across)) * widest / q) + TAPS
    laid, start, shear = _laid(frame, x, y, angle, bend, half, count)
    surface, mixed = np.empty((across.size, count), np.float32), np.empty(laid.shape[1], np.float32)
    for k in range(across.size):
        if form.size:
            before = start + (count - 1) / 2 + across[k] * shear
            for j in range(mixed.size):
                place = across[k] * _form_at(form, j - before) / q + half
                near = math.floor(place)
                a, b, c, d = taps(place - near)
                mixed[j] = a * laid[near - 1, j] + b * laid[near, j] + c * laid[near + 1, j] + d * laid[near + 2, j]
        else:
            place = across[k] / q + half
            near = math.floor(place)
            a, b, c, d = taps(place - near)
            first, second, third, fourth = laid[near - 1], laid[near], laid[near + 1], laid[near + 2]
            for j in range(mixed.size):
                mixed[j] = a * first[j] + b * second[j] + c * third[j] + d * fourth[j]
        place = start + across[k] * shear
        near = math.floor(place)
        a, b, c, d = taps(place - near)
        source, target = mixed[near - 1 :], surface[k]
        for j in range(count):
            target[j] = a * source[j] + b * source[j + 1] + c * source[j + 2] + d * source[j + 3]
    return surface


@compiled
def share_above(
    frame: Pixels, x: float, y: float, angle: float, bend: float, radius: float, length: float, level: int
) -> float:
    """Return the share of the pixels within a radius of the axis, over a length of it, that reach a level."""
    q = step_across(angle)
    count, half = max(1, math.floor(length * q)), radius / q
    rows, first, step, side, place, slope, begin = _lines(x, y, angle, count)
    lean = _shear(angle) / q
    far = frame.shape[1] if rows else frame.shape[0]
    above, seen = 0, 0
    for j in range(count):
        line = min(max(first + step * j, 0), (frame.shape[0] if rows else frame.shape[1]) - 1)
        middle = place + slope * j + side * _bent(bend, lean, begin + j / q) / q
        low, high = max(0, math.ceil(middle - half)), min(far, math.floor(middle + half) + 1)
        seen += max(0, high - low)
        if rows:
            across = frame[line, low:high]
            for i in range(across.size):
                above += 1 if across[i] >= level else 0
        else:
            down = frame[low:high, line]
            for i in range(down.size):
                above += 1 if down[i] >= level else 0
    return above / max(seen, 1)
