"""What several test modules share."""

import multiprocessing
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import runs
from filelock import FileLock
from places import MEDIAPIPE, SHARED
from threadpoolctl import threadpool_limits

from data_gen.models.ict import load_ict
from data_gen.models.openhead import load_openhead
from experiments.__main__ import prepare

prepare()  # before TensorFlow is loaded
_CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.hookimpl(trylast=True)  # once those that are not to run have left
def pytest_collection_modifyitems(items):
    """Make the run that several modules read first, and read it late, so that nobody waits.

    What is short comes last, lest one process works alone at the end.
    """
    readers = list(dict.fromkeys(i.path for i in items if "whole_bfm" in i.fixturenames))

    def place(item) -> int:
        if item.path in readers:
            return 0 if item.path == readers[0] else 2
        return 3 if "experiments" in item.path.parts else 1

    items.sort(key=place)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def head():
    return load_openhead()


@pytest.fixture(scope="session")
def ict():
    path = SHARED / "ict-facekit" / "ict_light.npz"
    if not path.is_file():
        pytest.skip("../shared/ict-facekit is absent")
    return load_ict(path)


@pytest.fixture(scope="session")
def paper():
    """The paper, in LaTeX."""
    path = SHARED / "paper.tex"
    if not path.exists():
        pytest.skip("../shared/paper.tex is absent")
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def apart():
    """Calls a function of a test module in another process, one that has not loaded TensorFlow."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield lambda function, *arguments: pool.submit(function, *arguments).result()


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Folder that tests only read, built once for all processes of pytest: `once(name, build)`."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent

    def once(name: str, build: Callable[[Path], object]) -> Path:
        folder, ready = root / name, root / f"{name}.ready"
        with FileLock(root / f"{name}.lock"):
            if not ready.exists():
                folder.mkdir()
                build(folder)
                ready.touch()
        return folder

    return once


@pytest.fixture(scope="session")
def whole_bfm(once):
    """Folder of the BFM experiment at the smallest size, as `make` leaves it; only to be read."""

    def build(folder):
        runs.make("reproduce-bfm", folder)
        runs.mark_as_done("reproduce-bfm", folder)

    return once("bfm", build)


@pytest.fixture(scope="session")
def whole_flame(once):
    """Folder of the FLAME experiment on the substitutes; without MediaPipe, without its rows."""
    variables = [] if MEDIAPIPE else ["MEDIAPIPE=no"]
    return once("flame", lambda folder: runs.make("reproduce-flame", folder, *variables))


@pytest.fixture(scope="session")
def whole_celeba(once, whole_bfm):
    """Folder of the CelebA experiment on the substitute, after the BFM track."""

    def build(folder):
        shutil.copytree(whole_bfm / "build", folder / "build")
        runs.make("reproduce-celeba", folder)

    return once("celeba", build)


@pytest.fixture(scope="module")
def one_thread():
    """For matrices so small that threads would only wait for each other."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session")
def launch():
    """Starts headless Chromiums, the one that the system has: `launch(*options)`."""
    from playwright.sync_api import sync_playwright

    chromium = next(filter(None, map(shutil.which, _CHROMIUM)), None)
    if chromium is None:
        pytest.skip("no Chromium on the path (Debian and Ubuntu: apt install chromium)")
    # Chromium's own sandbox refuses to run as root.
    needed = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as driver, ExitStack() as opened:

        def launch(*options: str):
            args = [*needed, *options]
            started = driver.chromium.launch(executable_path=chromium, args=args)
            opened.callback(started.close)
            return started

        yield launch


@pytest.fixture(scope="session")
def browser(launch):
    """A Chromium of `launch`."""
    return launch()


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
