"""How many frames a second are measured, and with how much memory, from the frames in memory and from files?

    python benchmarks/measure_speed.py [FOLDER]      (default: reports)

writes measure_speed.csv, measure_memory.csv and measure_speed.svg. Synthetic frames of 800 × 600 pixels, 12 bits, of a
yarn that swings by 1.5°, are repeated without being copied. Reading and measuring are timed together, on two threads
and on one; beside them, in the same run, on the same frames and one thread, a straightforward pipeline of scikit-image
(Otsu's threshold, region properties, structure tensor; development dependency): no unrolling, no uncertainty. Each time
is the best of ROUNDS. The peak of memory is that of a fresh process.
"""

import csv
import math
import resource
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

import pipeline.measure.axis as axis_steps
import pipeline.measure.twist as twist_steps
from pipeline.ingest.video import open_video
from pipeline.measure.yarn import measure_yarn
from pipeline.records import RawVideo, Scale, Source
from pipeline.synthetic import Material, render_frame, write_video

SHAPE = (600, 800)
DIAMETER, TWIST = 40.0, 0.004
RENDERED = 32
COUNTS = {"in memory": 512, "TIFF": 512, "FFV1": 64, "scikit-image": 16}
ROUNDS = 3
MEMORY = (1000, 10000)

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
    m = measure_yarn(video, Scale(4e-6, 0.002), cylinder_axis=math.pi / 2, threads=threads)
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


def best(work: Callable[[], None], count: int) -> float:
    """Frames per second, the best of `ROUNDS`."""
    seconds = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return count / min(seconds)


STEPS = (
    (axis_steps, "_find_line", "search"),
    (axis_steps, "straighten", "cut the strip"),
    (axis_steps, "_blocks", "block means"),
    (axis_steps, "_middle_mean", "profile"),
    (axis_steps, "_shifts", "tilt"),
    (axis_steps, "_fit_profile", "diameter"),
    (twist_steps, "unroll", "unroll"),
    (twist_steps, "_correlation", "correlation"),
    (twist_steps, "_stack", "sum along lines"),
)


@contextmanager
def stopwatch(seconds: dict[str, float]):
    """Add up the time that one thread spends in each of `STEPS`."""
    kept = [getattr(module, name) for module, name, _ in STEPS]

    def timed(step: Callable[..., object], label: str) -> Callable[..., object]:
        def run(*arguments: object) -> object:
            begin = time.perf_counter()
            try:
                return step(*arguments)
            finally:
                seconds[label] = seconds.get(label, 0.0) + time.perf_counter() - begin

        return run

    for (module, name, label), step in zip(STEPS, kept, strict=True):
        setattr(module, name, timed(step, label))
    try:
        yield
    finally:
        for (module, name, _), step in zip(STEPS, kept, strict=True):
            setattr(module, name, step)


def profile(images: list[Pixels], count: int) -> dict[str, float]:
    """Milliseconds per frame by step, on one thread from memory."""
    seconds: dict[str, float] = {}
    with stopwatch(seconds):
        begin = time.perf_counter()
        measure(in_memory(images, count), 1)
        whole = time.perf_counter() - begin
    seconds["all else"] = whole - sum(seconds.values())
    return {label: 1e3 * value / count for label, value in seconds.items()}


def peak_memory(images: list[Pixels], count: int) -> float:
    """Peak resident memory [MB] of a process that measures `count` frames, and holds the few that they repeat."""
    with tempfile.TemporaryDirectory() as scratch:
        stored = Path(scratch) / "frames.npy"
        np.save(stored, np.array(images))
        command = [sys.executable, __file__, "--peak", str(stored), str(count)]
        return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main(folder: Path) -> None:
    images = render()
    measure(in_memory(images, RENDERED), 2)  # warm: compiled steps, tables
    rows: list[tuple[str, int, float]] = []
    with tempfile.TemporaryDirectory() as scratch:
        tiff, ffv1 = Path(scratch) / "clip.tif", Path(scratch) / "clip.mkv"
        count = COUNTS["TIFF"]
        frames = Repeated(images, count)
        with tifffile.TiffWriter(tiff) as writer:
            for i in range(count):
                writer.write(frames.frame(i), photometric="minisblack", contiguous=False, metadata=None)
        write_video(ffv1, (frames.frame(i) for i in range(COUNTS["FFV1"])), 25)
        for threads in (2, 1):
            for name, video in (
                ("in memory", in_memory(images, COUNTS["in memory"])),
                ("TIFF", open_video(tiff, fps=1200, bits=12)),
                ("FFV1", open_video(ffv1, fps=1200, bits=12)),
            ):
                rate = best(lambda video=video, threads=threads: measure(video, threads), COUNTS[name])
                rows.append((name, threads, rate))
        for name, path in (("TIFF", tiff), ("FFV1", ffv1)):
            video = open_video(path, fps=1200, bits=12)
            read = best(
                lambda video=video: [video.frames.frame(i) for i in range(len(video.frames))] and None, COUNTS[name]
            )
            rows.append((f"{name}, read only", 1, read))
    with threadpool_limits(1):
        peer = best(lambda: structure_tensor(images, COUNTS["scikit-image"]), COUNTS["scikit-image"])
    rows.append(("scikit-image", 1, peer))
    steps = profile(images, COUNTS["in memory"])
    memory = [(count, peak_memory(images, count)) for count in MEMORY]

    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "measure_speed.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["frames", "threads", "frames_per_second", "times_scikit_image"])
        table.writerows([name, threads, f"{rate:.0f}", f"{rate / peer:.1f}"] for name, threads, rate in rows)
    with (folder / "measure_memory.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["frames", "peak_MB"], *([count, f"{peak:.0f}"] for count, peak in memory)])
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    left.barh([f"{name} ({threads})" for name, threads, _ in rows][::-1], [rate for *_, rate in rows][::-1])
    left.axvline(1200, color="0.5", linewidth=0.8)
    left.set(xlabel="frames per second, log (threads); line: the camera", xscale="log")
    right.barh(list(steps)[::-1], list(steps.values())[::-1])
    right.set(xlabel="ms per frame, one thread")
    figure.savefig(folder / "measure_speed.svg", metadata={"Date": None})
    for name, threads, rate in rows:
        print(f"{name:18} {threads} threads {rate:8.0f} frames/s {rate / peer:6.1f} × scikit-image")
    for label, value in steps.items():
        print(f"{label:18} {value:.3f} ms")
    for count, peak in memory:
        print(f"{count:6} frames: peak {peak:.0f} MB")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--peak"]:
        measure(in_memory(list(np.load(sys.argv[2])), int(sys.argv[3])), 2)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    else:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("reports"))
