"""The raw files of one case, opened: logs in memory, frames left on disk."""

from pathlib import Path

from pipeline.case import RawFiles
from pipeline.ingest.layouts import load_layout
from pipeline.ingest.tension import read_tension
from pipeline.ingest.video import open_video
from pipeline.records import RawTension, RawVideo


def read_raw(raw: RawFiles, folder: Path) -> tuple[tuple[RawTension, ...], tuple[RawVideo, ...]]:
    """Read the tension logs and open the clips that case.toml in `folder` names.

    Raises
    ------
    pipeline.errors.InputError
        If a file cannot be read, or a layout, a unit, or the recording rate is missing.
    """
    logs = tuple(
        read_tension(log.path, load_layout(log.profile, folder), root=folder, channel=log.channel)
        for log in raw.tension
    )
    clips = tuple(open_video(path, fps=raw.fps, bits=raw.bits, root=folder) for path in raw.video)
    return logs, clips
