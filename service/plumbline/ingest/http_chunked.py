"""HTTP/1.1 chunked transfer coding (RFC 9112, section 7.1), as NTRIP version 2 uses it. Sans-IO."""

MAX_CHUNK_BYTES = 1 << 24
MAX_LINE_BYTES = 256


class ChunkedDecoder:
    """Feed it bytes cut in any way for the content. ``error`` says why it gave up, ``ended`` that all came."""

    def __init__(self) -> None:
        self._buffer = b""
        self._left = 0  # content bytes of the present chunk still to come
        self._skip_line_end = False
        self.ended = False
        self.error = ""

    def receive(self, data: bytes) -> bytes:
        """Content bytes completed by ``data``. After an error or the end, everything is ignored."""
        content = []
        self._buffer += data
        while self._buffer and not self.ended and not self.error:
            if self._left:
                piece = self._buffer[: self._left]
                self._buffer = self._buffer[len(piece) :]
                self._left -= len(piece)
                self._skip_line_end = not self._left
                content.append(piece)
            elif not self._read_line():
                break
        return b"".join(content)

    def _read_line(self) -> bool:
        """Consume a size line, or the line end behind a chunk; False when more bytes are needed."""
        line, end, rest = self._buffer.partition(b"\n")
        if not end:
            if len(line) > MAX_LINE_BYTES:
                self.error = "chunk size line too long"
            return False
        self._buffer = rest
        line = line.rstrip(b"\r")
        if self._skip_line_end:
            self._skip_line_end = False
            if line:
                self.error = "chunk longer than its size"
            return True
        digits = line.partition(b";")[0].strip()
        size = int(digits, 16) if digits and all(c in b"0123456789abcdefABCDEF" for c in digits[:9]) else -1
        if not 0 <= size <= MAX_CHUNK_BYTES or len(digits) > 8:
            self.error = "not a chunk size"
        elif size == 0:
            self.ended = True
        self._left = max(size, 0)
        return True


def chunk(data: bytes) -> bytes:
    """``data`` as one chunk."""
    return b"%x\r\n%s\r\n" % (len(data), data)
