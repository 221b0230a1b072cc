"""Does any damage to a clip's header end in anything but frames or one clear error?

10 000 seeded mutations over all formats: bytes of the header overwritten (extreme and random values), files cut, also
empty ones. Each format is read in a process of its own, so a crash or a hang is seen, and its peak memory counted.
Outcomes: `read` every frame could be read, `flagged` some frames could not, `refused` the clip was refused with an
InputError, `other` any other exception. The clips are synthetic.

    python benchmarks/fuzz_readers.py [--mutations 10000] [--seed 0] [--table FILE.csv]
"""

import argparse
import csv
import multiprocessing
import queue
import resource
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from video_files import KINDS, cine_bytes, random_frames, write_clip

from pipeline.errors import InputError
from pipeline.ingest.video import open_video

HEADER = 1400
"""Bytes from the start that most mutations fall into."""
HANG = 60.0
"""Seconds without an outcome after which a reader hangs."""
EXTREME = (0, 1, 127, 128, 255)
CASES = [
    (kind, target) for kind in KINDS for target in (("clip.mraw", "clip.cihx") if kind.startswith("mraw") else ("",))
] + [
    ("cine P10", ""),
    ("tif", "clip.xml"),
    ("tif", "clip.chd"),
    ("folder .jpg", ""),
    ("jpg progressive", ""),
]
"""Kind of the clip, and the file that is damaged where it is not the clip itself."""


@dataclass(frozen=True)
class Tally:
    """What became of the mutations of one case."""

    outcomes: Counter[str]
    slowest: float
    slowest_mutation: int
    growth: int
    """Of the peak memory [bytes]."""
    example: str
    """The first exception that should not be."""


def make(folder: Path, kind: str, target: str) -> tuple[Path, Path]:
    """Write a small clip; return what to open and which file to damage."""
    frames = random_frames(6, 4, 16, 16, 8 if kind in ("folder .bmp", "folder .jpg") else 12)
    stamps = [(1_700_000_000 << 32) + i * (1 << 22) for i in range(4)]
    if kind == "cine P10":
        path = folder / "clip.cine"
        path.write_bytes(cine_bytes(frames >> 2, 12, stamps, packing="P10"))
    elif kind == "jpg progressive":
        path = folder / "clip.jpg"
        cv2.imwrite(str(path), random_frames(6, 40, 48, 3, 8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    else:
        path = write_clip(folder, kind, frames, 12)
    if target == "clip.chd":
        (folder / target).write_bytes(cine_bytes(frames, 12, stamps)[: 84 + 1000 + 8 + 8 * 4])
    elif target == "clip.xml":
        times = "".join(
            f'<Date frame="{i}">Sat Aug 24 2019</Date><Time frame="{i}">14:53:32.328 {i}40.68</Time>' for i in range(4)
        )
        (folder / target).write_text(
            f"<chd><CameraSetup><FrameRateDouble>1e4</FrameRateDouble></CameraSetup><TIMEBLOCK>{times}</TIMEBLOCK></chd>"
        )
    if target:
        return path, folder / target
    return path, min(path.iterdir()) if path.is_dir() else path


def mutated(good: bytes, rng: np.random.Generator) -> bytes:
    """Return the bytes with one to four of them overwritten, one time in five also cut."""
    data = bytearray(good)
    reach = len(data) if rng.random() < 0.3 else min(len(data), HEADER)
    for at in rng.integers(0, reach, rng.integers(1, 5)):
        data[at] = rng.choice(EXTREME) if rng.random() < 0.7 else rng.integers(256)
    return bytes(data[: rng.integers(0, len(data))] if rng.random() < 0.2 else data)


def outcome(path: Path) -> str:
    try:
        video = open_video(path, fps=1.0)
    except InputError:
        return "refused"
    left = 0
    for i in range(min(len(video.frames), 1000)):
        try:
            video.frames.frame(i)
            left += 1
        except InputError:
            continue
    return "read" if left == len(video.frames) else "flagged"


def fuzz(kind: str, target: str, count: int, seed: int, results: multiprocessing.Queue) -> None:
    """Read `count` damaged clips; put each outcome, then the tally's numbers."""
    rng = np.random.default_rng([seed, *kind.encode(), *target.encode()])
    with tempfile.TemporaryDirectory() as name:
        path, damaged = make(Path(name), kind, target)
        good = damaged.read_bytes()
        outcome(path)  # what a reader imports and allocates once is no growth
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for _ in range(count):
            damaged.write_bytes(mutated(good, rng))
            start = time.perf_counter()
            try:
                found, text = outcome(path), ""
            except Exception as error:
                found, text = "other", f"{type(error).__name__}: {error}"
            results.put((found, time.perf_counter() - start, text))
        results.put((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024)


def tally(kind: str, target: str, count: int, seed: int) -> Tally:
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    process = context.Process(target=fuzz, args=(kind, target, count, seed, results), daemon=True)
    process.start()
    outcomes: Counter[str] = Counter()
    slowest, where, growth, example = 0.0, -1, 0, ""
    while True:
        try:
            found = results.get(timeout=HANG)
        except queue.Empty:
            outcomes["hang" if process.is_alive() else "crash"] += 1
            process.kill()
            break
        if isinstance(found, int):
            growth = found
            break
        name, seconds, text = found
        if seconds > slowest:
            slowest, where = seconds, outcomes.total()
        outcomes[name] += 1
        example = example or text
    process.join()
    return Tally(outcomes, slowest, where, growth, example)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutations", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--table", type=Path)
    chosen = parser.parse_args()
    share, rest = divmod(chosen.mutations, len(CASES))
    names = ("read", "flagged", "refused", "other", "crash", "hang")
    print(f"{'clip':28}" + "".join(f"{name:>9}" for name in names) + f"{'slowest s':>11}{'growth MB':>11}")
    total: Counter[str] = Counter()
    slowest, growth = 0.0, 0
    table: list[list[object]] = [["clip", "damaged_file", *names, "slowest_s", "growth_MB"]]
    for i, (kind, target) in enumerate(CASES):
        got = tally(kind, target, share + (i < rest), chosen.seed)
        counts = "".join(f"{got.outcomes[name]:9}" for name in names)
        print(f"{f'{kind} {target}':28}{counts}{got.slowest:11.3f}{got.growth / 1e6:11.1f}", flush=True)
        table.append([kind, target or "the clip", *(got.outcomes[n] for n in names), f"{got.slowest:.3f}"])
        table[-1].append(f"{got.growth / 1e6:.1f}")
        if got.example:
            print(f"    {got.example}")
        total += got.outcomes
        slowest, growth = max(slowest, got.slowest), max(growth, got.growth)
    print(f"{'all':28}{''.join(f'{total[name]:9}' for name in names)}{slowest:11.3f}{growth / 1e6:11.1f}")
    if chosen.table:
        table.append(["all", "", *(total[n] for n in names), f"{slowest:.3f}", f"{growth / 1e6:.1f}"])
        with chosen.table.open("w", newline="") as file:
            csv.writer(file).writerows(table)
    sys.exit(1 if total["other"] + total["crash"] + total["hang"] else 0)


if __name__ == "__main__":
    main()
