"""TIFF: one page, many pages, or one description followed by all frames (as ImageJ writes beyond 4 GiB).

Through tifffile, page by page; a page's bytes are checked to lie inside the file first, because tifffile fills
missing ones with zeros.
"""

import logging
import math
import weakref
from pathlib import Path

from tifffile import TiffFile, TiffPage

from pipeline.errors import InputError
from pipeline.ingest.clip import Clip, Pixels, as_pixels, check_size, count_frames, frame_error
from pipeline.ingest.orientation import ORIENTATION, upright

# tifffile logs what it then also raises or what is checked here; without a handler Python prints it to stderr.
logging.getLogger("tifffile").addHandler(logging.NullHandler())

MIN_IS_BLACK, RGB = 1, 2
SAMPLES = {MIN_IS_BLACK: (1, 2), RGB: (3, 4)}
"""Of a pixel, by photometric interpretation: without and with an alpha channel."""
UNCOMPRESSED = 1
UNSIGNED = 1
MAX_COMPRESSION = 4096
"""Above what deflate (1032) and LZW (2730, a string of 4096 bytes in 12 bits) can reach."""


class TiffFrames:
    """Frames of a TIFF file, each decoded when asked for."""

    def __init__(self, path: Path):
        try:
            file = TiffFile(path)
            weakref.finalize(self, file.close)
            pages = len(file.pages)
            promised = _promised(file)
        # A damaged TIFF makes tifffile raise nearly anything (KeyError, struct.error, zlib.error …).
        except Exception as error:
            raise InputError(path, f"not a readable TIFF ({error})", "copy or export the clip again") from error
        self._path, self._file, self._pages = path, file, pages
        self._count = count_frames(pages, promised)

    def __len__(self) -> int:
        return self._count

    def frame(self, index: int) -> Pixels:
        """Frame `index` as stored (`Clip.frames`), rows top-down; `InputError` if it is cut short or damaged."""
        where = f"{self._path}: frame {index}"
        try:
            page, skipped = self._page(index)
            self._check(page, index, skipped)
            if skipped or page.is_final:
                first = page.dataoffsets[0] + skipped * page.nbytes
                kind = f"{self._file.byteorder}u{page.bitspersample // 8}"
                image = self._file.filehandle.read_array(kind, page.size, first).reshape(page.shape)
            else:
                image = page.asarray(maxworkers=1)
            return as_pixels(upright(image, page.tags.valueof(ORIENTATION, default=1), where), where)
        except InputError:
            raise
        except Exception as error:  # as in __init__
            raise frame_error(self._path, index, f"damaged ({error})") from error

    def _page(self, index: int) -> tuple[TiffPage, int]:
        """The page that describes a frame, and how many frames lie between that page's own and it."""
        page = self._file.pages[min(index, self._pages - 1)]
        if not isinstance(page, TiffPage):
            raise frame_error(self._path, index, "a page without a description")
        skipped = max(0, index - self._pages + 1)
        if skipped and page.compression != UNCOMPRESSED:
            raise frame_error(self._path, index, f"missing: the file ends after {self._pages} pages")
        return page, skipped

    def _check(self, page: TiffPage, index: int, skipped: int) -> None:
        where = f"{self._path}: frame {index}"
        if page.axes not in ("YX", "YXS") or page.samplesperpixel not in SAMPLES.get(page.photometric, ()):
            found = f"pixels {page.axes}, photometric {page.photometric}, {page.samplesperpixel} samples"
            raise InputError(where, found, "export in gray, 0 = black, or RGB")
        if page.bitspersample not in (8, 16):
            raise InputError(where, f"{page.bitspersample} bits per sample", "export with 8 or 16 bits per sample")
        if page.sampleformat != UNSIGNED:
            raise InputError(where, f"pixels of type {page.dtype}", "export with 8 or 16 bits per sample, unsigned")
        check_size(page.imagelength, page.imagewidth, where)
        size = self._file.filehandle.size
        shift = skipped * page.nbytes
        parts = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        if not parts or any(count == 0 or start + shift + count > size for start, count in parts):
            raise frame_error(self._path, index, "cut short: the file ends before its pixels do")
        if page.compression == UNCOMPRESSED and sum(count for _, count in parts) < page.nbytes:
            raise frame_error(self._path, index, "fewer bytes than its size needs")
        if sum(count for _, count in parts) * MAX_COMPRESSION < page.nbytes:
            raise frame_error(self._path, index, "a size that its bytes cannot fill, however compressed")


def _promised(file: TiffFile) -> int:
    """How many frames ImageJ's or tifffile's own description states; 0 where there is none."""
    if file.is_imagej:
        return int((file.imagej_metadata or {}).get("images", 0))
    if file.is_shaped and file.shaped_metadata:
        shape = file.shaped_metadata[0].get("shape", ())
        return math.prod(shape) // max(1, file.pages.first.size) if len(shape) > 2 else 0
    return 0


def open_tiff(path: Path) -> Clip:
    """Open a TIFF file; `InputError` if its pages cannot be found."""
    frames = TiffFrames(path)
    return Clip(frames, {"format": "TIFF"})
