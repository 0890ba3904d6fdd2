"""`python -m experiments STAGE [options]`: run one stage, as the Makefile does."""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module

from experiments.stages import STAGES

_MODULES = {stage.name: stage.module for stage in STAGES} | {
    "footprint": "bench.footprint",
    "make": "make",
    "pictures": "figures.doc_pictures",
    "report": "report.report",
    "show": "tracks.show",
    "surface": "pretrained.surface_errors",
}


def main(arguments: list[str] | None = None) -> None:
    arguments = sys.argv[1:] if arguments is None else arguments
    name = arguments[0] if arguments else "none"
    if name not in _MODULES:
        names = ", ".join(_MODULES)
        print(f"error: STAGE must be one of {names}. Received {name}.", file=sys.stderr)
        raise SystemExit(2)
    try:
        import_module(f"experiments.{_MODULES[name]}").main(arguments[1:])
        sys.stdout.flush()
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None
    except BrokenPipeError:  # who read the output, such as `head`, is gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(128 + signal.SIGPIPE) from None


if __name__ == "__main__":
    main()
