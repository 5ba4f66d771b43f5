"""The device side of plumbline: what a GNSS receiver, its sensors and its modem send."""
