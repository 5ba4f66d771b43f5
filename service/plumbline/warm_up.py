"""Compile every kernel into Numba's cache, so that none compiles at a first epoch: `make install` runs it."""

from plumbline import rtcm3
from plumbline.fusion.warm_up import warm_up as warm_up_fusion
from plumbline.gnss.warm_up import warm_up as warm_up_gnss
from plumbline.positioning.warm_up import warm_up as warm_up_positioning
from plumbline.quality.warm_up import warm_up as warm_up_quality


def main() -> None:
    """Warm up every package that has kernels."""
    rtcm3.warm_up()
    warm_up_gnss()
    warm_up_positioning()
    warm_up_fusion()
    warm_up_quality()


if __name__ == "__main__":
    main()
