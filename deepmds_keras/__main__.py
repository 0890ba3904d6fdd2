"""`deepmds`, the command: 3D face landmarks of photos, videos, or landmarks that are given."""

import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress

from deepmds_keras.errors import InputError, escape_unprintable
from deepmds_keras.tool.command.cli import parse, printable

_STOPPED = 130  # what shells expect of a command that Ctrl-C stopped


def main(arguments: list[str] | None = None) -> None:
    """Do what the arguments ask for, and end the process with the status that `--help` states."""
    options = vars(parse(arguments))
    _be_quiet()
    stopped = _stopped_by_ctrl_c()
    command, failed = options.pop("command"), 0
    try:
        if command == "evaluate":
            from deepmds_keras.tool.command.evaluation import evaluate

            evaluate(**options)
        elif command == "train":
            from deepmds_keras.tool.command.train import train

            train(**options)
        elif command == "export":
            from deepmds_keras.tool.command.onnx_export import export

            export(options["out"], options["model"], options["scheme"])
            print(f"{options['model']} → {options['out']}")
        elif command == "live":
            from deepmds_keras.tool.live.live_page import write_live_page

            write_live_page(**options)
            print(f"{options['path']}: open it in a browser.")
        else:
            # Not before: --help and wrong arguments are answered without its many imports.
            from deepmds_keras.tool.command.run import run

            failed = run(**options, stopped=stopped)
        print(end="", flush=True)  # there may be no output
    except (InputError, KeyboardInterrupt) as error:
        if isinstance(error, InputError) and not stopped():  # an import may fail by Ctrl-C
            sys.exit(f"error: {printable(str(error))}")
        resumes = command in ("predict", "train")
        print("Stopped." + " The same command goes on from here." * resumes, file=sys.stderr)
        sys.exit(_STOPPED)
    except OSError as error:  # of the output: who read it has seen enough, or the disk is full
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            sys.exit(1)
        place = printable(str(error.filename or "the output"))
        sys.exit(f"error: {place} cannot be written: {error.strerror}.")
    sys.exit(1 if failed else 0)


def _stopped_by_ctrl_c() -> Callable[[], bool]:
    """Whether Ctrl-C was pressed: what it raises may get lost in the library that it meets."""
    pressed = threading.Event()

    def interrupt(number, frame):
        pressed.set()
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, interrupt)
    return pressed.is_set


def _be_quiet() -> None:
    """Leaves the terminal to the command: no notices of TensorFlow, and no text that it refuses."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    os.environ.setdefault("TF_ENABLE_ONEDNN_OPTS", "0")  # its start-up notice; same sums everywhere
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    # Pillow's notices of odd metadata; the variable is for processes that this one starts. One of
    # them would list what those that Ctrl-C ended leave, which it removes.
    warnings.filterwarnings("ignore", module="PIL")
    warnings.filterwarnings("ignore", module="joblib")  # which counts what Ctrl-C cancelled
    os.environ.setdefault("PYTHONWARNINGS", "ignore:::PIL.TiffImagePlugin,ignore:resource_tracker")
    warnings.formatwarning = lambda message, *_, **__: f"note: {message}\n"
    escape_unprintable()


if __name__ == "__main__":
    main()
