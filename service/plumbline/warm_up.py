"""Compile every kernel into Numba's cache, so that none compiles at a first epoch: `make install` runs it."""

from plumbline import fusion, gnss, positioning, rtcm3


def main() -> None:
    """Warm up every package that has kernels."""
    for package in (rtcm3, gnss, fusion, positioning):
        package.warm_up()


if __name__ == "__main__":
    main()
