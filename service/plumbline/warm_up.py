"""Compile every kernel into Numba's cache, so that none compiles at a first epoch: `make install` runs it."""

from plumbline import rtcm3
from plumbline.fusion import warm_up as fusion
from plumbline.gnss import warm_up as gnss
from plumbline.positioning import warm_up as positioning


def main() -> None:
    """Warm up every package that has kernels."""
    rtcm3.warm_up()
    gnss.warm_up()
    positioning.warm_up()
    fusion()


if __name__ == "__main__":
    main()
