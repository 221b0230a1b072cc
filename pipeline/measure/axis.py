"""The yarn in one frame: its axis and its diameter, to a fraction of a pixel.

Three steps, none of which needs a threshold from the user:

1. *Find.* On a reduced frame, a smooth background (quadratic in x and y, fitted robustly) is subtracted; Otsu's
   threshold and connected components give the largest elongated thing; a line is fitted to its full cross-sections
   only, because the slanted ends where the frame cuts the yarn would turn the line.
2. *Align.* The frame is straightened along the line. The mean cross profile p(w) is held against each short block of
   the yarn: I(w) = g·p(w) + o − δ·p′(w) is solved for the block's shift δ (the image registration of Lucas and Kanade,
   IJCAI 1981, with gain and offset). p′ is large at the two edges only, so δ is the mean of both edges' sub-pixel
   positions and texture hardly enters. A robust line through δ corrects the axis; blocks with a hair or a second
   object drop out.
3. *Diameter.* A lit cylinder is darker towards its edges, so the width at half of its peak is too small (13 % for
   Lambert's law from the front). The edge is half way between the background and the body *at the edge*: the profile
   is fitted with a body of radius R whose brightness is a combination of 1, sinγ and cosγ (w = R sinγ: ambient light
   and Lambert's law from any side), blurred by a Gaussian, on a linear background. Symmetric blur moves no edge. The
   profile is the mean of the middle half of the values at each w, which leaves hairs out.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.records import Array

Image = NDArray[np.float32]

REDUCTION = 4
"""Step of the reduced frame that the yarn is looked for in [px]."""
BLOCK = 8
"""Length of yarn whose shift is found at once [px]."""
MIN_DIAMETER = 4.0
"""Thinner things are not measured [px]."""
MIN_ASPECT = 2.0
"""Length in view over diameter below which a thing has no axis."""


@dataclass(frozen=True, slots=True)
class YarnAxis:
    """Where the yarn is in a frame, in pixels of the frame, pixel centres at whole numbers."""

    centre: tuple[float, float]
    """A point (x, y) on the axis, rows top-down."""
    angle: float
    """[rad] in [0, π), counter-clockwise from +x as displayed."""
    diameter: float
    """[px]"""
    blur: float
    """Standard deviation of the edges' blur, pixel included [px]."""
    length: float
    """Length of yarn whose full width is in view [px]."""
    agreement: float
    """Share of the yarn's length in view that follows the line: 1 where no hair or second object disturbs it."""
    strip: Image
    """The frame straightened along the axis, shape (2h + 1, length): columns along the axis, row h near the axis."""
    offset: float
    """Distance of the axis from row h, to the right of the axis direction [px]."""

    @property
    def across(self) -> Array:
        """Distance of the strip's rows from the axis, to the right of the axis direction [px], shape (2h + 1,)."""
        half = self.strip.shape[0] // 2
        return np.arange(-half, half + 1) - self.offset


def find_axis(frame: NDArray[np.uint8] | NDArray[np.uint16]) -> YarnAxis | None:
    """Find the yarn in a frame, or None where there is none.

    Parameters
    ----------
    frame : shape (rows, columns), rows top-down.
    """
    image = frame.astype(np.float32)
    line = _find_line(image)
    if line is None:
        return None
    x, y, angle, radius = line
    agreement, strip = 0.0, image
    for _ in range(3):
        half = math.ceil(1.3 * radius + 6)
        span = _span(image.shape, x, y, angle, half)
        if span is None or span[1] - span[0] < max(MIN_ASPECT * 2 * radius, 4 * BLOCK):
            return None
        x, y = _along(x, y, angle, sum(span) / 2)
        strip = straighten(image, (x, y), angle, half, math.floor(span[1] - span[0]))
        found = _shifts(strip)
        if found is None:
            return None
        shift, tilt, agreement = found
        x, y = x + shift * math.sin(angle), y + shift * math.cos(angle)
        angle -= math.atan(tilt)
        if abs(shift) < 0.1 and abs(tilt) * strip.shape[1] < 0.2:
            break
    length = strip.shape[1]
    half = strip.shape[0] // 2
    strip = straighten(image, (x, y), angle, half, length)
    body = _fit_profile(strip, radius)
    if body is None:
        return None
    offset, radius, blur = body
    if 2 * radius < MIN_DIAMETER or length < MIN_ASPECT * 2 * radius or half < radius + 2:
        return None
    x, y = x + offset * math.sin(angle), y + offset * math.cos(angle)
    return YarnAxis((x, y), angle % math.pi, 2 * radius, blur, float(length), agreement, strip, offset)


def straighten(image: Image, centre: tuple[float, float], angle: float, half: int, length: int) -> Image:
    """Resample a frame along an axis by bicubic interpolation at the frame's own pixel pitch.

    Parameters
    ----------
    image : shape (rows, columns).
    centre : point (x, y) of the axis that becomes the strip's centre [px].
    angle : [rad], counter-clockwise from +x as displayed.
    half : rows on each side of the axis.
    length : columns of the strip.

    Returns
    -------
    Shape (2 half + 1, length); columns run along the axis, rows to the right of it.
    """
    c, s = math.cos(angle), math.sin(angle)
    start = -(length - 1) / 2
    matrix = np.array(
        [[c, s, centre[0] + start * c - half * s], [-s, c, centre[1] - start * s - half * c]], dtype=np.float64
    )
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    size = (length, 2 * half + 1)
    return cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)  # pyright: ignore[reportReturnType]


def _along(x: float, y: float, angle: float, distance: float) -> tuple[float, float]:
    return x + distance * math.cos(angle), y - distance * math.sin(angle)


def _span(shape: tuple[int, ...], x: float, y: float, angle: float, half: float) -> tuple[float, float] | None:
    """Return the positions along the axis between which a band of this half width lies inside the frame."""
    low, high = -math.inf, math.inf
    for side in (-half, half):
        for start, step, size in (
            (x + side * math.sin(angle), math.cos(angle), shape[1] - 1),
            (y + side * math.cos(angle), -math.sin(angle), shape[0] - 1),
        ):
            if abs(step) < 1e-9:
                if not 0 <= start <= size:
                    return None
                continue
            ends = sorted((-start / step, (size - start) / step))
            low, high = max(low, ends[0]), min(high, ends[1])
    return (low, high) if low < high else None


@lru_cache(maxsize=4)
def _surface_basis(rows: int, columns: int) -> Array:
    """Return 1, u, v, u², uv, v² over a frame's pixels, shape (rows, columns, 6)."""
    v, u = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def _background(image: Image) -> Image:
    """Fit a quadratic surface to most of the pixels, leaving out what deviates (iterated, 3 median deviations)."""
    basis = _surface_basis(*image.shape)
    coarse = basis[::2, ::2].reshape(-1, 6)
    values = image[::2, ::2].reshape(-1).astype(float)
    rest, coefficients = values - np.median(values), np.zeros(6)
    for _ in range(4):
        keep = np.abs(rest) <= 3 * 1.4826 * np.median(np.abs(rest)) + 1e-9
        kept = coarse[keep]
        coefficients = np.linalg.lstsq(kept.T @ kept, kept.T @ values[keep], rcond=None)[0]
        rest = values - coarse @ coefficients
    return (basis @ coefficients).astype(np.float32)


def _find_line(image: Image) -> tuple[float, float, float, float] | None:
    """Return a point (x, y), the angle and the half width of the largest elongated thing, good to about a pixel."""
    size = (image.shape[1] // REDUCTION, image.shape[0] // REDUCTION)
    if min(size) < 4:
        return None
    small = cv2.resize(image[: size[1] * REDUCTION, : size[0] * REDUCTION], size, interpolation=cv2.INTER_AREA)
    deviation = np.abs(small - _background(small))  # pyright: ignore[reportArgumentType]
    top = float(deviation.max())
    if top <= 0:
        return None
    _, mask = cv2.threshold((deviation * (255 / top)).astype(np.uint8), 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    for label in 1 + np.argsort(stats[1:, cv2.CC_STAT_AREA])[::-1][:3]:
        found = _line_through(np.argwhere(labels == label)[:, ::-1].astype(float), small.shape)
        if found is not None:
            x, y, angle, half = found
            edge = (REDUCTION - 1) / 2
            return x * REDUCTION + edge, y * REDUCTION + edge, angle, half * REDUCTION
    return None


def _line_through(points: Array, shape: tuple[int, ...]) -> tuple[float, float, float, float] | None:
    """Fit a line to the full cross-sections of a band of pixels (x, y), shape (n, 2), rows top-down."""
    if len(points) < 12:
        return None
    mean = points.mean(axis=0)
    spread, directions = np.linalg.eigh(np.cov((points - mean).T))
    if spread[1] < MIN_ASPECT**2 * spread[0]:
        return None
    angle = math.atan2(-directions[1, 1], directions[0, 1])
    x, y = float(mean[0]), float(mean[1])
    half = math.sqrt(3 * max(float(spread[0]), 1 / 12))
    for _ in range(4):
        c, s = math.cos(angle), math.sin(angle)
        along = (points[:, 0] - x) * c - (points[:, 1] - y) * s
        across = (points[:, 0] - x) * s + (points[:, 1] - y) * c
        span = _span(shape, x, y, angle, half)
        near = np.abs(across - np.median(across)) < 1.3 * half + 1
        if span is not None:
            near &= (along > span[0]) & (along < span[1])
        if near.sum() < 12:
            return None
        along, across = along[near], across[near]
        length = float(np.ptp(along)) + 1
        centred = along - along.mean()
        tilt = float(centred @ across) / float(centred @ centred)
        half = max(0.5, len(along) / length / 2)
        if length < MIN_ASPECT * 2 * half:
            return None
        shift = float(across.mean() - tilt * along.mean())
        x, y = x + shift * s, y + shift * c
        angle -= math.atan(tilt)
    return x, y, angle, half


def _middle_mean(strip: Image) -> tuple[Array, Array]:
    """Return the mean of the middle half of each row's values, and their interquartile range, both shape (rows,)."""
    ordered = np.sort(strip, axis=1)
    quarter = strip.shape[1] // 4
    middle = ordered[:, quarter : strip.shape[1] - quarter]
    return middle.mean(axis=1, dtype=np.float64), (middle[:, -1] - middle[:, 0]).astype(float)


def _shifts(strip: Image) -> tuple[float, float, float] | None:
    """Return the yarn's shift across at the strip's centre [px], its tilt (a slope), the share of blocks that agree."""
    profile, _ = _middle_mean(strip)
    slope = np.gradient(profile)
    design = np.column_stack([profile, np.ones_like(profile), -slope])
    scale = np.linalg.norm(design, axis=0)
    if scale.min() <= 0:
        return None
    count = strip.shape[1] // BLOCK
    blocks = strip[:, : count * BLOCK].reshape(strip.shape[0], count, BLOCK).mean(axis=2)
    gain, _, moved = (np.linalg.pinv(design / scale) @ blocks) / scale[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = moved / gain
    position = (np.arange(count) + 0.5) * BLOCK - strip.shape[1] / 2
    usable = np.isfinite(shift) & (gain > 0.3) & (np.abs(shift) < strip.shape[0] / 4)
    if usable.sum() < max(3, 0.3 * count):
        return None
    shift, position = shift[usable], position[usable]
    weight = np.ones_like(shift)
    level = tilt = 0.0
    for _ in range(10):
        total = weight.sum()
        middle = float(weight @ position) / total
        centred = position - middle
        tilt = float((weight * centred) @ shift) / float((weight * centred) @ centred)
        level = float(weight @ shift) / total - tilt * middle
        rest = shift - level - tilt * position
        # Tukey's biweight with the usual 4.685 deviations; the floor keeps a noise-free frame from rejecting itself
        reach = 4.685 * max(1.4826 * float(np.median(np.abs(rest))), 0.02)
        weight = np.clip(1 - (rest / reach) ** 2, 0, None) ** 2
    return level, tilt, float(np.count_nonzero(weight > 0.2)) / count


INNER = 0.5
"""Share of the radius inside of which the profile says nothing of the edges and is left out of the fit."""


@lru_cache(maxsize=16)
def _quadrature(count: int) -> tuple[Array, Array, Array]:
    """Return sin γ over (−π/2, π/2) at Gauss–Legendre nodes, weights for dw/R, and the shades 1, sin γ, cos γ."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    gamma = nodes * (math.pi / 2)
    shades = np.column_stack([np.ones_like(gamma), np.sin(gamma), np.cos(gamma)])
    return np.sin(gamma), weights * (math.pi / 2) * np.cos(gamma), shades


def _profile_basis(across: Array, parameters: Array) -> Array:
    """Return the profile's linear terms: background 1 and w, body 1, sinγ and cosγ, all blurred.

    Parameters
    ----------
    across : w, shape (n,) [px].
    parameters : offset, radius [px] and the logarithm of the blur, shape (m, 3).

    Returns
    -------
    Shape (m, n, 5).
    """
    offset, radius, blur = (
        parameters[:, 0, None, None],
        parameters[:, 1, None, None],
        np.exp(parameters[:, 2, None, None]),
    )
    # nodes closer than the narrowest usual blur
    sine, weight, shades = _quadrature(16 * math.ceil(3 * float(parameters[0, 1]) / 16))
    point_spread = np.exp(-0.5 * ((across[:, None] - offset - radius * sine) / blur) ** 2)
    body = (point_spread * (weight * radius / (blur * math.sqrt(2 * math.pi)))) @ shades
    background = np.broadcast_to(np.column_stack([np.ones_like(across), across]), (*body.shape[:2], 2))
    return np.concatenate([background, body], axis=2)


def _fit_profile(strip: Image, radius: float) -> tuple[float, float, float] | None:
    """Fit the blurred, shaded body to a strip's profile; return offset, radius and blur [px], None without contrast.

    Rows weigh by the spread of their values, so texture in the body does not outweigh the edges. Separable least
    squares (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973): Levenberg's steps in offset, radius and blur, all else
    linear.
    """
    half = strip.shape[0] // 2
    across = np.arange(-half, half + 1, dtype=float)
    profile, spread = _middle_mean(strip)
    outer = np.abs(across) > INNER * radius
    across, weight = across[outer], 1 / np.maximum(spread[outer], 1e-3 * max(np.ptp(profile), 1e-9))
    values = profile[outer] * weight

    def residuals(parameters: Array) -> tuple[Array, Array]:
        """Return residuals, shape (m, n), and coefficients, shape (m, 5), for parameters of shape (m, 3)."""
        basis = _profile_basis(across, parameters) * weight[:, None]
        scale = np.sqrt(np.sum(basis**2, axis=1, keepdims=True)) + 1e-300
        basis /= scale
        normal = np.swapaxes(basis, 1, 2) @ basis + 1e-10 * np.eye(5)
        coefficients = np.linalg.solve(normal, np.swapaxes(basis, 1, 2) @ values[:, None])
        return (basis @ coefficients)[..., 0] - values, coefficients[..., 0] / scale[:, 0]

    parameters = np.array([0.0, radius, 0.0])
    low = np.array([-radius, 0.6 * radius, math.log(0.3)])
    high = np.array([radius, min(1.4 * radius, half - 1.0), math.log(max(radius / 2, 1.0))])
    nudge = 1e-4 * np.vstack([np.zeros(3), np.eye(3)])
    damping, moved = 1e-3, math.inf
    rest, coefficients = residuals(parameters + nudge)
    for _ in range(20):
        jacobian = (rest[1:] - rest[0]) / 1e-4
        normal = jacobian @ jacobian.T
        step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal) + 1e-12), -jacobian @ rest[0], rcond=None)[0]
        trial = np.clip(parameters + step, low, high).astype(np.float64)
        trial_rest, trial_coefficients = residuals(trial + nudge)
        if trial_rest[0] @ trial_rest[0] < rest[0] @ rest[0]:
            moved = float(np.abs(trial - parameters).max())
            parameters, rest, coefficients = trial, trial_rest, trial_coefficients
            damping *= 0.1
        else:
            damping *= 10
        if moved < 5e-3 or damping > 1e3:
            break
    contrast = abs(float(coefficients[0, 2] + coefficients[0, 4] * math.pi / 4))
    if contrast < 5 * float(np.std(rest[0] / weight)) or not low[1] < parameters[1] < high[1]:
        return None
    return float(parameters[0]), float(parameters[1]), math.exp(parameters[2])
