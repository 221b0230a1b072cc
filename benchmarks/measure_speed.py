"""How many frames a second are measured, and with how much memory, from the frames in memory and from files?

    python benchmarks/measure_speed.py [FOLDER]      (default: reports; 4 minutes on a quiet machine)

writes measure_speed.csv, measure_readers.csv, measure_steps.csv, measure_memory.csv and measure_speed.svg. Synthetic
frames of 800 × 600 pixels, 12 bits, of a yarn that swings by 1.5°, are repeated without being copied.

- Speed: reading and measuring together, on two threads and on one; beside them, in the same run, on the same frames and
  one thread, a straightforward pipeline of scikit-image (Otsu's threshold, region properties, structure tensor;
  development dependency): no unrolling, no uncertainty. The wall time is the best of ROUNDS; the processor time beside
  it is that of the same round, and says more on a machine that others use too.
- Readers: bytes of frames a second, beside a plain copy out of a memory map and the SHA-256 that a report stores.
- Steps: processor time per frame, one thread, from a .cine file.
- Memory, and the whole command: `yarnval measure CLIP.cine --json` as a fresh process, on .cine files of 1 000, 10 000
  and 100 000 frames whose tables name the same 32 stored images over and over; start, file and JSON included.
"""

import csv
import hashlib
import math
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import tifffile
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from video_files import cine_bytes, write_mraw

import pipeline.ingest.cine as cine_steps
import pipeline.measure.axis as axis_steps
import pipeline.measure.twist as twist_steps
import pipeline.measure.yarn as yarn_steps
from pipeline.ingest.video import open_video
from pipeline.measure.yarn import measure_yarn
from pipeline.records import CylinderAxis, RawVideo, Scale, Source
from pipeline.synthetic import Material, render_frame, write_video

SHAPE = (600, 800)
DIAMETER, TWIST = 40.0, 0.004
RENDERED = 32
COUNT = 2048
COUNTS = {"FFV1": 64, "scikit-image": 16}
"""Frames timed where it is not `COUNT`: these are slow."""
PROFILED = 4000
"""Frames of the clip whose steps are timed: hairs and turn are looked at in some hundred frames of any clip."""
ROUNDS = 3
CLIPS = (1000, 10_000, 100_000)
THREADS = (2, 1)

Pixels = NDArray[np.uint16]


class Repeated:
    """A few frames over and over, to and fro."""

    def __init__(self, images: list[Pixels], count: int):
        self.images, self.count = images, count

    def __len__(self) -> int:
        return self.count

    def frame(self, index: int) -> Pixels:
        """Frame `index`, see pipeline.records.Frames."""
        last = len(self.images) - 1
        return self.images[last - abs(last - index % (2 * last))]


def render() -> list[Pixels]:
    rng = np.random.default_rng(1)
    material = Material.draw(rng)
    return [
        render_frame(
            material,
            rng,
            shape=SHAPE,
            axis_angle=math.radians(70 + 1.5 * math.sin(i / 5)),
            diameter=DIAMETER,
            twist=TWIST,
            offset=5 * math.sin(i / 9),
            phase=0.8 * i,
            travel=30.0 * i,
        )
        for i in range(RENDERED)
    ]


def in_memory(images: list[Pixels], count: int) -> RawVideo:
    return RawVideo(Source("", "", 0), Repeated(images, count), np.arange(count) / 1200, 1200.0, 12, SHAPE)


def measure(video: RawVideo, threads: int) -> None:
    m = measure_yarn(video, Scale(4e-6, 0.002), cylinder_axis=CylinderAxis(math.pi / 2), threads=threads)
    if np.count_nonzero(np.isfinite(m.twist)) < 0.99 * len(m.flag):
        raise RuntimeError("the timed frames were not measured")


def structure_tensor(images: list[Pixels], count: int) -> None:
    """The peer: axis and width from region properties, surface angle from the structure tensor within the region."""
    # Here, because only this peer needs it.
    from skimage.feature import structure_tensor as tensor  # noqa: PLC0415
    from skimage.filters import threshold_otsu  # noqa: PLC0415
    from skimage.measure import label, regionprops  # noqa: PLC0415

    video = Repeated(images, count)
    for i in range(count):
        image = video.frame(i).astype(float)
        labels = label(image > threshold_otsu(image))
        region = max(regionprops(labels), key=lambda found: found.area)
        inside = labels == region.label
        rr, rc, cc = (part[inside].mean() for part in tensor(image, sigma=1.5))
        _ = 0.5 * math.atan2(2 * rc, rr - cc) - region.orientation, region.axis_minor_length


def best(work: Callable[[], object], count: int) -> tuple[float, float]:
    """Frames per second and processor time per frame [ms] of the fastest of `ROUNDS`."""
    rounds = []
    for _ in range(ROUNDS):
        wall, processor = time.perf_counter(), time.process_time()
        work()
        rounds.append((time.perf_counter() - wall, time.process_time() - processor))
    wall, processor = min(rounds)
    return count / wall, 1e3 * processor / count


STEPS = (
    (cine_steps.CineFrames, "frame", "read"),
    (axis_steps, "find_line", "search the frame"),
    (axis_steps, "_measure", "cut, align, diameter"),
    (twist_steps, "halved", "unroll"),
    (twist_steps, "_spectra", "transform"),
    (twist_steps, "_ridge", "correlation, sums"),
    (yarn_steps, "_saturated", "saturation"),
    (yarn_steps, "hairiness", "hairs"),
    (yarn_steps, "helix_turn", "turn of the helix"),
    (yarn_steps, "face", "scatter of the fibres"),
    (yarn_steps, "recurrence", "a full turn"),
    (yarn_steps, "find_scallops", "outline"),
)


@contextmanager
def stopwatch(seconds: dict[str, float]):
    """Add up the processor time that is spent in each of `STEPS`."""
    kept = [getattr(module, name) for module, name, _ in STEPS]

    def timed(step: Callable[..., object], label: str) -> Callable[..., object]:
        def run(*arguments: object) -> object:
            begin = time.thread_time()
            try:
                return step(*arguments)
            finally:
                seconds[label] = seconds.get(label, 0.0) + time.thread_time() - begin

        return run

    for (module, name, label), step in zip(STEPS, kept, strict=True):
        setattr(module, name, timed(step, label))
    try:
        yield
    finally:
        for (module, name, _), step in zip(STEPS, kept, strict=True):
            setattr(module, name, step)


def profile(video: RawVideo) -> dict[str, float]:
    """Milliseconds of processor time per frame by step, on one thread."""
    seconds: dict[str, float] = {label: 0.0 for *_, label in STEPS}
    with stopwatch(seconds):
        begin = time.process_time()
        measure(video, 1)
        whole = time.process_time() - begin
    seconds["all else"] = whole - sum(seconds.values())
    return {label: 1e3 * value / len(video.frames) for label, value in seconds.items()}


def readers(clips: dict[str, RawVideo], plain: Path) -> list[tuple[str, float, float]]:
    """Frames a second and MB a second of reading alone, of a plain copy and of a SHA-256, each on one thread."""
    size = SHAPE[0] * SHAPE[1] * 2
    rows = []
    for name, video in clips.items():
        count = len(video.frames)
        rate, _ = best(lambda video=video, count=count: [video.frames.frame(i) for i in range(count)] and None, count)
        rows.append((name, rate, rate * size / 1e6))
    mapped = np.memmap(plain, np.uint8, "r")
    count, into = len(mapped) // size, np.empty(size, np.uint8)

    def copy() -> None:
        for i in range(count):
            into[:] = mapped[i * size : (i + 1) * size]

    for name, work in (("memory-mapped copy", copy), ("SHA-256", lambda: hashlib.sha256(mapped).digest())):
        rate, _ = best(work, count)
        rows.append((name, rate, rate * size / 1e6))
    return rows


def write_cine(path: Path, images: list[Pixels], count: int, packing: str = "") -> None:
    """A .cine file of 16-bit or packed pixels with `count` frames, whose table names the stored images to and fro."""
    data = bytearray(cine_bytes(np.array(images), 12, [], packing))
    fields = cine_steps.FILE_HEADER.unpack_from(data)
    offsets = np.frombuffer(data, "<u8", len(images), fields[10])
    table = Repeated(list(offsets), count)
    cine_steps.FILE_HEADER.pack_into(
        data, 0, *fields[:5], count, fields[6], count, *fields[8:10], len(data), fields[11]
    )
    path.write_bytes(data + struct.pack(f"<{count}Q", *(int(table.frame(i)) for i in range(count))))


def whole_command(clip: Path, count: int) -> tuple[float, float, float]:
    """Wall time [s], processor time [s] and peak resident memory [MB] of `yarnval measure` as a process of its own."""
    # VmHWM, because the peak that the parent is told counts the parent's own memory at the start of the child.
    call = "import sys\nfrom pipeline.cli import main\ntry:\n    main()\nfinally:\n"
    call += "    sys.stderr.write(open('/proc/self/status').read())"
    options = ["--scale-um-per-px", "4", "--fps", "1200", "--axis-deg", "90", "--json"]
    with clip.with_suffix(".json").open("w") as out, clip.with_suffix(".txt").open("w+") as told:
        begin = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-c", call, "measure", str(clip), *options], stdout=out, stderr=told
        )
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        told.seek(0)
        peak = [int(line.split()[1]) / 1024 for line in told if line.startswith("VmHWM")]
    if status or not peak:
        raise RuntimeError(f"yarnval measure ended with {status} on {count} frames")
    return wall, used.ru_utime + used.ru_stime, peak[0]


def main(folder: Path) -> None:
    images = render()
    measure(in_memory(images, RENDERED), 2)  # warm: compiled steps, tables
    rows: list[tuple[str, int, float, float]] = []
    with tempfile.TemporaryDirectory() as where:
        scratch = Path(where)
        frames = Repeated(images, COUNT)
        write_cine(scratch / "clip.cine", images, COUNT)
        write_cine(scratch / "packed.cine", images, COUNT, "P12L")
        with tifffile.TiffWriter(scratch / "clip.tif") as writer:
            for i in range(COUNT):
                writer.write(frames.frame(i), photometric="minisblack", contiguous=False, metadata=None)
        write_mraw(scratch / "clip.mraw", np.array([frames.frame(i) for i in range(COUNT)]), 16, 12)
        write_video(scratch / "clip.mkv", (frames.frame(i) for i in range(COUNTS["FFV1"])), 25)
        files = {
            ".cine": "clip.cine",
            ".cine P12L": "packed.cine",
            ".mraw": "clip.mraw",
            "TIFF": "clip.tif",
            "FFV1": "clip.mkv",
        }
        clips = {name: open_video(scratch / file, fps=1200, bits=12, hashed=False) for name, file in files.items()}
        for video in clips.values():
            measure(video, 2)  # warm, also the disk's cache
        for threads in THREADS:
            for name, video in {"in memory": in_memory(images, COUNT), **clips}.items():
                rate, ms = best(lambda video=video, threads=threads: measure(video, threads), len(video.frames))
                rows.append((name, threads, rate, ms))
        with threadpool_limits(1):
            count = COUNTS["scikit-image"]
            rows.append(("scikit-image", 1, *best(lambda: structure_tensor(images, count), count)))
        reading = readers(clips, scratch / "clip.mraw")
        write_cine(scratch / "long.cine", images, PROFILED)
        steps = profile(open_video(scratch / "long.cine", fps=1200, bits=12, hashed=False))
        memory = []
        for count in CLIPS:
            write_cine(scratch / "long.cine", images, count)
            memory.append((count, *whole_command(scratch / "long.cine", count)))

    peer = rows[-1][2]
    folder.mkdir(parents=True, exist_ok=True)
    write_table(
        folder / "measure_speed.csv",
        ["frames", "threads", "frames_per_second", "processor_ms_per_frame", "times_scikit_image"],
        [(name, threads, f"{rate:.0f}", f"{ms:.2f}", f"{rate / peer:.1f}") for name, threads, rate, ms in rows],
    )
    write_table(
        folder / "measure_readers.csv",
        ["reading", "frames_per_second", "MB_per_second"],
        [(name, f"{rate:.0f}", f"{megabytes:.0f}") for name, rate, megabytes in reading],
    )
    write_table(
        folder / "measure_steps.csv",
        ["step", "processor_ms_per_frame"],
        [(label, f"{value:.3f}") for label, value in steps.items()],
    )
    write_table(
        folder / "measure_memory.csv",
        ["frames", "wall_s", "processor_s", "frames_per_second", "peak_MB"],
        [
            (count, f"{wall:.1f}", f"{used:.1f}", f"{count / wall:.0f}", f"{peak:.0f}")
            for count, wall, used, peak in memory
        ],
    )
    draw(folder / "measure_speed.svg", rows, steps, memory)


def write_table(path: Path, header: list[str], rows: list[tuple[object, ...]]) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    print(path.read_text())


def draw(
    path: Path,
    rows: list[tuple[str, int, float, float]],
    steps: dict[str, float],
    memory: list[tuple[int, float, float, float]],
) -> None:
    """Draw speed, the profile and the peak of memory."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained", width_ratios=(3, 3, 2))
    left.barh([f"{name} ({threads})" for name, threads, *_ in rows][::-1], [rate for _, _, rate, _ in rows][::-1])
    left.axvline(1200, color="0.5", linewidth=0.8)
    left.set(xlabel="frames per second (threads); line: the camera", xscale="log")
    middle.barh(list(steps)[::-1], list(steps.values())[::-1])
    middle.set(xlabel="processor time per frame from .cine [ms]")
    right.plot([count for count, *_ in memory], [peak for *_, peak in memory], "o-")
    right.axhline(600, color="0.5", linewidth=0.8)
    right.set(xlabel="frames in the clip", ylabel="peak memory [MB]", xscale="log", ylim=(0, 700))
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("reports"))
