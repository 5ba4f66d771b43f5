"""Text files as lines of bytes, whatever they are compressed with."""

import gzip
import io
from collections.abc import Iterator
from pathlib import Path

import hatanaka

from plumbline.errors import FileFormatError

_GZIP_MAGIC = b"\x1f\x8b"
_OTHER_MAGICS = (b"\x1f\x9d", b"BZh", b"PK\x03\x04")  # .Z, .bz2, .zip
_COMPACT_RINEX_LABEL = b"CRINEX VERS   / TYPE"


class LineSource:
    """Iterates a file's lines as bytes without their ends; ``fraction`` tells how much of the file has been consumed.

    Plain and gzip files are streamed; compact RINEX (Hatanaka) and the other compressions are unpacked as a whole.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            self._size = max(self.path.stat().st_size, 1)
            self._raw: io.BufferedIOBase = open(self.path, "rb")  # noqa: SIM115 - closed with the iteration
        except OSError as error:
            raise FileFormatError(f"cannot read {path}: {error.strerror}") from error
        self.line_number = 0
        self._text = self._unpacked()

    def _unpacked(self) -> io.BufferedIOBase:
        magic = self._raw.read(4)
        self._raw.seek(0)
        if magic.startswith(_OTHER_MAGICS):
            return self._unpacked_whole()
        text: io.BufferedIOBase = self._raw
        if magic.startswith(_GZIP_MAGIC):
            text = io.BufferedReader(gzip.GzipFile(fileobj=self._raw), 1 << 16)
        first = text.read(80)
        self._raw.seek(0)
        if _COMPACT_RINEX_LABEL in first:
            return self._unpacked_whole()
        if text is not self._raw:
            text = io.BufferedReader(gzip.GzipFile(fileobj=self._raw), 1 << 16)
        return text

    def _unpacked_whole(self) -> io.BufferedIOBase:
        content = self._raw.read()
        self._size = len(content)
        try:
            unpacked = hatanaka.decompress(content)
        except (ValueError, hatanaka.HatanakaException) as error:
            raise FileFormatError(f"{self.path}: cannot be unpacked: {error}") from error
        self._raw.close()
        self._raw = io.BytesIO(unpacked)
        self._size = max(len(unpacked), 1)
        return self._raw

    @property
    def fraction(self) -> float:
        """How much of the file has been read, 0…1."""
        return 1.0 if self._raw.closed else min(self._raw.tell() / self._size, 1.0)

    def __iter__(self) -> Iterator[bytes]:
        return self

    def __next__(self) -> bytes:
        if self._text.closed:
            raise StopIteration
        try:
            line = self._text.readline()
        except (OSError, EOFError) as error:  # a truncated or damaged gzip member
            raise FileFormatError(f"{self.path}: {error}") from error
        if not line:
            self._text.close()
            self._raw.close()
            raise StopIteration
        self.line_number += 1
        return line.rstrip(b"\r\n")

    def error(self, what: str) -> FileFormatError:
        """An error that names the file and the line."""
        return FileFormatError(f"{self.path}, line {self.line_number}: {what}")


def fortran_float(text: str) -> float:
    """Number of a Fortran field (``1.0D+03``); blank is NaN; raises ``ValueError`` for anything else."""
    text = text.strip()
    return float(text.replace("D", "E").replace("d", "e")) if text else float("nan")
