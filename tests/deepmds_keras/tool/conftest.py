"""What the tests of the tool share."""

import pytest
from writers.heads import drawn_heads

from deepmds_keras.__main__ import main
from deepmds_keras.tool.detection import DETECTORS, Detector


@pytest.fixture(scope="session")
def heads(apart):
    """Images of five open heads, and their 51 landmarks in pixels."""
    return apart(drawn_heads)


@pytest.fixture
def command(capsys):
    """Runs `deepmds` in this process: `command(*arguments)` → status, stdout, stderr."""

    def command(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main([*map(str, arguments)])
        status, (output, errors) = ended.value.code, capsys.readouterr()
        # Python prints a text that it is ended with, and the status is 1.
        return (1, output, errors + status) if isinstance(status, str) else (status, output, errors)

    return command


@pytest.fixture
def add_detector(monkeypatch):
    """Adds a detector of 68 landmarks: `add_detector(name, find)`."""

    def add_detector(name, find):
        row = Detector("ibug68", lambda _: find, lambda: True, "nobody's")
        monkeypatch.setitem(DETECTORS, name, row)

    return add_detector
