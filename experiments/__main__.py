"""`python -m experiments STAGE [options]`: run one stage, as the Makefile does."""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module

from experiments.stages import STAGES


def main(arguments: list[str] | None = None) -> None:
    arguments = sys.argv[1:] if arguments is None else arguments
    name = arguments[0] if arguments else "none"
    if name not in STAGES:
        print(f"error: STAGE must be one of {', '.join(STAGES)}. Received {name}.", file=sys.stderr)
        raise SystemExit(2)
    try:
        import_module(f"experiments.{STAGES[name]}").main(arguments[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # who read the output, such as `head`, is gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(128 + signal.SIGPIPE) from None


if __name__ == "__main__":
    main()
