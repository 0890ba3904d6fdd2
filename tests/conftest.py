"""What several test modules share."""

import multiprocessing
import os
import shutil
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import faults
import pytest
from threadpoolctl import threadpool_limits

# As `make` has it, before TensorFlow is loaded: sums in one order on every processor.
os.environ.setdefault("TF_ENABLE_ONEDNN_OPTS", "0")
_CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="session")
def apart():
    """Calls a function of a test module in another process, one that has not loaded TensorFlow."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield lambda function, *arguments: pool.submit(function, *arguments).result()


@pytest.fixture(scope="session")
def whole_bfm(tmp_path_factory):
    """The BFM experiment at the smallest size, which nothing disturbed: nobody may write to it.

    Scored without MobileFace, whose table is kept apart, then with it.
    """
    folder = tmp_path_factory.mktemp("whole")
    first = faults.measure(("faces", "networks", "predictions", "bfm"), folder)
    (table,) = (folder / "results").glob("*/*/bfm/table.csv")
    shutil.copy(table, folder / "without_mobileface.csv")
    second = faults.measure(("images", "mobileface", "bfm"), folder)
    return faults.Measured(folder, first.seconds | second.seconds, first.sizes | second.sizes)


@pytest.fixture(scope="module")
def one_thread():
    """For matrices so small that threads would only wait for each other."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium, the one that the system has."""
    playwright = pytest.importorskip("playwright.sync_api")
    chromium = next(filter(None, map(shutil.which, _CHROMIUM)), None)
    if chromium is None:
        pytest.skip("no Chromium on the path (Debian and Ubuntu: apt install chromium)")
    # Chromium's own sandbox refuses to run as root.
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=chromium, args=options)
        yield opened
        opened.close()


@pytest.fixture
def visit(browser):
    """Opens HTML files as readers do: `visit(path, **options of a browser context)` → page.

    Whatever the test does, no page may write to the console, raise or ask for anything but itself.
    """
    contexts, troubles = [], []

    def visit(path: Path, **options):
        address = path.resolve().as_uri()
        context = browser.new_context(offline=True, **options)
        contexts.append(context)
        context.set_default_timeout(10_000)
        page = context.new_page()
        page.on("console", lambda message: troubles.append(message.text))
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on(
            "request",
            lambda request: (
                request.url.startswith((address, "data:", "blob:"))
                or troubles.append(f"request of {request.url}")
            ),
        )
        page.goto(address)
        return page

    yield visit
    for context in contexts:
        context.close()
    assert troubles == []
