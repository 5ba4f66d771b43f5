"""Every byte of every stream on disk, before anybody else sees it: the log that live, take-over and replay all read.

    Archive       a directory of stream logs: append, read by offset or by receive time, recover, sync
    stream_log    one stream: hour files of bytes, each with an index of (offset, receive time, length, CRC)
    replay        several streams of an archive as one, in the order of their receive times

Layout: ``{root}/{station}/{YYYY}/{DDD}/{HH}.rtcm3`` and ``{HH}.index``, by GPS date and hour of the receive time, so
that no leap second ever writes an hour twice. (archive, station, offset) names every byte for ever.
"""

from plumbline.archive.archive import Archive
from plumbline.archive.replay import replay

__all__ = ["Archive", "replay"]
