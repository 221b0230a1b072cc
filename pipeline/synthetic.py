"""The synthetic rig: a yarn of known truth, rendered to frames and tension logs. Nothing here was measured on a yarn.

Frames show one yarn as a cylinder whose surface carries a broadband fibre texture that is fixed in the yarn and sheared
into a helix, u = γ − 2πT·x, lit, blurred by the optics, integrated over pixels and read with shot and read noise. A
plied yarn is several strands wound about each other. All this shares no code with pipeline.measure, so a measurement
that agrees with the truth does so for a reason.

`python -m pipeline.synthetic DIR --truth FILE` regenerates the study in DIR and writes the truth apart, bit for bit
the same each time. The truth series are smooth seeded draws (first-order autoregressive), shifted and scaled until each
record's own mean and coefficient of variation are the published ones (Yin, Tao, Jasper 2020, Table 2; `RIG` says
which are its own choice). A difference between the report and those numbers is therefore the measurement's, not
the draw's.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from pipeline.records import Array

SUPERSAMPLING = 3
"""Rays per pixel and direction."""
BITS = 12


@dataclass(frozen=True, slots=True)
class Material:
    """The surface of a yarn, unrolled and untwisted; lengths in yarn diameters, periodic in both directions."""

    texture: NDArray[np.float32]
    """Relative albedo − 1, shape (around, along): the circumference is 2π rad, the length is `length`."""
    length: float
    """Period along the yarn [diameters]."""
    hairs: Array
    """Hairs, shape (n, 5): angle around [rad], position along, length, lean along, curl around [rad]."""
    plies: int = 1
    """Strands that are wound about each other; the twist is then that of the plies, the fibres lie along the yarn."""
    tracer: tuple[float, float] = (0.0, 0.0)
    """Width around [rad] and relative albedo of one dyed fibre that never leaves the surface; 0 wide: there is none."""
    variation: tuple[float, float] = (0.0, 10.0)
    """Variation of the twist along the yarn: relative amplitude of a sine, and its wave length [diameters]."""
    thickness: tuple[float, float] = (0.0, 10.0)
    """The same for the diameter of a single yarn; hairs start from the mean one."""
    depth: float = 0.0
    """How far below the outline the fibres of a single yarn run [radii]: few fibres make a yarn's outline, most of
    those that are seen run further in."""

    @classmethod
    def draw(
        cls,
        rng: np.random.Generator,
        *,
        fibre_length: float = 3.0,
        hairs_per_diameter: float = 1.5,
        contrast: float = 0.18,
    ) -> "Material":
        """Draw a surface whose waves around are 1/4 to 1/40 of the circumference long.

        Finite fibres scatter about the helix, so the mean slope of a short stretch scatters too.

        Parameters
        ----------
        fibre_length : length over which a fibre shows on the surface [diameters]; about half a turn of the twist.
        hairs_per_diameter : hairs per length of one diameter.
        contrast : standard deviation of the albedo over its mean.
        """
        around, along, per_diameter = 512, 1024, 8
        wave_around = np.fft.fftfreq(around, 1 / around)[:, None]
        wave_along = np.fft.rfftfreq(along, 1 / per_diameter)[None, :]
        band = (np.abs(wave_around) >= 4) & (np.abs(wave_around) <= 40)
        amplitude = (
            band * np.exp(-np.abs(wave_around) / 20) * np.exp(-(math.pi**2) / 6 * (wave_along * fibre_length) ** 2)
        )
        noise = np.fft.rfft2(rng.standard_normal((around, along)))
        texture = np.fft.irfft2(noise * amplitude, s=(around, along))
        length = along / per_diameter
        n = round(hairs_per_diameter * length)
        hairs = np.column_stack(
            [
                rng.uniform(0, 2 * math.pi, n),
                rng.uniform(0, length, n),
                rng.gamma(2.0, 0.35, n),
                rng.normal(0, 0.8, n),
                rng.normal(0, 0.8, n),
            ]
        )
        return cls((texture * (contrast / texture.std())).astype(np.float32), length, hairs)


@dataclass(frozen=True, slots=True)
class Optics:
    """Light, lens and sensor. Levels are fractions of full scale."""

    blur: float = 0.8
    """Standard deviation of the point spread [px]."""
    defocus: float = 0.0
    """Radius of the disc that a point out of focus becomes [px]."""
    background: float = 0.06
    yarn: float = 0.5
    """Level of the yarn where it faces the light."""
    ambient: float = 0.35
    """Share of the light that has no direction; the rest falls from `light_angle` (Lambert's law)."""
    light_angle: float = 0.2
    """Direction of the light around the yarn axis, 0 towards the camera [rad]."""
    uneven: tuple[float, float] = (0.15, -0.1)
    """Relative change of the light from the centre to the right and the upper border of the frame."""
    gloss: tuple[float, float] = (0.0, 0.3)
    """Level of a shining band over the yarn's, half way between camera and light, and its standard deviation around
    [rad]."""
    full_well: float = 40000.0
    """Photoelectrons at full scale: the shot noise."""
    read_noise: float = 2.5
    """[counts]"""


Backdrop = Callable[[Array, Array], Array]
"""What lies behind the yarn: level at (right, up) from the frame's centre [px], which broadcast against each other."""


def bar(angle: float, place: float, width: float, level: float, *, lit: bool = False) -> Backdrop:
    """Return a straight thing behind the yarn on a dark ground: flat, or round and lit from the front.

    Parameters
    ----------
    angle : direction [rad], counter-clockwise from +x as displayed.
    place : distance from the frame's centre, to the right of the direction [px].
    width : [px]
    level : where it is brightest.
    """

    def backdrop(right: Array, up: Array) -> Array:
        sine = (right * math.sin(angle) - up * math.cos(angle) - place) / (width / 2)
        shade = np.sqrt(np.maximum(1 - sine**2, 0)) if lit else 1.0
        return np.where(np.abs(sine) < 1, level * (0.25 + 0.75 * shade), 0.0)

    return backdrop


def render_frame(
    material: Material,
    rng: np.random.Generator,
    *,
    shape: tuple[int, int],
    axis_angle: float,
    diameter: float,
    twist: float,
    offset: float = 0.0,
    phase: float = 0.0,
    travel: float = 0.0,
    tilt: float = 0.0,
    bend: float = 0.0,
    exposure: float = 0.0,
    backdrop: Backdrop | None = None,
    optics: Optics | None = None,
) -> NDArray[np.uint16]:
    """Render one 12-bit frame of a yarn, rows top-down.

    Parameters
    ----------
    material : the yarn's surface.
    rng : source of the sensor noise.
    shape : rows, columns.
    axis_angle : yarn axis [rad], counter-clockwise from +x as displayed.
    diameter : of the yarn, of a plied one that of the circle around its strands [px].
    twist : signed, Z > 0 [1/px].
    offset : distance of the axis from the frame's centre, to the right of the axis direction [px].
    phase : rotation of the helix about the yarn's axis [rad]; yarn that moves without rotating turns its helix by
        −2π·twist·travel.
    travel : distance that the yarn has moved along its axis [px].
    tilt : angle of the axis with the image plane, its far end nearer to the camera if positive [rad].
    bend : curvature of the axis, to the right of its direction; it has its direction next to the frame's centre, from
        which places along it are counted, and its diameter square to that [1/px].
    exposure : rotation while the shutter is open, about `phase` [rad].
    backdrop : added to the background's level.
    optics : `Optics()` if not given.
    """
    optics = optics or Optics()
    # instants at most 2.5° apart
    instants = 1 + math.ceil(abs(exposure) / math.radians(2.5))
    turns = ((np.arange(instants) + 0.5) / instants - 0.5) * exposure
    levels = [
        _level(
            material, optics, shape, axis_angle, diameter=diameter, twist=twist, offset=offset,
            phase=phase + turn, travel=travel, tilt=tilt, bend=bend, backdrop=backdrop,
        )
        for turn in turns.tolist()
    ]  # fmt: skip
    full = 2**BITS - 1
    counts = full * (levels[0] if instants == 1 else np.mean(levels, axis=0))
    noise = np.sqrt(full * counts.clip(0) / optics.full_well + optics.read_noise**2)
    return np.round(counts + noise * rng.standard_normal(shape)).clip(0, full).astype(np.uint16)


def compressed(frame: NDArray[np.uint16], quality: int) -> NDArray[np.uint8]:
    """Return a 12-bit frame as 8 bits that went through JPEG of a quality from 1 to 100."""
    _, data = cv2.imencode(".jpg", (frame >> (BITS - 8)).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def _level(
    material: Material,
    optics: Optics,
    shape: tuple[int, int],
    axis_angle: float,
    *,
    diameter: float,
    twist: float,
    offset: float,
    phase: float,
    travel: float,
    tilt: float,
    bend: float,
    backdrop: Backdrop | None,
) -> Array:
    """One instant without noise, as levels; parameters as for `render_frame`."""
    rows, columns = shape
    step = 1 / SUPERSAMPLING
    right: Array = (np.arange(columns * SUPERSAMPLING, dtype=np.float64) + 0.5) * step - columns / 2
    up: Array = (rows / 2 - (np.arange(rows * SUPERSAMPLING, dtype=np.float64) + 0.5) * step)[:, None]
    c, s = math.cos(axis_angle), math.sin(axis_angle)
    across = right * s - up * c - offset

    image = np.full(across.shape, optics.background, np.float32)
    if backdrop is not None:
        image += backdrop(right, up).astype(np.float32)
    along = right * c + up * s
    if bend:
        across -= 0.5 * bend * along**2
    width = _width(material, diameter, along - travel)
    body = np.abs(across) < width / 2
    if material.plies > 1:
        turn = phase + _unevenness(material, twist, diameter, along - travel)
        body &= _strand(material, across, along, diameter, twist, turn)[0] > -math.inf
    along = along[body]
    turn = phase + _unevenness(material, twist, diameter, along - travel)
    if material.plies > 1:
        _, gamma, number = _strand(material, across[body], along, diameter, twist, turn)
        around = gamma - phase + 1.3 * number  # the strands' own twist undoes the plies'
    else:
        gamma = np.arcsin(across[body] / (np.broadcast_to(width, body.shape)[body] / 2))
        if tilt:
            along = (along - diameter / 2 * np.cos(gamma) * math.sin(tilt)) / math.cos(tilt)
        place = np.arcsin(np.clip(np.sin(gamma) / (1 - material.depth), -1, 1)) if material.depth else gamma
        around = place - 2 * math.pi * twist * along - turn
    albedo = 1 + _texture_at(material, around, (along - travel) / diameter)
    width, dye = material.tracer
    if width:
        albedo[np.abs(np.mod(around + math.pi, 2 * math.pi) - math.pi) < width / 2] *= dye
    lambert = np.maximum(np.cos(gamma - optics.light_angle), 0)
    image[body] = optics.yarn * albedo * (optics.ambient + (1 - optics.ambient) * lambert)
    shine, spread = optics.gloss
    if shine:
        image[body] += optics.yarn * shine * np.exp(-0.5 * ((gamma - optics.light_angle / 2) / spread) ** 2)
    hairs = _hairs_in_view(
        material, shape, axis_angle, diameter=diameter, twist=twist, offset=offset, phase=phase, travel=travel,
        bend=bend,
    )  # fmt: skip
    for points in hairs:
        sixteenths = np.round(((points + 0.5) * SUPERSAMPLING - 0.5) * 16).astype(np.int32)
        cv2.polylines(image, [sixteenths], False, 0.6 * optics.yarn, 2, cv2.LINE_AA, 4)
    light = 1 + optics.uneven[0] * (2 / columns) * right + optics.uneven[1] * (2 / rows) * up
    image *= light.astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), optics.blur * SUPERSAMPLING, borderType=cv2.BORDER_REPLICATE)
    if optics.defocus:
        reach = math.ceil(optics.defocus * SUPERSAMPLING)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        disc = (np.hypot(x, y) <= optics.defocus * SUPERSAMPLING).astype(np.float32)
        image = cv2.filter2D(image, -1, disc / disc.sum(), borderType=cv2.BORDER_REPLICATE)
    return cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)


def _unevenness(material: Material, twist: float, diameter: float, place: Array) -> Array | float:
    """Extra rotation of the helix [rad] where the twist varies, at places along the yarn [px]."""
    amplitude, wave = material.variation
    if not amplitude:
        return 0.0
    wave *= diameter
    return amplitude * twist * wave * np.sin(2 * math.pi / wave * place)


def _width(material: Material, diameter: float, place: Array) -> Array | float:
    """Diameter at places along the yarn [px]."""
    amplitude, wave = material.thickness
    return diameter * (1 + amplitude * np.sin(2 * math.pi / (wave * diameter) * place)) if amplitude else diameter


def _strand(
    material: Material, across: Array, along: Array, diameter: float, twist: float, turn: Array | float
) -> tuple[Array, Array, Array]:
    """Find the foremost strand: its depth towards the camera [px], −∞ where there is none; γ on it; its number."""
    sine = math.sin(math.pi / material.plies)
    radius = diameter / 2 / (1 + 1 / sine)
    depth, gamma, number = np.full(across.shape, -math.inf), np.zeros(across.shape), np.zeros(across.shape)
    for k in range(material.plies):
        angle = 2 * math.pi * (twist * along + k / material.plies) + turn
        inside = (across - radius / sine * np.sin(angle)) / radius
        front = radius / sine * np.cos(angle) + radius * np.sqrt(np.maximum(1 - inside**2, 0))
        nearer = (np.abs(inside) < 1) & (front > depth)
        depth[nearer], gamma[nearer], number[nearer] = front[nearer], np.arcsin(inside[nearer]), k
    return depth, gamma, number


def _texture_at(material: Material, around: Array, along: Array) -> NDArray[np.float32]:
    """Interpolate the texture linearly at angles [rad] and positions [diameters], both shape (n,)."""
    rows, columns = material.texture.shape
    row = np.mod(around / (2 * math.pi), 1) * rows
    column = np.mod(along / material.length, 1) * columns
    i, j = row.astype(np.intp), column.astype(np.intp)
    fi, fj = (row - i).astype(np.float32), (column - j).astype(np.float32)
    i, j = i % rows, j % columns
    i1, j1 = (i + 1) % rows, (j + 1) % columns
    t = material.texture
    return (1 - fi) * ((1 - fj) * t[i, j] + fj * t[i, j1]) + fi * ((1 - fj) * t[i1, j] + fj * t[i1, j1])


def _hairs_in_view(
    material: Material,
    shape: tuple[int, int],
    axis_angle: float,
    *,
    diameter: float,
    twist: float,
    offset: float,
    phase: float,
    travel: float,
    bend: float,
) -> Iterator[Array]:
    """Yield each hair's visible part as points (x, y), shape (k, 2) [px]; (0, 0) is the top left pixel's centre."""
    rows, columns = shape
    radius, length = diameter / 2, material.length * diameter
    c, s = math.cos(axis_angle), math.sin(axis_angle)
    outward = np.linspace(0, 1, 12)
    for angle, position, size, lean, curl in material.hairs:
        foot = math.remainder(position * diameter + travel, length)
        if abs(foot) > math.hypot(rows, columns):
            continue
        along = foot + outward * lean * size * diameter
        around = angle + 2 * math.pi * twist * foot + phase + curl * outward**2
        across = (radius + outward * size * diameter) * np.sin(around)
        visible = (np.cos(around) > 0) | (np.abs(across) > radius)
        across = across + offset + 0.5 * bend * along**2
        points = np.column_stack([columns / 2 - 0.5 + along * c + across * s, rows / 2 - 0.5 - along * s + across * c])
        if visible.sum() > 1:
            yield points[visible]


def smooth_series(rng: np.random.Generator, n: int, mean: float, cv: float, correlation: float) -> Array:
    """Draw a first-order autoregressive series whose sample mean and coefficient of variation are exactly those given.

    Far values are pulled in smoothly (2.5·tanh(z/2.5)) before the series is standardised, so that they stay physical.

    Parameters
    ----------
    n : number of samples.
    mean, cv : of the record itself; cv as a fraction, with the n − 1 standard deviation.
    correlation : correlation of neighbouring samples.
    """
    series = np.empty(n)
    series[0] = rng.standard_normal()
    for i, kick in enumerate(rng.standard_normal(n - 1), start=1):
        series[i] = correlation * series[i - 1] + math.sqrt(1 - correlation**2) * kick
    series = np.tanh((series - series.mean()) / series.std(ddof=1) / 2.5)
    series = (series - series.mean()) / series.std(ddof=1)
    return mean * (1 + cv * series)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCase:
    """One case of the rig: what the files are to show."""

    name: str
    seed: int
    tension: tuple[float, float]
    """p₃AB: mean [cN] and coefficient of variation (a fraction)."""
    twist: tuple[float, float]
    """T_AB: mean [1/m] and coefficient of variation."""
    theta: tuple[float, float]
    """θ_B: mean [°] and coefficient of variation."""
    speed: float
    """Delivery speed v [m/s]."""
    twist_CD: float
    """T_CD [1/m]; the yarn turns v·T_CD times a second."""
    micrometres_per_pixel: float
    frames: int
    video: str
    logs: tuple[str, ...]
    """File names; `.txt` is written as german-semicolon, `.csv` as plain-csv."""


DIAMETER = 0.16e-3
FRAME_RATE = 1200.0
SHAPE = (256, 480)
CYLINDER_AXIS = math.pi / 2
LOG_RATE = 100.0
LOG_SECONDS = 30.0

RIG = (
    RigCase(
        name="case1", seed=20201, tension=(10.61, 0.0722), twist=(1217.0, 0.1422), theta=(77.9, 0.1589), speed=0.16,
        twist_CD=902.0, micrometres_per_pixel=5.0, frames=60, video="yarn.mkv", logs=("tension_1.txt", "tension_2.csv"),
    ),
    RigCase(  # the source gives no CV for tension and angle here: case 1's are this rig's own choice
        name="case2", seed=20202, tension=(10.03, 0.0722), twist=(943.0, 0.1457), theta=(76.7, 0.1589), speed=0.25,
        twist_CD=563.0, micrometres_per_pixel=4.0, frames=48, video="yarn.tif", logs=("tension_1.csv",),
    ),
    RigCase(  # the source gives no CV for the angle here: case 1's is this rig's own choice
        name="case3", seed=20203, tension=(14.07, 0.0589), twist=(1157.0, 0.1541), theta=(77.9, 0.1589), speed=0.25,
        twist_CD=562.0, micrometres_per_pixel=5.0, frames=60, video="yarn.mkv", logs=("tension_1.txt",),
    ),
)  # fmt: skip


def rig_truth(case: RigCase) -> dict[str, Array]:
    """Return the truth of a case's frames, shape (frames,): 'theta' and 'axis_angle' in [0, π) [rad], 'twist' [1/m]."""
    rng = np.random.default_rng([case.seed, 1])
    theta = np.radians(smooth_series(rng, case.frames, *case.theta, correlation=0.5))
    twist = smooth_series(rng, case.frames, *case.twist, correlation=0.5)
    return {"theta": theta, "axis_angle": np.mod(CYLINDER_AXIS - theta, math.pi), "twist": twist}


def rig_frames(case: RigCase) -> Iterator[NDArray[np.uint16]]:
    """Render the frames of a case, shape `SHAPE`, 12-bit values."""
    rng = np.random.default_rng([case.seed, 2])
    material = Material.draw(rng, fibre_length=0.5 / (case.twist[0] * DIAMETER))
    truth = rig_truth(case)
    metres = case.micrometres_per_pixel * 1e-6
    offset = 6 * smooth_series(rng, case.frames, 1.0, 1.0, correlation=0.9)
    for i in range(case.frames):
        time = i / FRAME_RATE
        yield render_frame(
            material,
            rng,
            shape=SHAPE,
            axis_angle=float(truth["axis_angle"][i]),
            diameter=DIAMETER / metres,
            twist=float(truth["twist"][i]) * metres,
            offset=float(offset[i]),
            phase=2 * math.pi * case.speed * case.twist_CD * time,
            travel=case.speed * time / metres,
        )


def rig_tension(case: RigCase, log: int) -> Array:
    """Draw log number `log` of a case [cN], shape (LOG_SECONDS·LOG_RATE,)."""
    rng = np.random.default_rng([case.seed, 3, log])
    return smooth_series(rng, round(LOG_SECONDS * LOG_RATE), *case.tension, correlation=0.8)


def write_german_log(path: Path, tension_cN: Array, rate: float) -> None:
    """Write a log as a German meter's software does: cp1252, semicolons, decimal commas, 0.1 cN steps, a preamble."""
    lines = [
        "Synthetisches Protokoll (keine Messung);erzeugt von pipeline.synthetic",
        "Prüfgerät;Fadenzugkraftmesser 100 cN",
        "Messstelle;vor dem Zylinder, Länge AB",
        f"Abtastrate [Hz];{_comma(rate, 1)}",
        "",
        "Zeit [s];Fadenzugkraft [cN]",
    ]
    lines += [f"{_comma(i / rate, 3)};{_comma(value, 1)}" for i, value in enumerate(tension_cN)]
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("cp1252"))


def write_plain_log(path: Path, tension_cN: Array, rate: float) -> None:
    """Write a log as plain CSV: utf-8, one header row, decimal points, 0.001 cN steps."""
    lines = ["time_s,tension_cN"] + [f"{i / rate:.3f},{value:.3f}" for i, value in enumerate(tension_cN)]
    path.write_bytes(("\n".join(lines) + "\n").encode())


def _comma(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}".replace(".", ",")


def write_video(path: Path, frames: Iterator[NDArray[np.uint16]], rate: float) -> None:
    """Write frames without loss: FFV1 (gray16le holding 12-bit values) for .mkv, deflated pages for .tif.

    A container cannot hold a recording rate of 1200/s reliably: the reader is to be told the rate and the depth.
    """
    if path.suffix == ".tif":
        with tifffile.TiffWriter(path) as writer:
            for frame in frames:
                writer.write(
                    frame, photometric="minisblack", compression="zlib", predictor=True, contiguous=False, metadata=None
                )
        return
    first = next(frames)
    with av.open(str(path), "w", options={"fflags": "bitexact"}) as container:
        options = {"level": "3", "slicecrc": "1", "flags": "bitexact"}
        stream = container.add_stream("ffv1", rate=Fraction(rate), options=options)
        stream.pix_fmt = "gray16le"
        stream.height, stream.width = first.shape
        for frame in chain([first], frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="gray16le")))
        container.mux(stream.encode(None))


def write_rig(study_folder: Path, cases: Sequence[RigCase] = RIG) -> None:
    """Write each case's logs and clip to `study_folder`/<case name>/; other files there are left alone."""
    for case in cases:
        folder = study_folder / case.name
        folder.mkdir(parents=True, exist_ok=True)
        for log, name in enumerate(case.logs):
            write = write_german_log if name.endswith(".txt") else write_plain_log
            write(folder / name, rig_tension(case, log), LOG_RATE)
        write_video(folder / case.video, rig_frames(case), FRAME_RATE)


def write_truth(path: Path, cases: Sequence[RigCase] = RIG) -> None:
    """Write the truth of every frame as CSV: case, frame, axis_angle_deg, theta_B_deg, twist_tpm, diameter_mm."""
    lines = ["case,frame,axis_angle_deg,theta_B_deg,twist_tpm,diameter_mm"]
    for case in cases:
        truth = rig_truth(case)
        rows = zip(np.degrees(truth["axis_angle"]), np.degrees(truth["theta"]), truth["twist"], strict=True)
        lines += [f"{case.name},{i},{a:.6f},{t:.6f},{w:.4f},{DIAMETER * 1e3}" for i, (a, t, w) in enumerate(rows)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(("\n".join(lines) + "\n").encode())


def main(arguments: Sequence[str] | None = None) -> None:
    """Regenerate the rig from the command line."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.synthetic", description="Regenerate the synthetic rig.")
    parser.add_argument("directory", type=Path, help="study folder to write the cases' raw files to")
    parser.add_argument("--truth", type=Path, help="CSV file to write the truth to, apart from the study")
    call = parser.parse_args(arguments)
    write_rig(call.directory)
    if call.truth:
        write_truth(call.truth)


if __name__ == "__main__":
    main()
