"""A browser without a screen or network: Debian's Chromium, which Playwright steers."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

NAMES = ("chromium-headless-shell", "chromium")
"""The commands by which Debian installs it."""

SOFTWARE = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
"""WebGL on the processor; the sandbox does not work in containers, and the page is our own."""

PATIENCE_MS = 120_000


@contextmanager
def browser() -> Iterator["Browser"]:  # noqa: F821  (playwright is loaded late)
    """Start a browser and end it; skip the test where Chromium is not installed."""
    found = next((path for path in map(shutil.which, NAMES) if path), None)
    if found is None:
        pytest.skip("Chromium is not installed; apt-get install chromium-headless-shell")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=found, args=list(SOFTWARE))
        try:
            yield started
        finally:
            started.close()
