"""True frame times from the header that Phantom software writes beside an export: PCC .xml, or .chd.

A .chd is the head of a .cine file, set-up and tagged blocks, without images (Phantom user manual: "cine header file").
The .xml states the same in words, times to 10 ns.
"""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from pipeline.errors import InputError
from pipeline.ingest.cine import read_clock
from pipeline.ingest.clip import Clip
from pipeline.ingest.header_xml import parse_header
from pipeline.records import Array

SUFFIXES = (".xml", ".XML", ".chd", ".CHD")
CLOCK = re.compile(r"(\d\d):(\d\d):(\d\d)\.(\d{3}) (\d{3})(?:\.(\d{1,6}))?")
"""Hours, minutes, seconds, then ms, µs and a fraction of a µs."""
MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
TICKS = 10**12
"""Ticks of the .xml's times in a second: integers, so that no digit is lost."""


def with_sidecar(path: Path, clip: Clip) -> Clip:
    """Return the clip with the times of the .xml or .chd of the same name, or as it is where there is none.

    `metadata['times']` says which file they are from, or why they are not used: times for another number of frames
    tell nothing of these.

    Raises
    ------
    InputError
        If such a file cannot be read as one: times that are there but damaged are not passed over.
    """
    stem = path if path.is_dir() else path.with_suffix("")
    sidecar = next((p for suffix in SUFFIXES if (p := stem.with_name(stem.name + suffix)).is_file()), None)
    if sidecar is None:
        return clip
    metadata = dict(clip.metadata)
    if sidecar.suffix.lower() == ".xml":
        root = parse_header(sidecar, "chd")
        if root is None:
            metadata["times"] = f"not used: {sidecar.name} is no cine header"
            return replace(clip, metadata=metadata)
        stamps, nominal = _read_xml(sidecar, root)
    else:
        stamps, nominal = read_clock(sidecar)
    if nominal:
        metadata["nominal_rate"] = f"{nominal:g}"
    beside = (*clip.beside, sidecar)
    if len(stamps) != len(clip.frames):
        metadata["times"] = f"not used: {sidecar.name} has times of {len(stamps)} frames, the clip {len(clip.frames)}"
        return replace(clip, metadata=metadata, beside=beside)
    metadata["times"] = f"from {sidecar.name}"
    return replace(clip, metadata=metadata, stamps=stamps, beside=beside)


def _read_xml(path: Path, root: ET.Element) -> tuple[Array, float]:
    """Times from the first frame [s], shape (n,), and the nominal rate [1/s], 0 where it is not stated."""
    dates = {e.get("frame"): e.text or "" for e in root.iterfind("TIMEBLOCK/Date")}
    ticks = []
    for element in root.iterfind("TIMEBLOCK/Time"):
        frame, text = element.get("frame"), element.text or ""
        clock = CLOCK.fullmatch(text.strip())
        day = _day(dates.get(frame, ""))
        if clock is None or day is None:
            raise InputError(
                f"{path}: frame {frame}",
                f"found '{dates.get(frame, '')} {text}'",
                "a date as 'Sat Aug 24 2019' and a time as '14:53:32.328 240.68'",
            )
        hours, minutes, seconds = (int(part) for part in clock.groups()[:3])
        whole = ((day * 24 + hours) * 60 + minutes) * 60 + seconds
        ticks.append(whole * TICKS + int((clock[4] + clock[5] + (clock[6] or "")).ljust(12, "0")))
    try:
        nominal = float(root.findtext("CameraSetup/FrameRateDouble") or 0)
    except ValueError:
        nominal = 0.0
    times = np.array([float(tick - ticks[0]) / TICKS for tick in ticks], np.float64)
    return times, nominal if 0 < nominal < 1e9 else 0.0


def _day(text: str) -> int | None:
    """Days from year 1 of a date such as 'Sat Aug 24 2019', whatever the computer's language; None if it is none."""
    parts = text.split()
    if len(parts) != 4 or parts[1] not in MONTHS or not (parts[2].isdecimal() and parts[3].isdecimal()):
        return None
    try:
        return datetime(int(parts[3]), MONTHS.index(parts[1]) + 1, int(parts[2])).toordinal()
    except ValueError:
        return None
