"""What `make demo` promises, as a person sees it: three stations receiving, live motion, an alert. Oracle: the page."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

playwright = pytest.importorskip("playwright.sync_api")

pytestmark = pytest.mark.browser
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
RECEIVING = ".state[data-state=receiving]"
FIRST_BURST_S = 45_000


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, float]]:
    """A running demo: its address, and when its server began to answer."""
    folder = tmp_path_factory.mktemp("demo")
    port = free_port()
    command = [Path(sys.executable).with_name("plumbline-dtu"), "demo", "--http-port", str(port)]
    command += ["--ingest-port", str(free_port()), "--data-dir", str(folder / "data")]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | {"PYTHONUNBUFFERED": "1"})
    address = f"http://127.0.0.1:{port}/"
    try:
        deadline = time.monotonic() + 60
        while True:
            assert process.poll() is None, (folder / "log").read_text()
            assert time.monotonic() < deadline, (folder / "log").read_text()
            try:
                with urllib.request.urlopen(f"{address}healthz", timeout=1):
                    break
            except OSError:
                time.sleep(0.1)
        yield address, time.monotonic()
        assert process.poll() is None, (folder / "log").read_text()
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=60)
    assert "Traceback" not in (folder / "log").read_text()


@pytest.fixture(scope="module")
def page(demo: tuple[str, float]) -> Iterator["playwright.Page"]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    with playwright.sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page()
        page.goto(demo[0])
        yield page
        browser.close()


def test_three_stations_receive_within_ten_seconds(demo: tuple[str, float], page: "playwright.Page") -> None:
    page.wait_for_function(f"document.querySelectorAll('{RECEIVING}').length === 3", timeout=30_000)
    assert time.monotonic() - demo[1] < 10.0
    page.wait_for_function("document.getElementById('summary').textContent.startsWith('3 of 3 receiving')")


def test_each_station_draws_its_live_motion(page: "playwright.Page") -> None:
    points = "[...document.querySelectorAll('.chart')].map(c => +(c.dataset.points ?? 0))"
    page.wait_for_function(f"{points}.length === 3 && {points}.every(n => n > 40)", timeout=30_000)
    before = page.evaluate(points)
    page.wait_for_timeout(3_000)
    assert all(later > earlier for earlier, later in zip(before, page.evaluate(points), strict=True))
    readouts = page.locator("article .readout b").all_inner_texts()
    assert len(readouts) == 9
    assert all(re.fullmatch(r"−?-?\d+\.\d mm", text) for text in readouts), readouts


def test_the_shaking_station_raises_an_alert_and_the_others_do_not(page: "playwright.Page") -> None:
    page.wait_for_selector(".alert[data-station=main-span]", timeout=FIRST_BURST_S)
    assert "acceleration" in page.inner_text(".alert[data-station=main-span]")
    assert page.locator(".alert:not([data-station=main-span])").count() == 0
